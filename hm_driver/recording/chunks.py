"""A chunk of an MCAP file in the making.

The library's own chunk builder takes 5 to 10 µs a message, and a session in lock-step makes 75 000 messages a
second; this one writes the same bytes in about 1 µs.
"""

import struct
from array import array
from collections.abc import Sequence

from mcap.opcode import Opcode

MESSAGE_HEADER = struct.Struct("<BQHIQQ")
"""Opcode, length, channel, sequence, log time and publish time of a message record."""

_RECORD_HEADER = struct.Struct("<BQ")
_INDEX_HEADER = struct.Struct("<HI")
_LENGTH_OF_FIXED_PART = MESSAGE_HEADER.size - _RECORD_HEADER.size
_MESSAGE = int(Opcode.MESSAGE)


class ChunkBuilder:
    """Messages of one chunk and the index of each channel in it."""

    def __init__(self) -> None:
        self.data = bytearray()
        """The message records, uncompressed."""
        self.messages = 0
        """How many there are."""
        self.counts: dict[int, int] = {}
        """Messages written so far on each channel; goes on from chunk to chunk."""
        self.sequences: dict[int, int] = {}
        """Next sequence number of each channel: a gap is a message that was lost."""
        self.start_time_ns = 0
        self.end_time_ns = 0
        self._indexes: dict[int, array[int]] = {}

    def add(self, channel: int, log_time_ns: int, payload: bytes, skipped: int = 0) -> None:
        """Append one message; its MCAP sequence number counts its channel's, skipped ones included.

        Args:
            channel: Id of the channel.
            log_time_ns: Time of the message [ns].
            payload: The message.
            skipped: Messages of this channel that were lost just before this one.
        """
        self.counts[channel] = self.counts.get(channel, 0) + 1
        sequence = self.sequences.get(channel, 0) + skipped
        self.sequences[channel] = sequence + 1
        index = self._indexes.get(channel)
        if index is None:
            index = self._indexes[channel] = array("Q")
        index.append(log_time_ns)
        index.append(len(self.data))
        self._widen(log_time_ns)
        self.messages += 1
        self.data += MESSAGE_HEADER.pack(
            _MESSAGE,
            _LENGTH_OF_FIXED_PART + len(payload),
            channel,
            sequence & 0xFFFFFFFF,
            log_time_ns,
            log_time_ns,
        )
        self.data += payload

    def add_bundle(
        self, slices: Sequence[tuple[int, int, int]], log_time_ns: int, payload: bytes, skipped: int = 0
    ) -> None:
        """Append the messages of a bundle; slices are channel, start and end of each in the payload."""
        for channel, start, end in slices:
            self.add(channel, log_time_ns, payload[start:end], skipped)

    def _widen(self, log_time_ns: int) -> None:
        if not self.messages:
            self.start_time_ns = self.end_time_ns = log_time_ns
        elif log_time_ns > self.end_time_ns:
            self.end_time_ns = log_time_ns
        elif log_time_ns < self.start_time_ns:
            self.start_time_ns = log_time_ns

    def index_records(self) -> dict[int, bytes]:
        """The message index record of each channel: pairs of log time and offset."""
        records = {}
        for channel, index in self._indexes.items():
            body = _INDEX_HEADER.pack(channel, 8 * len(index)) + index.tobytes()
            records[channel] = _RECORD_HEADER.pack(Opcode.MESSAGE_INDEX, len(body)) + body
        return records

    def clear(self) -> None:
        """Begin the next chunk."""
        self.data = bytearray()
        self.messages = 0
        self._indexes = {}

"""An MCAP file as a container: where its chunks, schemas, attachments and metadata are.

A complete file is read by its summary. One without (truncated, or still being written) is walked record by
record; what stands before the cut is used.
"""

import io
import struct
import zlib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TypeVar

import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.stream_reader import get_chunk_data_stream
from mcap.writer import MCAP0_MAGIC

from hm_driver.errors import RecordingError
from hm_driver.recording.chunks import MESSAGE_HEADER

_RECORD_HEADER = struct.Struct("<BQ")
_FOOTER = struct.Struct("<BQQQI")
_CHUNK_INDEX = struct.Struct("<QQQQI")
_CHANNEL_OFFSET = struct.Struct("<HQ")
_LENGTH = struct.Struct("<Q")
_DATA_END = struct.Struct("<I")
_CHUNK_HEAD = struct.Struct("<QQQI")
_READ_BYTES = 1 << 20
_LARGEST_CHUNK = 1 << 31
_UNREADABLE = (struct.error, UnicodeDecodeError, McapError, OverflowError, ValueError, MemoryError)

R = TypeVar("R")


@dataclass(frozen=True, slots=True, kw_only=True)
class ChunkPlace:
    """Where a chunk stands and what it covers."""

    offset: int
    """Where its record begins in the file [B]."""
    start_time_ns: int
    """Earliest log time in it."""
    end_time_ns: int
    """Latest log time in it."""
    index_offsets: dict[int, int]
    """Where the message index of each channel stands; empty where there is none."""
    index_span: tuple[int, int] = (0, 0)
    """Where all of them stand, offset and length; no length where that is not known."""


@dataclass(slots=True)
class Contents:
    """What a file holds."""

    schemas: dict[int, records.Schema] = field(default_factory=dict)
    channels: dict[int, records.Channel] = field(default_factory=dict)
    chunks: list[ChunkPlace] = field(default_factory=list)
    attachments: list[int] = field(default_factory=list)
    """Offsets of the attachment records."""
    metadata: list[int] = field(default_factory=list)
    """Offsets of the metadata records."""
    counts: dict[int, int] | None = None
    """Messages by channel, where the file says so."""
    data_end: int = 0
    """Offset of the record that ends the data and holds their checksum; 0 where there is none."""
    damage: str = ""
    """Why the file is not whole; empty where it is."""


class Container:
    """An MCAP file, open for reading.

    Args:
        path: The file.

    Raises:
        RecordingError: if it is missing, empty, or no MCAP file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        try:
            self._file = self.path.open("rb")
        except OSError as error:
            raise RecordingError(f"{self.path} cannot be opened: {error.strerror or error}") from error
        try:
            self.size = self._file.seek(0, io.SEEK_END)
            self._check_magic()
            self.contents = self._read_summary() or self._walk()
        except BaseException:
            self._file.close()
            raise

    def close(self) -> None:
        """Close the file; idempotent."""
        self._file.close()

    def read(self, offset: int, length: int) -> bytes:
        """Bytes of the file; fewer at its end."""
        self._file.seek(offset)
        return self._file.read(min(length, max(0, self.size - offset)))

    def record(self, kind: type[R], offset: int) -> R:
        """The record at an offset.

        Raises:
            RecordingError: if it is damaged.
        """
        opcode, length = self._header(offset)
        if opcode == 0:
            raise RecordingError(f"{self.path}: the record at byte {offset} is cut off")
        return self._parse(kind, self.read(offset + _RECORD_HEADER.size, length), offset)

    def attachment(self, offset: int) -> records.Attachment:
        """The attachment at an offset.

        Raises:
            RecordingError: if its checksum is wrong.
        """
        attachment = self.record(records.Attachment, offset)
        _, length = self._header(offset)
        body = self.read(offset + _RECORD_HEADER.size, length)
        checksum = int.from_bytes(body[-4:], "little")
        if checksum and zlib.crc32(body[:-4]) != checksum:
            raise RecordingError(f"{self.path}: the attachment {attachment.name} is damaged: wrong checksum")
        return attachment

    def chunk(self, place: ChunkPlace) -> bytes:
        """The uncompressed records of a chunk.

        Raises:
            RecordingError: if its checksum or its compressed data is wrong.
        """
        chunk = self.record(records.Chunk, place.offset)
        try:
            if chunk.compression == "zstd":
                data = _decompress(chunk.data, chunk.uncompressed_size)
            else:
                stream, length = get_chunk_data_stream(chunk)
                data = bytes(stream.read(length))
        except (zstandard.ZstdError, RuntimeError, *_UNREADABLE) as error:
            raise RecordingError(
                f"{self.path}: the chunk at byte {place.offset} is damaged: {error}"
            ) from error
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise RecordingError(f"{self.path}: the chunk at byte {place.offset} is damaged: wrong checksum")
        return data

    def has_right_checksum(self) -> bool:
        """Whether all that stands before the summary bears out its checksum, if the file has one."""
        end = self.contents.data_end
        opcode, length = self._header(end) if end else (0, 0)
        if opcode != Opcode.DATA_END or length != _DATA_END.size:
            return not end
        (expected,) = _DATA_END.unpack(self.read(end + _RECORD_HEADER.size, length))
        checksum = 0
        for offset in range(0, end, _READ_BYTES):
            checksum = zlib.crc32(self.read(offset, min(_READ_BYTES, end - offset)), checksum)
        return expected in (0, checksum)

    def message_offsets(self, place: ChunkPlace) -> bytes:
        """Pairs of log time and offset (u64, little endian) of a chunk's messages, as its index has them."""
        pairs = []
        if place.index_span[1]:
            data = self.read(*place.index_span)
            return b"".join(
                data[start + 6 : end]
                for opcode, start, end in split_records(data)
                if opcode == Opcode.MESSAGE_INDEX and (end - start) % 16 == 6
            )
        for offset in place.index_offsets.values():
            opcode, length = self._header(offset)
            body = self.read(offset + _RECORD_HEADER.size, length) if opcode == Opcode.MESSAGE_INDEX else b""
            pairs.append(body[6:] if len(body) % 16 == 6 else b"")
        return b"".join(pairs)

    def _check_magic(self) -> None:
        start = self.read(0, len(MCAP0_MAGIC))
        if not start:
            raise RecordingError(f"{self.path} is empty")
        if start != MCAP0_MAGIC:
            raise RecordingError(f"{self.path} is no MCAP file: it begins with {start!r}")

    def _header(self, offset: int) -> tuple[int, int]:
        """Opcode and length of a record; opcode 0 where it does not fit into the file."""
        header = self.read(offset, _RECORD_HEADER.size)
        if len(header) < _RECORD_HEADER.size:
            return 0, 0
        opcode, length = _RECORD_HEADER.unpack(header)
        if offset + _RECORD_HEADER.size + length > self.size:
            return 0, 0
        return opcode, length

    def _parse(self, kind: type[R], body: bytes, offset: int) -> R:
        try:
            record: R = kind.read(ReadDataStream(io.BytesIO(body)))  # type: ignore[attr-defined]  # each record has it
        except _UNREADABLE as error:
            raise RecordingError(f"{self.path}: the record at byte {offset} is damaged: {error}") from error
        return record

    def _read_summary(self) -> Contents | None:
        """Contents by the summary section; None where there is none or its checksum is wrong."""
        end = self.size - len(MCAP0_MAGIC)
        if self.read(end, len(MCAP0_MAGIC)) != MCAP0_MAGIC:
            return None
        footer_at = end - _FOOTER.size
        footer = self.read(footer_at, _FOOTER.size) if footer_at > 0 else b""
        if len(footer) < _FOOTER.size:
            return None
        opcode, length, start, _, crc = _FOOTER.unpack(footer)
        if opcode != Opcode.FOOTER or length != _FOOTER.size - 9 or not 0 < start <= footer_at:
            return None
        summary = self.read(start, footer_at - start)
        if crc and zlib.crc32(summary + footer[:-4]) != crc:
            return None
        try:
            contents = self._parse_summary(summary, start)
        except RecordingError:
            return None
        contents.data_end = start - _RECORD_HEADER.size - _DATA_END.size
        has_messages = any((contents.counts or {}).values())
        return contents if contents.chunks or not has_messages else None

    def _parse_summary(self, summary: bytes, start: int) -> Contents:
        contents = Contents()
        position = 0
        while position + _RECORD_HEADER.size <= len(summary):
            opcode, length = _RECORD_HEADER.unpack_from(summary, position)
            body = summary[position + _RECORD_HEADER.size : position + _RECORD_HEADER.size + length]
            self._take_summary_record(contents, opcode, body, start + position)
            position += _RECORD_HEADER.size + length
        return contents

    def _take_summary_record(self, contents: Contents, opcode: int, body: bytes, offset: int) -> None:
        if opcode == Opcode.SCHEMA:
            self._take_schema(contents, body, offset)
        elif opcode == Opcode.CHANNEL:
            self._take_channel(contents, body, offset)
        elif opcode == Opcode.STATISTICS:
            contents.counts = dict(self._parse(records.Statistics, body, offset).channel_message_counts)
        elif opcode == Opcode.ATTACHMENT_INDEX:
            contents.attachments.append(self._parse(records.AttachmentIndex, body, offset).offset)
        elif opcode == Opcode.METADATA_INDEX:
            contents.metadata.append(self._parse(records.MetadataIndex, body, offset).offset)
        elif opcode == Opcode.CHUNK_INDEX:
            self._take_chunk_index(contents, body, offset)

    def _take_chunk_index(self, contents: Contents, body: bytes, offset: int) -> None:
        """Read by hand: a large log has ten thousand of these, and they decide how soon it is open."""
        try:
            first, last, at, length, size = _CHUNK_INDEX.unpack_from(body)
            map_end = _CHUNK_INDEX.size + size
            offsets = dict(_CHANNEL_OFFSET.iter_unpack(body[_CHUNK_INDEX.size : map_end]))
            (index_length,) = _LENGTH.unpack_from(body, map_end)
        except struct.error as error:
            raise RecordingError(f"{self.path}: the record at byte {offset} is damaged: {error}") from error
        start, end = _span(contents, first, last)
        contents.chunks.append(
            ChunkPlace(
                offset=at,
                start_time_ns=start,
                end_time_ns=end,
                index_offsets=offsets,
                index_span=(at + length, index_length),
            )
        )

    def _take_schema(self, contents: Contents, body: bytes, offset: int) -> None:
        schema = self._parse(records.Schema, body, offset)
        contents.schemas[schema.id] = schema

    def _take_channel(self, contents: Contents, body: bytes, offset: int) -> None:
        channel = self._parse(records.Channel, body, offset)
        contents.channels[channel.id] = channel

    def _walk(self) -> Contents:
        """Contents record by record, up to the end or to the first record that makes no sense."""
        contents = Contents()
        position = len(MCAP0_MAGIC)
        contents.damage = "it has no end"
        while True:
            opcode, length = self._header(position)
            if opcode == 0:
                if position < self.size:
                    contents.damage = f"it is cut off in a record at byte {position} of {self.size}"
                break
            if opcode == Opcode.DATA_END:
                contents.damage = "its summary is damaged"
                break
            try:
                self._take_record(contents, opcode, position, length)
            except RecordingError as error:
                contents.damage = str(error)
                break
            position += _RECORD_HEADER.size + length
        if opcode != Opcode.DATA_END and contents.chunks:
            contents.chunks[-1].index_offsets.clear()  # it may be cut off between two channels
        self._find_channels_in_chunks(contents)
        return contents

    def _take_record(self, contents: Contents, opcode: int, offset: int, length: int) -> None:
        body_at = offset + _RECORD_HEADER.size
        if opcode == Opcode.SCHEMA:
            self._take_schema(contents, self.read(body_at, length), offset)
        elif opcode == Opcode.CHANNEL:
            self._take_channel(contents, self.read(body_at, length), offset)
        elif opcode == Opcode.ATTACHMENT:
            contents.attachments.append(offset)
        elif opcode == Opcode.METADATA:
            contents.metadata.append(offset)
        elif opcode == Opcode.MESSAGE_INDEX and contents.chunks and length >= 6:
            channel = int.from_bytes(self.read(body_at, 2), "little")
            contents.chunks[-1].index_offsets[channel] = offset
        elif opcode == Opcode.MESSAGE:
            raise RecordingError("it has messages outside of chunks, which are not read")
        elif opcode == Opcode.CHUNK and length >= _CHUNK_HEAD.size:
            first, last, _, _ = _CHUNK_HEAD.unpack(self.read(body_at, _CHUNK_HEAD.size))
            start, end = _span(contents, first, last)
            contents.chunks.append(
                ChunkPlace(offset=offset, start_time_ns=start, end_time_ns=end, index_offsets={})
            )

    def _find_channels_in_chunks(self, contents: Contents) -> None:
        """Other writers declare channels inside chunks: look where an index names one that is not known."""
        for place in contents.chunks:
            if place.index_offsets and contents.channels.keys() >= place.index_offsets.keys():
                continue
            try:
                data = self.chunk(place)
            except RecordingError:
                continue  # reading it will say so
            for opcode, start, end in split_records(data):
                if opcode == Opcode.SCHEMA:
                    self._take_schema(contents, data[start:end], place.offset)
                elif opcode == Opcode.CHANNEL:
                    self._take_channel(contents, data[start:end], place.offset)


def _span(contents: Contents, start: int, end: int) -> tuple[int, int]:
    """The times that a chunk says it covers, without a checksum; those before where they cannot be."""
    if 0 <= start <= end < 1 << 63:
        return start, end
    before = contents.chunks[-1].end_time_ns if contents.chunks else 0
    return before, before


def split_records(data: bytes) -> list[tuple[int, int, int]]:
    """Opcode, start and end of the body of each record in a chunk."""
    found = []
    position, size = 0, len(data)
    while position + _RECORD_HEADER.size <= size:
        opcode, length = _RECORD_HEADER.unpack_from(data, position)
        start = position + _RECORD_HEADER.size
        position = start + length
        if position > size:
            break
        found.append((opcode, start, position))
    return found


def walk_messages(data: bytes) -> list[int]:
    """Offsets of the message records in a chunk, found by walking it."""
    shortest = MESSAGE_HEADER.size - _RECORD_HEADER.size
    return [
        start - _RECORD_HEADER.size
        for opcode, start, end in split_records(data)
        if opcode == Opcode.MESSAGE and end - start >= shortest
    ]


def _decompress(data: bytes, size: int) -> bytes:
    declared = zstandard.frame_content_size(data)
    if size > _LARGEST_CHUNK or declared not in (-1, size):
        raise ValueError(f"it claims to hold {declared} B of {size} B")
    return zstandard.ZstdDecompressor().decompress(data, max_output_size=size)

"""Making a whole file of a truncated or damaged one."""

import struct
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from mcap import records
from mcap.opcode import Opcode

from hm_driver.errors import RecordingError
from hm_driver.recording.chunks import MESSAGE_HEADER
from hm_driver.recording.container import Container, walk_messages
from hm_driver.recording.writer import Attachment, LogWriter

_PAIR = struct.Struct("<QQ")
_INDEX = struct.Struct("<BQHI")


@dataclass(frozen=True, slots=True, kw_only=True)
class Recovery:
    """What was saved."""

    messages: int
    """Messages in the new file."""
    chunks: int
    """Chunks copied."""
    damaged: tuple[str, ...]
    """What had to be left out, and why; empty where nothing was."""


def recover(source: str | Path, target: str | Path) -> Recovery:
    """Copy everything that can be read into a new, whole file.

    Args:
        source: A log, truncated or damaged.
        target: The new log; it must not exist.

    Raises:
        RecordingError: if the source is no MCAP file or holds nothing, or the target cannot be made.
    """
    container = Container(source)
    try:
        contents = container.contents
        if not contents.chunks and not contents.channels:
            raise RecordingError(f"{source}: there is nothing to recover: {contents.damage or 'it is empty'}")
        damaged = [contents.damage] if contents.damage else []
        with LogWriter(target, ()) as writer:
            for schema in contents.schemas.values():
                writer.copy_schema(schema)
            for channel in contents.channels.values():
                writer.copy_channel(channel)
            damaged += _copy_extras(container, writer)
            copied = 0
            for place in contents.chunks:
                try:
                    data = container.chunk(place)
                except RecordingError as error:
                    damaged.append(str(error))
                    continue
                indexes, counts = _index(data)
                writer.copy_chunk(container.record(records.Chunk, place.offset), indexes, counts)
                copied += 1
        return Recovery(messages=writer.messages_written, chunks=copied, damaged=tuple(damaged))
    finally:
        container.close()


def _copy_extras(container: Container, writer: LogWriter) -> list[str]:
    """Copy metadata and attachments; returns what could not be copied."""
    damaged = []
    for offset in container.contents.metadata:
        try:
            metadata = container.record(records.Metadata, offset)
            writer.add_metadata(metadata.name, metadata.metadata)
        except RecordingError as error:
            damaged.append(str(error))
    for offset in container.contents.attachments:
        try:
            found = container.attachment(offset)
            writer.add_attachment(Attachment(found.name, found.media_type, found.data))
        except RecordingError as error:
            damaged.append(str(error))
    return damaged


def _index(data: bytes) -> tuple[dict[int, bytes], dict[int, int]]:
    """Message index records and message counts of a chunk, by channel."""
    pairs: defaultdict[int, list[bytes]] = defaultdict(list)
    for offset in walk_messages(data):
        _, _, channel, _, log_time_ns, _ = MESSAGE_HEADER.unpack_from(data, offset)
        pairs[channel].append(_PAIR.pack(log_time_ns, offset))
    indexes = {
        channel: _INDEX.pack(Opcode.MESSAGE_INDEX, 6 + 16 * len(found), channel, 16 * len(found))
        + b"".join(found)
        for channel, found in pairs.items()
    }
    return indexes, {channel: len(found) for channel, found in pairs.items()}

"""Writing an MCAP file: indexed, compressed, with checksums, readable up to the last flush in any case."""

import os
import zlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from enum import Enum
from io import FileIO
from pathlib import Path

import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC

from hm_driver.errors import RecordingError
from hm_driver.recording.chunks import ChunkBuilder
from hm_driver.recording.schemas import Channel
from hm_driver.version import __version__


class Compression(Enum):
    """How chunks are compressed."""

    NONE = ""
    """Not at all."""
    ZSTD = "zstd"
    """Small; level 1."""


@dataclass(frozen=True, slots=True)
class Attachment:
    """A file inside the log, such as the configuration of the session.

    Args:
        name: Name of the file, as ``config.json``.
        media_type: Its MIME type.
        data: Its bytes.
    """

    name: str
    media_type: str
    data: bytes


def _compressor(compression: Compression) -> Callable[[bytes], bytes]:
    if compression is Compression.ZSTD:
        return zstandard.ZstdCompressor(level=1).compress
    return bytes


def _take(builder: RecordBuilder) -> bytes:
    data: bytes = builder.end()  # type: ignore[no-untyped-call]  # the library left it without annotations
    return data


class LogWriter:
    """One MCAP file that does not exist yet.

    Schemas, channels, attachments and metadata are written and synced at once: a truncated file has them.

    Args:
        path: Where it goes.
        channels: Every channel that will be written.
        metadata: Records of metadata, by name.
        attachments: Files inside the log.
        compression: How chunks are compressed.
        chunk_bytes: Size at which a chunk ends, uncompressed [B].

    Raises:
        RecordingError: if the file exists or cannot be made.
    """

    def __init__(
        self,
        path: str | Path,
        channels: Iterable[Channel],
        *,
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        attachments: Iterable[Attachment] = (),
        compression: Compression = Compression.ZSTD,
        chunk_bytes: int = 1 << 18,
    ) -> None:
        self.path = Path(path)
        self.chunk = ChunkBuilder()
        self._compression = compression
        self._compress = _compressor(compression)
        self.chunk_bytes = chunk_bytes
        self.bytes_written = 0
        """Bytes in the file so far."""
        self.messages_written = 0
        """Messages in the file so far; those of the chunk in progress are not."""
        self._crc = 0
        self._schemas: list[records.Schema] = []
        self._channels: list[records.Channel] = []
        self._chunk_indexes: list[records.ChunkIndex] = []
        self._attachment_indexes: list[records.AttachmentIndex] = []
        self._metadata_indexes: list[records.MetadataIndex] = []
        self._span: tuple[int, int] | None = None
        self._file = self._create()
        try:
            self._write(MCAP0_MAGIC)
            self._write_record(records.Header(profile="", library=f"hapticmaster-stack {__version__}"))
            for channel in channels:
                self._add_channel(channel)
            for name, values in (metadata or {}).items():
                self.add_metadata(name, values)
            for attachment in attachments:
                self.add_attachment(attachment)
            self.sync()
        except BaseException:
            self._file.close()
            raise

    def _create(self) -> FileIO:
        try:
            return self.path.open("xb", buffering=0)
        except FileExistsError as error:
            raise RecordingError(f"{self.path} exists already; choose another name or remove it") from error
        except OSError as error:
            raise RecordingError(f"{self.path} cannot be made: {error.strerror or error}") from error

    @property
    def counts(self) -> dict[int, int]:
        """Messages so far, by channel id."""
        return dict(self.chunk.counts)

    def add(self, channel: int, log_time_ns: int, payload: bytes) -> None:
        """Append a message; raises OSError where the disk fails."""
        self.chunk.add(channel, log_time_ns, payload)
        self.end_full_chunk()

    def end_full_chunk(self) -> None:
        """Write the chunk if it has its size; for those who fill `chunk` themselves."""
        if len(self.chunk.data) >= self.chunk_bytes:
            self.end_chunk()

    def end_chunk(self) -> None:
        """Write the chunk in progress, if it holds anything."""
        chunk = self.chunk
        if not chunk.messages:
            return
        data = bytes(chunk.data)
        record = records.Chunk(
            compression=self._compression.value,
            data=self._compress(data),
            message_start_time=chunk.start_time_ns,
            message_end_time=chunk.end_time_ns,
            uncompressed_crc=zlib.crc32(data),
            uncompressed_size=len(data),
        )
        self._write_chunk(record, chunk.index_records())
        self.messages_written += chunk.messages
        chunk.clear()

    def copy_chunk(self, chunk: records.Chunk, indexes: dict[int, bytes], counts: Mapping[int, int]) -> None:
        """Append a chunk of another file as it is, with its index records and message counts by channel."""
        self.end_chunk()
        self._write_chunk(chunk, indexes)
        for channel, count in counts.items():
            self.chunk.counts[channel] = self.chunk.counts.get(channel, 0) + count
            self.messages_written += count

    def _write_chunk(self, chunk: records.Chunk, indexes: dict[int, bytes]) -> None:
        offset = self.bytes_written
        self._write_record(chunk)
        index_start = self.bytes_written
        offsets = {}
        for channel, index in indexes.items():
            offsets[channel] = self.bytes_written
            self._write(index)
        start, end = chunk.message_start_time, chunk.message_end_time
        self._chunk_indexes.append(
            records.ChunkIndex(
                chunk_length=index_start - offset,
                chunk_start_offset=offset,
                compression=chunk.compression,
                compressed_size=len(chunk.data),
                message_end_time=end,
                message_index_length=self.bytes_written - index_start,
                message_index_offsets=offsets,
                message_start_time=start,
                uncompressed_size=chunk.uncompressed_size,
            )
        )
        first, last = self._span or (start, end)
        self._span = min(first, start), max(last, end)

    def sync(self) -> None:
        """Write what there is and wait until the disk has it: a power cut loses nothing before this."""
        self.end_chunk()
        os.fsync(self._file.fileno())

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a record of metadata."""
        offset = self.bytes_written
        self._write_record(records.Metadata(name=name, metadata=dict(values)))
        length = self.bytes_written - offset
        self._metadata_indexes.append(records.MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, attachment: Attachment) -> None:
        """Write a file into the log."""
        offset = self.bytes_written
        self._write_record(
            records.Attachment(
                create_time=0,
                log_time=0,
                name=attachment.name,
                media_type=attachment.media_type,
                data=attachment.data,
            )
        )
        self._attachment_indexes.append(
            records.AttachmentIndex(
                offset=offset,
                length=self.bytes_written - offset,
                log_time=0,
                create_time=0,
                data_size=len(attachment.data),
                name=attachment.name,
                media_type=attachment.media_type,
            )
        )

    def finish(self) -> None:
        """Write the summary that lets readers seek, and close the file; idempotent."""
        if self._file.closed:
            return
        self.end_chunk()
        self._write_record(records.DataEnd(data_section_crc=self._crc))
        self._write(self._summary(self.bytes_written))
        self._write(MCAP0_MAGIC)
        os.fsync(self._file.fileno())
        self._file.close()

    def abandon(self) -> None:
        """Close the file as it is, without a summary; idempotent."""
        self._file.close()

    def __enter__(self) -> "LogWriter":
        return self

    def __exit__(self, error: object, *_: object) -> None:
        if error is None:
            self.finish()
        else:
            self.abandon()

    def _add_channel(self, channel: Channel) -> None:
        name = channel.message.full_name
        schema = next((one for one in self._schemas if one.name == name), None)
        if schema is None:
            data = channel.message.file_descriptor_set()
            schema = records.Schema(id=len(self._schemas) + 1, data=data, encoding="protobuf", name=name)
            self.copy_schema(schema)
        self.copy_channel(
            records.Channel(
                id=channel.id,
                topic=channel.topic,
                message_encoding="protobuf",
                metadata={},
                schema_id=schema.id,
            )
        )

    def copy_schema(self, schema: records.Schema) -> None:
        """Append a schema of another file as it is."""
        self._schemas.append(schema)
        self._write_record(schema)

    def copy_channel(self, channel: records.Channel) -> None:
        """Append a channel of another file as it is; its schema comes first."""
        self._channels.append(channel)
        self._write_record(channel)

    def _summary(self, start: int) -> bytes:
        builder = RecordBuilder()
        offsets = []
        groups: tuple[tuple[Opcode, list[records.McapRecord]], ...] = (
            (Opcode.SCHEMA, [*self._schemas]),
            (Opcode.CHANNEL, [*self._channels]),
            (Opcode.STATISTICS, [self._statistics()]),
            (Opcode.CHUNK_INDEX, [*self._chunk_indexes]),
            (Opcode.ATTACHMENT_INDEX, [*self._attachment_indexes]),
            (Opcode.METADATA_INDEX, [*self._metadata_indexes]),
        )
        for opcode, group in groups:
            before = builder.count
            for record in group:
                record.write(builder)
            if group:
                offsets.append(
                    records.SummaryOffset(
                        group_opcode=opcode, group_start=start + before, group_length=builder.count - before
                    )
                )
        offset_start = start + builder.count
        for offset in offsets:
            offset.write(builder)
        data = _take(builder)
        footer = records.Footer(summary_start=start, summary_offset_start=offset_start, summary_crc=0)
        footer.write(builder)
        without_crc = _take(builder)[:-4]
        crc = zlib.crc32(without_crc, zlib.crc32(data))
        return data + without_crc + crc.to_bytes(4, "little")

    def _statistics(self) -> records.Statistics:
        start, end = self._span or (0, 0)
        return records.Statistics(
            attachment_count=len(self._attachment_indexes),
            channel_count=len(self._channels),
            channel_message_counts=self.counts,
            chunk_count=len(self._chunk_indexes),
            message_count=sum(self.chunk.counts.values()),
            metadata_count=len(self._metadata_indexes),
            message_start_time=start,
            message_end_time=end,
            schema_count=len(self._schemas),
        )

    def _write_record(self, record: records.McapRecord) -> None:
        builder = RecordBuilder()
        record.write(builder)
        self._write(_take(builder))

    def _write(self, data: bytes) -> None:
        self._crc = zlib.crc32(data, self._crc)
        with memoryview(data) as rest:
            done = 0
            while done < len(data):
                done += self._file.write(rest[done:])
        self.bytes_written += len(data)

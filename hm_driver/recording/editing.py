"""New logs made of others: a piece of one, or several in one. The sources are never changed."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from mcap import records

from hm_driver.errors import RecordingError
from hm_driver.recording.reader import Recording
from hm_driver.recording.writer import Attachment, LogWriter


def cut(
    source: str | Path,
    target: str | Path,
    start: float | None = None,
    end: float | None = None,
    *,
    topics: Iterable[str] | None = None,
) -> int:
    """Copy a piece of a log into a new one, with its attachments and metadata.

    Args:
        source: A log; all its parts are read.
        target: The new log; it must not exist.
        start: First time, in seconds from the beginning of the log.
        end: Time at which to stop, that time not included.
        topics: Names of the topics to keep; all where None.

    Returns:
        The number of messages copied.

    Raises:
        RecordingError: if the source cannot be read, the range lies outside of it, a topic is not there, or
            the target cannot be made.
    """
    with Recording(source) as recording:
        blocks = recording.blocks(topics, start, end)
        with LogWriter(target, ()) as writer:
            copier = _Copier(writer)
            copier.begin(recording, recording.topics if topics is None else tuple(topics))
            for topic, block in blocks:
                copier.add(topic, block.times.tolist(), block.payloads, block.sequences.tolist())
            writer.add_metadata(
                "cut", {"source": recording.path.name, "start_s": str(start), "end_s": str(end)}
            )
        return writer.messages_written


def merge(sources: Sequence[str | Path], target: str | Path) -> int:
    """Copy several logs, each with all its parts, into a new one; viewers order it by time.

    Args:
        sources: The logs. A topic that several have must be of the same schema in each.
        target: The new log; it must not exist.

    Returns:
        The number of messages copied.

    Raises:
        RecordingError: if a source cannot be read, a topic's schemas differ, or the target cannot be made.
    """
    recordings: list[Recording] = []
    try:
        recordings += [Recording(source) for source in sources]
        _check_schemas(recordings)
        with LogWriter(target, ()) as writer:
            copier = _Copier(writer)
            for recording in sorted(recordings, key=lambda one: one.start_time_ns):
                copier.begin(recording, recording.topics)
                for topic, block in recording.blocks():
                    copier.add(topic, block.times.tolist(), block.payloads, None)
        return writer.messages_written
    finally:
        for recording in recordings:
            recording.close()


def _check_schemas(recordings: Iterable[Recording]) -> None:
    known: dict[str, tuple[str, Path]] = {}
    for recording in recordings:
        for topic in recording.topics:
            schema = recording.schema(topic)
            name = schema.name if schema else ""
            first, path = known.setdefault(topic, (name, recording.path))
            if name != first:
                raise RecordingError(
                    f"{topic} is {first or 'without a schema'} in {path} and {name or 'without one'} in "
                    f"{recording.path}; they cannot be merged"
                )


class _Copier:
    """Copies channels once, however many logs have them."""

    def __init__(self, writer: LogWriter) -> None:
        self._writer = writer
        self._channels: dict[str, int] = {}
        self._schemas: dict[tuple[str, bytes], int] = {}
        self._names: set[str] = set()

    def begin(self, recording: Recording, topics: Iterable[str]) -> None:
        for topic in topics:
            if topic not in self._channels:
                self._copy_channel(recording, topic)
        for name, values in recording.metadata.items():
            self._writer.add_metadata(self._fresh(name, recording), values)
        for name, data in recording.attachments.items():
            media_type = "application/json" if name.endswith(".json") else "application/octet-stream"
            fresh = self._fresh(name, recording)
            self._writer.add_attachment(Attachment(name=fresh, media_type=media_type, data=data))

    def add(
        self, topic: str, times: list[int], payloads: Iterable[object], sequences: list[int] | None
    ) -> None:
        """Append messages; with sequence numbers, gaps in them stay gaps."""
        channel, writer = self._channels[topic], self._writer
        chunk = writer.chunk
        if sequences is not None and sequences:
            chunk.sequences.setdefault(channel, sequences[0])
        for place, (time_ns, payload) in enumerate(zip(times, payloads, strict=True)):
            skipped = max(0, sequences[place] - chunk.sequences[channel]) if sequences is not None else 0
            chunk.add(channel, time_ns, bytes(payload), skipped)  # type: ignore[call-overload]  # a row of bytes
            writer.end_full_chunk()

    def _copy_channel(self, recording: Recording, topic: str) -> None:
        channel, schema = recording.channel(topic), recording.schema(topic)
        schema_id = 0
        if schema is not None:
            key = schema.name, schema.data
            if key not in self._schemas:
                self._schemas[key] = len(self._schemas) + 1
                self._writer.copy_schema(
                    records.Schema(
                        id=self._schemas[key], data=schema.data, encoding=schema.encoding, name=schema.name
                    )
                )
            schema_id = self._schemas[key]
        self._channels[topic] = len(self._channels) + 1
        self._writer.copy_channel(
            records.Channel(
                id=self._channels[topic],
                topic=topic,
                message_encoding=channel.message_encoding,
                metadata=dict(channel.metadata),
                schema_id=schema_id,
            )
        )

    def _fresh(self, name: str, recording: Recording) -> str:
        """A name of metadata or an attachment, with that of its log where another log has it too."""
        if name in self._names:
            name = f"{recording.path.stem}/{name}"
        self._names.add(name)
        return name

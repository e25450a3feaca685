"""Reading a log: columns as numpy arrays, by topic and time range, also from a truncated file."""

import contextlib
import glob
import re
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
from mcap import records
from numpy.typing import NDArray

from hm_driver.errors import RecordingError
from hm_driver.recording import frames
from hm_driver.recording.chunks import MESSAGE_HEADER
from hm_driver.recording.container import ChunkPlace, Container, walk_messages
from hm_driver.recording.decoding import Columns, Decoder

LOG_TIME = "log_time_ns"
"""Name of the column that every topic has: the time at which the message was logged [ns since the epoch]."""

Payloads: TypeAlias = "NDArray[np.uint8] | list[bytes]"

_HEADER = np.dtype(
    {
        "names": ["opcode", "length", "channel", "sequence", "log_time", "publish_time"],
        "formats": ["u1", "<u8", "<u2", "<u4", "<i8", "<i8"],
        "offsets": [0, 1, 9, 11, 15, 23],
        "itemsize": MESSAGE_HEADER.size,
    }
)
_MESSAGE = 5
_NUMBERS = frozenset({"float64", "float32", "uint64", "int64", "uint32", "int32", "bool"})


class RecordingWarning(UserWarning):
    """A log is not whole; what can be read is read."""


@dataclass(frozen=True, slots=True)
class TopicSummary:
    """What a log holds of one topic."""

    topic: str
    """Name of the topic."""
    schema: str
    """Full name of its message."""
    columns: tuple[str, ...]
    """Names of the columns, without the log time."""
    units: Mapping[str, str]
    """Unit of each column that has one."""
    kinds: Mapping[str, str]
    """What each column holds: ``float64``, ``uint64``, ``bool`` …, ``text``, ``bytes``, or a list of them:
    ``float64 list``."""

    @property
    def numbers(self) -> tuple[str, ...]:
        """Names of the columns that hold one number a message."""
        return tuple(name for name in self.columns if self.kinds[name] in _NUMBERS)


class Block(NamedTuple):
    """Messages of one topic in one chunk, n of them."""

    times: NDArray[np.int64]
    """Log times [ns since the epoch], shape (n,)."""
    payloads: Payloads
    """The messages as they stand in the file."""
    sequences: NDArray[np.uint32]
    """Their sequence numbers, shape (n,): a gap is a message that was lost."""


class Recording:
    """A log with all its parts, open for reading; a context manager.

    A log that was split, or whose recorder died, goes on in files named ``NAME.part2.mcap`` and so on beside
    it: they are read as one. What a killed recorder had written and the next one wrote again is read once.

    Args:
        path: The MCAP file; the first of its parts, or a single later one.

    Raises:
        RecordingError: if it is missing, empty, or no MCAP file.
    """

    def __init__(self, path: str | Path) -> None:
        self.path = Path(path)
        self._parts = [_Part(Container(path))]
        try:
            self._parts += [_Part(Container(one)) for one in parts_after(self.path)]
        except RecordingError:
            self.close()
            raise
        self._decoders: dict[str, Decoder] = {}
        damaged = [part for part in self._parts if part.contents.damage]
        self.damage = "; ".join(_damage(part, self.path) for part in damaged)
        """Why the log is not whole; empty where it is."""
        if self.damage:
            chunks = sum(len(part.contents.chunks) for part in self._parts)
            warnings.warn(
                f"{self.path} is not whole: {self.damage}; {chunks} chunks can be read",
                RecordingWarning,
                stacklevel=3,
            )

    @property
    def parts(self) -> tuple[Path, ...]:
        """The files that are read, in their order."""
        return tuple(part.container.path for part in self._parts)

    @property
    def topics(self) -> tuple[str, ...]:
        """Names of the topics."""
        return tuple(sorted({topic for part in self._parts for topic in part.channels}))

    @property
    def start_time_ns(self) -> int:
        """Log time of the first message [ns since the epoch]; 0 in a log without messages."""
        return min((place.start_time_ns for part in self._parts for place in part.contents.chunks), default=0)

    @property
    def end_time_ns(self) -> int:
        """Log time of the last message [ns since the epoch]."""
        return max((place.end_time_ns for part in self._parts for place in part.contents.chunks), default=0)

    @property
    def duration_s(self) -> float:
        """From the first message to the last [s]."""
        return (self.end_time_ns - self.start_time_ns) / 1e9

    @cached_property
    def counts(self) -> dict[str, int]:
        """Number of messages of each topic."""
        if len(self._parts) == 1 and (known := self._parts[0].contents.counts) is not None:
            channels = self._parts[0].channels
            return {topic: known.get(channel.id, 0) for topic, channel in channels.items()}
        counts = dict.fromkeys(self.topics, 0)
        for topic, block in self._blocks(self.topics):
            counts[topic] += len(block.times)
        return counts

    @cached_property
    def metadata(self) -> dict[str, dict[str, str]]:
        """Records of metadata, by name; a later part's take the place of an earlier one's.

        They have no checksum of their own: one that cannot be read is left out with a warning.
        """
        found = {}
        for part in self._parts:
            for offset in part.contents.metadata:
                try:
                    record = part.container.record(records.Metadata, offset)
                except RecordingError as error:
                    warnings.warn(str(error), RecordingWarning, stacklevel=3)
                else:
                    found[record.name] = dict(record.metadata)
        return found

    @cached_property
    def attachments(self) -> dict[str, bytes]:
        """Files inside the log, by name.

        Raises:
            RecordingError: if one is damaged.
        """
        return {
            record.name: record.data
            for part in self._parts
            for record in (part.container.attachment(offset) for offset in part.contents.attachments)
        }

    def describe(self, topic: str) -> TopicSummary:
        """Schema, columns and units of a topic.

        Raises:
            RecordingError: if there is no such topic, or its messages are not protobuf.
        """
        decoder = self._decoder(topic)
        schema = next(part.schema(topic) for part in self._parts if topic in part.channels)
        name = schema.name if schema else ""
        return TopicSummary(topic, name, decoder.names, decoder.units, decoder.kinds)

    def describe_readable(self) -> list[TopicSummary]:
        """What `describe` says of every topic that can be read; those of other encodings are left out."""
        found = []
        for topic in self.topics:
            with contextlib.suppress(RecordingError):
                found.append(self.describe(topic))
        return found

    def columns(
        self,
        topic: str,
        start: float | None = None,
        end: float | None = None,
        *,
        names: Iterable[str] | None = None,
    ) -> Columns:
        """Columns of a topic, in the order of the file, with the log time as ``log_time_ns``.

        Args:
            topic: Name of the topic.
            start: First time, in seconds from the beginning of the log.
            end: Time at which to stop, that time not included.
            names: Columns to read; all where None.

        Returns:
            One array of shape (n,) for each column; lists and texts are arrays of objects.

        Raises:
            RecordingError: if there is no such topic or column, its messages are not protobuf, or the range
                lies outside the log.
        """
        return self.tables({topic: names}, start, end)[topic]

    def frame(
        self,
        topic: str,
        start: float | None = None,
        end: float | None = None,
        *,
        library: Literal["pandas", "polars"] = "pandas",
        names: Iterable[str] | None = None,
    ) -> Any:  # noqa: ANN401 - a frame of a library that need not be installed
        """What `columns` returns, as a data frame of a library that is installed.

        Args:
            topic: Name of the topic.
            start: First time, in seconds from the beginning of the log.
            end: Time at which to stop, that time not included.
            library: ``pandas`` or ``polars``.
            names: Columns to read; all where None.

        Raises:
            RecordingError: as `columns` does, or where the library is not installed or none of the two.
        """
        make = frames.maker(library)
        return make(self.columns(topic, start, end, names=names))

    def tables(
        self,
        wanted: Mapping[str, Iterable[str] | None],
        start: float | None = None,
        end: float | None = None,
    ) -> dict[str, Columns]:
        """Columns of several topics in one pass over the file, which is quicker than one after the other.

        Args:
            wanted: Columns to read of each topic; all where None.
            start: First time, in seconds from the beginning of the log.
            end: Time at which to stop, that time not included.

        Returns:
            What `columns` returns, for each topic.

        Raises:
            RecordingError: as `columns` does.
        """
        requests = {topic: self._names(topic, names) for topic, names in wanted.items()}
        parts: dict[str, list[Columns]] = {topic: [] for topic in requests}
        for topic, block in self._blocks(tuple(requests), self._span(start, end)):
            columns = self._decoder(topic).decode(block.payloads, requests[topic])
            parts[topic].append({LOG_TIME: block.times, **{name: columns[name] for name in requests[topic]}})
        for topic, blocks in parts.items():
            if not blocks:
                empty = self._decoder(topic).decode([])
                no_times = np.empty(0, dtype=np.int64)
                blocks.append({LOG_TIME: no_times, **{name: empty[name] for name in requests[topic]}})
        return {
            topic: {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}
            for topic, blocks in parts.items()
        }

    def blocks(
        self, topics: Iterable[str] | None = None, start: float | None = None, end: float | None = None
    ) -> Iterator[tuple[str, Block]]:
        """The messages as they stand in the file, chunk by chunk.

        Args:
            topics: Names of the topics; all where None.
            start: First time, in seconds from the beginning of the log.
            end: Time at which to stop, that time not included.

        Raises:
            RecordingError: if there is no such topic, or the range lies outside the log.
        """
        chosen = self.topics if topics is None else tuple(topics)
        for topic in chosen:
            self._part_of(topic)
        return self._blocks(chosen, self._span(start, end))

    def decode(self, topic: str, block: Block) -> Columns:
        """All columns of a block that `blocks` gave, with the log time.

        Raises:
            RecordingError: if there is no such topic, or its messages are not protobuf or damaged.
        """
        return {LOG_TIME: block.times, **self._decoder(topic).decode(block.payloads)}

    def require(self, topic: str, names: Iterable[str]) -> None:
        """See that a topic has columns, before its blocks are read.

        Raises:
            RecordingError: if there is no such topic or column, or its messages are not protobuf.
        """
        self._names(topic, names)

    def find_broken_checksums(self) -> list[str]:
        """Read all files from end to end, and tell which do not bear out the checksum over their data."""
        return [
            f"{part.container.path} is damaged: wrong checksum over its data"
            for part in self._parts
            if not part.container.has_right_checksum()
        ]

    def schema(self, topic: str) -> records.Schema | None:
        """Schema of a topic; None for messages without one.

        Raises:
            RecordingError: if there is no such topic.
        """
        return self._part_of(topic).schema(topic)

    def channel(self, topic: str) -> records.Channel:
        """Channel of a topic, with the id that it has in the file.

        Raises:
            RecordingError: if there is no such topic.
        """
        return self._part_of(topic).channels[topic]

    def _names(self, topic: str, names: Iterable[str] | None) -> tuple[str, ...]:
        there = self._decoder(topic).names
        if names is None:
            return there
        chosen = tuple(name for name in names if name != LOG_TIME)
        unknown = sorted(set(chosen) - set(there))
        if unknown:
            raise RecordingError(f"{self.path}: {topic} has no column {unknown}; there are {list(there)}")
        return chosen

    def close(self) -> None:
        """Close the files; idempotent."""
        for part in self._parts:
            part.container.close()

    def __enter__(self) -> "Recording":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _decoder(self, topic: str) -> Decoder:
        part = self._part_of(topic)
        if topic not in self._decoders:
            channel, schema = part.channels[topic], part.schema(topic)
            if schema is None or schema.encoding != "protobuf" or channel.message_encoding != "protobuf":
                encoding = channel.message_encoding or "unknown"
                raise RecordingError(f"{self.path}: {topic} is not protobuf but {encoding}")
            self._decoders[topic] = Decoder(schema.name, schema.data)
        return self._decoders[topic]

    def _part_of(self, topic: str) -> "_Part":
        """The first file that has a topic."""
        for part in self._parts:
            if topic in part.channels:
                return part
        there = ", ".join(self.topics) or "none"
        raise RecordingError(f"{self.path} has no channel {topic}; there are: {there}")

    def _span(self, start: float | None, end: float | None) -> tuple[int, int] | None:
        if start is None and end is None:
            return None
        first = 0.0 if start is None else start
        last = self.duration_s + 1.0 if end is None else end
        if not first < last or first > self.duration_s or last <= 0.0:
            raise RecordingError(
                f"{self.path}: the range {first:g} s to {last:g} s is outside of 0 to {self.duration_s:g} s"
            )
        return self.start_time_ns + round(first * 1e9), self.start_time_ns + round(last * 1e9)

    def _blocks(
        self, topics: tuple[str, ...], span: tuple[int, int] | None = None
    ) -> Iterator[tuple[str, Block]]:
        """Topic and messages, chunk by chunk."""
        last: dict[str, Block] = {}
        for number, part in enumerate(self._parts):
            before, last = last, {}
            for topic, block in part.blocks(topics, span):
                fresh = _without(block, before.get(topic)) if number else block
                last[topic] = block
                if len(fresh.times):
                    yield topic, fresh


class _Part:
    """One file of a log."""

    def __init__(self, container: Container) -> None:
        self.container = container
        self.contents = container.contents
        self.channels = {channel.topic: channel for channel in self.contents.channels.values()}

    def schema(self, topic: str) -> records.Schema | None:
        return self.contents.schemas.get(self.channels[topic].schema_id)

    def blocks(self, topics: tuple[str, ...], span: tuple[int, int] | None) -> Iterator[tuple[str, Block]]:
        numbers = {topic: self.channels[topic].id for topic in topics if topic in self.channels}
        for place in self.contents.chunks:
            if span and (place.end_time_ns < span[0] or place.start_time_ns >= span[1]):
                continue
            if place.index_offsets and place.index_offsets.keys().isdisjoint(numbers.values()):
                continue
            try:
                chunk = _Chunk(self.container, place)
            except RecordingError as error:
                seconds = (place.end_time_ns - place.start_time_ns) / 1e9
                warnings.warn(f"{error}; {seconds:g} s are left out", RecordingWarning, stacklevel=6)
                continue
            for topic, number in numbers.items():
                block = chunk.messages(number, span)
                if block is not None:
                    yield topic, block


def parts_after(path: Path) -> list[Path]:
    """The files in which a log goes on, in their order: ``NAME.part2.mcap`` and so on."""
    found = path.parent.glob(f"{glob.escape(path.stem)}.part*{path.suffix}")
    pattern = re.compile(re.escape(path.stem) + r"\.part([1-9][0-9]*)" + re.escape(path.suffix))
    numbers = {int(match[1]): one for one in found if (match := pattern.fullmatch(one.name))}
    return [numbers[number] for number in sorted(numbers)]


def _damage(part: _Part, path: Path) -> str:
    name = part.container.path.name
    return part.contents.damage if name == path.name else f"{name}: {part.contents.damage}"


def _without(block: Block, before: Block | None) -> Block:
    """The messages of a block that the last one of the part before does not hold as they are."""
    if before is None or np.min(block.times) > np.max(before.times):
        return block
    known = {(time, bytes(one)) for time, one in zip(before.times.tolist(), before.payloads, strict=True)}
    pairs = zip(block.times.tolist(), block.payloads, strict=True)
    fresh = np.array([(time, bytes(one)) not in known for time, one in pairs])
    if isinstance(block.payloads, np.ndarray):
        return Block(block.times[fresh], block.payloads[fresh], block.sequences[fresh])
    kept = [one for one, is_fresh in zip(block.payloads, fresh, strict=True) if is_fresh]
    return Block(block.times[fresh], kept, block.sequences[fresh])


class _Chunk:
    """A chunk whose message records have been found."""

    def __init__(self, container: Container, place: ChunkPlace) -> None:
        data = container.chunk(place)
        self._data = data
        self._content = np.frombuffer(data, dtype=np.uint8)
        found = _indexed_messages(self._content, container.message_offsets(place))
        if found is None:
            offsets = np.array(walk_messages(data), dtype=np.int64)
            found = offsets, _headers(self._content, offsets)
        self._offsets, self._headers = found

    def messages(self, channel: int, span: tuple[int, int] | None) -> Block | None:
        """Log times and payloads of a channel's messages; None where there is none."""
        chosen = self._headers["channel"] == channel
        times, sequences = self._headers["log_time"], self._headers["sequence"]
        if span:
            chosen &= (times >= span[0]) & (times < span[1])
        if not chosen.any():
            return None
        sizes = self._headers["length"][chosen].astype(np.int64) - (MESSAGE_HEADER.size - 9)
        starts = self._offsets[chosen] + MESSAGE_HEADER.size
        if (sizes == sizes[0]).all():
            rows = _rows(self._content, starts, int(sizes[0]))
            return Block(times[chosen], rows, sequences[chosen])
        data = self._data
        parts = [data[start : start + size] for start, size in zip(starts, sizes, strict=True)]
        return Block(times[chosen], parts, sequences[chosen])


def _rows(content: NDArray[np.uint8], starts: NDArray[np.int64], size: int) -> NDArray[np.uint8]:
    """The bytes behind each start, shape (n, size)."""
    if not size:
        return np.empty((len(starts), 0), dtype=np.uint8)
    windows = np.ndarray((len(content) - size + 1, size), np.uint8, content, strides=(1, 1))
    rows: NDArray[np.uint8] = windows[starts]  # a sliding_window_view costs several times as much
    return rows


def _headers(content: NDArray[np.uint8], offsets: NDArray[np.int64]) -> NDArray[np.void]:
    if not len(offsets):
        return np.empty(0, dtype=_HEADER)
    headers: NDArray[np.void] = _rows(content, offsets, _HEADER.itemsize).view(_HEADER)[:, 0]
    return headers


def _indexed_messages(
    content: NDArray[np.uint8], index: bytes
) -> tuple[NDArray[np.int64], NDArray[np.void]] | None:
    """Offsets and headers of the messages in the order of the chunk, where the index covers it without a gap.

    An index has no checksum of its own, the chunk has: an index that the chunk bears out cannot be wrong.
    """
    offsets = np.sort(np.frombuffer(index, dtype="<i8").reshape(-1, 2)[:, 1])
    if not len(offsets) or offsets[0] != 0 or offsets[-1] > len(content) - _HEADER.itemsize:
        return None
    headers = _headers(content, offsets)
    ends = offsets + 9 + headers["length"].astype(np.int64)
    is_tiled = (ends[:-1] == offsets[1:]).all() and ends[-1] == len(content)
    are_messages = (headers["opcode"] == _MESSAGE) & (headers["length"] >= MESSAGE_HEADER.size - 9)
    return (offsets, headers) if is_tiled and are_messages.all() else None

"""From a log to the files of other programs: CSV, Parquet, MATLAB; only a piece is in memory at a time."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from hm_driver.errors import RecordingError
from hm_driver.recording.decoding import Columns
from hm_driver.recording.reader import LOG_TIME, Recording, TopicSummary
from tools.log import csv_file, mat_file, parquet_file
from tools.log.output import check_room, whole_file

TIME = "time_s"
"""Name of the first column: time since the beginning of the log [s]."""

_WRITERS = {".csv": csv_file.write, ".parquet": parquet_file.write}
_FOR_VIEWERS = "foxglove."
"""Package of the messages that are made of others for viewers."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Table:
    """One topic to be exported."""

    summary: TopicSummary
    """Its schema, units and kinds."""
    columns: tuple[str, ...]
    """Names of all columns of the table, times first."""

    @property
    def kinds(self) -> dict[str, str]:
        """What each column holds, as in `TopicSummary.kinds`."""
        known = {TIME: "float64", LOG_TIME: "int64"} | dict(self.summary.kinds)
        return {name: known[name] for name in self.columns}

    @property
    def units(self) -> dict[str, str]:
        """Unit of each column that has one."""
        known = {TIME: "s", LOG_TIME: "ns"} | dict(self.summary.units)
        return {name: known[name] for name in self.columns if name in known}


@dataclass(frozen=True, slots=True, kw_only=True)
class Selection:
    """What of a log is exported."""

    topics: tuple[str, ...] = ()
    """Names of the topics; none for all but those that were made for viewers."""
    columns: tuple[str, ...] = ()
    """Names of the columns; none for all. A vector's name stands for its components."""
    start: float | None = None
    """First time, from the beginning of the log [s]."""
    end: float | None = None
    """Time at which to stop [s]."""


def export(log: Path, target: Path, selection: Selection, *, force: bool = False) -> dict[Path, int]:
    """Write topics of a log into files of another format, by the target's suffix.

    A CSV or Parquet file holds one topic: of several, each goes into a file of its own beside the target,
    with the topic behind its name. A ``.mat`` file holds them all, each as a struct.

    Args:
        log: The log.
        target: The file to write; ``.csv``, ``.parquet`` or ``.mat``.
        selection: Topics, columns and range.
        force: Whether files that are there may be written over.

    Returns:
        The files written, with the number of messages in each.

    Raises:
        RecordingError: The log cannot be read, has no such topic, column or range, the suffix is none of the
            three, or a file cannot be written.
    """
    suffix = target.suffix.lower()
    if suffix not in (*_WRITERS, ".mat"):
        named = f"{suffix} is" if suffix else "without a suffix it is"
        raise RecordingError(
            f"{target}: {named} none of .csv, .parquet and .mat, by which the format is chosen"
        )
    with Recording(log) as recording:
        tables = _tables(recording, selection)
        if suffix == ".mat":
            with whole_file(target, force=force, sources=recording.parts) as draft:
                return {target: mat_file.write(draft, _streams(recording, tables, selection))}
        paths = _paths(target, [table.summary.topic for table in tables])
        for path in paths:
            check_room(path, force=force, sources=recording.parts)
        written = {}
        for path, (table, pieces) in zip(paths, _streams(recording, tables, selection), strict=True):
            with whole_file(path, force=force, sources=recording.parts) as draft:
                written[path] = _WRITERS[suffix](draft, table, pieces)
        return written


def _tables(recording: Recording, selection: Selection) -> list[Table]:
    summaries = [recording.describe(topic) for topic in selection.topics] or _own_topics(recording)
    if not summaries:
        raise RecordingError(f"{recording.path} has no topic that could be exported")
    unknown = [name for name in selection.columns if not any(_matching(one, name) for one in summaries)]
    if unknown:
        there = "; ".join(f"{one.topic} has {', '.join(one.columns)}" for one in summaries)
        raise RecordingError(f"{recording.path}: no column {', '.join(unknown)}; {there}")
    tables = []
    for one in summaries:
        chosen = [column for name in selection.columns for column in _matching(one, name)]
        if selection.columns and not chosen:
            continue
        columns = dict.fromkeys((TIME, LOG_TIME, *(chosen or one.columns)))
        tables.append(Table(summary=one, columns=tuple(columns)))
    return tables


def _matching(summary: TopicSummary, name: str) -> list[str]:
    if name in (TIME, LOG_TIME):
        return [name]
    return [column for column in summary.columns if column == name or column.startswith(f"{name}.")]


def _own_topics(recording: Recording) -> list[TopicSummary]:
    """All topics that can be decoded, but those for viewers where there are others."""
    found = recording.describe_readable()
    return [one for one in found if not one.schema.startswith(_FOR_VIEWERS)] or found


def _streams(
    recording: Recording, tables: Sequence[Table], selection: Selection
) -> Iterator[tuple[Table, Iterator[Columns]]]:
    """Each table with its columns piece by piece."""
    for table in tables:
        topic = table.summary.topic
        blocks = recording.blocks([topic], selection.start, selection.end)
        yield table, (_select(recording, table, recording.decode(name, block)) for name, block in blocks)


def _select(recording: Recording, table: Table, piece: Columns) -> Columns:
    seconds = (piece[LOG_TIME] - np.int64(recording.start_time_ns)) / 1e9
    return {name: seconds if name == TIME else piece[name] for name in table.columns}


def _paths(target: Path, topics: Sequence[str]) -> list[Path]:
    if len(topics) == 1:
        return [target]
    names = [topic.strip("/").replace("/", "-") for topic in topics]
    return [target.with_name(f"{target.stem}-{name}{target.suffix}") for name in names]

"""Signals of a log by name: ``/device/state.measured_force.z``, or the column where one topic has it."""

import difflib
from collections.abc import Iterable
from dataclasses import dataclass

from hm_driver.errors import RecordingError
from hm_driver.recording.reader import Recording, TopicSummary

_WHOLE_NUMBERS = frozenset({"uint64", "int64", "uint32", "int32", "bool"})


@dataclass(frozen=True, slots=True, kw_only=True)
class Signal:
    """A number that a topic gives with each of its messages."""

    topic: str
    """Name of the topic."""
    column: str
    """Name of the column."""
    unit: str
    """Its unit; empty where it has none."""
    is_whole: bool
    """Whether it is a whole number, a state or a yes or no, which has no values between two messages."""

    @property
    def name(self) -> str:
        """Its full name."""
        return f"{self.topic}.{self.column}"


def find_signals(recording: Recording, names: Iterable[str]) -> list[Signal]:
    """The signals that names stand for, in their order and each once.

    A name is a topic and a column, or a column alone where one topic has it. The name of a vector stands for
    its three components.

    Raises:
        RecordingError: There is no such signal, or several topics have it.
    """
    summaries = recording.describe_readable()
    found: dict[str, Signal] = {}
    for name in names:
        for signal in _find(recording, summaries, name):
            found[signal.name] = signal
    return list(found.values())


def short_names(signals: Iterable[Signal]) -> dict[str, str]:
    """A name to show for each signal: the column alone where no other of them has the same."""
    signals = list(signals)
    columns = [signal.column for signal in signals]
    return {one.name: one.column if columns.count(one.column) == 1 else one.name for one in signals}


def _find(recording: Recording, summaries: list[TopicSummary], name: str) -> list[Signal]:
    for is_match in (_is_column, _is_vector):
        matching = [
            (one, tuple(column for column in one.columns if is_match(one.topic, column, name)))
            for one in summaries
        ]
        matching = [(one, columns) for one, columns in matching if columns]
        if len(matching) > 1:
            choices = ", ".join(f"{one.topic}.{name}" for one, _ in matching)
            raise RecordingError(f"{recording.path}: several topics have {name}; say which: {choices}")
        if matching:
            return _signals(recording, *matching[0])
    error = RecordingError(f"{recording.path} has no signal {name}{_guess(summaries, name)}")
    for one in summaries:
        if one.numbers:
            error.add_note(f"{one.topic} has {', '.join(one.numbers)}")
    raise error


def _is_column(topic: str, column: str, name: str) -> bool:
    return name in (column, f"{topic}.{column}")


def _is_vector(topic: str, column: str, name: str) -> bool:
    vector = column.rpartition(".")[0]
    return bool(vector) and name in (vector, f"{topic}.{vector}")


def _signals(recording: Recording, summary: TopicSummary, columns: tuple[str, ...]) -> list[Signal]:
    for column in columns:
        if column not in summary.numbers:
            numbers = ", ".join(summary.numbers) or "none"
            raise RecordingError(
                f"{recording.path}: {summary.topic}.{column} is no number but {summary.kinds[column]}; "
                f"numbers are: {numbers}"
            )
    return [
        Signal(
            topic=summary.topic,
            column=column,
            unit=summary.units.get(column, ""),
            is_whole=summary.kinds[column] in _WHOLE_NUMBERS,
        )
        for column in columns
    ]


def _guess(summaries: list[TopicSummary], name: str) -> str:
    known = [
        known for one in summaries for column in one.numbers for known in (column, f"{one.topic}.{column}")
    ]
    close = list(dict.fromkeys(difflib.get_close_matches(name, known, n=3)))
    return f"; did you mean {' or '.join(close)}?" if close else ""

"""The cycles of a loop, piece by piece: what was measured and what was commanded in each."""

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hm_driver.recording.decoding import Columns
from hm_driver.recording.reader import Recording
from hm_driver.recording.schemas import DEVICE_COMMAND_CHANNEL, DEVICE_STATE_CHANNEL

FloatArray = NDArray[np.float64]

AXES = ("x", "y", "z")
PIECE = 1 << 14
"""Cycles of a piece: sixteen seconds at 1 kHz."""

_KEY = "time_ns"
"""What tells cycles apart also in a log that was merged of several: their numbers begin anew in each."""
_STATE, _COMMAND = DEVICE_STATE_CHANNEL.topic, DEVICE_COMMAND_CHANNEL.topic


@dataclass(frozen=True, slots=True, kw_only=True)
class Cycles:
    """Cycles that follow each other without a gap, n of them."""

    time_s: FloatArray
    """Times on the loop's grid since the beginning of the log, shape (n,) [s]."""
    position: FloatArray
    """Measured, shape (n, 3) [m]."""
    velocity: FloatArray
    """Of the device's virtual mass, shape (n, 3) [m/s]."""
    force: FloatArray
    """Of the hand on the end effector, shape (n, 3) [N]."""
    reference: FloatArray
    """Of the position springs, shape (n, 3) [m]."""
    reference_velocity: FloatArray
    """Shape (n, 3) [m/s]."""
    spring_force: FloatArray
    """Commanded force of the position springs, shape (n, 3) [N]."""
    phase: FloatArray
    """Each spring: 0 admittance, 1 position, 2 releasing; shape (n, 3)."""
    assist_reference: FloatArray
    """Rest height of the assist, shape (n,) [m]."""
    assist_force: FloatArray
    """Commanded force of the assist in z, shape (n,) [N]."""
    bias_force: FloatArray
    """Shape (n, 3) [N]."""

    def part(self, first: int, last: int) -> "Cycles":
        """The cycles from first up to last, that one not included."""
        return Cycles(**{one.name: getattr(self, one.name)[first:last] for one in fields(self)})


def read_cycles(
    recording: Recording, start: float | None = None, end: float | None = None
) -> Iterator[Cycles]:
    """The cycles of a log of which state and command are there, without a gap in any piece.

    Args:
        recording: The log.
        start: First time, from the beginning of the log [s].
        end: Time at which to stop [s].

    Raises:
        RecordingError: The log has no such channels, or the range lies outside of it.
    """
    recording.require(
        _STATE, (_KEY, "sequence", *_names("measured_position", "model_velocity", "measured_force"))
    )
    recording.require(_COMMAND, (_KEY, *_names("reference", "reference_velocity", "spring_force", "phase")))
    held: dict[str, list[Columns]] = {_STATE: [], _COMMAND: []}
    for topic, block in recording.blocks((_STATE, _COMMAND), start, end):
        held[topic].append(recording.decode(topic, block))
        if min(sum(len(one[_KEY]) for one in pieces) for pieces in held.values()) >= PIECE:
            joined, held = _join(held)
            yield from _runs(joined, recording.start_time_ns)
    if all(any(len(one[_KEY]) for one in pieces) for pieces in held.values()):
        yield from _runs(_join(held)[0], recording.start_time_ns)


def _join(held: dict[str, list[Columns]]) -> tuple[Columns, dict[str, list[Columns]]]:
    """The cycles that both topics have, and what of them is left for later."""
    state, command = (_concatenate(held[topic]) for topic in (_STATE, _COMMAND))
    _, mine, its = np.intersect1d(state[_KEY], command[_KEY], return_indices=True)
    joined = {name: values[mine] for name, values in state.items()}
    joined |= {name: values[its] for name, values in command.items() if name not in joined}
    last = min(int(state[_KEY].max()), int(command[_KEY].max()))
    return joined, {_STATE: [_after(state, last)], _COMMAND: [_after(command, last)]}


def _concatenate(pieces: list[Columns]) -> Columns:
    return {name: np.concatenate([piece[name] for piece in pieces]) for name in pieces[0]}


def _after(columns: Columns, time_ns: int) -> Columns:
    chosen = columns[_KEY] > time_ns
    return {name: values[chosen] for name, values in columns.items()}


def _runs(joined: Columns, start_ns: int) -> Iterator[Cycles]:
    numbers = joined["sequence"].astype(np.int64)
    if not len(numbers):
        return
    bounds = [0, *(np.flatnonzero(np.diff(numbers) != 1) + 1).tolist(), len(numbers)]
    whole = Cycles(
        time_s=(joined["time_ns"] - np.int64(start_ns)) / 1e9,
        position=_vector(joined, "measured_position"),
        velocity=_vector(joined, "model_velocity"),
        force=_vector(joined, "measured_force"),
        reference=_vector(joined, "reference"),
        reference_velocity=_vector(joined, "reference_velocity"),
        spring_force=_vector(joined, "spring_force"),
        phase=_vector(joined, "phase"),
        assist_reference=_column(joined, "assist_reference"),
        assist_force=_column(joined, "assist_force"),
        bias_force=_vector(joined, "bias_force"),
    )
    for first, last in itertools.pairwise(bounds):
        yield whole.part(first, last)


def _names(*vectors: str) -> list[str]:
    return [f"{vector}.{axis}" for vector in vectors for axis in AXES]


def _vector(columns: dict[str, NDArray[Any]], name: str) -> FloatArray:
    return np.column_stack([_column(columns, one) for one in _names(name)])


def _column(columns: dict[str, NDArray[Any]], name: str) -> FloatArray:
    """A column; zeros where a log is older than the column."""
    return columns[name] if name in columns else np.zeros(len(columns[_KEY]))

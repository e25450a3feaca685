"""What the live view shows, and the record of bytes that carries it to the drawing process."""

import math
import struct
from typing import NamedTuple

TEXT_LENGTH = 120
"""Characters of a message that are shown."""

_NUMBERS = struct.Struct("<H9d5q")
_SEPARATOR = "\0"
_LEAST_TEXTS = 2  # stage and scheduling always go along


class SessionStatus(NamedTuple):
    """A session at one moment, as a person wants to see it."""

    time_s: float
    """Time since the start of the session [s]."""
    stage: str
    """What the session is doing: ``starting``, ``practice``, ``teaching``, ``autonomous``, ``finished``."""
    C: float
    """Control factor of eq. (9): 1 for the human, 0 for the robot."""
    force_n: float
    """Contact force of the manipulator [N]."""
    reference_force_n: float
    """Force that the task asks for [N]."""
    models: int
    """Local models of the learner."""
    coverage: float
    """Share of the task's plane with w_max >= w_th, 0 to 1."""
    updates: int
    """Updates of the learner so far."""
    accumulated: int
    """Samples in the accumulation buffer."""
    accumulation_length: int
    """Samples that make an update, N_acc."""
    loop_rate_hz: float | None
    """Rate of the driver loop as measured [Hz]; None where time is virtual."""
    missed_periods: int
    """Periods of the driver loop missed so far."""
    lateness_p99_us: float | None
    """99th percentile of the loop's wake-up lateness [µs]; None where time is virtual."""
    scheduling: str
    """Rung of the scheduling ladder that the loop was granted."""
    coverage_goal: float = 0.99
    """Coverage at which the session becomes autonomous, 0 to 1."""
    force_tolerance_n: float = 0.5
    """Half width of the target zone about the reference force [N]."""
    messages: tuple[str, ...] = ()
    """What happened since the last update, a line each."""

    @property
    def control(self) -> str:
        """Who is in control: ``human``, ``robot`` or, between them, ``blending``."""
        return "human" if self.C >= 1.0 else "robot" if self.C <= 0.0 else "blending"


def encode(status: SessionStatus, messages: tuple[str, ...], limit: int) -> bytes:
    """One record of at most `limit` bytes; messages that do not fit are left out, the oldest first."""
    texts = [status.stage, status.scheduling, *(message.replace(_SEPARATOR, " ") for message in messages)]
    while True:
        text = _SEPARATOR.join(text[:TEXT_LENGTH] for text in texts).encode()
        size = _NUMBERS.size + len(text)
        if size <= limit or len(texts) == _LEAST_TEXTS:
            break
        del texts[_LEAST_TEXTS]
    return (
        _NUMBERS.pack(
            size,
            status.time_s,
            status.C,
            status.force_n,
            status.reference_force_n,
            status.coverage,
            _number(status.loop_rate_hz),
            _number(status.lateness_p99_us),
            status.coverage_goal,
            status.force_tolerance_n,
            status.models,
            status.updates,
            status.accumulated,
            status.accumulation_length,
            status.missed_periods,
        )
        + text
    )


def decode(data: bytes) -> tuple[list[SessionStatus], bytes]:
    """The whole records at the start of the data, and what is left of it."""
    statuses = []
    while len(data) >= _NUMBERS.size and len(data) >= (size := _NUMBERS.unpack_from(data)[0]):
        statuses.append(_decode_one(data[:size]))
        data = data[size:]
    return statuses, data


def _decode_one(record: bytes) -> SessionStatus:
    _, time_s, factor, force, reference, coverage, rate, late, goal, tolerance, *counts = (
        _NUMBERS.unpack_from(record)
    )
    models, updates, accumulated, length, missed = counts
    stage, scheduling, *messages = record[_NUMBERS.size :].decode().split(_SEPARATOR)
    return SessionStatus(
        time_s=time_s,
        stage=stage,
        C=factor,
        force_n=force,
        reference_force_n=reference,
        models=models,
        coverage=coverage,
        updates=updates,
        accumulated=accumulated,
        accumulation_length=length,
        loop_rate_hz=_optional(rate),
        missed_periods=missed,
        lateness_p99_us=_optional(late),
        scheduling=scheduling,
        coverage_goal=goal,
        force_tolerance_n=tolerance,
        messages=tuple(messages),
    )


def _number(value: float | None) -> float:
    return math.nan if value is None else value


def _optional(value: float) -> float | None:
    return None if math.isnan(value) else value

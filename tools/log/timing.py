"""How punctual the loop of a log was."""

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hm_driver.errors import RecordingError
from hm_driver.recording.reader import LOG_TIME, Recording
from hm_driver.recording.schemas import LOOP_TIMING_CHANNEL

FloatArray = NDArray[np.float64]

MEASURES = {
    "lateness": "lateness_ns",
    "response": "response_ns",
    "execution": "execution_ns",
    "exchange": "exchange_ns",
}
"""What is timed, and its column: wake-up and command sent, behind the grid; the cycle; its exchange."""
INTERVALS = 200
"""Parts of the course over time."""
_WORST = 5


class Percentiles(NamedTuple):
    """Of the times of all cycles [us]."""

    p50: float
    p90: float
    p99: float
    p99_9: float
    max: float


class Moment(NamedTuple):
    """A cycle that was late."""

    time_s: float
    """Time since the beginning of the log [s]."""
    lateness_us: float
    """[us]"""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopTiming:
    """How punctual a loop was."""

    log: str
    is_virtual: bool
    """Whether it ran on a virtual clock, where lateness means nothing."""
    cycles: int
    """Cycles in the log."""
    missed: int
    """Periods that the loop skipped."""
    unlogged: int
    """Cycles that are neither in the log nor were missed: the recorder lost them."""
    rate_hz: float
    """Rate of the loop's grid by the log's times [Hz]."""
    longest_gap_ms: float
    """Longest time from one cycle to the next [ms]."""
    percentiles: dict[str, Percentiles]
    """By the name in `MEASURES`, of those that the log has."""
    drift_us_per_s: float
    """Slope of the lateness over the log, by the medians of its parts [us/s]."""
    saturated: int
    """Cycles with a joint at its velocity limit."""
    worst: tuple[Moment, ...]
    """The latest cycles, the worst first."""
    course_s: FloatArray
    """Middles of the parts of the log, shape (k,) [s]."""
    course: dict[str, FloatArray]
    """Median and largest time in each part, shape (k, 2) [us]."""
    tails: dict[str, tuple[FloatArray, FloatArray]]
    """Times [us], and the share of cycles that took longer [%]."""
    missed_at_s: FloatArray
    """When periods were missed [s]."""

    def as_dict(self) -> dict[str, object]:
        """For JSON."""
        return {
            "log": self.log,
            "is_virtual": self.is_virtual,
            "cycles": self.cycles,
            "missed": self.missed,
            "unlogged": self.unlogged,
            "rate_hz": self.rate_hz,
            "longest_gap_ms": self.longest_gap_ms,
            "drift_us_per_s": self.drift_us_per_s,
            "saturated": self.saturated,
            "percentiles_us": {name: found._asdict() for name, found in self.percentiles.items()},
            "worst": [moment._asdict() for moment in self.worst],
        }


@dataclass(slots=True)
class _Series:
    """What is kept of the cycles: single precision holds a microsecond of any lateness."""

    time_s: FloatArray
    sequence: NDArray[np.int64]
    missed: NDArray[np.int64]
    saturated: int
    times_us: dict[str, NDArray[np.float32]]


def analyse(log: Path, start: float | None = None, end: float | None = None) -> LoopTiming:
    """Read the timing of a loop from its log.

    Args:
        log: The log.
        start: First time, from the beginning of the log [s].
        end: Time at which to stop [s].

    Raises:
        RecordingError: It cannot be read, has no cycles of a loop, or the range lies outside.
    """
    with Recording(log) as recording:
        series = _read(recording, start, end)
        is_virtual = recording.metadata.get("session", {}).get("clock") == "virtual"
    if len(series.time_s) < 2:
        raise RecordingError(f"{log} has no cycles of a loop in this range")
    steps = np.diff(series.sequence)
    grid = int(steps[steps > 0].sum())
    missed = np.diff(series.missed)
    lost = int(missed[missed > 0].sum())
    gaps = np.diff(series.time_s)
    parts = np.array_split(np.arange(len(series.time_s)), min(INTERVALS, len(series.time_s)))
    course_s = np.array([series.time_s[part[len(part) // 2]] for part in parts])
    course = {name: _course(values, parts) for name, values in series.times_us.items()}
    return LoopTiming(
        log=str(log),
        is_virtual=is_virtual,
        cycles=len(series.time_s),
        missed=lost,
        unlogged=max(0, grid - lost - (len(series.time_s) - 1)),
        rate_hz=round(float(1.0 / np.median(gaps[steps == 1])), 6) if (steps == 1).any() else 0.0,
        longest_gap_ms=1e3 * float(np.max(gaps)),
        percentiles={name: _percentiles(values) for name, values in series.times_us.items()},
        drift_us_per_s=_drift(course_s, course["lateness"][:, 0]),
        saturated=series.saturated,
        worst=_worst(series),
        course_s=course_s,
        course=course,
        tails={name: _tail(values) for name, values in series.times_us.items()},
        missed_at_s=series.time_s[1:][missed > 0],
    )


def as_rows(timing: LoopTiming) -> list[tuple[str, str]]:
    """The numbers for a terminal: names and values."""
    share = 100.0 * timing.missed / max(1, timing.cycles + timing.missed)
    rows = [
        ("clock", "virtual: times have no meaning" if timing.is_virtual else "wall"),
        ("grid", f"{timing.rate_hz:.6g} Hz"),
        ("cycles", str(timing.cycles)),
        ("missed periods", f"{timing.missed} ({share:.3g} %)"),
        ("not logged", str(timing.unlogged)),
        ("longest gap", f"{timing.longest_gap_ms:.3f} ms"),
        ("drift of lateness", f"{timing.drift_us_per_s:+.3f} µs/s"),
        ("at velocity limit", f"{timing.saturated} cycles"),
    ]
    for name, found in timing.percentiles.items():
        text = f"median {found.p50:.1f}, 90 % {found.p90:.1f}, 99 % {found.p99:.1f}, 99.9 % {found.p99_9:.1f}"
        rows.append((name, f"{text}, largest {found.max:.1f} µs"))
    worst = ", ".join(f"{one.lateness_us:.0f} µs at {one.time_s:.3f} s" for one in timing.worst)
    rows.append(("latest", worst))
    return rows


def _read(recording: Recording, start: float | None, end: float | None) -> _Series:
    topic = LOOP_TIMING_CHANNEL.topic
    recording.require(topic, ("sequence", "missed_periods", MEASURES["lateness"]))
    there = recording.describe(topic).columns
    measures = {name: column for name, column in MEASURES.items() if column in there}
    pieces: dict[str, list[NDArray[np.generic]]] = {}
    saturated: list[int] = []
    for _, block in recording.blocks([topic], start, end):
        piece = recording.decode(topic, block)
        kept: dict[str, NDArray[np.generic]] = {
            "time_s": (piece[LOG_TIME] - np.int64(recording.start_time_ns)) / 1e9,
            "sequence": piece["sequence"].astype(np.int64),
            "missed": piece["missed_periods"].astype(np.int64),
        }
        kept |= {name: (piece[column] * 1e-3).astype(np.float32) for name, column in measures.items()}
        saturated.append(int(piece["saturated_cycles"][-1]) if "saturated_cycles" in piece else 0)
        for name, values in kept.items():
            pieces.setdefault(name, []).append(values)
    joined = {name: np.concatenate(parts) for name, parts in pieces.items()}
    empty = np.empty(0)
    return _Series(
        time_s=joined.get("time_s", empty).astype(np.float64),
        sequence=joined.get("sequence", empty).astype(np.int64),
        missed=joined.get("missed", empty).astype(np.int64),
        saturated=max(saturated, default=0),
        times_us={name: joined.get(name, empty).astype(np.float32) for name in measures},
    )


def _percentiles(values: NDArray[np.float32]) -> Percentiles:
    return Percentiles(*(float(one) for one in np.percentile(values, (50.0, 90.0, 99.0, 99.9, 100.0))))


def _course(values: NDArray[np.float32], parts: list[NDArray[np.int64]]) -> FloatArray:
    return np.array([(np.median(values[part]), np.max(values[part])) for part in parts], dtype=np.float64)


def _drift(times_s: FloatArray, medians: FloatArray) -> float:
    return float(np.polyfit(times_s - times_s.mean(), medians, 1)[0]) if len(times_s) > 2 else 0.0


def _tail(values: NDArray[np.float32]) -> tuple[FloatArray, FloatArray]:
    ordered = np.sort(values)[::-1]
    picked = np.unique(np.geomspace(1, len(ordered), 300).astype(np.int64))
    return ordered[picked - 1].astype(np.float64), 100.0 * picked / len(ordered)


def _worst(series: _Series) -> tuple[Moment, ...]:
    late = series.times_us["lateness"]
    latest = np.argsort(late)[::-1][:_WORST]
    return tuple(Moment(float(series.time_s[place]), float(late[place])) for place in latest)

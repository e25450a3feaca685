"""Signals over time, thinned so that a picture can hold them, without the loss of a peak."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hm_driver.errors import RecordingError
from hm_driver.recording.reader import LOG_TIME, Recording
from tools.log.signals import Signal

FloatArray = NDArray[np.float64]

BINS = 2000
"""Intervals of a thinned curve: more than a screen has columns."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Curve:
    """A signal over time."""

    signal: Signal
    time_s: FloatArray
    """Times since the beginning of the log, shape (n,) [s]."""
    values: FloatArray
    """Values, shape (n,); NaN where a line is to break."""
    smallest: float
    """Smallest value of all messages; NaN where there is none."""
    largest: float
    """Largest value of all messages."""


class Envelope:
    """The smallest and the largest value in each of equal intervals of time.

    Args:
        start: Beginning of the first interval [s].
        end: End of the last one [s].
        bins: Their number.
    """

    def __init__(self, start: float, end: float, bins: int = BINS) -> None:
        self._start = start
        self._width = max(end - start, 1e-9) / bins
        self._low = np.full(bins, np.inf)
        self._high = np.full(bins, -np.inf)

    def add(self, time_s: FloatArray, values: FloatArray) -> None:
        """Take in values of shape (n,); those that are not finite are left out."""
        finite = np.isfinite(values)
        place = ((time_s[finite] - self._start) / self._width).astype(np.int64)
        place = np.clip(place, 0, len(self._low) - 1)
        np.minimum.at(self._low, place, values[finite])
        np.maximum.at(self._high, place, values[finite])

    def curve(self) -> tuple[FloatArray, FloatArray]:
        """Two points for each interval, at its middle; NaN for one without a value."""
        middles = self._start + (np.arange(len(self._low)) + 0.5) * self._width
        values = np.column_stack((self._low, self._high)).ravel()
        values[~np.isfinite(values)] = np.nan
        return np.repeat(middles, 2), values


def read_curves(
    recording: Recording, signals: Sequence[Signal], start: float | None = None, end: float | None = None
) -> list[Curve]:
    """Read signals in one pass over a log.

    A signal with few messages is kept as it is; of others, each of `BINS` intervals keeps its smallest and
    its largest value.

    Args:
        recording: The log.
        signals: What to read.
        start: First time, from the beginning of the log [s].
        end: Time at which to stop [s].

    Raises:
        RecordingError: The range lies outside of the log, or holds no message of these signals.
    """
    first = 0.0 if start is None else max(0.0, start)
    last = recording.duration_s if end is None else min(end, recording.duration_s)
    collectors = {signal.name: _Collector(first, last) for signal in signals}
    topics = tuple(dict.fromkeys(signal.topic for signal in signals))
    for topic, block in recording.blocks(topics, start, end):
        piece = recording.decode(topic, block)
        time_s = (piece[LOG_TIME] - np.int64(recording.start_time_ns)) / 1e9
        for signal in signals:
            if signal.topic == topic:
                collectors[signal.name].add(time_s, piece[signal.column].astype(np.float64))
    if not any(collector.count for collector in collectors.values()):
        names = ", ".join(signal.name for signal in signals)
        raise RecordingError(
            f"{recording.path}: there is no message of {names} from {first:g} s to {last:g} s"
        )
    return [collectors[signal.name].curve(signal) for signal in signals]


class _Collector:
    """Keeps messages as they are until they are too many, and their envelope from there."""

    def __init__(self, start: float, end: float) -> None:
        self.count = 0
        self._span = start, end
        self._pieces: list[tuple[FloatArray, FloatArray]] = []
        self._envelope: Envelope | None = None
        self._extremes: list[float] = []

    def add(self, time_s: FloatArray, values: FloatArray) -> None:
        self.count += len(values)
        finite = values[np.isfinite(values)]
        if len(finite):
            self._extremes = [
                min([*self._extremes, float(np.min(finite))]),
                max([*self._extremes, float(np.max(finite))]),
            ]
        self._pieces.append((time_s, values))
        if self._envelope is None and self.count > 4 * BINS:
            self._envelope = Envelope(*self._span)
        if self._envelope is not None:
            for piece in self._pieces:
                self._envelope.add(*piece)
            self._pieces = []

    def curve(self, signal: Signal) -> Curve:
        if self._envelope is not None:
            time_s, values = self._envelope.curve()
        elif self._pieces:
            time_s, values = _with_gaps(*(np.concatenate(parts) for parts in zip(*self._pieces, strict=True)))
        else:
            time_s = values = np.empty(0)
        low, high = (float(one) for one in self._extremes or (np.nan, np.nan))
        return Curve(signal=signal, time_s=time_s, values=values, smallest=low, largest=high)


def _with_gaps(time_s: FloatArray, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """A NaN in each gap that is ten times as long as the usual step, so that no line runs over it."""
    if len(time_s) < 20:
        return time_s, values
    steps = np.diff(time_s)
    gaps = np.flatnonzero(steps > max(10.0 * float(np.median(steps)), 1e-6)) + 1
    return np.insert(time_s, gaps, time_s[gaps]), np.insert(values, gaps, np.nan)


def by_unit(curves: Iterable[Curve]) -> list[tuple[str, list[Curve]]]:
    """Curves that share an axis: those of one unit."""
    groups: dict[str, list[Curve]] = {}
    for curve in curves:
        key = curve.signal.unit or ("" if not curve.signal.is_whole else " ")
        groups.setdefault(key, []).append(curve)
    return [(unit.strip(), group) for unit, group in groups.items()]

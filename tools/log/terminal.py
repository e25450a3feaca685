"""Signals over time as text: a chart of Braille dots for each, for a terminal or a pipe."""

import math
from collections.abc import Sequence

import numpy as np

from tools.log.curves import Curve, FloatArray
from tools.log.signals import short_names

_DOTS = ((0x01, 0x02, 0x04, 0x40), (0x08, 0x10, 0x20, 0x80))
"""Bit of each dot of a Braille sign, by column and row."""
_MARGIN = 11
"""Columns left of a chart, for its numbers."""


def render(curves: Sequence[Curve], *, width: int, height: int) -> str:
    """Charts below each other over one axis of time.

    Args:
        curves: What to show.
        width: Columns of the terminal.
        height: Lines of the terminal; charts become no lower than four lines, whatever it says.
    """
    names = short_names(curve.signal for curve in curves)
    times = np.concatenate([curve.time_s for curve in curves])
    start, end = float(times.min()), float(times.max())
    end = end if end > start else start + 1e-3
    rows = min(16, max(4, (height - 4) // len(curves) - 1))
    columns = max(20, width - _MARGIN - 2)
    lines: list[str] = []
    for curve in curves:
        unit = f" [{curve.signal.unit}]" if curve.signal.unit else ""
        lines.append(
            f"{names[curve.signal.name]}{unit}  smallest {curve.smallest:.5g}, largest {curve.largest:.5g}"
        )
        lines += _chart(curve, start, end, rows=rows, columns=columns)
    return "\n".join([*lines, *_time_axis(start, end, columns)])


def _chart(curve: Curve, start: float, end: float, *, rows: int, columns: int) -> list[str]:
    low, high = _limits(curve)
    bottom, top = _ranges(curve, start, end, 2 * columns)
    dots = 4 * rows
    cells = np.zeros((rows, columns), dtype=np.int64)
    scale = (dots - 1) / (high - low)
    for column in range(2 * columns):
        if math.isnan(bottom[column]):
            continue
        first = dots - 1 - round((top[column] - low) * scale)
        last = dots - 1 - round((bottom[column] - low) * scale)
        for dot in range(max(0, first), min(dots - 1, last) + 1):
            cells[dot // 4, column // 2] |= _DOTS[column % 2][dot % 4]
    labels = {
        min(rows - 1, int((high - value) / (high - low) * rows)): _number(value)
        for value in _round_values(low, high, max(2, rows // 3))
    }
    return [
        f"{labels.get(row, ''):>{_MARGIN - 1}} {'┤' if row in labels else '│'}"
        + "".join(chr(0x2800 + int(cell)) for cell in cells[row])
        for row in range(rows)
    ]


def _limits(curve: Curve) -> tuple[float, float]:
    low, high = curve.smallest, curve.largest
    if math.isnan(low):
        return 0.0, 1.0
    room = 0.5 * abs(low) or 0.5
    return (low, high) if high > low else (low - room, high + room)


def _ranges(curve: Curve, start: float, end: float, columns: int) -> tuple[FloatArray, FloatArray]:
    """Smallest and largest value in each column of dots, joined to those of the column before."""
    low, high = np.full(columns, np.inf), np.full(columns, -np.inf)
    known = np.isfinite(curve.values)
    place = ((curve.time_s[known] - start) / (end - start) * (columns - 1)).round().astype(np.int64)
    np.minimum.at(low, place, curve.values[known])
    np.maximum.at(high, place, curve.values[known])
    bare = np.isinf(low)
    if bare.any() and len(curve.time_s):
        low[bare] = high[bare] = _between(curve, np.linspace(start, end, columns)[bare])
    for column in range(1, columns):
        if high[column - 1] < low[column]:
            low[column] = high[column - 1]
        elif low[column - 1] > high[column]:
            high[column] = low[column - 1]
    return low, high


def _between(curve: Curve, times: FloatArray) -> FloatArray:
    """Values between two messages: on a straight line, or the last one of a whole number; NaN in a gap."""
    if not curve.signal.is_whole:
        return np.interp(times, curve.time_s, curve.values, left=np.nan, right=np.nan)
    place = np.searchsorted(curve.time_s, times, side="right") - 1
    return np.where(place >= 0, curve.values[np.maximum(place, 0)], np.nan)


def _time_axis(start: float, end: float, columns: int) -> list[str]:
    rule, labels = ["─"] * columns, [" "] * (columns + 2)
    for value in _round_values(start, end, max(2, columns // 12)):
        place = round((value - start) / (end - start) * (columns - 1))
        rule[place] = "┬"
        text = _number(value)
        at = max(0, min(place + 1 - len(text) // 2, len(labels) - len(text)))
        labels[at : at + len(text)] = text
    pad = " " * _MARGIN
    return [f"{pad}└{''.join(rule)}", f"{pad}{''.join(labels).rstrip()}", f"{pad} time [s]"]


def _round_values(low: float, high: float, about: int) -> list[float]:
    """Round numbers from low to high, about so many."""
    rough = (high - low) / about
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(one * power for one in (1.0, 2.0, 5.0, 10.0) if one * power >= rough * (1.0 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [number * step for number in range(first, last + 1)]


def _number(value: float) -> str:
    return f"{value:.6g}"

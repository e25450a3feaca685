"""A surface given as an array of stiffness: any shape that a grid of numbers can hold.

Cells that differ little belong to one region, as one would colour them; where two neighbours differ by more
there is a border between regions, along the edge of the cells.
"""

import csv
import itertools
import math
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hm_driver.errors import ConfigurationError
from teaching.surface import PALETTE, STIFFNESS_RANGE, Point, Segment, SurfaceObject

FloatArray = NDArray[np.float64]

MOST_CELLS: Final = 250_000
"""Cells that an array may have: each log carries it."""
MOST_REGIONS: Final = 64
"""Regions that an array may fall into: more are a matter of noise, not of objects."""


class Interpolation(Enum):
    """What the stiffness is between the middles of cells."""

    NEAREST = "nearest"
    """That of the cell: a step at its edge."""
    LINEAR = "linear"
    """Bilinear: smooth everywhere, without borders."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StiffnessArray:
    """Stiffness of cells of equal size; hashable, and complete without its file.

    Raises:
        ConfigurationError: The shape, a value or the extent is out of range.
    """

    values: tuple[tuple[float, ...], ...]
    """Stiffness [N/m]; the first index goes along x, the second along y."""
    extent: tuple[float, float, float, float]
    """x_min, x_max, y_min, y_max of the outermost cells' outer edges [m]."""
    interpolation: Interpolation = Interpolation.NEAREST
    """What is between the middles of cells."""
    border: float = 0.2
    """Relative difference of two neighbours from which on there is a border between them."""
    regions: tuple[tuple[int, ...], ...] = field(init=False)
    """Index of the region of each cell."""

    def __post_init__(self) -> None:
        sizes = {len(row) for row in self.values}
        if len(self.values) < 2 or len(sizes) != 1 or min(sizes) < 2:
            shapes = ", ".join(str(size) for size in sorted(sizes)[:5]) or "none"
            raise ConfigurationError(
                "array.values",
                f"{len(self.values)} rows of {shapes} numbers; it must be a rectangle of at least 2 by 2",
            )
        if len(self.values) * min(sizes) > MOST_CELLS:
            raise ConfigurationError(
                "array.values", f"{len(self.values)} by {min(sizes)} cells are more than {MOST_CELLS}"
            )
        low, high = STIFFNESS_RANGE
        for i, row in enumerate(self.values):
            for j, value in enumerate(row):
                if not low <= value <= high:
                    raise ConfigurationError(
                        "array.values",
                        f"[{i}][{j}] = {value:g} N/m is outside {low:g} to {high:g} N/m",
                    )
        x0, x1, y0, y1 = self.extent
        if not (all(map(math.isfinite, self.extent)) and x0 < x1 and y0 < y1):
            raise ConfigurationError(
                "array.extent", f"{list(self.extent)} must be x_min, x_max, y_min, y_max [m]"
            )
        if not 0.0 < self.border <= 100.0:
            raise ConfigurationError("array.border", f"{self.border:g} must be above 0 and at most 100")
        labels, count = self._label()
        if count > MOST_REGIONS:
            raise ConfigurationError(
                "array.border",
                f"{self.border:g} splits the plane into {count} regions, more than {MOST_REGIONS}; raise it, "
                "or set interpolation = 'linear' for a surface without borders",
            )
        object.__setattr__(self, "regions", tuple(map(tuple, labels.tolist())))

    def covers(self, half: float) -> bool:
        """Whether the plane |x|, |y| <= half [m] lies within the array."""
        x0, x1, y0, y1 = self.extent
        tiny = 1e-9
        return x0 <= -half + tiny and x1 >= half - tiny and y0 <= -half + tiny and y1 >= half - tiny

    def stiffness_at(self, x: float, y: float) -> float:
        """Stiffness at a point [N/m]; beyond the array that of its nearest point."""
        u, v = self._cells(x, y)
        nx, ny = len(self.values), len(self.values[0])
        if self.interpolation is Interpolation.NEAREST:
            return self.values[min(nx - 1, max(0, math.floor(u)))][min(ny - 1, max(0, math.floor(v)))]
        u, v = min(nx - 1.0, max(0.0, u - 0.5)), min(ny - 1.0, max(0.0, v - 0.5))
        i, j = min(nx - 2, int(u)), min(ny - 2, int(v))
        a, b = u - i, v - j
        low, high = self.values[i], self.values[i + 1]
        near = (1.0 - a) * low[j] + a * high[j]
        far = (1.0 - a) * low[j + 1] + a * high[j + 1]
        return (1.0 - b) * near + b * far

    def region_at(self, x: float, y: float) -> int:
        """Index of the region at a point [m]."""
        u, v = self._cells(x, y)
        nx, ny = len(self.values), len(self.values[0])
        return self.regions[min(nx - 1, max(0, math.floor(u)))][min(ny - 1, max(0, math.floor(v)))]

    def borders(self, half: float) -> tuple[Segment, ...]:
        """Where two regions meet within the plane |x|, |y| <= half [m], in straight pieces."""
        labels = np.array(self.regions)
        xs = np.linspace(self.extent[0], self.extent[1], labels.shape[0] + 1).tolist()
        ys = np.linspace(self.extent[2], self.extent[3], labels.shape[1] + 1).tolist()
        found: list[Segment] = []
        for i in range(1, labels.shape[0]):
            for first, last in _runs(labels[i - 1] != labels[i]):
                found += _clipped((xs[i], ys[first]), (xs[i], ys[last]), half)
        for j in range(1, labels.shape[1]):
            for first, last in _runs(labels[:, j - 1] != labels[:, j]):
                found += _clipped((xs[first], ys[j]), (xs[last], ys[j]), half)
        return tuple(found)

    def objects(self) -> tuple[SurfaceObject, ...]:
        """The regions as objects to be named and drawn: their boxes, with their mean stiffness."""
        labels, values = np.array(self.regions), np.array(self.values)
        x0, x1, y0, y1 = self.extent
        dx, dy = (x1 - x0) / labels.shape[0], (y1 - y0) / labels.shape[1]
        colours = itertools.cycle(name for name in PALETTE if name != "black")
        things = []
        for region, colour in zip(range(int(labels.max()) + 1), colours, strict=False):
            i, j = np.nonzero(labels == region)
            left, right = x0 + dx * float(i.min()), x0 + dx * float(i.max() + 1)
            low, high = y0 + dy * float(j.min()), y0 + dy * float(j.max() + 1)
            things.append(
                SurfaceObject(
                    name=f"region {region + 1}",
                    outline=((left, low), (right, low), (right, high), (left, high)),
                    stiffness=float(values[labels == region].mean()),
                    colour=colour,
                )
            )
        return tuple(things)

    def _cells(self, x: float, y: float) -> Point:
        x0, x1, y0, y1 = self.extent
        return len(self.values) * (x - x0) / (x1 - x0), len(self.values[0]) * (y - y0) / (y1 - y0)

    def _label(self) -> tuple[NDArray[np.int64], int]:
        """Regions of cells that are joined by small differences, numbered as they come."""
        values = np.array(self.values)
        labels = np.full(values.shape, -1, dtype=np.int64)
        if self.interpolation is Interpolation.LINEAR:
            return np.zeros_like(labels), 1
        count = 0
        for start in np.ndindex(*values.shape):
            if labels[start] >= 0:
                continue
            labels[start] = count
            waiting = [start]
            while waiting:
                i, j = waiting.pop()
                for a, b in ((i - 1, j), (i + 1, j), (i, j - 1), (i, j + 1)):
                    if 0 <= a < values.shape[0] and 0 <= b < values.shape[1] and labels[a, b] < 0:
                        smaller = min(values[i, j], values[a, b])
                        if abs(values[i, j] - values[a, b]) <= self.border * smaller:
                            labels[a, b] = count
                            waiting.append((a, b))
            count += 1
        return labels, count


def read_array(path: Path) -> tuple[tuple[float, ...], ...]:
    """Numbers of a ``.npy`` file (two-dimensional) or of a ``.csv`` file (a row of x each line).

    Raises:
        ConfigurationError: The file cannot be read, or does not hold numbers in a rectangle.
    """
    try:
        if path.suffix == ".npy":
            loaded = np.load(path, allow_pickle=False)
            if loaded.ndim != 2 or loaded.dtype.kind not in "fiu":
                raise ConfigurationError(
                    "array.file",
                    f"{path} holds {loaded.dtype} of shape {loaded.shape}; it must be numbers, (n, m)",
                )
            return tuple(map(tuple, loaded.astype(float).tolist()))
        if path.suffix != ".csv":
            raise ConfigurationError("array.file", f"{path} must be a .npy or a .csv file")
        with path.open(newline="", encoding="utf-8") as file:
            rows = [row for row in csv.reader(file) if row and not row[0].lstrip().startswith("#")]
    except (OSError, ValueError, EOFError) as error:
        raise ConfigurationError("array.file", f"{path} cannot be read: {error}") from error
    values = []
    for number, row in enumerate(rows, start=1):
        try:
            values.append(tuple(float(cell) for cell in row))
        except ValueError as error:
            raise ConfigurationError("array.file", f"{path}, row {number}: {error}") from error
    return tuple(values)


def _runs(chosen: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First index of each run of chosen ones, and the index behind it."""
    steps = np.diff(np.concatenate(([0], chosen.astype(np.int8), [0])))
    return list(zip(np.flatnonzero(steps == 1).tolist(), np.flatnonzero(steps == -1).tolist(), strict=True))


def _clipped(a: Point, b: Point, half: float) -> list[Segment]:
    """The part of an axis-parallel segment within the plane, if it is inside and has a length."""
    (ax, ay), (bx, by) = a, b
    if (ax == bx and abs(ax) >= half - 1e-9) or (ay == by and abs(ay) >= half - 1e-9):
        return []
    ax, bx = max(-half, ax), min(half, bx)
    ay, by = max(-half, ay), min(half, by)
    return [((ax, ay), (bx, by))] if (bx - ax) + (by - ay) > 1e-9 else []

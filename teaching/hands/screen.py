"""The plane as a demonstrator sees it on the screen: coloured areas of any shape, and ways over them."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from teaching.hands.paths import Area, Point, raster

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

PITCH = 0.005
"""Distance of two places that he tells apart on the screen [m]."""
SHORTEST = 0.02
"""Lines shorter than this are not worth drawing [m]."""


class Screen:
    """Colours on the plane, seen as a whole; no stiffness.

    Args:
        colour_at: Index of the colour at a place [m]; negative where there is none.
        half: Half the edge of the plane [m].
        pitch: Distance of two places that are told apart [m].
    """

    def __init__(self, colour_at: Callable[[float, float], int], half: float, pitch: float = PITCH) -> None:
        n = max(2, round(2.0 * half / pitch))
        self._n, self._half, self._pitch = n, half, 2.0 * half / n
        steps = self._pitch * (np.arange(n) + 0.5) - half
        x, y = np.meshgrid(steps, steps, indexing="ij")
        self._points: FloatArray = np.stack((x.ravel(), y.ravel()), axis=1)
        self._colours: IntArray = np.array(
            [colour_at(a, b) for a, b in self._points.tolist()], dtype=np.int64
        )
        self._to_edge = self._distances()
        self.colours: list[int] = sorted({colour for colour in self._colours.tolist() if colour >= 0})
        """The colours that are to be seen."""

    def area(self, colour: int) -> Area:
        """The box around a colour [m]."""
        low = self._points[self._colours == colour].min(axis=0) - 0.5 * self._pitch
        high = self._points[self._colours == colour].max(axis=0) + 0.5 * self._pitch
        return Area(float(low[0]), float(high[0]), float(low[1]), float(high[1]))

    def lines(
        self, colour: int, spacing: float, margin: float, *, along_x: bool = True, start: Point
    ) -> list[Point]:
        """Boustrophedon lines over a colour, whatever its shape.

        Args:
            colour: What to cover.
            spacing: Largest distance of two lines [m].
            margin: Distance kept from the colour's edge and from the plane's [m].
            along_x: Whether the lines run along x.
            start: Where one comes from [m].

        Returns:
            Way points [m].
        """
        area = self.area(colour)
        path = raster(area, spacing, margin, along_x=along_x, start=start)
        if np.all(self._inside(colour, area)):
            return path
        found: list[Point] = []
        for (ax, ay), (bx, by) in zip(path[::2], path[1::2], strict=True):
            n = max(2, math.ceil(math.hypot(bx - ax, by - ay) / self._pitch) + 1)
            t = np.linspace(0.0, 1.0, n)
            places = np.stack((ax + t * (bx - ax), ay + t * (by - ay)), axis=1)
            index = self._index(places)
            is_own = (self._colours[index] == colour) & (self._to_edge[index] >= margin)
            for first, last in runs(is_own):
                ends = [(float(px), float(py)) for px, py in places[[first, last]]]
                if math.dist(*ends) >= SHORTEST:
                    found += ends
        return found or [area.centre]

    def edge(self, colour: int, offset: float, start: Point) -> list[Point]:
        """A way along the inner side of a colour's edge to other colours, at a distance from it [m].

        The plane's own edge is no edge between colours, and he keeps a little away from it.
        """
        from_rim = self._half - np.abs(self._points).max(axis=1)
        is_there = np.abs(self._to_edge - offset) <= 0.5 * self._pitch + 1e-9
        chosen = np.flatnonzero((self._colours == colour) & is_there & (from_rim > self._pitch))
        places = self._points[chosen]
        left = np.ones(len(places), dtype=bool)
        here = np.asarray(start)
        pieces: list[list[FloatArray]] = []
        while left.any():
            gaps = np.where(left, ((places - here) ** 2).sum(axis=1), np.inf)
            nearest = int(np.argmin(gaps))
            if not pieces or gaps[nearest] > (3.0 * self._pitch) ** 2:
                pieces.append([])
            left[nearest] = False
            here = places[nearest]
            pieces[-1].append(here)
        way: list[Point] = []
        for piece in pieces:
            if len(piece) >= 3:
                way += smoothed(np.array(piece))
        return way

    def _inside(self, colour: int, area: Area) -> NDArray[np.bool_]:
        """Whether each place in an area is of the colour."""
        x, y = self._points.T
        is_in = (x > area.x_min) & (x < area.x_max) & (y > area.y_min) & (y < area.y_max)
        same: NDArray[np.bool_] = self._colours[is_in] == colour
        return same

    def _index(self, places: FloatArray) -> IntArray:
        cell = np.clip(((places + self._half) / self._pitch).astype(np.int64), 0, self._n - 1)
        index: IntArray = cell[:, 0] * self._n + cell[:, 1]
        return index

    def _distances(self) -> FloatArray:
        """Distance of each place from the nearest of another colour, less half a pitch [m]."""
        grid = self._colours.reshape(self._n, self._n)
        is_rim = np.zeros_like(grid, dtype=bool)
        for axis in (0, 1):
            differs = np.diff(grid, axis=axis) != 0
            along = [slice(None), slice(None)]
            along[axis] = slice(0, -1)
            is_rim[tuple(along)] |= differs
            along[axis] = slice(1, None)
            is_rim[tuple(along)] |= differs
        rim = np.flatnonzero(is_rim.ravel())
        distances = np.full(len(self._points), np.inf)
        for colour in np.unique(self._colours):
            others = self._points[rim[self._colours[rim] != colour]]
            own = np.flatnonzero(self._colours == colour)
            if len(others):
                offset = self._points[own][:, None, :] - others[None, :, :]
                distances[own] = np.sqrt((offset**2).sum(axis=2).min(axis=1)) - 0.5 * self._pitch
        return distances


def runs(chosen: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First and last index of each run of chosen places."""
    steps = np.diff(np.concatenate(([0], chosen.astype(np.int8), [0])))
    return list(
        zip(np.flatnonzero(steps == 1).tolist(), (np.flatnonzero(steps == -1) - 1).tolist(), strict=True)
    )


def smoothed(places: FloatArray) -> list[Point]:
    """Places in a row, shape (n, 2), averaged over five and thinned to every third."""
    if len(places) >= 5:
        padded = np.concatenate((places[:1], places[:1], places, places[-1:], places[-1:]))
        ends = places[0], places[-1]
        places = np.mean([padded[k : k + len(places)] for k in range(5)], axis=0)
        places[0], places[-1] = ends
    thinned = np.concatenate((places[:-1:3], places[-1:]))
    return [(float(x), float(y)) for x, y in thinned]

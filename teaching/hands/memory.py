"""What a demonstrator remembers of the plane: where he was in control, and where the skill was."""

import math
from enum import IntEnum

import numpy as np

from teaching.hands.paths import Area, Point


class Remembered(IntEnum):
    """What was last seen in a cell."""

    NOTHING = 0
    """Not visited since the last update."""
    OWN = 1
    """He was in control."""
    SKILL = 2
    """The skill was in control."""


class PlaneMemory:
    """A coarse memory of who was in control where.

    Args:
        areas: The coloured areas [m].
        cell: Size of what he tells apart [m].
        dwell: How long the skill must hold the places that were his before he believes in an update [s].
        patience: How long the skill must be in control anywhere before he believes in an update [s].
    """

    def __init__(self, areas: list[Area], *, cell: float, dwell: float = 0.3, patience: float = 2.5) -> None:
        self._x_min = min(a.x_min for a in areas)
        self._y_min = min(a.y_min for a in areas)
        self._cell = cell
        self._nx = max(1, round((max(a.x_max for a in areas) - self._x_min) / cell))
        self._ny = max(1, round((max(a.y_max for a in areas) - self._y_min) / cell))
        self._seen = [Remembered.NOTHING] * (self._nx * self._ny)
        self._dwell = dwell
        self._patience = patience
        self._lost = 0.0
        self._without = 0.0
        self._taught: list[Point] = []

    def _index(self, x: float, y: float) -> int:
        i = int((x - self._x_min) / self._cell)
        j = int((y - self._y_min) / self._cell)
        return min(max(i, 0), self._nx - 1) * self._ny + min(max(j, 0), self._ny - 1)

    def see(self, x: float, y: float, C: float, dt: float) -> None:
        """Take in who is in control at a place [m] for a time [s]."""
        index = self._index(x, y)
        if C == 1.0:
            self._without = self._lost = 0.0
            if self._seen[index] is not Remembered.OWN:
                self._seen[index] = Remembered.OWN
                self._taught.append((x, y))
        elif C < 0.5:
            if not self._taught:
                self._seen[index] = Remembered.SKILL
                return
            self._without += dt
            if self._seen[index] is Remembered.OWN:
                self._lost += dt
            else:
                self._seen[index] = Remembered.SKILL
                self._lost = 0.0

    @property
    def has_changed_hands(self) -> bool:
        """Whether the skill has taken over where he was in control."""
        return self._lost >= self._dwell or self._without >= self._patience

    def note_update(self) -> list[Point]:
        """Believe in an update: what was his is to be looked at again.

        Returns:
            The places that he had taught [m].
        """
        self._lost = self._without = 0.0
        self._seen = [Remembered.NOTHING if s is Remembered.OWN else s for s in self._seen]
        taught, self._taught = self._taught, []
        return taught

    def nearest_unsettled(self, x: float, y: float, rng: np.random.Generator) -> Point:
        """The nearest place [m] where he has not seen the skill in control; anywhere, when there is none."""
        best, distance = -1, math.inf
        for index, seen in enumerate(self._seen):
            if seen is not Remembered.SKILL:
                px, py = self._point(index)
                d = (px - x) ** 2 + (py - y) ** 2
                if d < distance and d > self._cell**2 / 16.0:
                    best, distance = index, d
        return self._point(best if best >= 0 else int(rng.integers(len(self._seen))))

    def _point(self, index: int) -> Point:
        i, j = divmod(index, self._ny)
        return self._x_min + (i + 0.5) * self._cell, self._y_min + (j + 0.5) * self._cell

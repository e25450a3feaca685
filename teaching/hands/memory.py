"""What a demonstrator remembers of the plane: where he was in control, and where the skill was."""

from enum import IntEnum

from teaching.hands.paths import Area, Point

RECENT = 200
"""A place that he has looked at within so many looks is not looked at again."""


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
        suspicion: How long the skill must hold places that he did not know to be its own before he
            suspects an update [s].
    """

    def __init__(self, areas: list[Area], *, cell: float, suspicion: float = 0.5) -> None:
        self._x_min = min(a.x_min for a in areas)
        self._y_min = min(a.y_min for a in areas)
        self._cell = cell
        self._nx = max(1, round((max(a.x_max for a in areas) - self._x_min) / cell))
        self._ny = max(1, round((max(a.y_max for a in areas) - self._y_min) / cell))
        self._seen = [Remembered.NOTHING] * (self._nx * self._ny)
        self._visited = [0] * len(self._seen)
        self._visits = 0
        self._suspicion = suspicion
        self._unexplained: dict[int, float] = {}
        self._own_trail: list[Point] = []
        self.taught: list[Point] = []
        """The places that he has taught since the last update [m]."""

    def see(self, x: float, y: float, C: float, dt: float) -> None:
        """Take in who is in control at a place [m] for a time [s]."""
        index = self._index(x, y)
        self._visits += 1
        self._visited[index] = self._visits
        if C == 1.0:
            self._explain()
            if self._seen[index] is not Remembered.OWN:
                self._seen[index] = Remembered.OWN
                self.taught.append((x, y))
            self._own_trail.append((x, y))
            del self._own_trail[:-20]
        elif C < 0.5 and self._seen[index] is not Remembered.SKILL:
            self._unexplained[index] = self._unexplained.get(index, 0.0) + dt
            if not self.taught:
                self._explain()

    @property
    def suspects(self) -> bool:
        """Whether the skill has held places for a while that were not its own, so that he looks back."""
        return sum(self._unexplained.values()) >= self._suspicion and bool(self._own_trail)

    def look_back(self) -> Point:
        """The place to look at [m]: where he was in control a moment before he lost it.

        What he has seen since then is explained once it turns out that he is still in control there.
        """
        return self._own_trail[0]

    def dismiss(self) -> None:
        """He is still in control where he looked back: the skill knew these places before."""
        self._explain()

    def note_update(self) -> None:
        """Believe in an update: what was his is to be looked at again."""
        self._explain()
        self._own_trail.clear()
        self._seen = [Remembered.NOTHING if s is Remembered.OWN else s for s in self._seen]
        self.taught = []

    def next_place(self, x: float, y: float) -> Point:
        """Where to look for places to teach [m]: the nearest that he does not know, or his own oldest."""
        recent = self._visits - RECENT
        unknown = [
            i
            for i, seen in enumerate(self._seen)
            if seen is Remembered.NOTHING and (self._visited[i] == 0 or self._visited[i] < recent)
        ]
        if unknown:
            return min((self._point(i) for i in unknown), key=lambda p: (p[0] - x) ** 2 + (p[1] - y) ** 2)
        own = [i for i, seen in enumerate(self._seen) if seen is Remembered.OWN]
        return self._point(min(own or range(len(self._seen)), key=self._visited.__getitem__))

    def _explain(self) -> None:
        for index in self._unexplained:
            self._seen[index] = Remembered.SKILL
        self._unexplained.clear()

    def _index(self, x: float, y: float) -> int:
        i = int((x - self._x_min) / self._cell)
        j = int((y - self._y_min) / self._cell)
        return min(max(i, 0), self._nx - 1) * self._ny + min(max(j, 0), self._ny - 1)

    def _point(self, index: int) -> Point:
        i, j = divmod(index, self._ny)
        return self._x_min + (i + 0.5) * self._cell, self._y_min + (j + 0.5) * self._cell

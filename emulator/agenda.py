"""What the device will do at a later step: the course of an initialisation, a schedule of faults."""

import heapq
from collections.abc import Callable
from itertools import count

NEVER = 1 << 62
"""A step that is never reached."""


class Agenda:
    """Actions by the step at which they are due; those of one step run in the order they were entered."""

    __slots__ = ("_entries", "_order", "next_step")

    def __init__(self) -> None:
        self._entries: list[tuple[int, int, str, Callable[[], None]]] = []
        self._order = count()
        self.next_step = NEVER
        """The earliest step at which something is due."""

    def enter(self, step: int, action: Callable[[], None], *, topic: str) -> None:
        """Have `action` run once `step` steps are done; `topic` is the name to strike it out by."""
        heapq.heappush(self._entries, (step, next(self._order), topic, action))
        self.next_step = self._entries[0][0]

    def strike_out(self, topic: str) -> None:
        """Forget what was entered under a topic."""
        self._entries = [entry for entry in self._entries if entry[2] != topic]
        heapq.heapify(self._entries)
        self.next_step = self._entries[0][0] if self._entries else NEVER

    def run_due(self, step: int) -> None:
        """Run what is due at `step`, also what it enters for now."""
        while self._entries and self._entries[0][0] <= step:
            action = heapq.heappop(self._entries)[3]
            self.next_step = self._entries[0][0] if self._entries else NEVER
            action()

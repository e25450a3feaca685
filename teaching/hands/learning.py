"""Demonstrators who are not perfect: one who learns over time, and one who errs and corrects himself."""

import math
from typing import Any

from teaching.hands.contract import HandIntent, Seen
from teaching.hands.paths import Area, Point, raster
from teaching.hands.simulated import Doing, SimulatedHand

NOTICED = 0.15
"""Relative error of the skill's force that he notices."""
NOTICE_S = 0.2
"""How long he must see it [s]."""
PUSH = 15.0
"""Force with which he insists [N]."""
GIVE_UP_S = 3.0
"""How long he insists where control does not come back [s]."""


class ClumsyHand(SimulatedHand):
    """A novice: unsteady and slow to react, as much as his options say."""

    def _clumsy(self) -> float:
        return self._options.clumsiness


class LearningHand(SimulatedHand):
    """Begins as a novice, and remembers of each colour the depth that he has found for it.

    His unsteadiness and his lag fall from ``clumsiness`` times the options' to the options' own.
    """

    def _clumsy(self) -> float:
        return 1.0 + (self._options.clumsiness - 1.0) * math.exp(-self._age / self._options.learning_time)


class MistakenHand(SimulatedHand):
    """Holds a wrong force in a region until he sees the skill doing so; then he insists and teaches it anew.

    He pushes against the skill with what he takes for right now. Where control does not come back, because
    the session lets nobody take it so, he gives up after a while and goes on.
    """

    def __init__(self, **given: Any) -> None:  # noqa: ANN401 - the arguments of SimulatedHand
        super().__init__(**given)
        self.is_aware = False
        """Whether he knows that he was wrong."""
        self._off = self._insisted = 0.0
        self._is_relearning = False
        self._before: tuple[Doing, list[Point]] = (Doing.MOPPING_UP, [])

    def step(self, seen: Seen, dt: float) -> HandIntent | None:
        """As :meth:`SimulatedHand.step`, with a push where he insists."""
        intent = super().step(seen, dt)
        if intent is None or not self._is_insisting(seen):
            return intent
        right = self._depths[self._colour] if 0 <= self._colour < len(self._depths) else seen.depth
        return intent._replace(force=(0.0, 0.0, -PUSH if right > seen.depth else PUSH))

    def _aim(self, seen: Seen) -> float:
        is_wrong = not self.is_aware and self._is_in_region(seen)
        return self._options.mistake_share if is_wrong else 1.0

    def _is_in_region(self, seen: Seen) -> bool:
        options = self._options
        return math.dist((seen.x, seen.y), (options.mistake_x, options.mistake_y)) <= options.mistake_radius

    def _is_insisting(self, seen: Seen) -> bool:
        is_there = self.doing is Doing.CORRECTING and self._walker.is_done
        return is_there and not self._is_relearning and seen.C < 0.5

    def _decide(self, seen: Seen, dt: float) -> None:
        if self.doing is Doing.CORRECTING:
            self._correct(seen, dt)
            return
        if not self.is_aware and self._sees_it(seen, dt):
            self.is_aware = True
            self._before = self.doing, [self._walker.position, *self._walker.way_points]
            self.doing = Doing.CORRECTING
            self._walker.go([(self._options.mistake_x, self._options.mistake_y)])
            return
        super()._decide(seen, dt)

    def _sees_it(self, seen: Seen, dt: float) -> bool:
        is_off = abs(seen.force / self._reference_force - 1.0) > NOTICED
        looks = self.doing is not Doing.LOOKING_BACK and seen.C == 0.0 and self._is_in_region(seen)
        self._off = self._off + dt if looks and is_off else 0.0
        return self._off >= NOTICE_S

    def _correct(self, seen: Seen, dt: float) -> None:
        walker, options = self._walker, self._options
        if not walker.is_done:
            return
        if self._is_relearning or self._insisted > GIVE_UP_S:
            self.doing, path = self._before
            walker.go(path)
        elif seen.C > 0.5:
            self._is_relearning = True
            x, y, r = options.mistake_x, options.mistake_y, options.mistake_radius
            area = Area(x - r, x + r, y - r, y + r)
            walker.go(raster(area, options.line_spacing, 0.0, start=walker.position))
        else:
            self._insisted += dt

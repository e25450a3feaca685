"""The finger on the button that takes control: how a simulated human judges when to press it."""

from teaching.hands.contract import Seen

WRONG = 2.0
"""Deviation of the force from which on he takes control [N]."""
RIGHT = 1.0
"""Deviation of the force up to which he is content [N]."""
NOTICE = 0.4
"""How long it must be wrong, or right, until he acts [s]."""
LEAST = 2.0
"""How long he keeps the button down at least, to demonstrate something [s]."""


class Finger:
    """Presses where the force that he sees is wrong, and lets go once he has shown how it is done.

    Args:
        reference_force: Force that he is asked to hold [N].
    """

    def __init__(self, reference_force: float) -> None:
        self._reference_force = reference_force
        self._noticed = self._held = 0.0
        self.is_down = False

    def step(self, seen: Seen, dt: float) -> bool:
        """Whether the button is down after another look of a duration [s]."""
        off = abs(seen.force - self._reference_force)
        self._held += dt
        if seen.surface < 0 or seen.autonomous:
            self._noticed = 0.0
        else:
            self._noticed = self._noticed + dt if (off < RIGHT if self.is_down else off > WRONG) else 0.0
        if self._noticed > NOTICE and (not self.is_down or self._held > LEAST):
            self.is_down = not self.is_down
            self._noticed = self._held = 0.0
        return self.is_down

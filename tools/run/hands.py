"""The hand's way to the emulated arm: what the session's hands intend, in the words of the world endpoint."""

from emulator.world import World
from teaching.hands.contract import HandIntent
from tools.run.runner import Felt


class EmulatedWorld:
    """Carries a hand's intent to an emulator's world endpoint, over a socket or in this process.

    Args:
        world: The endpoint.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._holds = True

    def move(self, intent: HandIntent | None) -> Felt:
        """Carry the intent over; None lets go."""
        if intent is None:
            truth = self._world.exchange(None) if self._holds else self._world.observe()
            self._holds = False
        else:
            self._holds = True
            truth = self._world.exchange(intent._asdict())
        return Felt(truth.hand_force, truth.contact_force)

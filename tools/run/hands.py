"""The hand's way to the emulated arm: what the session's hands intend, in the words of the world endpoint."""

from collections import deque

from emulator.world import Truth, World, WorldClient
from hm_driver.errors import TransportTimeout
from teaching.hands.contract import HandIntent
from tools.run.runner import Felt

LONGEST_SILENCE_NS = 2_000_000_000
"""How long the world endpoint may leave an intent unanswered."""


class EmulatedWorld:
    """Carries a hand's intent to an emulator in this process.

    Args:
        world: The endpoint.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._holds = True

    def move(self, time_ns: int, intent: HandIntent | None) -> list[Felt]:
        """Carry the intent over; None lets go. What it was met with is known at once."""
        if intent is None:
            truth = self._world.exchange(None) if self._holds else self._world.observe()
            self._holds = False
        else:
            self._holds = True
            truth = self._world.exchange(intent._asdict())
        return [_felt(time_ns, intent, truth)]


class RemoteWorld:
    """Carries a hand's intent to an emulator in another process, without waiting for it.

    A tick sends its intent and takes the replies that have come by then, so that an emulator which a busy
    machine holds up for a moment does not hold up the tick.

    Args:
        client: The connection to the endpoint; the caller closes it.
    """

    def __init__(self, client: WorldClient) -> None:
        self._client = client
        self._waiting: deque[tuple[int, HandIntent | None]] = deque()

    def move(self, time_ns: int, intent: HandIntent | None) -> list[Felt]:
        """Send the intent, None to let go, and tell what earlier ones were met with.

        Raises:
            TransportTimeout: No reply for `LONGEST_SILENCE_NS`.
            TransportClosed: The connection is lost.
        """
        felt = [_felt(*self._waiting.popleft(), truth) for truth in self._client.finished()]
        if self._waiting and time_ns - self._waiting[0][0] > LONGEST_SILENCE_NS:
            raise TransportTimeout(
                f"the world endpoint {self._client.url} has not answered for "
                f"{LONGEST_SILENCE_NS * 1e-9:g} s; is the emulator still running?"
            )
        self._client.begin(None if intent is None else intent._asdict())
        self._waiting.append((time_ns, intent))
        return felt


def _felt(time_ns: int, intent: HandIntent | None, truth: Truth) -> Felt:
    return Felt(time_ns, intent, truth.hand_force, truth.contact_force)

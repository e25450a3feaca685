"""A hand that does again what a hand in a log did."""

import itertools
from collections.abc import Sequence

from hm_driver.errors import ConfigurationError
from teaching.hands.contract import HandIntent, Seen


class RecordedHand:
    """Replays intents by the time that has passed, whatever happens.

    Args:
        times: Times of the intents from the first one on [s], ascending.
        intents: The intents; None where the hand had let go.

    Raises:
        ConfigurationError: There is no intent, there are not as many times, or they do not ascend.
    """

    button = False
    """A log does not tell of the hand's button."""

    def __init__(self, times: Sequence[float], intents: Sequence[HandIntent | None]) -> None:
        if not times or len(times) != len(intents):
            raise ConfigurationError("recording", f"{len(times)} times and {len(intents)} intents of a hand")
        if any(b <= a for a, b in itertools.pairwise(times)):
            raise ConfigurationError("recording", "the times of the hand's intents do not ascend")
        self._times, self._intents = list(times), list(intents)
        self._time = times[0]
        self._next = 0

    def step(self, seen: Seen, dt: float) -> HandIntent | None:
        """The intent of this time; lets go behind the last one and for the autonomous stage."""
        if self._next > 0:
            self._time += dt
        while self._next < len(self._times) and self._times[self._next] <= self._time + 1e-6:
            self._next += 1
        is_over = self._next == len(self._times) and self._time > self._times[-1] + 1e-6
        return None if seen.autonomous or is_over else self._intents[self._next - 1]

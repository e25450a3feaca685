"""The absolute 2500 Hz grid of the emulated device: which steps are due, which periods were missed."""

from fractions import Fraction

from hm_driver.errors import ConfigurationError

STEP_RATE_HZ = 2500
"""Update rate of the outer and inner loop (device facts, confidence H)."""
STEP_NS = 1_000_000_000 // STEP_RATE_HZ
"""Device time of one step [ns]."""

LOWEST_SPEED, HIGHEST_SPEED = 0.001, 100.0


def steps_until(time_ns: int) -> int:
    """How many steps the device has run by a device time [ns]: floor(t * 2500), in integers."""
    return time_ns * STEP_RATE_HZ // 1_000_000_000


class TickGrid:
    """Ticks at fixed times after a start, and the steps to run at each.

    A tick is 400 µs of wall time, or one step where the device runs slower than the wall clock. After a
    stall the steps that fell due are caught up at once as far as ``max_catch_up`` allows; the rest is given
    up, whole steps at a time, so that the grid never shifts. Device time then lags by what was given up.

    Args:
        start_ns: Wall time of step 0 [ns].
        speed: Device seconds a wall second, 0.001 to 100.
        max_catch_up: Most steps of real time (400 µs each) to run at one tick.

    Raises:
        ConfigurationError: The speed is out of range.
    """

    __slots__ = (
        "_done",
        "_max_steps",
        "_start_ns",
        "_step_denominator",
        "_step_numerator",
        "_steps_per_tick",
        "given_up",
        "missed",
        "next_ns",
        "ticks",
    )

    def __init__(self, *, start_ns: int, speed: float = 1.0, max_catch_up: int = 50) -> None:
        if not LOWEST_SPEED <= speed <= HIGHEST_SPEED:
            raise ConfigurationError("speed", f"{speed} must be {LOWEST_SPEED} to {HIGHEST_SPEED:g}")
        step_ns = Fraction(STEP_NS) / Fraction(speed).limit_denominator(1000)
        self._start_ns = start_ns
        self._step_numerator, self._step_denominator = step_ns.numerator, step_ns.denominator
        self._steps_per_tick = max(1, round(speed))
        self._max_steps = max_catch_up * self._steps_per_tick
        self._done = 0
        self.ticks = 0
        """Ticks at which steps were run."""
        self.missed = 0
        """Periods without a tick of their own: run late with the next, or given up."""
        self.given_up = 0
        """Steps that were never run."""
        self.next_ns = start_ns
        """Wall time of the next tick [ns]."""

    def take_due(self, now_ns: int) -> int:
        """Steps to run now; 0 before the next tick."""
        if now_ns < self.next_ns:
            return 0
        reached = (now_ns - self._start_ns) * self._step_denominator // self._step_numerator + 1
        due = reached - self._done
        self._done = reached
        self.ticks += 1
        if due > self._steps_per_tick:
            self.missed += due // self._steps_per_tick - 1
            if due > self._max_steps:
                self.given_up += due - self._max_steps
                due = self._max_steps
        following = reached + self._steps_per_tick - 1
        self.next_ns = self._start_ns - (-following * self._step_numerator // self._step_denominator)
        return due

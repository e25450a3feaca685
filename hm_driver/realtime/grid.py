"""The absolute time grid of a periodic loop: skip whole periods and count them, sleep, then spin the rest.

A next deadline of "now + period" runs at 984 Hz when 1000 are asked; here deadline k is start + k periods,
whatever happened before. A loop that comes late by whole periods leaves them out, and counts them: cycles
run + periods missed = length of the grid, exactly.
"""

from hm_driver.errors import ConfigurationError
from hm_driver.realtime.clock import Clock

NANOSECONDS = 1_000_000_000
SAFETY_NS = 10_000
"""Added to the expected lateness of the sleep [ns]."""
MAXIMUM_MARGIN_NS = 150_000
"""The longest spin before a deadline [ns]."""
_QUANTILE = 0.998
_STEP_NS = 4_000.0


def period_ns_of(rate_hz: float) -> int:
    """Period [ns] of a rate [Hz], rounded to a whole nanosecond.

    Raises:
        ConfigurationError: The rate is outside 1 to 10000 Hz.
    """
    if not 1.0 <= rate_hz <= 10_000.0:
        raise ConfigurationError("rate_hz", f"{rate_hz:g} Hz is outside 1 to 10000 Hz")
    return round(NANOSECONDS / rate_hz)


class SpinMargin:
    """How long before a deadline to end the sleep: running p99.8 of the sleep's own lateness + 10 µs.

    With the p99 a hundredth of all wake-ups is late, and the p99 of the loop is that of the
    sleep: 14 µs were measured, and 0.6 µs with the p99.8, for 11 instead of 7 % of a core.

    The quantile is followed by a stochastic step (up 0.998, down 0.002 of 4 µs), so that a host stall of
    milliseconds moves it no further than any other late wake-up. The duty cap bounds the spin to a share of
    the period; a cap of 0 (battery, CI) never spins.

    Args:
        period_ns: Period of the loop [ns].
        duty_cap: Largest share of the period that may be spun.

    Raises:
        ConfigurationError: The cap is outside 0 to 0.5.
    """

    __slots__ = ("_ceiling_ns", "_quantile_ns", "margin_ns")

    def __init__(self, period_ns: int, *, duty_cap: float = 0.15) -> None:
        if not 0.0 <= duty_cap <= 0.5:
            raise ConfigurationError("duty_cap", f"{duty_cap:g} is outside 0 to 0.5")
        self._ceiling_ns = min(MAXIMUM_MARGIN_NS, int(duty_cap * period_ns))
        self._quantile_ns = 80_000.0
        self.margin_ns = min(self._ceiling_ns, 90_000)
        """Time between the end of the sleep asked for and the deadline [ns]."""

    def observe(self, lateness_ns: int) -> None:
        """Learn from a sleep that ended this much after the time asked for [ns]."""
        quantile_ns = self._quantile_ns
        quantile_ns += _STEP_NS * _QUANTILE if lateness_ns > quantile_ns else _STEP_NS * (_QUANTILE - 1.0)
        self._quantile_ns = max(0.0, quantile_ns)
        margin_ns = int(quantile_ns) + SAFETY_NS
        self.margin_ns = min(self._ceiling_ns, margin_ns)


class Grid:
    """The deadlines of a loop, taken one after the other by ``wait``.

    Args:
        clock: Clock that the deadlines are on.
        period_ns: Distance between deadlines [ns].
        start_ns: Deadline 0 [ns]; None for the time of the first ``wait``.
        first: Number of the first deadline to wait for, of a grid that began before.
        spin: Spin margin; None sleeps up to the deadline.
    """

    __slots__ = (
        "_clock",
        "_first",
        "_now_ns",
        "_spin",
        "_start_ns",
        "cycles",
        "deadline_ns",
        "dt_ns",
        "index",
        "lateness_ns",
        "missed",
        "period_ns",
        "skipped",
        "spun_ns",
        "wake_ns",
    )

    def __init__(
        self,
        clock: Clock,
        period_ns: int,
        *,
        start_ns: int | None = None,
        first: int = 0,
        spin: SpinMargin | None = None,
    ) -> None:
        self._clock = clock
        self._now_ns = clock.now_ns
        self._spin = spin
        self._start_ns = start_ns
        self.period_ns = period_ns
        self._first = first
        self.index = first - 1
        """Number of the present deadline, from 0."""
        self.deadline_ns = 0
        """The present deadline [ns]: the last one at or before the wake-up."""
        self.wake_ns = 0
        """When ``wait`` returned [ns]."""
        self.lateness_ns = 0
        """Wake-up minus the deadline that was waited for [ns], skipped periods included."""
        self.dt_ns = period_ns
        """True time between this wake-up and the one before [ns]."""
        self.skipped = 0
        """Periods left out just before this cycle."""
        self.cycles = 0
        """Cycles run."""
        self.missed = 0
        """Periods missed in all."""
        self.spun_ns = 0
        """Time spent spinning in all [ns]."""

    @property
    def length(self) -> int:
        """Deadlines passed so far; cycles + missed by construction."""
        return self.index + 1 - self._first

    def resume(self, cycles: int) -> None:
        """Go on behind a loop that ran so many cycles from a ``start_ns`` on and missed none.

        Raises:
            ValueError: The grid has no ``start_ns``.
        """
        if self._start_ns is None:
            raise ValueError("only a grid with a start can be resumed")
        self.cycles = cycles
        self.index = self._first + cycles - 1
        self.wake_ns = self.deadline_ns = self._start_ns + self.index * self.period_ns

    def wait(self) -> int:
        """Wait for the next deadline; returns the number of periods that had to be skipped."""
        start_ns = self._start_ns
        if start_ns is None:
            start_ns = self._start_ns = self._now_ns()
        period_ns = self.period_ns
        target = self.index + 1
        target_ns = start_ns + target * period_ns
        now_ns = self._now_ns()
        if now_ns < target_ns:
            if self._spin is None:
                self._clock.sleep_until_ns(target_ns)
                now_ns = self._now_ns()
            else:
                now_ns = self._sleep_and_spin(self._spin, target_ns, now_ns)
        self.lateness_ns = lateness_ns = now_ns - target_ns
        if lateness_ns < period_ns:
            self.skipped = skipped = 0
            self.deadline_ns = target_ns
        else:
            self.skipped = skipped = lateness_ns // period_ns
            self.missed += skipped
            target += skipped
            self.deadline_ns = target_ns + skipped * period_ns
        if self.cycles:
            self.dt_ns = now_ns - self.wake_ns
        self.wake_ns = now_ns
        self.index = target
        self.cycles += 1
        return skipped

    def _sleep_and_spin(self, spin: SpinMargin, target_ns: int, now_ns: int) -> int:
        clock = self._clock
        margin_ns = spin.margin_ns
        if margin_ns == 0:
            clock.sleep_until_ns(target_ns)
            return self._now_ns()
        asked_ns = target_ns - margin_ns
        if now_ns < asked_ns:
            clock.sleep_until_ns(asked_ns)
            now_ns = self._now_ns()
            spin.observe(now_ns - asked_ns)
        if now_ns < target_ns:
            self.spun_ns += target_ns - now_ns
            now_ns = clock.spin_until_ns(target_ns)
        return now_ns

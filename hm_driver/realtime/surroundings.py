"""What the loop watches beside the device: the application's heartbeat, and its own missed deadlines."""

from hm_driver.realtime.grid import Grid
from hm_driver.realtime.options import WatchOptions
from hm_driver.realtime.segment import Trip

_FORGIVEN = 0.5
"""Missed periods that each cycle forgives: more than every other one, for long enough, trips."""


class Surroundings:
    """Counts silence and missed periods.

    Silence is counted in time that the loop itself ran, so that a stall of the whole machine is none. The
    heartbeat is watched from the application's first sign of life on.

    Args:
        grid: The deadlines.
        watch: The limits.
        beat: The application's heartbeat, as last seen.
        silence_ns: Time since it changed [ns]; negative before the first sign of life.
    """

    __slots__ = ("_beat", "_beat_limit_ns", "_grid", "_missed", "_missed_limit", "_silence_ns")

    def __init__(self, grid: Grid, watch: WatchOptions, *, beat: int, silence_ns: int = -1) -> None:
        self._grid = grid
        self._beat = beat
        self._beat_limit_ns = int(watch.heartbeat_s * 1e9)
        self._silence_ns = silence_ns
        self._missed = 0.0
        self._missed_limit = watch.missed_s * 1e9 / grid.period_ns

    def problem(self, beat: int) -> tuple[Trip, str] | None:
        """Look around once a cycle; what trips, and why.

        Args:
            beat: The application's heartbeat; any change is a sign of life.
        """
        if beat != self._beat:
            self._beat = beat
            self._silence_ns = 0
        elif self._silence_ns >= 0 < self._beat_limit_ns:
            grid = self._grid
            self._silence_ns += min(grid.dt_ns, 2 * grid.period_ns)
            if self._silence_ns > self._beat_limit_ns:
                return Trip.HEARTBEAT, (
                    f"the application was silent for {self._silence_ns * 1e-6:.0f} ms, "
                    f"{self._beat_limit_ns * 1e-6:g} ms are allowed"
                )
        if self._grid.skipped or self._missed:
            return self._count_missed()
        return None

    def _count_missed(self) -> tuple[Trip, str] | None:
        self._missed = max(0.0, self._missed - _FORGIVEN) + self._grid.skipped
        if 0.0 < self._missed_limit < self._missed:
            return Trip.DEADLINE, (
                f"{self._missed:.0f} periods of {self._grid.period_ns * 1e-6:g} ms were missed, "
                f"{self._missed_limit:.0f} are allowed; lower the rate, or see what else this CPU runs"
            )
        return None

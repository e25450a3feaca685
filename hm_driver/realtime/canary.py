"""The canary: a process that sleeps to the loop's deadlines, to tell the host's lateness from ours.

On a virtual machine, stalls of the host hit every program. A canary of higher priority on the same CPU sleeps
to the loop's deadlines; the loop's lateness minus the canary's is what the loop itself has to answer for.
"""

import subprocess
import time
from dataclasses import dataclass
from typing import Self

from hm_driver.errors import ConfigurationError, LoopError
from hm_driver.realtime.child import parent_is_gone, receive_argument, spawn
from hm_driver.realtime.clock import WallClock
from hm_driver.realtime.grid import Grid
from hm_driver.realtime.process import end_process
from hm_driver.realtime.scheduling import Rung, enter_realtime, prepare_process
from hm_driver.realtime.shared import SharedBlock
from hm_driver.realtime.trace import Trace, TracePoint, trace_size

_START_S = 30.0
_PARENT_EVERY_NS = 100_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class CanaryOptions:
    """Which deadlines a canary sleeps to."""

    period_ns: int
    """Distance between deadlines [ns]."""
    start_ns: int
    """Deadline 0 on CLOCK_MONOTONIC [ns]; may be past."""
    length: int
    """Deadlines that are kept, the newest."""
    priority: int = 90
    """SCHED_FIFO priority that is asked for; above the loop's."""
    cpu: int | None = None
    """CPU to pin it to, or None."""
    best: Rung = Rung.FIFO
    """Best rung to try."""

    def __post_init__(self) -> None:
        if not (self.period_ns > 0 and self.length > 0):
            raise ConfigurationError("length", f"{self.length} deadlines of {self.period_ns} ns are none")


class Canary:
    """A canary's process; a context manager, on its grid as soon as it is entered.

    Args:
        options: Which deadlines.
    """

    def __init__(self, options: CanaryOptions) -> None:
        self._options = options
        self._block: SharedBlock | None = None
        self._trace: Trace | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self._points: list[TracePoint] = []
        self._rung = Rung.PLAIN

    def __enter__(self) -> Self:
        self._block = SharedBlock.create(trace_size(self._options.length), tag="canary")
        self._trace = Trace(self._block.buffer)
        argument = (self._options, str(self._block.path))
        self._process = spawn("hm_driver.realtime.canary", "main", argument)
        deadline = time.monotonic() + _START_S
        while not self._trace.is_ready:
            if self._process.poll() is not None or time.monotonic() > deadline:
                self.close()
                raise LoopError("the canary's process did not start")
            time.sleep(0.002)
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def points(self, first: int = 0) -> list[TracePoint]:
        """Lateness at the newest deadlines, from ``first`` on; one that the canary missed is not there."""
        if self._trace is not None:
            return self._trace.since(first)
        return [point for point in self._points if point.number >= first]

    @property
    def next_number(self) -> int:
        """Number behind that of the newest deadline at which the canary was awake."""
        if self._trace is not None:
            return self._trace.next_number
        return self._points[-1].number + 1 if self._points else 0

    @property
    def rung(self) -> Rung:
        """Rung of the scheduling ladder that the canary was granted."""
        return self._rung if self._trace is None else list(Rung)[self._trace.rung]

    def close(self) -> None:
        """End the canary; idempotent. The points stay."""
        if self._trace is None or self._block is None:
            return
        self._trace.request_stop()
        if self._process is not None:
            end_process(self._process, patience_s=2.0)
        self._points, self._rung = self._trace.points(), self.rung
        self._trace.close()
        self._trace = None
        self._block.close()
        self._block = None


def main() -> None:
    """Run the canary that the parent describes on standard input."""
    options, path = _receive()
    with SharedBlock.attach(path) as block:
        trace = Trace(block.buffer)
        prepare_process()
        granted = enter_realtime(options.priority, cpu=options.cpu, best=options.best)
        clock = WallClock()
        first = max(0, (clock.now_ns() - options.start_ns) // options.period_ns + 1)
        grid = Grid(clock, options.period_ns, start_ns=options.start_ns, first=first)
        trace.set_ready(granted.rung.level)
        run_canary(grid, trace)
        trace.close()


def run_canary(grid: Grid, trace: Trace, *, last: int | None = None) -> None:
    """Sleep to the deadlines until told to end, until the parent is gone, or up to a last deadline."""
    asked_ns = 0
    while not trace.is_stop_requested and (last is None or grid.index < last):
        grid.wait()
        trace.record(grid.index - grid.skipped, grid.lateness_ns, 0, grid.wake_ns)
        if grid.wake_ns - asked_ns > _PARENT_EVERY_NS:
            asked_ns = grid.wake_ns
            if parent_is_gone(timeout_s=0.0):
                return


def _receive() -> tuple[CanaryOptions, str]:
    argument = receive_argument()
    if not (isinstance(argument, tuple) and isinstance(argument[0], CanaryOptions)):
        raise SystemExit(2)
    return argument

"""The loop's process with something done to it: a fault to be found, or its privileges given up.

The loop that is judged is the one that users run; what is done to it is done here, from outside.
"""

import ctypes
import os
import struct
import time
from pathlib import Path
from typing import NamedTuple

from hm_driver.errors import LoopError
from hm_driver.realtime import loop_main, runner, scheduling
from hm_driver.realtime.child import receive_argument, spawn
from hm_driver.realtime.grid import Grid
from hm_driver.realtime.options import LoopOptions
from hm_driver.realtime.process import LoopProcess
from hm_driver.realtime.segment import Segment, Word
from hm_driver.realtime.setpoint import LoopState, SetPoint

SLEEP_S = 0.002
SLEEP_EVERY = 250
SLEEPING_LAW = "tools.jitter.faulty:SleepingLaw"
_CAPABILITY_VERSION_3 = 0x20080522
_RLIMIT_NICE, _RLIMIT_RTPRIO = 13, 14  # of Linux; Python has no names for them


class SleepingLaw:
    """A control law that does what the application asks, and now and then sleeps for 2 ms."""

    def __init__(self) -> None:
        self._steps = 0

    def step(self, state: LoopState, command: SetPoint, dt: float) -> SetPoint:
        """Return the command."""
        del state, dt
        self._steps += 1
        if self._steps % SLEEP_EVERY == 0:
            time.sleep(SLEEP_S)
        return command


class RelativeGrid(Grid):
    """The naive grid: the next deadline is a period after the last wake-up."""

    def wait(self) -> int:
        """Sleep for a period; misses are never noticed."""
        last_ns = self.wake_ns or self._clock.now_ns()
        self._clock.sleep_until_ns(last_ns + self.period_ns)
        self.wake_ns = self.deadline_ns = self._clock.now_ns()
        self.dt_ns = self.wake_ns - last_ns
        self.lateness_ns = 0
        self.index += 1
        self.cycles += 1
        return 0


class Alterations(NamedTuple):
    """What is done to a loop's process before it starts."""

    has_relative_grid: bool
    is_unprivileged: bool


class AlteredLoopProcess(LoopProcess):
    """A loop's process that starts in `main`.

    Args:
        options: What to run.
        has_relative_grid: Whether it gets the naive grid.
        is_unprivileged: Whether it gives up its privileges first.
    """

    def __init__(self, options: LoopOptions, *, has_relative_grid: bool, is_unprivileged: bool) -> None:
        super().__init__(options)
        self._alterations = Alterations(has_relative_grid=has_relative_grid, is_unprivileged=is_unprivileged)

    def _spawn(self, options: LoopOptions, segment: Segment, path: str) -> None:
        process = spawn("tools.jitter.faulty", "main", (self._alterations, options, path))
        self._process = process
        segment.words[Word.LOOP_PID] = process.pid


def main() -> None:
    """Main function of an altered loop's process."""
    alterations, options, path = _receive()
    if alterations.has_relative_grid:
        vars(runner)["Grid"] = RelativeGrid
    if alterations.is_unprivileged:
        drop_privileges()
    vars(loop_main)["_receive"] = lambda: (options, path)
    loop_main.main()


def _receive() -> tuple[Alterations, LoopOptions, str]:
    argument = receive_argument()
    if not (isinstance(argument, tuple) and isinstance(argument[0], Alterations)):
        raise SystemExit(2)
    return argument


def drop_privileges() -> None:
    """Give up what an ordinary user has not: every capability, real-time and negative nice priorities.

    The user stays the same, so that he can still read the program. What a root without capabilities may do as
    the owner of a file, holding the CPU out of its idle states, is left out too.

    Raises:
        LoopError: The system refused.
    """
    import resource

    for number in (_RLIMIT_NICE, _RLIMIT_RTPRIO):
        resource.setrlimit(number, (0, 0))
    libc = ctypes.CDLL(None, use_errno=True)
    header = struct.pack("<Ii", _CAPABILITY_VERSION_3, 0)
    if libc.capset(header, bytes(24)) != 0:
        raise LoopError(f"the loop's privileges cannot be given up: {os.strerror(ctypes.get_errno())}")
    vars(scheduling)["_DMA_LATENCY"] = Path("/nonexistent")

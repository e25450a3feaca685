"""Scheduling of the emulator's one thread: as real-time as the machine grants.

One priority below the driver's loop. A ladder: ``SCHED_FIFO``, else a better nice value with the smallest
timer slack, else the timer slack alone, else plain. What was granted is returned, never assumed.
"""

import ctypes
import gc
import os
import sys
from typing import NamedTuple

FIFO_PRIORITY = 79
"""One below the driver's loop, so that the loop is never kept waiting by the device it talks to."""

_PR_SET_TIMERSLACK = 29
_MCL_CURRENT_AND_FUTURE = 3


class Scheduling(NamedTuple):
    """What the machine granted."""

    policy: str
    """``fifo 79``, ``nice -20`` or ``plain``."""
    timer_slack: bool
    """Timer slack is 1 ns."""
    memory_locked: bool
    """No page of this process is swapped out or faulted in late."""
    refused: str
    """What was refused and why, empty if nothing."""

    def __str__(self) -> str:
        granted = [self.policy]
        granted += ["timer slack 1 ns"] if self.timer_slack else []
        granted += ["memory locked"] if self.memory_locked else []
        return ", ".join(granted) + (f" (refused: {self.refused})" if self.refused else "")


def schedule_realtime(*, priority: int = FIFO_PRIORITY, lock_memory: bool = True) -> Scheduling:
    """Climb the ladder for the calling thread, and quiet the garbage collector of this process.

    Call it after everything is imported and compiled: what exists by then is frozen out of collection.
    """
    refused: list[str] = []
    policy = _climb(priority, refused)
    linux = sys.platform == "linux"
    libc = ctypes.CDLL(None, use_errno=True) if linux else None
    slack = libc is not None and libc.prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0) == 0
    locked = False
    if libc is not None and lock_memory:
        locked = libc.mlockall(_MCL_CURRENT_AND_FUTURE) == 0
        if not locked:
            refused.append(f"mlockall: {os.strerror(ctypes.get_errno())}")
    gc.collect()
    gc.freeze()
    gc.disable()
    return Scheduling(policy, slack, locked, "; ".join(refused))


def _climb(priority: int, refused: list[str]) -> str:
    if hasattr(os, "sched_setscheduler"):
        try:
            os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
        except OSError as error:
            refused.append(f"SCHED_FIFO: {error.strerror}")
        else:
            return f"fifo {priority}"
    if hasattr(os, "setpriority"):
        try:
            os.setpriority(os.PRIO_PROCESS, 0, -20)
        except OSError as error:
            refused.append(f"nice -20: {error.strerror}")
        else:
            return "nice -20"
    return "plain"

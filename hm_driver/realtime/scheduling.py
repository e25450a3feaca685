"""The scheduling ladder: take the best rung that the machine grants, and say which one it was.

1. ``fifo``: SCHED_FIFO with reset-on-fork.
2. ``nice``: nice -20 and a timer slack of 1 ns.
3. ``slack``: a timer slack of 1 ns alone, which needs no privilege.
4. ``plain``: nothing was granted, or the platform knows none of these.

Scheduling belongs to the calling thread, memory locking and garbage collection to its process. Nothing
here raises because a privilege is missing, unless ``require_realtime`` asks for it.
"""

import contextlib
import ctypes
import gc
import os
import struct
import sys
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path

from hm_driver.errors import ConfigurationError, LoopError

_PR_SET_TIMERSLACK = 29
_PR_GET_TIMERSLACK = 30
_MCL_CURRENT, _MCL_FUTURE = 1, 2
_RLIMIT_RTTIME = 15
_SHORTEST_RTTIME_US = 20_000
_DMA_LATENCY = Path("/dev/cpu_dma_latency")


class Rung(StrEnum):
    """What the scheduler granted, best first."""

    FIFO = "fifo"
    """SCHED_FIFO: runs before every ordinary thread."""
    NICE = "nice"
    """nice -20 and a timer slack of 1 ns."""
    SLACK = "slack"
    """A timer slack of 1 ns; wakes on time, but shares the processor."""
    PLAIN = "plain"
    """Nothing."""

    @property
    def level(self) -> int:
        """0 for the best rung, 3 for the last; what a fixed-width log stores."""
        return list(Rung).index(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class Granted:
    """What ``enter_realtime`` obtained for the calling thread."""

    rung: Rung
    """The rung of the ladder."""
    priority: int
    """FIFO priority, or 0 on a lower rung."""
    refusals: tuple[str, ...]
    """Why each better rung, and each extra that was asked for, was refused."""
    cpu: int | None
    """CPU that the thread is pinned to, or None."""
    rttime_us: int | None
    """RLIMIT_RTTIME [µs]: processor time that FIFO allows between two sleeps; None where unlimited."""
    dma_latency_held: bool
    """Whether /dev/cpu_dma_latency is held at 0, which keeps the CPU out of deep idle states."""
    dma_latency_fd: int | None = None

    @property
    def may_spin(self) -> bool:
        """Whether spinning is safe: a short RLIMIT_RTTIME would kill the process for it."""
        return self.rung is not Rung.FIFO or self.rttime_us is None or self.rttime_us >= _SHORTEST_RTTIME_US

    def release(self) -> None:
        """Let the CPU idle again; only the first call does something."""
        if self.dma_latency_fd is not None:
            with contextlib.suppress(OSError):
                os.close(self.dma_latency_fd)

    def describe(self) -> str:
        """One line for a log or a person."""
        text = f"{self.rung}" + (f" {self.priority}" if self.priority else "")
        if self.cpu is not None:
            text += f", cpu {self.cpu}"
        if self.dma_latency_held:
            text += ", cpu idle latency 0"
        return text + (f" (refused: {'; '.join(self.refusals)})" if self.refusals else "")


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessPrepared:
    """What ``prepare_process`` obtained for the calling process."""

    memory_locked: bool
    """Whether every page is locked into memory."""
    detail: str
    """Why not, or empty."""


def enter_realtime(
    priority: int = 80,
    *,
    cpu: int | None = None,
    best: Rung = Rung.FIFO,
    hold_dma_latency: bool = True,
    require_realtime: bool = False,
) -> Granted:
    """Climb the ladder with the calling thread.

    Args:
        priority: SCHED_FIFO priority, 1 to 99.
        cpu: CPU to pin the thread to, or None.
        best: Best rung to try; a lower one for tests and comparisons.
        hold_dma_latency: Hold /dev/cpu_dma_latency at 0 where it exists, until ``Granted.release``.
        require_realtime: Refuse anything below FIFO.

    Raises:
        ConfigurationError: The priority is outside 1 to 99.
        LoopError: FIFO is required and was refused.
    """
    if not 1 <= priority <= 99:
        raise ConfigurationError("priority", f"{priority} is outside 1 to 99")
    refusals: list[str] = []
    rung = _climb(priority, best, refusals)
    if require_realtime and rung is not Rung.FIFO:
        raise LoopError(
            f"real-time scheduling is required, and only '{rung}' was granted ({'; '.join(refusals)}); "
            "raise RLIMIT_RTPRIO (/etc/security/limits.conf), add CAP_SYS_NICE, or drop the requirement"
        )
    pinned = _pin(cpu, refusals)
    fd = _hold_dma_latency(refusals) if hold_dma_latency and rung is not Rung.PLAIN else None
    return Granted(
        rung=rung,
        priority=priority if rung is Rung.FIFO else 0,
        refusals=tuple(refusals),
        cpu=pinned,
        rttime_us=_rttime_us(),
        dma_latency_held=fd is not None,
        dma_latency_fd=fd,
    )


def prepare_process(*, lock_memory: bool = True, freeze_gc: bool = True) -> ProcessPrepared:
    """Lock the process's memory, and collect, freeze and disable its garbage collection.

    For a process that holds nothing but the loop: with collection off, reference cycles are never freed.
    """
    if freeze_gc:
        gc.collect()
        gc.freeze()
        gc.disable()
    if not lock_memory:
        return ProcessPrepared(memory_locked=False, detail="not asked for")
    if not sys.platform.startswith("linux"):
        return ProcessPrepared(memory_locked=False, detail=f"not known on {sys.platform}")
    libc = ctypes.CDLL(None, use_errno=True)
    if libc.mlockall(_MCL_CURRENT | _MCL_FUTURE) != 0:
        return ProcessPrepared(memory_locked=False, detail=f"mlockall: {os.strerror(ctypes.get_errno())}")
    return ProcessPrepared(memory_locked=True, detail="")


def timer_slack_ns() -> int | None:
    """Timer slack of the calling thread [ns], or None where the platform has none."""
    slack_ns = _prctl(_PR_GET_TIMERSLACK, 0)
    return slack_ns if slack_ns >= 0 else None


def _climb(priority: int, best: Rung, refusals: list[str]) -> Rung:
    if best is Rung.FIFO:
        refusal = _try_fifo(priority)
        if refusal is None:
            _prctl(_PR_SET_TIMERSLACK, 1)
            return Rung.FIFO
        refusals.append(refusal)
    if best is Rung.PLAIN:
        return Rung.PLAIN
    if _prctl(_PR_SET_TIMERSLACK, 1) != 0:
        refusals.append("timer slack: not known here")
        return Rung.PLAIN
    if best is Rung.SLACK:
        return Rung.SLACK
    try:
        os.setpriority(os.PRIO_PROCESS, 0, -20)
    except OSError as error:
        refusals.append(f"nice -20: {error.strerror}")
        return Rung.SLACK
    return Rung.NICE


def _try_fifo(priority: int) -> str | None:
    """Enter SCHED_FIFO; why it was refused, or None."""
    if not hasattr(os, "sched_setscheduler"):
        return f"SCHED_FIFO: not known on {sys.platform}"
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(priority))
    except OSError as error:
        return f"SCHED_FIFO {priority}: {error.strerror}"
    return None


def _pin(cpu: int | None, refusals: list[str]) -> int | None:
    if cpu is None:
        return None
    if not hasattr(os, "sched_setaffinity"):
        refusals.append(f"cpu {cpu}: pinning is not known on {sys.platform}")
        return None
    try:
        os.sched_setaffinity(0, {cpu})
    except OSError as error:
        refusals.append(f"cpu {cpu}: {error.strerror}")
        return None
    return cpu


def _hold_dma_latency(refusals: list[str]) -> int | None:
    if not _DMA_LATENCY.exists():
        return None
    try:
        fd = os.open(_DMA_LATENCY, os.O_WRONLY | os.O_CLOEXEC)
    except OSError as error:
        refusals.append(f"{_DMA_LATENCY}: {error.strerror}")
        return None
    try:
        os.write(fd, struct.pack("i", 0))
    except OSError as error:
        os.close(fd)
        refusals.append(f"{_DMA_LATENCY}: {error.strerror}")
        return None
    return fd


def _rttime_us() -> int | None:
    try:
        import resource
    except ImportError:  # no POSIX limits on this platform
        return None
    try:
        soft, _ = resource.getrlimit(_RLIMIT_RTTIME)
    except (OSError, ValueError):
        return None
    return None if soft == resource.RLIM_INFINITY else soft


def _prctl(option: int, argument: int) -> int:
    """Linux's prctl with one argument; -1 where it is refused or unknown."""
    if not sys.platform.startswith("linux"):
        return -1
    libc = ctypes.CDLL(None, use_errno=True)
    return int(libc.prctl(option, ctypes.c_ulong(argument), 0, 0, 0))

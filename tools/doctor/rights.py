"""What this user may: scheduling, memory locking, limits, and who else claims real-time priorities."""

import os
import shutil
import sys
import threading
from collections.abc import Iterator
from pathlib import Path

from hm_driver.realtime.options import TimingOptions
from hm_driver.realtime.scheduling import Granted, Rung, enter_realtime, timer_slack_ns
from tools.doctor.finding import Finding, State, unknown
from tools.doctor.kernel import read

_CAP_IPC_LOCK, _CAP_SYS_NICE = 14, 23
_LIMITS_FILE = "/etc/security/limits.d/hapticmaster.conf"
_ENOUGH_MEMORY = 128 << 20
_SHORTEST_RTTIME_US = 20_000
_FIFO_POLICIES = (1, 2)


def rights_findings(root: Path = Path("/")) -> Iterator[Finding]:
    """Everything about this user's rights.

    Args:
        root: Where /proc and /dev are.
    """
    yield _scheduling(try_ladder())
    yield _timer_slack()
    capabilities = _capabilities(root)
    yield _rtprio(capabilities)
    yield _memory_lock(capabilities)
    yield _rttime()
    yield _dma_latency(root)
    yield _rivals(root)
    yield _cyclictest()


def try_ladder() -> Granted:
    """Climb the scheduling ladder in a thread of its own, which ends at once."""
    granted: list[Granted] = []
    thread = threading.Thread(target=lambda: granted.append(enter_realtime(TimingOptions().priority)))
    thread.start()
    thread.join()
    granted[0].release()
    return granted[0]


def _scheduling(granted: Granted) -> Finding:
    name, title = "scheduling", "scheduling granted"
    value = granted.describe()
    if granted.rung is Rung.FIFO:
        return Finding(name=name, title=title, value=value, state=State.GOOD)
    if not sys.platform.startswith("linux"):
        return Finding(name=name, title=title, value=value, state=State.BAD,
                       why=f"{sys.platform} has none of the rungs; the loop shares its CPU with everything",
                       change="run the loop on Linux")  # fmt: skip
    return Finding(
        name=name, title=title, value=value, state=State.BAD,
        why="below SCHED_FIFO any other program can keep the loop waiting",
        change=_rtprio_change(),
    )  # fmt: skip


def _timer_slack() -> Finding:
    name, title = "timer_slack", "timer slack"
    slack_ns = timer_slack_ns()
    if slack_ns is None:
        return unknown(name, title, missing=f"{sys.platform} has none")
    value = f"{slack_ns / 1e3:g} µs by default, the loop sets 1 ns"
    return Finding(name=name, title=title, value=value, state=State.GOOD)


def _rtprio(capabilities: int | None) -> Finding:
    name, title = "rtprio_limit", "real-time priority limit"
    if _has(capabilities, _CAP_SYS_NICE):
        return Finding(name=name, title=title, value="none needed: CAP_SYS_NICE", state=State.GOOD)
    limit = _limit(14)
    if limit is None:
        return unknown(name, title, missing="RLIMIT_RTPRIO")
    wanted = TimingOptions().priority
    if limit < 0 or limit >= wanted:
        return Finding(name=name, title=title, value=_amount(limit), state=State.GOOD)
    return Finding(
        name=name, title=title, value=f"{limit}, the loop asks for {wanted}", state=State.BAD,
        why="SCHED_FIFO is refused above the limit", change=_rtprio_change(),
    )  # fmt: skip


def _memory_lock(capabilities: int | None) -> Finding:
    name, title = "memory_lock", "memory locking"
    if _has(capabilities, _CAP_IPC_LOCK):
        return Finding(name=name, title=title, value="unlimited: CAP_IPC_LOCK", state=State.GOOD)
    limit = _limit(8)
    if limit is None:
        return unknown(name, title, missing="RLIMIT_MEMLOCK")
    if limit < 0 or limit >= _ENOUGH_MEMORY:
        return Finding(name=name, title=title, value=_amount(limit, " B"), state=State.GOOD)
    return Finding(
        name=name, title=title, value=f"{limit / (1 << 20):g} MiB", state=State.NOTE,
        why="a page that is not locked can be fetched late from the disk",
        change=f"echo '{_user()} - memlock unlimited' >> {_LIMITS_FILE}, then log in again",
    )  # fmt: skip


def _rttime() -> Finding:
    name, title = "rttime_limit", "real-time CPU limit"
    limit = _limit(15)
    if limit is None:
        return unknown(name, title, missing="RLIMIT_RTTIME")
    if limit < 0:
        return Finding(name=name, title=title, value="unlimited", state=State.GOOD)
    if limit >= _SHORTEST_RTTIME_US:
        return Finding(name=name, title=title, value=f"{limit / 1e3:g} ms between sleeps", state=State.NOTE,
                       why="a cycle that takes longer than that ends the process",
                       change="ulimit -R unlimited")  # fmt: skip
    return Finding(
        name=name, title=title, value=f"{limit / 1e3:g} ms between sleeps", state=State.BAD,
        why="the loop does not spin under so short a limit, as the kernel would end it",
        change="ulimit -R unlimited",
    )  # fmt: skip


def _dma_latency(root: Path) -> Finding:
    name, title = "cpu_dma_latency", "CPU idle latency"
    path = root / "dev/cpu_dma_latency"
    if not path.exists():
        return unknown(name, title, missing="/dev/cpu_dma_latency")
    if os.access(path, os.W_OK):
        return Finding(name=name, title=title, value="the loop holds it at 0", state=State.GOOD)
    return Finding(
        name=name, title=title, value="/dev/cpu_dma_latency is closed to this user", state=State.NOTE,
        why="a CPU in a deep idle state takes up to some 100 µs to wake",
        change="echo 'KERNEL==\"cpu_dma_latency\", MODE=\"0666\"' > /etc/udev/rules.d/99-cpu-dma.rules; "
        "udevadm control --reload; udevadm trigger",
    )  # fmt: skip


def _rivals(root: Path) -> Finding:
    name, title = "rivals", "other real-time threads"
    threads = sorted(_fifo_threads(root), reverse=True)
    if not (root / "proc").is_dir():
        return unknown(name, title, missing="/proc")
    priority = TimingOptions().priority
    above = [(level, comm) for level, comm in threads if priority <= level and not _is_kernel(comm)]
    if not above:
        return Finding(name=name, title=title, value=f"none at {priority} or above", state=State.GOOD)
    shown = ", ".join(f"{comm} {level}" for level, comm in above[:6])
    return Finding(
        name=name, title=title, value=f"{len(above)} at {priority} or above: {shown}", state=State.NOTE,
        why="the loop waits for them when they share its CPU",
        change="end them, or pin the loop to another CPU: --set timing.cpu=N",
    )  # fmt: skip


def _cyclictest() -> Finding:
    name, title = "cyclictest", "cyclictest"
    path = shutil.which("cyclictest")
    if path:
        return Finding(name=name, title=title, value=path, state=State.GOOD)
    return Finding(name=name, title=title, value="not installed", state=State.NOTE,
                   why="hm jitter --cyclictest compares the loop with it",
                   change="apt-get install rt-tests")  # fmt: skip


def _fifo_threads(root: Path) -> Iterator[tuple[int, str]]:
    for path in (root / "proc").glob("[0-9]*/task/[0-9]*/stat"):
        if path.parts[-4] == str(os.getpid()):
            continue
        text = read(path)
        if text is None or ")" not in text:
            continue
        comm, _, rest = text[text.find("(") + 1 :].rpartition(")")
        words = rest.split()
        if len(words) > 38 and int(words[38]) in _FIFO_POLICIES:
            yield int(words[37]), comm


def _is_kernel(comm: str) -> bool:
    return comm.startswith(("migration/", "irq/", "watchdog", "idle_inject", "rcu", "ktimers", "posixcputmr"))


def _capabilities(root: Path) -> int | None:
    for line in (read(root / "proc/self/status") or "").splitlines():
        if line.startswith("CapEff:"):
            return int(line.split()[1], 16)
    return None


def _has(capabilities: int | None, bit: int) -> bool:
    return capabilities is not None and bool(capabilities >> bit & 1)


def _limit(number: int) -> int | None:
    """A soft limit by Linux's number; -1 for unlimited, None where the platform has no such limit."""
    if not sys.platform.startswith("linux"):
        return None
    import resource

    try:
        soft = resource.getrlimit(number)[0]
    except (OSError, ValueError):
        return None
    return -1 if soft == resource.RLIM_INFINITY else soft


def _amount(limit: int, unit: str = "") -> str:
    return "unlimited" if limit < 0 else f"{limit}{unit}"


def _rtprio_change() -> str:
    return (
        f"printf '{_user()} - rtprio 99\\n{_user()} - nice -20\\n' >> {_LIMITS_FILE}, then log in again; "
        "in a container: --cap-add SYS_NICE --ulimit rtprio=99"
    )


def _user() -> str:
    return os.environ.get("USER") or os.environ.get("LOGNAME") or "@realtime"

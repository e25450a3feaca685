"""What the kernel is and how it is set, from /proc and /sys; every one of these files may be absent."""

import os
import platform
from collections.abc import Iterator
from pathlib import Path

from tools.doctor.finding import Finding, State, unknown

_FAST_CLOCKS = ("tsc", "kvm-clock", "arch_sys_counter", "hyperv_clocksource_tsc_page")
_CPU = "sys/devices/system/cpu"
_THROTTLE_FROM_US = 950_000


def kernel_findings(root: Path = Path("/")) -> Iterator[Finding]:
    """Everything about the kernel.

    Args:
        root: Where /proc and /sys are.
    """
    yield _preemption(root)
    yield _clock_source(root)
    yield _governor(root)
    yield _isolated(root)
    yield _throttling(root)
    yield _virtualisation(root)
    yield _container(root)


def read(path: Path) -> str | None:
    """Text of a small file without its line end, or None where it is absent or closed to us."""
    try:
        return path.read_text(encoding="utf-8", errors="replace").strip()
    except OSError:
        return None


def steal_ticks(root: Path = Path("/")) -> tuple[int, int] | None:
    """Time stolen by the host and time in all, of all CPUs [clock ticks]; None where it is not told."""
    for line in (read(root / "proc/stat") or "").splitlines():
        words = line.split()
        if words and words[0] == "cpu" and len(words) > 8:
            values = [int(word) for word in words[1:9]]
            return values[7], sum(values)
    return None


def _preemption(root: Path) -> Finding:
    name, title = "preemption", "kernel preemption"
    version = platform.version()
    if read(root / "sys/kernel/realtime") == "1" or "PREEMPT_RT" in version:
        return Finding(name=name, title=title, value="PREEMPT_RT", state=State.GOOD)
    words = [word for word in version.split() if word.startswith("PREEMPT")]
    if not words:
        return unknown(name, title, missing="the kernel's version names none")
    mode = read(root / "sys/kernel/debug/sched/preempt") or ""
    chosen = mode[mode.find("(") : mode.find(")") + 1] if "(" in mode else ""
    return Finding(
        name=name, title=title, value=f"{words[0]} {chosen}".strip(), state=State.NOTE,
        why="without PREEMPT_RT a driver or a system call can hold the loop up for milliseconds, seldom",
        change="install a real-time kernel: apt-get install linux-image-rt-amd64 (Debian), "
        "pro enable realtime-kernel (Ubuntu)",
    )  # fmt: skip


def _clock_source(root: Path) -> Finding:
    name, title = "clock_source", "clock source"
    directory = root / "sys/devices/system/clocksource/clocksource0"
    current = read(directory / "current_clocksource")
    if current is None:
        return unknown(name, title, missing=str(directory))
    if current in _FAST_CLOCKS:
        return Finding(name=name, title=title, value=current, state=State.GOOD)
    available = (read(directory / "available_clocksource") or "").split()
    fast = next((clock for clock in available if clock in _FAST_CLOCKS), "")
    return Finding(
        name=name, title=title, value=current, state=State.BAD,
        why="each look at this clock takes a microsecond or more",
        change=f"echo {fast} > /{directory.relative_to(root)}/current_clocksource"
        if fast else "no faster one is available here; look for tsc in: dmesg | grep -i clocksource",
    )  # fmt: skip


def _governor(root: Path) -> Finding:
    name, title = "governor", "CPU governor"
    files = sorted((root / _CPU).glob("cpu[0-9]*/cpufreq/scaling_governor"))
    governors = sorted({text for path in files if (text := read(path))})
    if not governors:
        return unknown(name, title, missing="cpufreq")
    if governors == ["performance"]:
        return Finding(name=name, title=title, value="performance", state=State.GOOD)
    return Finding(
        name=name, title=title, value=", ".join(governors), state=State.NOTE,
        why="a CPU that has slowed down takes longer for the first cycles after a pause",
        change="cpupower frequency-set -g performance",
    )  # fmt: skip


def _isolated(root: Path) -> Finding:
    name, title = "isolated", "isolated CPUs"
    text = read(root / _CPU / "isolated")
    if text is None:
        return unknown(name, title, missing=f"/{_CPU}/isolated")
    if text:
        return Finding(
            name=name, title=title, value=text, state=State.GOOD,
            change=f"pin the loop there: --set timing.cpu={text.replace('-', ',').split(',')[0]}",
        )  # fmt: skip
    cpus = os.cpu_count() or 1
    if cpus < 4:
        return Finding(name=name, title=title, value=f"none of {cpus}", state=State.NOTE,
                       why="with so few CPUs the loop shares its own with everything else")  # fmt: skip
    return Finding(
        name=name, title=title, value=f"none of {cpus}", state=State.NOTE,
        why="a CPU of its own keeps other programs' interrupts and work away from the loop",
        change=f"add isolcpus={cpus - 1} nohz_full={cpus - 1} to the kernel's command line "
        f"(/etc/default/grub), update-grub, reboot, then --set timing.cpu={cpus - 1}",
    )  # fmt: skip


def _throttling(root: Path) -> Finding:
    name, title = "rt_throttling", "real-time throttling"
    texts = [read(root / f"proc/sys/kernel/sched_rt_{kind}_us") for kind in ("runtime", "period")]
    if texts[0] is None or texts[1] is None:
        return unknown(name, title, missing="/proc/sys/kernel/sched_rt_runtime_us")
    runtime_us, period_us = int(texts[0]), int(texts[1])
    if runtime_us < 0:
        return Finding(name=name, title=title, value="off", state=State.NOTE,
                       why="a real-time thread that never sleeps would take its CPU for good",
                       change="sysctl -w kernel.sched_rt_runtime_us=950000")  # fmt: skip
    value = f"{runtime_us / 1e3:g} ms of each {period_us / 1e3:g} ms"
    if runtime_us < 0.8 * period_us:
        return Finding(name=name, title=title, value=value, state=State.BAD,
                       why="real-time threads are stopped for the rest of each such time when they use it up",
                       change=f"sysctl -w kernel.sched_rt_runtime_us={int(0.95 * period_us)}")  # fmt: skip
    return Finding(name=name, title=title, value=value, state=State.GOOD)


def _virtualisation(root: Path) -> Finding:
    name, title = "virtualisation", "virtualisation"
    information = read(root / "proc/cpuinfo")
    if information is None:
        return unknown(name, title, missing="/proc/cpuinfo")
    vendor = read(root / "sys/class/dmi/id/sys_vendor") or read(root / "sys/hypervisor/type") or ""
    flags = next((line for line in information.splitlines() if line.startswith("flags")), "")
    if " hypervisor" not in flags:
        return Finding(name=name, title=title, value="none seen", state=State.GOOD)
    return Finding(
        name=name, title=title, value=f"a virtual machine {f'({vendor})' if vendor else ''}".strip(),
        state=State.NOTE,
        why="the host may stop the whole machine for milliseconds, which no setting in it prevents",
        change="run the loop on real hardware, or have the host give this machine CPUs of its own",
    )  # fmt: skip


def _container(root: Path) -> Finding:
    name, title = "container", "container and cgroup"
    marks = [mark for mark in (".dockerenv", "run/.containerenv") if (root / mark).exists()]
    text = read(root / "proc/self/cgroup")
    if text is None:
        return unknown(name, title, missing="/proc/self/cgroup")
    limits = list(_cgroup_limits(root, text))
    value = "a container" if marks else "none seen"
    if not limits:
        return Finding(name=name, title=title, value=f"{value}, no CPU limit", state=State.GOOD)
    return Finding(
        name=name, title=title, value=f"{value}, {'; '.join(limits)}", state=State.BAD,
        why="a cgroup that is out of its share is stopped until the next period, real-time threads included",
        change="docker update --cpus 0 CONTAINER, or start it with --ulimit rtprio=99 --cap-add SYS_NICE "
        "--cpu-rt-runtime 950000 and without --cpus",
    )  # fmt: skip


def _cgroup_limits(root: Path, text: str) -> Iterator[str]:
    for line in text.splitlines():
        _, controllers, path = [*line.split(":", 2), "", ""][:3]
        place = path.lstrip("/")
        if not controllers:
            quota = (read(root / "sys/fs/cgroup" / place / "cpu.max") or "max").split()
            if quota[0] != "max" and len(quota) == 2:
                yield f"cpu.max {float(quota[0]) / float(quota[1]):g} CPUs"
        elif "cpu" in controllers.split(","):
            directory = root / "sys/fs/cgroup" / "cpu" / place
            if (read(directory / "cpu.cfs_quota_us") or "-1") != "-1":
                yield f"cpu.cfs_quota_us {read(directory / 'cpu.cfs_quota_us')}"
            if read(directory / "cpu.rt_runtime_us") == "0":
                yield "cpu.rt_runtime_us 0: SCHED_FIFO is refused here"

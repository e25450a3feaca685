"""The loop beside cyclictest, in slices that take turns, so that what the machine does meets all alike.

cyclictest runs with the loop's priority and rate, memory locked, pinned to the loop's CPU. No canary runs: it
would delay the loop and not cyclictest.
"""

import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import dataclass, replace

from hm_driver.errors import ConfigurationError, LoopError
from hm_driver.realtime.options import TimingOptions
from tools.jitter.options import JitterOptions, Scenario
from tools.jitter.result import CyclictestResult
from tools.jitter.rig import Cpus, run_scenario
from tools.jitter.spread import Spread
from tools.jitter.verdict import Check

NAME = "cyclictest"
_LONGEST_US = 100_000
_PATIENCE_S = 30.0
_LINE = re.compile(r"^(\d+)\s+(\d+)\s*$", re.MULTILINE)
_MAXIMUM = re.compile(r"^# Max Latencies:\s*(\d+)", re.MULTILINE)


@dataclass(frozen=True, slots=True, kw_only=True)
class SliceOptions:
    """How the slices are cut."""

    slices: int = 10
    """How often each takes its turn."""
    slice_s: float = 2.0
    """Length of a turn [s]."""
    spin_ratio: float = 0.1
    """Limit of the ratio of the 99th percentiles, with spin."""
    no_spin_ratio: float = 1.5
    """The same without spin."""

    def __post_init__(self) -> None:
        if not 1 <= self.slices <= 1000:
            raise ConfigurationError("--slices", f"{self.slices} is outside 1 to 1000; 10 is usual")
        if not 1.0 <= self.slice_s <= 600.0:
            raise ConfigurationError("--slice", f"{self.slice_s:g} s is outside 1 to 600 s; 2 is usual")


def find_cyclictest() -> str:
    """Path of the program.

    Raises:
        ConfigurationError: It is not installed.
    """
    path = shutil.which("cyclictest")
    if path is None:
        raise ConfigurationError(
            "--cyclictest", "the program is not installed; get it with: apt-get install rt-tests"
        )
    return path


def run_slices(
    slices: SliceOptions,
    options: JitterOptions,
    url: str,
    cpus: Cpus,
    *,
    tell: Callable[[str], None],
) -> tuple[CyclictestResult, tuple[Check, ...]]:
    """Let cyclictest, the loop with spin and the loop without take turns, and pool what each was late.

    Args:
        slices: How often, and for how long.
        options: Rate, and what is done to the loop.
        url: The device.
        cpus: Where the loop runs.
        tell: Is told what begins.

    Raises:
        ConfigurationError: cyclictest is not installed.
        LoopError: It failed, or the loop did not start.
    """
    command = _command(slices, options, cpus)
    alone = Scenario(name=NAME, loads=())
    tests: list[Spread] = []
    spinning: list[Spread] = []
    sleeping: list[Spread] = []
    for number in range(slices.slices):
        tell(f"{NAME}: round {number + 1} of {slices.slices}, 3 turns of {slices.slice_s:g} s")
        tests.append(_run(command, timeout_s=slices.slice_s + _PATIENCE_S))
        for kept, duty in ((spinning, options.spin_duty), (sleeping, 0.0)):
            turn = replace(options, duration_s=slices.slice_s, spin_duty=duty)
            result = run_scenario(alone, turn, url, cpus, has_canaries=False)
            if result.problem:
                raise LoopError(f"the loop ended beside {NAME}: {result.problem}")
            kept.append(result.lateness)
    pooled = CyclictestResult(
        slices=slices.slices,
        slice_s=slices.slice_s,
        command=" ".join(command),
        cyclictest=Spread.pooled(tests),
        spin=Spread.pooled(spinning),
        no_spin=Spread.pooled(sleeping),
    )
    checks = [_check("no spin", pooled.no_spin_ratio, slices.no_spin_ratio)]
    if options.spin_duty > 0.0:
        checks.insert(0, _check("spin", pooled.spin_ratio, slices.spin_ratio))
    return pooled, tuple(checks)


def parse_histogram(text: str) -> Spread:
    """Read what ``cyclictest -h`` prints: a line a microsecond, and the maximum.

    Raises:
        LoopError: There is no histogram in it.
    """
    bins = {float(upper): int(count) for upper, count in _LINE.findall(text)}
    maximum = _MAXIMUM.search(text)
    if not sum(bins.values()) or maximum is None:
        raise LoopError(f"{NAME} printed no histogram: {text.strip()[:200] or 'nothing at all'}")
    return Spread.of_bins(bins, maximum=float(maximum[1]))


def _command(slices: SliceOptions, options: JitterOptions, cpus: Cpus) -> list[str]:
    interval_us = round(1e6 / options.rate_hz)
    loops = round(slices.slice_s * options.rate_hz)
    words = [find_cyclictest(), "-q", "-m", "-t", "1", "-p", str(TimingOptions().priority)]
    words += ["-i", str(interval_us), "-l", str(loops), "-h", str(_LONGEST_US)]
    return [*words, "-a", str(cpus.loop)] if cpus.loop is not None else words


def _run(command: list[str], *, timeout_s: float) -> Spread:
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=timeout_s, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        raise LoopError(f"{NAME} failed: {error}") from error
    if done.returncode != 0:
        raise LoopError(
            f"{NAME} failed with exit code {done.returncode}: {done.stderr.strip()[:300]}; it needs root or "
            "a real-time priority (ulimit -r)"
        )
    return parse_histogram(done.stdout)


def _check(kind: str, ratio: float, limit: float) -> Check:
    return Check(
        scenario=NAME, name=f"p99 of the loop over {NAME}'s, {kind}", value=ratio, limit=limit,
        passed=ratio <= limit,
    )  # fmt: skip

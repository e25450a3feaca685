"""A whole run: each scenario in turn on one device, then cyclictest, then the verdict."""

import os
import platform
from collections.abc import Callable
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hm_driver.version import __version__
from tools.jitter.cyclictest import SliceOptions, run_slices
from tools.jitter.options import JitterOptions
from tools.jitter.perfetto import TraceFile
from tools.jitter.result import Run, ScenarioResult
from tools.jitter.rig import INTERRUPTED, choose_cpus, device_of, run_scenario
from tools.jitter.verdict import Check, judge


def run_suite(
    options: JitterOptions,
    *,
    tell: Callable[[str], None],
    cyclictest: SliceOptions | None = None,
    trace: TraceFile | None = None,
) -> Run:
    """Run it.

    Args:
        options: What to run.
        tell: Is told what begins.
        cyclictest: The slices beside cyclictest; None for none.
        trace: Takes the cycles for an export.

    Raises:
        HapticMasterError: The device cannot be reached, or the loop did not start.
    """
    started = datetime.now(UTC).isoformat(timespec="seconds")
    cpus = choose_cpus(options.cpu)
    results: list[ScenarioResult] = []
    checks: list[Check] = []
    sliced = None
    with device_of(options, cpus) as url:
        for scenario in options.scenarios:
            tell(f"scenario {scenario.name}: {options.duration_s:g} s at {options.rate_hz:g} Hz")
            on_rows = None if trace is None else trace.begin(scenario.name)
            result = run_scenario(
                scenario, options, url, cpus, has_canaries=not options.is_unprivileged, on_rows=on_rows
            )
            results.append(result)
            checks += judge(result, options.limits)
            if result.problem == INTERRUPTED:
                cyclictest = None
                break
        if cyclictest is not None:
            sliced, more = run_slices(cyclictest, options, url, cpus, tell=tell)
            checks += more
    return Run(
        started=started,
        version=__version__,
        host=host(),
        options=option_values(options),
        scenarios=tuple(results),
        cyclictest=sliced,
        checks=tuple(check.as_dict() for check in checks),
    )


def host() -> dict[str, str]:
    """What the run was measured on."""
    return {
        "name": platform.node(),
        "system": platform.platform(),
        "kernel": platform.version(),
        "processor": _processor(),
        "cpus": str(os.cpu_count()),
        "python": f"{platform.python_implementation()} {platform.python_version()}",
    }


def _processor() -> str:
    try:
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    except OSError:
        return platform.processor() or platform.machine()
    names = [line.partition(":")[2].strip() for line in text.splitlines() if line.startswith("model name")]
    return names[0] if names else platform.machine()


def option_values(options: JitterOptions) -> dict[str, Any]:
    """What a run was told, as values for its file."""
    values = asdict(options)
    values["scenarios"] = [scenario.name for scenario in options.scenarios]
    del values["modes"], values["motion"]  # nothing of a loop's timing rests on them
    return values


__all__ = ["Check", "run_suite"]

"""A run as tables on the terminal; plain text where there is no terminal."""

import sys
from collections.abc import Iterable, Sequence

from tools.cli.console import write
from tools.jitter.result import CyclictestResult, Run, ScenarioResult
from tools.jitter.spread import Spread

PERCENTILES = ("p50", "p90", "p99", "p99.9", "max")
QUANTITIES = (
    ("excess", "excess over the canary"),
    ("lateness", "wake lateness"),
    ("canary", "canary's lateness"),
    ("response", "response"),
    ("execution", "execution"),
    ("exchange", "exchange"),
)
"""Spreads of a scenario, and how tables name them."""


def percentiles(spread: Spread) -> tuple[float, float, float, float, float]:
    """The values of `PERCENTILES` [µs]."""
    return spread.p50, spread.p90, spread.p99, spread.p99_9, spread.max


def microseconds(value: float) -> str:
    """A duration in three digits or more."""
    return f"{value:.0f}" if value >= 99.95 else f"{value:.1f}" if value >= 9.995 else f"{value:.2f}"


def print_run(run: Run) -> None:
    """Print everything that a person wants to know first."""
    for result in run.scenarios:
        print_table(
            f"{result.name}: {result.duration_s:g} s at {result.rate_hz:g} Hz  [µs]",
            ("", *PERCENTILES),
            [
                (title, *map(microseconds, percentiles(spread)))
                for name, title in QUANTITIES
                if (spread := getattr(result, name)).samples
            ],
        )
        for line in facts(result):
            write(f"  {line}")
        write("")
    if run.cyclictest is not None:
        _print_cyclictest(run.cyclictest)
    bad = [check for check in run.checks if not check["passed"]]
    for check in bad:
        detail = f" ({check['detail']})" if check["detail"] else ""
        write(f"  beyond its limit: {check['scenario']}: {check['name']}: {_short(check)}{detail}")
    write("PASSED" if not bad else f"FAILED: {len(bad)} of {len(run.checks)} limits were exceeded")


def facts(result: ScenarioResult) -> list[str]:
    """What the percentiles do not say, a line each."""
    ran = result.window_cycles + result.window_missed
    missed = f"missed {result.window_missed} of {ran} periods"
    if result.canary_missed is None:
        missed += "; no canary ran, as it would delay a loop without privileges"
    else:
        device = result.device_canary_missed
        beside = "" if device is None else f", that on the emulator's {device}"
        missed += f", {result.own_missed} that no canary missed; the canary on the loop's CPU missed "
        missed += f"{result.canary_missed}{beside}"
    sign = "=" if result.has_identity else "is not"
    canary = f"; canary: {result.canary_rung}" if result.canary_rung else ""
    exchanges = "in one request" if result.is_combined else "one by one"
    identity = (
        f"cycles {result.cycles} + missed {result.missed} {sign} {result.grid_length} of the grid; drift "
        f"{result.drift_us_per_s:+.2f} µs/s, resolved to {result.drift_resolution_us_per_s:.2f}"
    )
    cost = (
        f"{result.requests_per_cycle:.2f} exchanges a cycle, {result.dialect} dialect, commands {exchanges}; "
        f"{result.cpu_us_per_cycle:.0f} µs processor a cycle, {result.spun_share:.1%} of a core spun"
    )
    silence = f"longest silence {result.longest_silence_ms:.0f} ms"
    beats = f"{result.heartbeats} heartbeats of the application, {silence}"
    lines = [missed, identity, f"scheduling: {result.scheduling}{canary}", cost, beats]
    lines += result.loads
    if result.problem:
        lines.append(f"the loop ended early: {result.problem}")
    return lines


def print_table(title: str, head: Sequence[str], rows: Iterable[Sequence[str]]) -> None:
    """Print a table: names to the left, numbers to the right."""
    rows = list(rows)
    if sys.stdout.isatty():
        _print_rich(title, head, rows)
        return
    widths = [max(len(row[column]) for row in [head, *rows]) for column in range(len(head))]
    write(title)
    for row in [head, *rows]:
        cells = [row[0].ljust(widths[0])]
        cells += [cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True)]
        write(f"  {'  '.join(cells)}".rstrip())


def _print_rich(title: str, head: Sequence[str], rows: list[Sequence[str]]) -> None:
    from rich.console import Console
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold")
    for column, name in enumerate(head):
        table.add_column(name, justify="right" if column else "left", no_wrap=True)
    for row in rows:
        table.add_row(*row)
    Console().print(table)


def _print_cyclictest(sliced: CyclictestResult) -> None:
    rows = [
        ("cyclictest", *map(microseconds, percentiles(sliced.cyclictest)), "1"),
        ("loop with spin", *map(microseconds, percentiles(sliced.spin)), f"{sliced.spin_ratio:.3f}"),
        ("loop without", *map(microseconds, percentiles(sliced.no_spin)), f"{sliced.no_spin_ratio:.3f}"),
    ]
    title = f"wake lateness beside cyclictest, {sliced.slices} slices of {sliced.slice_s:g} s each  [µs]"
    print_table(title, ("", *PERCENTILES, "ratio of p99"), rows)
    write("")


def _short(check: dict[str, object]) -> str:
    return f"{check['value']:.4g} where {check['limit']:g} is allowed"

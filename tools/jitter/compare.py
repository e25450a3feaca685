"""Two runs beside each other: ratios of the second to the first, for what both measured."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass
from typing import Any

from tools.cli.console import write
from tools.jitter.result import Run, ScenarioResult
from tools.jitter.spread import Spread
from tools.jitter.table import microseconds, print_table

_QUANTITIES = ("excess", "lateness", "response", "execution", "exchange")
_PERCENTILES = {"p50": "p50", "p99": "p99", "p99_9": "p99.9", "max": "max"}
_LEAST_US = 0.05


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One quantity of one scenario that both runs have."""

    scenario: str
    quantity: str
    before: Mapping[str, float]
    """Percentiles of the first run [µs]."""
    after: Mapping[str, float]
    """Percentiles of the second run [µs]."""

    @property
    def ratios(self) -> dict[str, float]:
        """Second over first; left out where the first is next to nothing."""
        return {name: self.after[name] / value for name, value in self.before.items() if value >= _LEAST_US}


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Two runs."""

    names: tuple[str, str]
    """The files, first and second."""
    rows: tuple[Row, ...]
    only_once: tuple[str, ...]
    """Scenarios that one run alone has."""
    differences: tuple[str, ...]
    """In what else the runs differ, so that ratios do not mislead."""

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        values = asdict(self)
        values["rows"] = [asdict(row) | {"ratios": row.ratios} for row in self.rows]
        return values


def compare_runs(before: Run, after: Run, *, names: tuple[str, str]) -> Comparison:
    """Compare two runs, scenario by scenario.

    Args:
        before: The first.
        after: The second.
        names: Where they came from.
    """
    first = {result.name: result for result in before.scenarios}
    second = {result.name: result for result in after.scenarios}
    both = [name for name in first if name in second]
    return Comparison(
        names=names,
        rows=tuple(row for name in both for row in _rows(first[name], second[name])),
        only_once=tuple(sorted(set(first) ^ set(second))),
        differences=tuple(_differences(before, after)),
    )


def print_comparison(comparison: Comparison) -> None:
    """Print the ratios as a table: each cell is first -> second and the ratio."""
    write(f"first:  {comparison.names[0]}")
    write(f"second: {comparison.names[1]}")
    for difference in comparison.differences:
        write(f"note: {difference}")
    head = ("scenario", "quantity [µs]", *_PERCENTILES.values())
    print_table("second / first", head, [_cells(row) for row in comparison.rows])
    if comparison.only_once:
        write(f"in one run alone: {', '.join(comparison.only_once)}")


def _rows(before: ScenarioResult, after: ScenarioResult) -> Iterator[Row]:
    for quantity in _QUANTITIES:
        pair: tuple[Spread, Spread] = getattr(before, quantity), getattr(after, quantity)
        if all(spread.samples for spread in pair):
            one, two = ({name: getattr(spread, name) for name in _PERCENTILES} for spread in pair)
            yield Row(scenario=before.name, quantity=quantity, before=one, after=two)


def _cells(row: Row) -> tuple[str, ...]:
    cells = []
    for name in _PERCENTILES:
        ratio = f"{row.ratios[name]:.2f}" if name in row.ratios else "-"
        cells.append(f"{microseconds(row.before[name])} -> {microseconds(row.after[name])}  x{ratio}")
    return row.scenario, row.quantity, *cells


def _differences(before: Run, after: Run) -> Iterator[str]:
    for name in sorted(set(before.host) | set(after.host)):
        one, two = before.host.get(name, "-"), after.host.get(name, "-")
        if one != two:
            yield f"the host's {name} differs: {one}; {two}"
    for name in ("rate_hz", "duration_s", "loop", "spin_duty", "is_unprivileged", "fault", "device"):
        if before.options.get(name) != after.options.get(name):
            yield f"{name} differs: {before.options.get(name)}; {after.options.get(name)}"

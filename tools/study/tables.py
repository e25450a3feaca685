"""The tables of a study, in lines of text."""

from collections.abc import Iterable, Sequence
from typing import Final

from tools.study.statistics import CaseResult, Mean, Results, varying_axes

COLUMNS: Final = (
    ("grid error [N]", "grid_overall_mean", 1.0, 2),
    ("at borders [N]", "grid_border_mean", 1.0, 2),
    ("run error [N]", "run_overall_mean", 1.0, 2),
    ("teaching [s]", "teaching_s", 1.0, 1),
    ("to autonomy [s]", "autonomy_s", 1.0, 1),
    ("human [%]", "human_share", 100.0, 0),
    ("hand-overs", "hand_overs", 1.0, 0),
    ("covered [%]", "coverage", 100.0, 1),
    ("models", "models", 1.0, 0),
    ("AUC", "auc_std", 1.0, 2),
)
"""Heading, column of the results, factor and digits behind the point."""


def cross_table(results: Results) -> list[str]:
    """The combinations, a line each."""
    return _table(results.cross, varying_axes(results.cross) or ["method"])


def sensitivity_tables(results: Results) -> list[list[str]]:
    """A table for each parameter that is varied alone."""
    return [_table(cases, _axes(part, cases)) for part, cases in results.sensitivity.items()]


def shown(mean: Mean, factor: float, digits: int) -> str:
    """A mean and half its interval; a dash where there is none."""
    if mean.n == 0:
        return "-"
    text = f"{factor * mean.mean:.{digits}f}"
    return text if mean.n == 1 else f"{text} ± {factor * mean.half:.{digits}f}"


def _axes(part: str, cases: Sequence[CaseResult]) -> list[str]:
    return [part, *(axis for axis in varying_axes(cases) if axis != part)]


def _table(cases: Iterable[CaseResult], axes: Sequence[str]) -> list[str]:
    rows = [[*axes, "sessions", "alone [%]", *(heading for heading, *_ in COLUMNS)]]
    for case in cases:
        settings = dict(case.settings)
        count = str(case.sessions) if case.sessions == case.wanted else f"{case.sessions} of {case.wanted}"
        alone = f"{100.0 * case.share_autonomous:.0f}" if case.sessions else "-"
        rows.append(
            [*(settings.get(axis, "") for axis in axes), count, alone]
            + [shown(case.figures[column], factor, digits) for _, column, factor, digits in COLUMNS]
        )
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    left = len(axes)
    return [
        "  ".join(
            cell.ljust(width) if place < left else cell.rjust(width)
            for place, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    ]

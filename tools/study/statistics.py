"""From rows to means with their 95 % intervals, case by case."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from tools.study.plan import Settings
from tools.study.store import COUNTS, FIGURES, Store, Table

LEVEL: Final = 0.95
"""Confidence of the intervals."""

FloatArray = NDArray[np.float64]


class Mean(NamedTuple):
    """A mean over sessions."""

    mean: float
    """NaN without a session that has the figure."""
    half: float
    """Half the width of its 95 % interval, by Student's t; NaN below two sessions."""
    n: int
    """Sessions that have the figure."""

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        return self.mean - self.half

    @property
    def high(self) -> float:
        """Upper end of the interval."""
        return self.mean + self.half


@dataclass(frozen=True, slots=True, kw_only=True)
class CaseResult:
    """What the sessions of a case came to."""

    part: str
    settings: Settings
    sessions: int
    """Sessions that are there."""
    wanted: int
    """Sessions that the study asks for."""
    ended_early: int
    """Sessions that an error or a trip ended."""
    share_autonomous: float
    """Share of the sessions whose skill went on alone before teaching was given up."""
    figures: Mapping[str, Mean]
    """By the name of the column."""
    curve_s: FloatArray
    """Times since the first sample, shape (k,) [s]."""
    curve_error: FloatArray
    """Error of the skill on the grid at these times, a session a row, shape (n, k) [N]."""

    @property
    def name(self) -> str:
        """The settings in one line."""
        return " ".join(f"{axis}={value}" for axis, value in self.settings) or "base"


class Results(NamedTuple):
    """The results of a study."""

    title: str
    cross: tuple[CaseResult, ...]
    """The combinations."""
    sensitivity: Mapping[str, tuple[CaseResult, ...]]
    """By parameter: the cases in which it alone is varied."""


def mean_of(values: FloatArray) -> Mean:
    """Mean and interval of the finite values of shape (n,)."""
    finite = values[np.isfinite(values)]
    n = len(finite)
    if n == 0:
        return Mean(math.nan, math.nan, 0)
    if n == 1:
        return Mean(float(finite[0]), math.nan, 1)
    half = float(stats.t.ppf(0.5 + 0.5 * LEVEL, n - 1) * finite.std(ddof=1) / math.sqrt(n))
    return Mean(float(finite.mean()), half, n)


def load_results(store: Store, *, curve_step_s: float = 3.0) -> Results:
    """All results of a directory, in the order of the study file.

    Raises:
        ConfigurationError: There are none, or they are another version's.
    """
    title, cases, keys = store.cases()
    table = store.table()
    place = {key: row for row, key in enumerate(table["key"])}
    cross: list[CaseResult] = []
    sensitivity: dict[str, list[CaseResult]] = {}
    for case, wanted in zip(cases, keys, strict=True):
        rows = np.array([place[key] for key in wanted if key in place], dtype=np.int64)
        result = _case_result(case.part, case.settings, table, rows, len(wanted), curve_step_s)
        if case.part == "cross":
            cross.append(result)
        else:
            sensitivity.setdefault(case.part, []).append(result)
    return Results(title, tuple(cross), {part: tuple(found) for part, found in sensitivity.items()})


def varying_axes(cases: Sequence[CaseResult]) -> list[str]:
    """Axes on which the cases differ, in their order."""
    seen: dict[str, set[str]] = {}
    for case in cases:
        for axis, value in case.settings:
            seen.setdefault(axis, set()).add(value)
    return [axis for axis, values in seen.items() if len(values) > 1]


def _case_result(
    part: str, settings: Settings, table: Table, rows: NDArray[np.int64], wanted: int, step_s: float
) -> CaseResult:
    ended = table["ended"][rows]
    figures = {name: mean_of(table[name][rows].astype(float)) for name in (*COUNTS, *FIGURES)}
    autonomous = np.isfinite(table["autonomy_s"][rows])
    longest = max((float(curve[-1]) for curve in table["curve_s"][rows] if len(curve)), default=0.0)
    times = np.arange(0.0, longest + step_s, step_s)
    curves = [_held(table["curve_s"][row], table["curve_error"][row], times) for row in rows]
    return CaseResult(
        part=part,
        settings=settings,
        sessions=len(rows),
        wanted=wanted,
        ended_early=int(np.count_nonzero(ended != "")),
        share_autonomous=float(autonomous.mean()) if len(rows) else math.nan,
        figures=figures,
        curve_s=times,
        curve_error=np.array(curves).reshape(len(rows), len(times)),
    )


def _held(times: FloatArray, errors: FloatArray, at: FloatArray) -> FloatArray:
    """The error at some times: that of the last update, NaN before the first."""
    index = np.searchsorted(times, at, side="right") - 1
    values = np.append(errors, np.nan)
    held: FloatArray = values[index]
    return held

"""Sessions beside each other: the figures of each, and means with their intervals over those of a group."""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hm_driver.errors import RecordingError
from tools.report import metrics
from tools.report.session_data import SESSION_METADATA, TEACHING, load_session
from tools.report.summary import Analysis, Summary, analyse

FloatArray = NDArray[np.float64]

LEVEL = 0.95
"""Confidence of the intervals."""
CONTROL_STEP_S = 5.0
"""Intervals over which the human's share of control is taken [s]."""
_COLUMNS = 6
"""Sessions or groups side by side in the terminal."""


class Metric(NamedTuple):
    """A figure of a session."""

    key: str
    """Its name in JSON."""
    label: str
    """Its name in tables."""
    unit: str
    """Its unit."""
    of: Callable[[Summary], float]
    """How it is taken from the numbers of a session."""


def _missed_percent(summary: Summary) -> float:
    periods = summary.cycles + summary.missed_periods
    return 100.0 * summary.missed_periods / periods if periods else math.nan


METRICS = (
    Metric("coverage_percent", "coverage of the plane", "%", lambda one: 100.0 * one.coverage),
    Metric("updates", "updates of the skill", "", lambda one: one.updates),
    Metric("samples", "samples learned", "", lambda one: one.samples),
    Metric("models", "local models", "", lambda one: one.models),
    Metric("teaching_s", "time of teaching", "s", lambda one: one.teaching_s),
    Metric("hand_overs", "changes of control", "", lambda one: one.hand_overs),
    Metric("skill_mean", "error of the skill, plane", "N", lambda one: one.grid.overall.mean),
    Metric("skill_inside_mean", "… inside the objects", "N", lambda one: one.grid.inside.mean),
    Metric("skill_border_mean", "… at their borders", "N", lambda one: one.grid.border.mean),
    Metric("run_mean", "error of the run, path", "N", lambda one: one.run.force.overall.mean),
    Metric("run_inside_mean", "… inside the objects", "N", lambda one: one.run.force.inside.mean),
    Metric("run_border_mean", "… at their borders", "N", lambda one: one.run.force.border.mean),
    Metric("rendering_mean", "… of it by rendering", "N", lambda one: one.run.rendering.overall.mean),
    Metric("missed_percent", "periods missed", "%", _missed_percent),
    Metric("lateness_p99_us", "lateness of the loop, 99 %", "µs", lambda one: one.lateness_us.p99),
    Metric("lost_messages", "messages lost", "", lambda one: one.lost_messages),
)
"""What is compared; errors are means of the force's error, as in a session's report."""


class Line(NamedTuple):
    """A curve of a session; arrays of shape (n,)."""

    x: FloatArray
    y: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """What a session came to, without its log."""

    path: Path
    name: str
    """What tells it from the others."""
    group: str
    """What its group has in common; its name where sessions are not grouped."""
    values: dict[str, float]
    """The metrics by their keys; NaN where the session has none."""
    learning: Line
    """Mean error of the skill [N] over the time since teaching began [s]."""
    control: Line
    """The human's share of control [%] over that time."""
    border: Line
    """Mean error of the autonomous run [N] over the distance from the nearest border [cm]."""


class Mean(NamedTuple):
    """A mean over sessions."""

    mean: float
    """NaN where no session has the figure."""
    half: float
    """Half the width of its 95 % interval, by Student's t; NaN below two sessions."""
    n: int
    """Sessions that have it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Comparison:
    """Sessions, and the groups that they form."""

    by: tuple[str, ...]
    """Keys of the session record by which they are grouped; empty where each stands for itself."""
    sessions: tuple[Session, ...]

    @property
    def groups(self) -> dict[str, list[Session]]:
        """The sessions of each group, in the order of the command line."""
        found: dict[str, list[Session]] = {}
        for session in self.sessions:
            found.setdefault(session.group, []).append(session)
        return found

    def means(self, group: str) -> dict[str, Mean]:
        """Mean of each metric over a group."""
        sessions = self.groups[group]
        return {one.key: mean_of([session.values[one.key] for session in sessions]) for one in METRICS}

    def as_dict(self) -> dict[str, object]:
        """For JSON: what is not known is null."""
        return {
            "by": list(self.by),
            "sessions": [
                {"log": str(one.path), "name": one.name, "group": one.group}
                | {"figures": {key: _known(value) for key, value in one.values.items()}}
                for one in self.sessions
            ],
            "groups": {
                group: {
                    key: {"mean": _known(mean.mean), "half": _known(mean.half), "n": mean.n}
                    for key, mean in self.means(group).items()
                }
                for group in self.groups
            },
        }


def compare(logs: Sequence[Path], *, by: Sequence[str] = ()) -> Comparison:
    """Read sessions one after the other, and keep of each what is compared.

    Args:
        logs: Their logs, two at least, each once.
        by: Keys of the logs' session record; sessions that agree in all of them form a group.

    Raises:
        RecordingError: A log cannot be read or holds no session, is given twice, has no such key, or there
            are fewer than two.
    """
    if len(logs) < 2:
        raise RecordingError("there is nothing to compare; name two logs or more")
    twice = [one for one, other in itertools.combinations(logs, 2) if one.resolve() == other.resolve()]
    if twice:
        raise RecordingError(f"{twice[0]} is given twice")
    sessions = tuple(_read(log, name, by) for log, name in zip(logs, _names(logs), strict=True))
    return Comparison(by=tuple(by), sessions=sessions)


def mean_of(values: Sequence[float]) -> Mean:
    """Mean and interval of the values that are finite."""
    from scipy import stats

    finite = np.array([value for value in values if math.isfinite(value)])
    n = len(finite)
    if n < 2:
        return Mean(float(finite[0]) if n else math.nan, math.nan, n)
    half = float(stats.t.ppf(0.5 + 0.5 * LEVEL, n - 1) * finite.std(ddof=1) / math.sqrt(n))
    return Mean(float(finite.mean()), half, n)


def rows(compared: Comparison) -> list[tuple[str, list[str]]]:
    """The table: the label of each metric with its unit, and a text for each session or group."""
    means = [compared.means(group) for group in compared.groups]
    table = (
        [("sessions", [str(len(sessions)) for sessions in compared.groups.values()])] if compared.by else []
    )
    for metric in METRICS:
        label = f"{metric.label} [{metric.unit}]" if metric.unit else metric.label
        table.append((label, [_text(mean[metric.key], is_group=bool(compared.by)) for mean in means]))
    return table


def as_text(compared: Comparison) -> str:
    """The table for a terminal, a few columns at a time."""
    names, table = list(compared.groups), rows(compared)
    width = max(len(label) for label, _ in table)
    blocks = []
    for first in range(0, len(names), _COLUMNS):
        part = slice(first, first + _COLUMNS)
        widths = [
            max(len(name), *(len(cells[part][place]) for _, cells in table))
            for place, name in enumerate(names[part])
        ]
        lines = [("", names[part]), *((label, cells[part]) for label, cells in table)]
        blocks.append(
            "\n".join(
                "  ".join(
                    [
                        f"{label:<{width}}",
                        *(f"{cell:>{wide}}" for cell, wide in zip(cells, widths, strict=True)),
                    ]
                )
                for label, cells in lines
            )
        )
    note = "mean ± half the width of its 95 % interval" if compared.by else ""
    return "\n\n".join([*blocks, note] if note else blocks)


def _names(logs: Sequence[Path]) -> list[str]:
    """The logs' names, with their directories where names are not enough."""
    stems = [log.stem for log in logs]
    return [
        log.stem if stems.count(log.stem) == 1 else f"{log.resolve().parent.name}/{log.stem}" for log in logs
    ]


def _read(log: Path, name: str, by: Sequence[str]) -> Session:
    data = load_session(log)
    record = data.metadata.get(SESSION_METADATA, {})
    for key in by:
        if key not in record:
            there = ", ".join(record) or "nothing"
            raise RecordingError(f"{log}: its session record has no {key}; it has {there}")
    group = ", ".join(record[key] if key in ("method", "task") else f"{key} {record[key]}" for key in by)
    analysis = analyse(data)
    values = {metric.key: float(metric.of(analysis.summary)) for metric in METRICS}
    if data.is_virtual:
        values["lateness_p99_us"] = math.nan
    return Session(
        path=log,
        name=name,
        group=group or name,
        values=values,
        learning=_learning(analysis),
        control=_control(analysis),
        border=_border(analysis),
    )


def _teaching_begins_s(analysis: Analysis) -> float:
    ticks = analysis.data.ticks
    teaching = ticks.time_s[ticks.stage == TEACHING]
    return float(teaching[0]) if len(teaching) else 0.0


def _learning(analysis: Analysis) -> Line:
    """Steps: before the first update the skill commands nothing, and misses the whole reference."""
    begin = _teaching_begins_s(analysis)
    task, ticks = analysis.data.task, analysis.data.ticks
    times = [0.0, *(skill.time_s - begin for skill in analysis.data.skills), float(ticks.time_s[-1]) - begin]
    errors = [task.reference_force, *(float(error.mean()) for error in analysis.errors)]
    return Line(np.array(times), np.array([*errors, errors[-1]]))


def _control(analysis: Analysis) -> Line:
    ticks = analysis.data.ticks
    teaching = ticks.stage == TEACHING
    time_s = ticks.time_s[teaching] - _teaching_begins_s(analysis)
    if not len(time_s):
        return Line(np.empty(0), np.empty(0))
    place = (time_s / CONTROL_STEP_S).astype(np.int64)
    counts = np.bincount(place)
    shares = 100.0 * np.bincount(place, weights=ticks.C[teaching]) / np.maximum(counts, 1)
    shares[counts == 0] = np.nan
    return Line(CONTROL_STEP_S * (np.arange(len(counts), dtype=np.float64) + 0.5), shares)


def _border(analysis: Analysis) -> Line:
    profile = metrics.profile(analysis.run.force, analysis.run.border)
    return Line(100.0 * profile.distance, profile.mean)


def _text(mean: Mean, *, is_group: bool) -> str:
    if math.isnan(mean.mean):
        return "–"
    if not is_group or math.isnan(mean.half):
        return _number(mean.mean)
    return f"{_number(mean.mean)} ± {_number(mean.half)}"


def _number(value: float) -> str:
    return f"{value:.0f}" if value == round(value) or abs(value) >= 1000.0 else f"{value:.3g}"


def _known(value: float) -> float | None:
    return value if math.isfinite(value) else None

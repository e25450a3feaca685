"""The numbers of a session: the report's table, and what ``--json`` prints."""

import dataclasses
import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from teaching.evaluation import Figures, ForceError, OnGrid, Trace, by_border, evaluate
from tools.report import metrics
from tools.report.metrics import Evaluation, Lateness, RunError, RunSamples
from tools.report.session_data import AUTONOMOUS, PRACTICE, TEACHING, FloatArray, SessionData


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """What a session came to. Errors are in newtons: overall, inside the objects and at their borders."""

    updates: int
    """Updates of the skill."""
    samples: int
    """Samples learned."""
    models_added: int
    """Models made."""
    models_pruned: int
    """Models pruned."""
    models: int
    """Models present at the end."""
    coverage: float
    """Share of the plane where w_max is at least w_th, from 0 to 1."""
    hand_overs: int
    """How often control changed hands while teaching."""
    teaching_from_first_sample_s: float
    """Duration of teaching from the first sample on [s]."""
    human_share: float
    """Share of that time in which the human was in control."""
    session_s: float
    """From the first tick to the last [s]."""
    practice_s: float
    """Duration of practice [s]."""
    teaching_s: float
    """Duration of teaching [s]."""
    autonomous_s: float
    """Duration of the autonomous run [s]."""
    update_times_s: tuple[float, ...]
    """When each update was taken over [s]."""
    cycles: int
    """Cycles of the loop in the log."""
    missed_periods: int
    """Periods of the loop that were skipped."""
    saturated_cycles: int
    """Cycles with a joint at its velocity limit."""
    lost_messages: int
    """Messages that did not get into the log."""
    force_change_n_per_ms: float
    """Largest change of the position spring's force in z that the command caused [N/ms]."""
    lateness_us: Lateness
    """Lateness of the loop [us]; means nothing on a virtual clock."""
    grid: ForceError
    """|K y - F_ref| of the learned skill on an 80 x 80 grid [N]."""
    run: RunError
    """The autonomous run: force error, and its parts by skill and rendering [N]."""
    share_wrong: float
    """Share of the grid where the skill is wrong by more than 2 N."""
    auc_w_max: float
    """How well the activation tells those places: area under the receiver operating characteristic."""
    auc_std: float
    """How well the skill's own deviation, by the size of its prediction, tells them; NaN where the log does
    not hold what the deviation follows from."""

    def as_dict(self) -> dict[str, Any]:
        """The summary as nested dictionaries for JSON; None stands for what there is not."""
        return {field.name: _plain(getattr(self, field.name)) for field in dataclasses.fields(self)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Analysis:
    """The session with what was computed from it, for the figures."""

    data: SessionData
    """What the log holds."""
    points: FloatArray
    """The grid, shape (n^2, 2) [m]."""
    border: FloatArray
    """Distance of each point from the nearest border, shape (n^2,) [m]."""
    evaluations: tuple[Evaluation, ...]
    """The skill after each update, on the grid."""
    errors: tuple[FloatArray, ...]
    """|K y - F_ref| after each update, on the grid [N]."""
    run: RunSamples
    """The autonomous run."""
    summary: Summary
    """The numbers."""


def analyse(data: SessionData) -> Analysis:
    """Compute everything that figures and table show."""
    task = data.task
    points = task.grid(metrics.GRID)
    border = task.border_distances(points)
    stiffness = task.stiffness_at(points)
    final = len(data.skills) - 1
    evaluations = tuple(
        metrics.evaluate(skill, points, with_std=k == final) for k, skill in enumerate(data.skills)
    )
    errors = tuple(np.abs(stiffness * one.y - task.reference_force) for one in evaluations)
    run = metrics.run_samples(data.ticks, data.cycles, task)
    last = data.skills[-1] if data.skills else None
    figures = _figures(data, evaluations)
    time_s, stage = data.ticks.time_s, data.ticks.stage
    tick_s = float(np.median(np.diff(time_s))) if len(time_s) > 1 else 0.0
    summary = Summary(
        updates=sum(skill.cause == 0 for skill in data.skills),
        samples=last.samples if last else 0,
        models_added=last.added if last else 0,
        models_pruned=last.pruned if last else 0,
        models=len(last.centres) if last else 0,
        coverage=metrics.coverage(evaluations[-1], data.w_th) if last else 0.0,
        hand_overs=metrics.hand_overs(data.ticks),
        teaching_from_first_sample_s=figures.teaching_s,
        human_share=figures.human_share,
        session_s=float(time_s[-1] - time_s[0]),
        practice_s=round(tick_s * int(np.count_nonzero(stage == PRACTICE)), 6),
        teaching_s=round(tick_s * int(np.count_nonzero(stage == TEACHING)), 6),
        autonomous_s=round(tick_s * int(np.count_nonzero(stage == AUTONOMOUS)), 6),
        update_times_s=tuple(skill.time_s for skill in data.skills if skill.cause == 0),
        cycles=len(data.timing.lateness_us),
        missed_periods=data.timing.missed_periods,
        saturated_cycles=data.timing.saturated_cycles,
        lost_messages=data.lost_messages,
        force_change_n_per_ms=metrics.force_change(data.cycles, data.modes),
        lateness_us=metrics.lateness(data.timing.lateness_us),
        grid=by_border(errors[-1] if errors else np.empty(0), border if errors else np.empty(0)),
        run=metrics.run_error(run),
        share_wrong=figures.share_wrong,
        auc_w_max=figures.auc_w_max,
        auc_std=figures.auc_std,
    )
    return Analysis(
        data=data,
        points=points,
        border=border,
        evaluations=evaluations,
        errors=errors,
        run=run,
        summary=summary,
    )


def _figures(data: SessionData, evaluations: tuple[Evaluation, ...]) -> Figures:
    """What is said of every session, from the log."""
    ticks = data.ticks
    nothing = np.zeros(metrics.GRID**2)
    last = evaluations[-1] if evaluations else Evaluation(nothing, nothing)
    trace = Trace(ticks.time_s, ticks.stage, ticks.C, ticks.recorded, ticks.x, ticks.y, ticks.force)
    return evaluate(data.task, OnGrid(last.y, last.w_max, last.std), trace, w_th=data.w_th, n=metrics.GRID)


def _plain(value: Any) -> Any:  # noqa: ANN401 - whatever a field holds
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: _plain(part) for name, part in value._asdict().items()}
    if isinstance(value, tuple):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

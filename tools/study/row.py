"""One session of a study, and the row that it adds to the results: no clock, no file, no process."""

from functools import lru_cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from hm_driver.errors import HapticMasterError
from teaching.evaluation import Figures, Trace, evaluate, judge
from teaching.learner import FloatArray, Learner
from teaching.session import Session, Stage, Tick
from teaching.task import Task
from tools.run.fused import run_fused
from tools.run.request import TeachRequest
from tools.study.plan import SessionJob

CURVE_GRID: Final = 40
"""Points along each edge of the grid on which the skill is judged while it grows."""
CURVE_STEP_S: Final = 2.0
"""Of the updates within this time only the last is judged [s]."""

Row = dict[str, Any]


class Trail:
    """A log that keeps what the figures need."""

    def __init__(self) -> None:
        self._ticks: list[tuple[float, ...]] = []
        self.skills: list[tuple[int, Learner, float]] = []
        """Tick, skill and coverage of each update."""

    def tick(self, time_ns: int, tick: Tick) -> None:
        """Note a tick."""
        self._ticks.append((time_ns, tick.stage, tick.C, tick.recorded, tick.x, tick.y, tick.force))
        if tick.update is not None:
            self.skills.append((len(self._ticks) - 1, tick.update.learner, tick.update.coverage))

    def hand(self, *_: object) -> None:
        """What only a simulation knows is of no interest here."""

    def trace(self) -> Trace:
        """The ticks as arrays."""
        if not self._ticks:
            return Trace.empty()
        t = np.array(self._ticks)
        return Trace(
            time_s=(t[:, 0] - t[0, 0]) * 1e-9,
            stage=t[:, 1].astype(np.int64),
            C=t[:, 2],
            recorded=t[:, 3].astype(bool),
            x=t[:, 4],
            y=t[:, 5],
            force=t[:, 6],
        )


def run_session(job: SessionJob) -> Row:
    """Run one session; what ends it early is told in the row, with the figures up to there."""
    request = TeachRequest(options=job.options, task=job.task, seed=job.seed, output=Path())
    trail = Trail()
    session: Session | None = None
    ended = ""
    try:
        session = run_fused(request, trail)
    except HapticMasterError as error:
        ended = f"{type(error).__name__}: {error}"
    trace = trail.trace()
    learner = trail.skills[-1][1] if trail.skills else job.options.learner.build()
    figures = evaluate(job.task, judge(learner, job.task), trace, w_th=job.options.arbitration.w_th)
    return _row(job, figures, trace, trail, learner) | {
        "ended": ended,
        "updates": session.updates if session is not None else len(trail.skills),
    }


def _row(job: SessionJob, figures: Figures, trace: Trace, trail: Trail, learner: Learner) -> Row:
    first = np.flatnonzero(trace.recorded)
    start_s = float(trace.time_s[first[0]]) if len(first) else np.nan
    autonomous = np.flatnonzero(trace.stage == Stage.AUTONOMOUS)
    teaching_limit = job.options.session.practice + job.options.session.give_up
    began_s = float(trace.time_s[autonomous[0]]) if len(autonomous) else np.nan
    has_mastered = bool(len(autonomous)) and began_s <= teaching_limit - 0.02
    row: Row = {
        "key": job.key,
        "seed": job.seed,
        "models": learner.n_models,
        "models_added": learner.n_added,
        "models_pruned": learner.n_pruned,
        "samples": learner.n_samples,
        "coverage": figures.coverage,
        "session_s": float(trace.time_s[-1]) if len(trace.time_s) else 0.0,
        "teaching_s": figures.teaching_s,
        "autonomy_s": began_s - start_s if has_mastered else np.nan,
        "human_share": figures.human_share,
        "hand_overs": figures.hand_overs,
        "share_wrong": figures.share_wrong,
        "auc_std": figures.auc_std,
        "auc_w_max": figures.auc_w_max,
    }
    for name, error in (("grid", figures.grid), ("run", figures.run)):
        for place, spread in error._asdict().items():
            for statistic, value in spread._asdict().items():
                row[f"{name}_{place}_{statistic}"] = value
    return row | _curve(job.task, trace, trail, start_s)


def _curve(task: Task, trace: Trace, trail: Trail, start_s: float) -> Row:
    """How the skill grew: time since the first sample, error on the grid and models, an update each."""
    times: list[float] = []
    errors: list[float] = []
    models: list[int] = []
    points, stiffness = _curve_grid(task)
    for tick, learner, _ in trail.skills:
        time_s = float(trace.time_s[tick]) - start_s
        if times and int(time_s / CURVE_STEP_S) == int(times[-1] / CURVE_STEP_S):
            del times[-1], errors[-1], models[-1]
        force = stiffness * learner.predict(points)[:, 0]
        times.append(time_s)
        errors.append(float(np.mean(np.abs(force - task.reference_force))))
        models.append(learner.n_models)
    return {"curve_s": times, "curve_error": errors, "curve_models": models}


@lru_cache(maxsize=16)
def _curve_grid(task: Task) -> tuple[FloatArray, FloatArray]:
    points = task.grid(CURVE_GRID)
    return points, task.stiffness_at(points)

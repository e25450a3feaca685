"""The report's numbers: pure functions of arrays. Skills are evaluated anew, without the learner's code."""

import math
from typing import NamedTuple

import numpy as np

from hm_driver.realtime.modes import ModeOptions
from teaching.evaluation import ForceError, by_border
from teaching.task import Task
from tools.report.session_data import AUTONOMOUS, Cycles, FloatArray, Skill, Ticks

GRID = 80
"""Points along each edge of the grid on which a skill is judged."""
W_CUTOFF = 0.001
"""Share of the largest weight below which the learner leaves a model out of eq. (1)."""


class Evaluation(NamedTuple):
    """A skill on points of the plane; arrays of shape (n,)."""

    y: FloatArray
    """Predicted displacement, eq. (1) [m]."""
    w_max: FloatArray
    """Largest activation."""
    std: FloatArray | None = None
    """Standard deviation of a sample about the prediction [m]; None where it was not asked for or the log
    does not hold what it follows from."""


class RunError(NamedTuple):
    """Force errors of the autonomous run [N]."""

    force: ForceError
    """|F - F_ref|, as measured."""
    skill: ForceError
    """|K y - F_ref|, what the skill would give if the arm followed it perfectly."""
    rendering: ForceError
    """K |z_handle - z_ref|, what the arm adds by not following perfectly."""


class RunSamples(NamedTuple):
    """Ticks of the autonomous run that lie on the plane; arrays of shape (n,)."""

    time_s: FloatArray
    x: FloatArray
    y: FloatArray
    force: FloatArray
    """|F - F_ref| [N]."""
    skill: FloatArray
    """|K y - F_ref| [N]."""
    rendering: FloatArray
    """K |z_handle - z_ref| [N]; NaN where position mode was not engaged."""
    border: FloatArray
    """Distance from the nearest border [m]."""


class Profile(NamedTuple):
    """Errors by the distance from the nearest border; arrays of shape (n,)."""

    distance: FloatArray
    """Middle of each bin [m]."""
    mean: FloatArray
    """Mean error in it [N]; NaN where it is empty."""
    p95: FloatArray
    """95 % quantile [N]."""


class Lateness(NamedTuple):
    """Quantiles of the loop's lateness [us]."""

    p50: float
    p99: float
    p99_9: float
    max: float


def evaluate(skill: Skill, points: FloatArray, *, with_std: bool = False) -> Evaluation:
    """Eqs. (1) to (4) for points of shape (n, 2) [m]; the same cut-off as the learner's.

    Args:
        skill: The skill as the log holds it.
        points: Where.
        with_std: Whether the deviation is wanted too.
    """
    n = len(points)
    if not len(skill.centres):
        std = np.full(n, np.inf) if with_std and skill.variances is not None else None
        return Evaluation(np.zeros(n), np.zeros(n), std)
    offset = points[:, None, :] - skill.centres[None, :, :]
    q = np.einsum("nkj,kji,nki->nk", offset, skill.D, offset, optimize=True)
    nearest = q.min(axis=1)
    w = np.exp(-0.5 * (q - nearest[:, None]))  # shifted, so that it is finite however far away
    w[w < W_CUTOFF] = 0.0
    if skill.say is not None:
        w *= skill.say
    local = np.einsum("nkj,kj->nk", offset, skill.M[:, :2]) + skill.M[:, 2]
    y, w_max = (w * local).sum(axis=1) / w.sum(axis=1), np.exp(-0.5 * nearest)
    if not with_std or skill.P is None or skill.variances is None:
        return Evaluation(y, w_max)
    point, model = np.nonzero(w)
    z = np.column_stack((offset[point, model], np.ones(len(point))))
    uncertain = 1.0 + np.einsum("ij,ijk,ik->i", z, skill.P[model], z)
    parts = uncertain * skill.variances[model] + (local[point, model] - y[point]) ** 2
    variance = np.bincount(point, w[point, model] * parts, n) / w.sum(axis=1)
    return Evaluation(y, w_max, np.where(w_max < W_CUTOFF, np.inf, np.sqrt(variance)))


def coverage(evaluation: Evaluation, w_th: float) -> float:
    """Share of the points where w_max is at least w_th."""
    return float(np.mean(evaluation.w_max >= w_th)) if len(evaluation.w_max) else math.nan


def run_samples(ticks: Ticks, cycles: Cycles, task: Task) -> RunSamples:
    """The autonomous run, tick by tick, its error split into skill and rendering."""
    half = 0.5 * task.size
    chosen = (ticks.stage == AUTONOMOUS) & (np.abs(ticks.x) <= half) & (np.abs(ticks.y) <= half)
    time_s, x, y, K = ticks.time_s[chosen], ticks.x[chosen], ticks.y[chosen], ticks.stiffness[chosen]
    reference = task.reference_force
    return RunSamples(
        time_s=time_s,
        x=x,
        y=y,
        force=np.abs(ticks.force[chosen] - reference),
        skill=np.abs(K * ticks.y_robot[chosen] - reference),
        rendering=K * task.scale[2] * _tracking_error(cycles, time_s),
        border=task.border_distances(np.column_stack((x, y))),
    )


def _tracking_error(cycles: Cycles, time_s: FloatArray) -> FloatArray:
    """|z_handle - z_ref| [m] at the cycle of each time; NaN where position mode was not engaged."""
    error = np.full(len(time_s), np.nan)
    if not len(cycles.time_s):
        return error
    at = np.clip(np.searchsorted(cycles.time_s, time_s + 1e-6, side="right") - 1, 0, None)
    engaged = cycles.phase_z[at] == 1.0
    error[engaged] = np.abs(cycles.z[at] - cycles.reference_z[at])[engaged]
    return error


def run_error(samples: RunSamples) -> RunError:
    """Force errors of the run, overall, inside the objects and at the borders."""
    has_rendering = np.isfinite(samples.rendering)
    return RunError(
        force=by_border(samples.force, samples.border),
        skill=by_border(samples.skill, samples.border),
        rendering=by_border(samples.rendering[has_rendering], samples.border[has_rendering]),
    )


def profile(errors: FloatArray, distances: FloatArray, *, width: float = 0.005) -> Profile:
    """Errors by the distance from the nearest border, in bins of a width [m]."""
    finite = np.isfinite(errors) & np.isfinite(distances)
    errors, distances = errors[finite], distances[finite]
    n = int(np.max(distances) / width) + 1 if len(distances) else 0
    index = (distances / width).astype(np.int64)
    parts = [errors[index == place] for place in range(n)]
    return Profile(
        distance=(np.arange(n, dtype=np.float64) + 0.5) * width,
        mean=np.array([part.mean() if len(part) else np.nan for part in parts]),
        p95=np.array([np.quantile(part, 0.95) if len(part) else np.nan for part in parts]),
    )


def lateness(lateness_us: FloatArray) -> Lateness:
    """Quantiles of the lateness [us]; NaN without cycles."""
    if not len(lateness_us):
        return Lateness(math.nan, math.nan, math.nan, math.nan)
    p50, p99, p99_9 = np.quantile(lateness_us, (0.5, 0.99, 0.999))
    return Lateness(float(p50), float(p99), float(p99_9), float(np.max(lateness_us)))


def hand_overs(ticks: Ticks) -> int:
    """How often control changed hands while teaching."""
    C = ticks.C[ticks.stage == 1]
    return int(np.count_nonzero(np.diff((C > 0.5).astype(np.int8))))


def force_change(cycles: Cycles, modes: ModeOptions) -> float:
    """Largest change of the position spring's force in z that the command caused [N per ms].

    With the handle moving as it does, the reference changes the force K (r - x) + B (v - x') by
    K (v - x') dt + B dv in a cycle, and by B dv beyond going on as before; the smaller one is taken. The rest
    of what the force changes by is the hand's.
    """
    stiffness = modes.position_stiffness
    damping = modes.damping(stiffness, modes.position_damping_ratio)
    is_engaged = (cycles.phase_z[1:] == 1.0) & (cycles.phase_z[:-1] == 1.0)
    dt = cycles.dt_s[1:]
    slip = cycles.reference_velocity_z[1:] - cycles.velocity_z[1:]
    going_on = damping * np.diff(cycles.reference_velocity_z)
    change = np.minimum(np.abs(stiffness * slip * dt + going_on), np.abs(going_on))
    change = change[is_engaged] / (dt[is_engaged] * 1e3)
    return float(np.max(change)) if len(change) else math.nan


def decimate(time: FloatArray, values: FloatArray, bins: int) -> tuple[FloatArray, FloatArray]:
    """The smallest and the largest value of each bin, so that no peak is lost; NaN stays where all is NaN.

    Args:
        time: Times, shape (n,).
        values: Values, shape (n,).
        bins: Number of bins; fewer than 2 * bins points are returned as they are.
    """
    n = len(time)
    if n <= 2 * bins:
        return time, values
    edges = np.linspace(0, n, bins + 1).astype(np.int64)
    missing = np.isnan(values)
    low = np.minimum.reduceat(np.where(missing, np.inf, values), edges[:-1])
    high = np.maximum.reduceat(np.where(missing, -np.inf, values), edges[:-1])
    low[np.isinf(low)], high[np.isinf(high)] = np.nan, np.nan
    middle = time[(edges[:-1] + edges[1:]) // 2]
    return np.repeat(middle, 2), np.column_stack((low, high)).ravel()

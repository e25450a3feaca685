"""How good a skill is: the share of the plane that it covers, and the force error that it would make."""

import math
from typing import NamedTuple

import numpy as np

from teaching.learner import FloatArray, Learner
from teaching.task import Task

INSIDE: float = 0.04
"""Points farther from every border than this are inside an object [m]."""
BAND: float = 0.02
"""Points at most this far from a border are at the border [m]."""


class Spread(NamedTuple):
    """Mean, 95 % quantile and maximum of absolute errors; NaN where there is no point."""

    mean: float
    p95: float
    max: float


class ForceError(NamedTuple):
    """Force error |K y - F_ref| of a skill over the plane [N]."""

    overall: Spread
    """Everywhere."""
    inside: Spread
    """More than 4 cm from every border."""
    border: Spread
    """Within 2 cm of a border."""


def coverage(learner: Learner, task: Task, w_th: float, n: int = 80) -> float:
    """Share of an n x n grid of the plane where w_max is at least w_th."""
    return learner.share_active(task.grid(n), w_th)


def force_error(learner: Learner, task: Task, n: int = 80) -> ForceError:
    """Force error of the learned skill on an n x n grid of the plane."""
    points = task.grid(n)
    errors = np.abs(task.stiffness_at(points) * learner.predict(points)[:, 0] - task.reference_force)
    return by_border(errors, task.border_distances(points))


def by_border(errors: FloatArray, distances: FloatArray) -> ForceError:
    """Absolute errors [N] of shape (n,), split by the distance from the nearest border [m] of shape (n,)."""
    return ForceError(spread(errors), spread(errors[distances > INSIDE]), spread(errors[distances <= BAND]))


def spread(errors: FloatArray) -> Spread:
    """Mean, 95 % quantile and maximum of errors of shape (n,)."""
    if len(errors) == 0:
        return Spread(math.nan, math.nan, math.nan)
    return Spread(float(errors.mean()), float(np.quantile(errors, 0.95)), float(np.max(errors)))

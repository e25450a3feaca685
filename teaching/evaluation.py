"""How good a skill is, and what it cost to teach it: what reports and studies say of a session.

Example:
    >>> from teaching.evaluation import Trace, evaluate, judge
    >>> from teaching.lwr import LWR
    >>> from teaching.task_file import load_task
    >>> task = load_task("paper")
    >>> figures = evaluate(task, judge(LWR(), task), Trace.empty())
    >>> figures.grid.overall.mean
    10.0
"""

import math
from typing import Any, Final, Literal, NamedTuple, Protocol, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray

from teaching.learner import FloatArray, Learner
from teaching.task import Task

INSIDE: Final[float] = 0.04
"""Points farther from every border than this are inside an object [m]."""
BAND: Final[float] = 0.02
"""Points at most this far from a border are at the border [m]."""
GRID: Final = 80
"""Points along each edge of the grid on which a skill is judged."""
WRONG: Final = 2.0
"""Force error from which on a skill counts as wrong at a place [N]."""
PRACTICE, TEACHING, AUTONOMOUS = 0, 1, 2
"""Stages as a :class:`Trace` numbers them, those of ``teaching.session.Stage``."""

BoolArray = NDArray[np.bool_]


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


class OnGrid(NamedTuple):
    """A skill on the grid of a task, ``task.grid(80)``; arrays of shape (n,)."""

    y: FloatArray
    """Predicted displacement [m]."""
    w_max: FloatArray
    """Largest activation."""
    std: FloatArray | None = None
    """Predictive standard deviation [m], of a learner that has one."""


class Trace(NamedTuple):
    """The ticks of a session, one after the other; arrays of shape (n,)."""

    time_s: FloatArray
    """Time on the session's clock [s]."""
    stage: NDArray[np.int64]
    """0 practice, 1 teaching, 2 autonomous, 3 done."""
    C: FloatArray
    """Control factor of eq. (8)."""
    recorded: BoolArray
    """Whether the tick's sample was accumulated."""
    x: FloatArray
    """Position of the manipulator [m]."""
    y: FloatArray
    force: FloatArray
    """Interaction force [N]."""

    @classmethod
    def empty(cls) -> Self:
        """No tick."""
        none = np.empty(0)
        return cls(none, none.astype(np.int64), none, none.astype(bool), none, none, none)


class Figures(NamedTuple):
    """A session in numbers. What there is not, as the run of a session that never came to it, is NaN."""

    grid: ForceError
    """|K y - F_ref| of the skill on the grid [N]."""
    run: ForceError
    """|F - F_ref| in the autonomous run, on the plane [N]."""
    share_wrong: float
    """Share of the grid where the skill is wrong by more than 2 N."""
    auc_std: float
    """How well the predictive standard deviation by the size of the prediction tells those places: the
    probability that it is larger at one that is wrong than at one that is not."""
    auc_w_max: float
    """The same of the activation, smaller at one that is wrong: the paper's signal."""
    coverage: float
    """Share of the grid with an activation of at least w_th."""
    teaching_s: float
    """Duration of teaching from the first sample on [s]."""
    human_share: float
    """Share of that time in which the human was in control, C > 0.5."""
    hand_overs: int
    """How often control changed hands while teaching."""

    def as_dict(self) -> dict[str, Any]:
        """The figures as nested dictionaries for JSON; None stands for what there is not."""
        plain: dict[str, Any] = _plain(self)
        return plain


class Judged(Protocol):
    """What a learner must be asked for: every one of this package can be."""

    def w_max(self, X: ArrayLike) -> FloatArray:
        """Largest activation, shape (n,), at inputs of shape (n, d)."""
        ...

    def predict(self, X: ArrayLike, *, return_std: Literal[True]) -> tuple[FloatArray, FloatArray]:
        """Outputs and their standard deviations, shapes (n, m), at inputs of shape (n, d)."""
        ...


def judge(learner: Judged, task: Task, n: int = GRID) -> OnGrid:
    """Ask a learner for its skill on the grid."""
    points = task.grid(n)
    y, std = learner.predict(points, return_std=True)
    return OnGrid(y[:, 0], learner.w_max(points), std[:, 0])


def evaluate(task: Task, skill: OnGrid, trace: Trace, *, w_th: float = 0.5, n: int = GRID) -> Figures:
    """Everything that is said of a session's outcome.

    Args:
        task: The plane.
        skill: The final skill on ``task.grid(n)``, as :func:`judge` gives it.
        trace: The session's ticks.
        w_th: Activation from which a place counts as covered.
        n: Points along each edge of the grid.
    """
    points = task.grid(n)
    errors = np.abs(task.stiffness_at(points) * skill.y - task.reference_force)
    wrong = errors > WRONG
    taught = _from_first_sample(trace)
    C = trace.C[taught]
    tick_s = float(np.median(np.diff(trace.time_s))) if len(trace.time_s) > 1 else 0.0
    return Figures(
        grid=by_border(errors, task.border_distances(points)),
        run=_run_error(task, trace),
        share_wrong=float(wrong.mean()),
        auc_std=math.nan if skill.std is None else auc(_relative(skill.std, skill.y), wrong),
        auc_w_max=auc(-skill.w_max, wrong),
        coverage=float((skill.w_max >= w_th).mean()),
        teaching_s=round(tick_s * len(C), 6),
        human_share=float((C > 0.5).mean()) if len(C) else math.nan,
        hand_overs=int(np.count_nonzero(np.diff((trace.C[trace.stage == TEACHING] > 0.5).astype(np.int8)))),
    )


def auc(score: ArrayLike, is_positive: ArrayLike) -> float:
    """Area under the receiver operating characteristic, by the rank sum of Mann and Whitney.

    The probability that the score of a positive is larger than that of a negative, ties counting half.

    Args:
        score: Scores, shape (n,); infinite ones are in order, NaN is refused.
        is_positive: Which of them are positives, shape (n,).

    Returns:
        The area; NaN unless there is at least one of each.

    Raises:
        ValueError: Shapes differ, or a score is NaN.
    """
    values, chosen = np.asarray(score, dtype=float), np.asarray(is_positive, dtype=bool)
    if values.ndim != 1 or values.shape != chosen.shape:
        raise ValueError(f"scores have the shape {values.shape} and positives {chosen.shape}; both are (n,)")
    if np.isnan(values).any():
        raise ValueError(f"score[{int(np.flatnonzero(np.isnan(values))[0])}] is NaN; it has no rank")
    positives = int(chosen.sum())
    negatives = len(chosen) - positives
    if not positives or not negatives:
        return math.nan
    _, group, counts = np.unique(values, return_inverse=True, return_counts=True)
    ranks = (np.cumsum(counts) - 0.5 * (counts - 1))[group]
    return float((ranks[chosen].sum() - 0.5 * positives * (positives + 1)) / (positives * negatives))


def coverage(learner: Learner, task: Task, w_th: float, n: int = GRID) -> float:
    """Share of an n x n grid of the plane where w_max is at least w_th."""
    return learner.share_active(task.grid(n), w_th)


def force_error(learner: Learner, task: Task, n: int = GRID) -> ForceError:
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


def _relative(std: FloatArray, y: FloatArray) -> FloatArray:
    """Standard deviation by the size of the prediction: the arbitration's doubt."""
    return std / np.maximum(np.abs(y), 1e-9)


def _from_first_sample(trace: Trace) -> BoolArray:
    """Which ticks belong to teaching, counted from the first sample."""
    first = np.flatnonzero(trace.recorded)
    taught: BoolArray = trace.stage == TEACHING
    if not len(first):
        return np.zeros_like(taught)
    taught[: first[0]] = False
    return taught


def _run_error(task: Task, trace: Trace) -> ForceError:
    half = 0.5 * task.size
    on_plane = (np.abs(trace.x) <= half) & (np.abs(trace.y) <= half)
    chosen = (trace.stage == AUTONOMOUS) & on_plane
    errors = np.abs(trace.force[chosen] - task.reference_force)
    return by_border(errors, task.border_distances(np.column_stack((trace.x[chosen], trace.y[chosen]))))


def _plain(value: Any) -> Any:  # noqa: ANN401 - whatever a field holds
    if isinstance(value, tuple) and hasattr(value, "_asdict"):
        return {name: _plain(part) for name, part in value._asdict().items()}
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value

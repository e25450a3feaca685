"""The skill as it grows: updates learned aside, what is forgotten of it, and the way back."""

from collections import deque
from enum import IntEnum
from typing import NamedTuple

import numpy as np

from teaching.accumulator import BackgroundUpdate, Batch
from teaching.arbitration import Arbitration, Query
from teaching.correction import Region
from teaching.learner import FloatArray, Learner
from teaching.task import Task

COVERAGE_GRID = 80
"""Points along each edge of the grid on which coverage is judged."""
MASTERY_GRID = 40
"""Points along each edge of the grid on which the skill's own doubt is judged."""
_TICKS = 20
"""Ticks over which the plane is surveyed, where the skill is asked for its doubt."""
_EVERYWHERE = (-np.inf, -np.inf), (np.inf, np.inf)


class Cause(IntEnum):
    """Why the skill is another one."""

    UPDATE = 0
    """A batch was learned."""
    FORGET = 1
    """The human had models removed."""
    UNDO = 2
    """The human took the last change back."""


class Update(NamedTuple):
    """A change of the skill that was swapped in at this tick."""

    number: int
    """Counts the updates from 1; what is forgotten or undone does not count."""
    learner: Learner
    """The skill from now on; it is not changed in place."""
    coverage: float
    """Share of the plane that it covers."""
    cause: Cause = Cause.UPDATE
    """Why it is another one."""


class _Past(NamedTuple):
    learner: Learner
    coverage: float
    mastery: float
    undoes: str


class Skill:
    """The learner in use, and everything that is going to replace it.

    The learner in use is never changed in place: an update is learned by a copy, forgetting happens on a
    copy, and each replaces it in whole, so that undoing is to go back to the one before.

    Args:
        learner: What is known at the beginning.
        task: The plane.
        arbitration: Who is in control; asked how much of the plane the skill masters, where it knows doubt.
        w_th: Activation from which on a place of the plane counts as covered.
        samples_per_tick: Number of samples learned in a step.
        undo_steps: How many changes can be undone.
    """

    def __init__(
        self,
        learner: Learner,
        task: Task,
        arbitration: Arbitration,
        *,
        w_th: float,
        samples_per_tick: int,
        undo_steps: int,
    ) -> None:
        self.learner = learner
        self.coverage = 0.0
        """Share of the plane with an activation of at least w_th."""
        self.mastery = 0.0
        """Share of the plane where the skill would be in control; without doubt, the coverage."""
        self.updates = 0
        """Batches learned."""
        self._arbitration = arbitration
        self._w_th = w_th
        self._grid = task.grid(COVERAGE_GRID)
        self._coarse = [(x, y) for x, y in task.grid(MASTERY_GRID).tolist()]
        self._samples_per_tick = samples_per_tick
        self._batches: deque[Batch] = deque()
        self._batch: Batch | None = None
        self._pending: BackgroundUpdate[Learner] | None = None
        self._survey: _Survey | None = None
        self._past: deque[_Past] = deque(maxlen=undo_steps)

    @property
    def is_learning(self) -> bool:
        """Whether an update is being learned aside."""
        return self._batch is not None

    def learn(self, batch: Batch) -> None:
        """Learn a batch in the steps to come, after those before it."""
        self._batches.append(batch)

    def step(self) -> Update | None:
        """Learn a share of the pending update; a finished one replaces the skill in whole."""
        if self._batch is None:
            if not self._batches:
                return None
            self._begin(self._batches.popleft())
        if self._pending is not None:
            learned = self._pending.step()
            if learned is None:
                return None
            self._pending = None
            if self._arbitration.needs_std:
                self._survey = _Survey(learned, self._arbitration, self._w_th, self._grid, self._coarse)
                return None
        else:
            if self._survey is None or not self._survey.step():
                return None
            learned = self._survey.learner
        survey, self._batch, self._survey = self._survey, None, None
        self.updates += 1
        return self._swap(learned, Cause.UPDATE, survey, f"update {self.updates}")

    def forget(self, region: Region | None) -> tuple[Update | None, int]:
        """Remove the models of a region, and the samples there that are still to be learned.

        Args:
            region: The region; None for the whole plane.

        Returns:
            The change, None if there was no model to remove, and how many models were removed.
        """
        for index, batch in enumerate(self._batches):
            self._batches[index] = _outside(batch, region)
        restart = None if self._batch is None else _outside(self._batch, region)
        learner = self.learner.copy()
        if region is None:
            removed = learner.remove_box(*_EVERYWHERE)
        else:
            low = (region.x - region.radius, region.y - region.radius)
            high = (region.x + region.radius, region.y + region.radius)
            removed = learner.remove_box(low, high)
            removed += learner.remove_near((region.x, region.y), 0.99 * self._arbitration.w_free)
        change = self._swap(learner, Cause.FORGET, None, "forgetting") if removed else None
        if restart is not None:
            self._begin(restart)
        return change, removed

    def undo(self) -> tuple[Update, str] | None:
        """Go back to the skill before the last change.

        Returns:
            The change, and what was undone; None if there is nothing to undo. What is being learned is
            learned into the skill that is gone back to.
        """
        if not self._past:
            return None
        past = self._past.pop()
        self.learner, self.coverage, self.mastery = past.learner, past.coverage, past.mastery
        if self._batch is not None:
            self._begin(self._batch)
        return Update(self.updates, self.learner, self.coverage, Cause.UNDO), past.undoes

    def _begin(self, batch: Batch) -> None:
        self._batch, self._survey = batch, None
        self._pending = BackgroundUpdate(self.learner.copy(), *batch, self._samples_per_tick)

    def _swap(self, learner: Learner, cause: Cause, survey: "_Survey | None", undoes: str) -> Update:
        self._past.append(_Past(self.learner, self.coverage, self.mastery, undoes))
        self.learner = learner
        if survey is None:
            self.coverage = self.mastery = learner.share_active(self._grid, self._w_th)
        else:
            self.coverage, self.mastery = survey.coverage, survey.mastery
        return Update(self.updates, learner, self.coverage, cause)


class _Survey:
    """Asks at points of the plane, some in each tick, whether a model is there and the skill in control."""

    def __init__(
        self,
        learner: Learner,
        arbitration: Arbitration,
        w_th: float,
        grid: FloatArray,
        coarse: list[tuple[float, float]],
    ) -> None:
        self.learner = learner
        self._arbitration, self._w_th = arbitration, w_th
        self._grid, self._coarse = grid, coarse
        self._tick = self._covered = self._mastered = 0

    @property
    def coverage(self) -> float:
        return self._covered / len(self._grid)

    @property
    def mastery(self) -> float:
        return self._mastered / len(self._coarse)

    def step(self) -> bool:
        """Ask at the next points; True once all are done."""
        k, self._tick = self._tick, self._tick + 1
        part = self._grid[k * len(self._grid) // _TICKS : (k + 1) * len(self._grid) // _TICKS]
        self._covered += round(self.learner.share_active(part, self._w_th) * len(part))
        n = len(self._coarse)
        for x, y in self._coarse[k * n // _TICKS : (k + 1) * n // _TICKS]:
            y_robot, w_max, std = self.learner.query_std(x, y)
            self._mastered += self._arbitration.factor(Query(y_robot, w_max, std, x, y)) < 0.5
        return self._tick == _TICKS


def _outside(batch: Batch, region: Region | None) -> Batch:
    """The samples of a batch that are not in a region."""
    if region is None:
        return Batch(batch.X[:0], batch.Y[:0])
    keep = [not region.contains(x, y) for x, y in batch.X.tolist()]
    return Batch(batch.X[keep], batch.Y[keep])

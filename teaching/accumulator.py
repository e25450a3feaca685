"""The accumulation buffer of eqs. (10) and (11), and learning a batch without delaying a tick."""

from collections import deque
from collections.abc import Callable
from itertools import compress
from typing import Generic, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from hm_driver.errors import ConfigurationError
from teaching.learner import Learner

FloatArray = NDArray[np.float64]
Sample = tuple[float, ...]
L = TypeVar("L", bound=Learner)


class Batch(NamedTuple):
    """Samples to learn, in the order in which to learn them."""

    X: FloatArray
    """Inputs, shape (n, d)."""
    Y: FloatArray
    """Outputs, shape (n, m)."""


class Accumulator:
    """Collects the samples of which the human alone was in control, and gives them out shuffled.

    Eq. (10) read to the letter loses the sample that arrives when the buffer is full, and is silent on
    one that arrives with C < 1 then. Here the sample that fills the buffer also empties it, so that no
    sample meets a full buffer and none is lost. What is left at the end can be had by :meth:`flush`.

    With a hindsight, which is ours, a sample waits before it is collected: what he held just before he
    changed his mind is not what he wanted, and :meth:`retract` takes it back.

    Args:
        n_acc: Number of samples that are collected for an update, N_acc.
        downsample: Keep every how manieth of the collected samples, before they are shuffled; 1 keeps all.
        hindsight: How many samples may be retracted.
        rng: Random numbers for randperm of eq. (11).
        n_inputs: Number of inputs d.
        n_outputs: Number of outputs m.

    Raises:
        ConfigurationError: A number is out of range.
    """

    def __init__(
        self,
        n_acc: int = 1000,
        downsample: int = 1,
        *,
        hindsight: int = 0,
        rng: np.random.Generator,
        n_inputs: int = 2,
        n_outputs: int = 1,
    ) -> None:
        for name, value, high in (("n_acc", n_acc, 10_000_000), ("downsample", downsample, n_acc)):
            if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= high:
                raise ConfigurationError(name, f"{value!r} must be a whole number from 1 to {high}")
        if isinstance(hindsight, bool) or not isinstance(hindsight, int) or not 0 <= hindsight <= 100_000:
            raise ConfigurationError("hindsight", f"{hindsight!r} must be a whole number from 0 to 100000")
        self.n_acc, self.downsample, self.hindsight = n_acc, downsample, hindsight
        self._waiting: deque[tuple[Sample, float | Sample]] = deque()
        self._rng = rng
        self._shape = n_inputs, n_outputs
        self._X: list[Sample] = []
        self._Y: list[float | Sample] = []

    @property
    def count(self) -> int:
        """Number of samples in the buffer; those that wait are not counted."""
        return len(self._X)

    def add(self, x: Sample, y: float | Sample, C: float = 1.0) -> Batch | None:
        """Collect a sample if C is exactly 1; returns the batch that it completes."""
        if C != 1.0:
            return None
        if self.hindsight:
            self._waiting.append((x, y))
            if len(self._waiting) <= self.hindsight:
                return None
            x, y = self._waiting.popleft()
        return self._collect(x, y)

    def retract(self) -> int:
        """Take back the samples that still wait, because of what came after them; returns how many."""
        retracted = len(self._waiting)
        self._waiting.clear()
        return retracted

    def confirm(self) -> Batch | None:
        """Collect the samples that still wait, as nothing speaks against them; returns a completed batch."""
        batch = None
        while self._waiting and batch is None:
            batch = self._collect(*self._waiting.popleft())
        return batch

    def flush(self, minimum: int = 1) -> Batch | None:
        """Give out what there is, or nothing and keep it if that is fewer than minimum samples."""
        if len(self._X) < max(1, minimum):
            return None
        n_inputs, n_outputs = self._shape
        X = np.array(self._X[:: self.downsample], dtype=float).reshape(-1, n_inputs)
        Y = np.array(self._Y[:: self.downsample], dtype=float).reshape(-1, n_outputs)
        order = self._rng.permutation(len(X))
        self._X, self._Y = [], []
        return Batch(X[order], Y[order])

    def discard(self, is_unwanted: Callable[[Sample], bool]) -> int:
        """Forget the samples whose input is unwanted, and all that wait; returns how many."""
        keep = [not is_unwanted(x) for x in self._X]
        discarded = len(keep) - sum(keep) + self.retract()
        self._X = list(compress(self._X, keep))
        self._Y = list(compress(self._Y, keep))
        return discarded

    def clear(self) -> None:
        """Forget what was collected."""
        self._X, self._Y = [], []
        self._waiting.clear()

    def _collect(self, x: Sample, y: float | Sample) -> Batch | None:
        self._X.append(x)
        self._Y.append(y)
        return self.flush() if len(self._X) == self.n_acc else None


class BackgroundUpdate(Generic[L]):
    """Learns a batch aside, a few samples a tick, and gives out the finished learner in whole.

    Deterministic and without threads: the session goes on with the old learner until :meth:`step`
    returns the new one. What the learner learns does not depend on samples_per_tick,
    but for one that takes several samples at a time, as :class:`teaching.rehearsal.RehearsingLWR` does.

    Args:
        learner: A copy that nobody else uses; it is updated and given out.
        X: Inputs, shape (n, d).
        Y: Outputs, shape (n, m).
        samples_per_tick: Number of samples learned in a step.
    """

    def __init__(self, learner: L, X: FloatArray, Y: FloatArray, samples_per_tick: int = 50) -> None:
        if samples_per_tick < 1:
            raise ConfigurationError("samples_per_tick", f"{samples_per_tick} must be at least 1")
        self._learner, self._X, self._Y = learner, X, Y
        self._samples_per_tick = samples_per_tick
        self._done = 0

    @property
    def remaining(self) -> int:
        """Number of samples still to learn."""
        return len(self._X) - self._done

    def step(self) -> L | None:
        """Learn the next samples; returns the learner once all are learned."""
        end = min(self._done + self._samples_per_tick, len(self._X))
        if end > self._done:
            self._learner.partial_fit(self._X[self._done : end], self._Y[self._done : end])
            self._done = end
        return self._learner if self._done == len(self._X) else None

    def finish(self) -> L:
        """Learn all that is left at once: for the end of a session, not for a tick."""
        while (learner := self.step()) is None:
            pass
        return learner

"""Gradual arbitrations, in the spirit of the two methods that the paper compares itself to.

The formulas of their sources are not public: what is here is **ours in their spirit**. With both, human
and skill act at once for long. While a spring drags the handle, the difference between the two commands
shrinks by itself; the human's command is therefore taken from a handle that is left free (the *uncoupled*
variant, ``session.coupling = "uncoupled"``), or is the session's estimate of his intention where the handle
is coupled.
"""

import math
from collections.abc import Callable
from typing import Final

from hm_driver.errors import ConfigurationError
from teaching.arbitration.contract import Arbitration, Observation, Query
from teaching.arbitration.existence import ExistenceArbitration, control_factor

Success = Callable[[Observation], float]
"""How well the task was done in a tick, from 0 to 1: defined by the user, for his task."""

_SMALL: Final = 1e-9
_ENOUGH: Final = 0.25
"""Weight of the observed cells about a place that is enough: one cell's at its own corner."""


class ErrorArbitration(Arbitration):
    """The human's share falls with the average error of prediction: ours, in the spirit of [7].

    Peternel et al. (2014), reference [7] of the paper, shift control by "the average error between the human
    generated motor output and LWR output" over the whole state space up to now; map, window and normalisation
    are not public. Here C = clip((r - done) / (alone - done), 0, 1), with r the average of |y_demo - y_robot|
    by that of |y_demo|, both over a fading memory. C is one number for the whole plane. The human has to act
    all the time.

    Args:
        alone: Relative error r from which on the human is alone in control.
        done: Relative error r up to which the skill is.
        memory: Time constant of the averages [s]; infinite for all that there has been.
        w_th: Activation from which a spot counts as covered; it decides nothing here but when teaching ends.

    Raises:
        ConfigurationError: An argument is out of range.
    """

    def __init__(
        self, alone: float = 0.5, done: float = 0.1, memory: float = 10.0, *, w_th: float = 0.5
    ) -> None:
        if not 0.0 <= done < alone <= 100.0:
            raise ConfigurationError("alone", f"{alone:g} must be above done = {done:g} and at most 100")
        if not memory > 0.0:
            raise ConfigurationError("memory", f"{memory:g} s must be above 0 s")
        ExistenceArbitration(w_th, 0.0)
        self.alone, self.done, self.memory = alone, done, memory
        self._w_th = w_th
        self._error = self._size = 0.0
        self.reset()

    @property
    def w_th(self) -> float:
        """Activation from which a spot counts as covered by a model."""
        return self._w_th

    @property
    def is_stateful(self) -> bool:
        """It is: it keeps two averages."""
        return True

    @property
    def is_gradual(self) -> bool:
        """It is."""
        return True

    @property
    def error(self) -> float:
        """Relative error r; infinite before the first observation."""
        return self._error / self._size if self._size > 0.0 else math.inf

    def factor(self, query: Query) -> float:  # noqa: ARG002  # the same everywhere
        """Control factor C, the same wherever the manipulator is."""
        return min(1.0, max(0.0, (self.error - self.done) / (self.alone - self.done)))

    def observe(self, observation: Observation) -> None:
        """Take a demonstrated tick into the averages, at any C."""
        error = abs(observation.y_demo - observation.y_robot)
        if not observation.is_demonstrating or not math.isfinite(error):
            return
        keep = math.exp(-observation.dt / self.memory)
        self._error = keep * self._error + observation.dt * error
        self._size = keep * self._size + observation.dt * max(abs(observation.y_demo), _SMALL)

    def forget(self, x: float, y: float, radius: float) -> None:  # noqa: ARG002  # one number for all places
        """Think nothing of the skill any more: there is one average for the whole plane."""
        self.reset()

    def reset(self) -> None:
        """Forget the averages: the human is alone in control."""
        self._error = self._size = 0.0


class SuccessArbitration(Arbitration):
    """The human's share falls where the task has been done well: ours, in the spirit of [24].

    Reference [24] of the paper uses "a local success measure of the task execution"; its formula is not
    public. Here each cell of the plane keeps a fading average s of a success between 0 and 1 that the user
    defines; C(x) = clip((high - s(x)) / (high - low), 0, 1), with s interpolated between the middles of four
    cells, and at least eq. (9): where nothing is learned, no success gives the skill a share.

    Args:
        success: Success of a tick; what it needs to know of the task is the method's price.
        low: Success up to which the human is alone in control.
        high: Success from which on the skill is.
        memory: Time constant of a cell's average [s], counted while in the cell.
        cell: Edge of a cell [m].
        w_th: Threshold of eq. (9).
        d: Width of eq. (9).

    Raises:
        ConfigurationError: An argument is out of range.
    """

    def __init__(
        self,
        success: Success,
        *,
        low: float = 0.5,
        high: float = 0.9,
        memory: float = 0.3,
        cell: float = 0.04,
        w_th: float = 0.5,
        d: float = 0.05,
    ) -> None:
        if not 0.0 <= low < high < 1.0:
            raise ConfigurationError("high", f"{high:g} must be above low = {low:g} and below 1")
        if not memory > 0.0:
            raise ConfigurationError("memory", f"{memory:g} s must be above 0 s")
        if not 1e-3 <= cell <= 10.0:
            raise ConfigurationError("cell", f"{cell:g} m must be 0.001 to 10 m")
        self._existence = ExistenceArbitration(w_th, d)
        self.success, self.low, self.high, self.memory, self.cell = success, low, high, memory, cell
        self._cells: dict[tuple[int, int], float] = {}

    @property
    def w_th(self) -> float:
        """Activation from which a spot counts as covered by a model."""
        return self._existence.w_th

    @property
    def w_free(self) -> float:
        """Activation below which eq. (9) is 1."""
        return self._existence.w_free

    @property
    def is_stateful(self) -> bool:
        """It is: each cell keeps an average."""
        return True

    @property
    def is_gradual(self) -> bool:
        """It is."""
        return True

    def local_success(self, x: float, y: float) -> float:
        """Success s at a place [m], interpolated between observed cells; 0 where there is none."""
        if not (abs(x) < 1e6 and abs(y) < 1e6):
            return 0.0
        a, b = x / self.cell - 0.5, y / self.cell - 0.5
        i, j = math.floor(a), math.floor(b)
        a, b = a - i, b - j
        total = weight = 0.0
        for di, u in ((0, 1.0 - a), (1, a)):
            for dj, v in ((0, 1.0 - b), (1, b)):
                s = self._cells.get((i + di, j + dj))
                if s is not None:
                    total += u * v * s
                    weight += u * v
        return total / max(weight, _ENOUGH)

    def factor(self, query: Query) -> float:
        """Control factor C of the place, at least that of eq. (9)."""
        missing = (self.high - self.local_success(query.x, query.y)) / (self.high - self.low)
        existence = control_factor(query.w_max, w_th=self._existence.w_th, d=self._existence.d)
        return max(existence, min(1.0, max(0.0, missing)))

    def observe(self, observation: Observation) -> None:
        """Take the success of a tick into the average of its cell, whoever was in control.

        Raises:
            ValueError: The success is not between 0 and 1.
        """
        success = self.success(observation)
        if not 0.0 <= success <= 1.0:
            raise ValueError(f"success gave {success!r} for {observation}; it must be between 0 and 1")
        key = math.floor(observation.x / self.cell), math.floor(observation.y / self.cell)
        before = self._cells.get(key, 0.0)
        self._cells[key] = before + (1.0 - math.exp(-observation.dt / self.memory)) * (success - before)

    def forget(self, x: float, y: float, radius: float) -> None:
        """Forget the cells that a circle meets, and those that are interpolated with them."""
        for key in list(self._cells):
            i, j = key
            dx = max(0.0, abs((i + 0.5) * self.cell - x) - 1.5 * self.cell)
            dy = max(0.0, abs((j + 0.5) * self.cell - y) - 1.5 * self.cell)
            if dx * dx + dy * dy <= radius * radius:
                del self._cells[key]

    def reset(self) -> None:
        """Forget every cell: the human is alone in control."""
        self._cells.clear()


def force_success(reference: float, tolerance: float) -> Success:
    """Success at holding a force: 1 within a tolerance of the reference, falling to 0 at twice of it.

    Args:
        reference: Force that the task asks for [N].
        tolerance: Deviation that is a full success [N].
    """

    def success(observation: Observation) -> float:
        return min(1.0, max(0.0, 2.0 - abs(observation.force - reference) / tolerance))

    return success

"""Who moved the arm: the work of the hand, of the springs and of the bias force, and what is left of it."""

from dataclasses import dataclass

import numpy as np

from tools.log.cycles import Cycles, FloatArray

SOURCES = ("hand", "position springs", "assist", "bias force")
"""Who does work on the virtual mass."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Energy:
    """Works over a log; the virtual mass takes them all."""

    time_s: FloatArray
    """Shape (n,) [s]."""
    work: FloatArray
    """Work of each of `SOURCES` up to that time, shape (n, 4) [J]."""
    kinetic: FloatArray | None
    """Of the virtual mass, over its beginning, shape (n,) [J]; None where the mass is not known."""

    @property
    def dissipated(self) -> float | None:
        """What neither moves the arm nor came back: damping, friction, and objects of the device [J].

        Negative where energy was made: the rendering was not passive.
        """
        if self.kinetic is None or not len(self.time_s):
            return None
        return float(self.work[-1].sum() - self.kinetic[-1])


class EnergyBalance:
    """Takes in cycles, and adds up the works.

    Args:
        mass: Virtual mass [kg]; None where it is not known.
        is_bias_a_spring: Whether the loop renders the position springs as a bias force; they are not counted
            twice.
    """

    def __init__(self, mass: float | None, *, is_bias_a_spring: bool = False) -> None:
        self._mass = mass
        self._is_bias_a_spring = is_bias_a_spring
        self._work = np.zeros(len(SOURCES))
        self._first: float | None = None
        self._pieces: list[tuple[FloatArray, FloatArray, FloatArray]] = []

    def add(self, cycles: Cycles, every: int = 100) -> None:
        """Take in cycles without a gap; one of so many goes into the course."""
        if len(cycles.time_s) < 2:
            return
        period = float(np.median(np.diff(cycles.time_s)))
        v = cycles.velocity
        bias = (cycles.bias_force * v).sum(axis=1)
        powers = np.column_stack(
            (
                (cycles.force * v).sum(axis=1),
                (cycles.spring_force * v).sum(axis=1),
                cycles.assist_force * v[:, 2],
                np.zeros(len(bias)) if self._is_bias_a_spring else bias,
            )
        )
        powers = np.where(np.isfinite(powers), powers, 0.0)
        steps = 0.5 * period * (powers[1:] + powers[:-1])
        work = self._work + np.concatenate((np.zeros((1, len(SOURCES))), np.cumsum(steps, axis=0)))
        speed2 = (v * v).sum(axis=1)
        self._first = float(speed2[0]) if self._first is None else self._first
        self._work = work[-1]
        picked = np.unique(np.concatenate((np.arange(0, len(work), every), [len(work) - 1])))
        self._pieces.append((cycles.time_s[picked], work[picked], speed2[picked] - self._first))

    def energy(self) -> Energy:
        """The works so far."""
        if not self._pieces:
            return Energy(time_s=np.empty(0), work=np.empty((0, len(SOURCES))), kinetic=None)
        time_s, work, speed2 = (np.concatenate(parts) for parts in zip(*self._pieces, strict=True))
        kinetic = None if self._mass is None else 0.5 * self._mass * speed2
        return Energy(time_s=time_s, work=work, kinetic=kinetic)

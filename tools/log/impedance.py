"""What the hand felt: stiffness, damping and mass, by least squares on the motion while a spring was engaged.

With x the handle, r the reference of the spring, f the hand's force, b the bias force and m the virtual mass

    f + b - m x'' = K (x - r) + B (x' - r') + c

where c takes the force sensor's offset. What a cycle commands acts on what the next one measures. All terms
go through the same moving average, which leaves the relation as it is and takes the noise. In free motion,
K is nothing and m is estimated. The intervals are those of the jackknife over pieces of a second, as
samples that follow each other are not independent.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from tools.log.cycles import AXES, Cycles, FloatArray

SMOOTHING_S = 0.015
"""Length of the moving average [s]."""
SETTLING_S = 0.1
"""Time after a spring was engaged during which its largest force still grows [s]."""
SHORTEST_S = 0.25
"""Shortest segment that is used [s]."""
PIECE_S = 1.0
"""Pieces of the jackknife [s]."""
FEWEST_PIECES = 4
"""Below so many pieces nothing is estimated."""
_SATURATED = 0.98
_POINTS = 2000


class Estimate(NamedTuple):
    """A value, and half the width of its 95 % interval."""

    value: float
    half: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Rendered:
    """What was rendered along an axis."""

    kind: str
    """``position spring``, ``assist`` or ``free``."""
    axis: str
    time_s: float
    """Time of the segments that were used [s]."""
    stiffness: Estimate | None
    """[N/m]; None in free motion."""
    damping: Estimate
    """[N s/m]."""
    mass: Estimate | None
    """[kg]; None where it was taken from the configuration."""
    r2: float
    """Share of the force's variance that these explain."""
    asked_stiffness: float | None
    """By the configuration [N/m]; None where that is not known."""
    asked_damping: float | None
    """By the configuration [N s/m]."""
    deflection: FloatArray
    """Samples of x - r, shape (k,) [m]."""
    restoring: FloatArray
    """What of the force goes with it, the damping's share taken off, shape (k,) [N]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Asked:
    """What the configuration in the log asks for; None for what it does not say."""

    mass: float | None = None
    position_stiffness: float | None = None
    position_damping: float | None = None
    position_force_max: float = math.inf
    assist_stiffness: float | None = None
    assist_damping: float | None = None
    assist_force_max: float = math.inf
    is_bias_a_spring: bool = False
    """Whether the loop renders the position springs as a bias force, which then is no force of its own."""


@dataclass(slots=True)
class _Sums:
    """Sums of least squares, a piece of the jackknife each."""

    gram: list[FloatArray] = field(default_factory=list)
    right: list[FloatArray] = field(default_factory=list)
    squares: list[tuple[float, float, int]] = field(default_factory=list)
    samples: list[FloatArray] = field(default_factory=list)
    time_s: float = 0.0


class Impedance:
    """Takes in cycles and estimates what was rendered along each axis.

    Args:
        asked: What the configuration asks for.
    """

    def __init__(self, asked: Asked) -> None:
        self._asked = asked
        self._sums: dict[tuple[str, int], _Sums] = {}

    def add(self, cycles: Cycles) -> None:
        """Take in cycles without a gap."""
        if len(cycles.time_s) < 4:
            return
        period = float(np.median(np.diff(cycles.time_s)))
        cycles = replace(
            cycles.part(1, len(cycles.time_s)),
            reference=cycles.reference[:-1],
            reference_velocity=cycles.reference_velocity[:-1],
            assist_reference=cycles.assist_reference[:-1],
        )
        for axis in range(len(AXES)):
            for kind, chosen in self._kinds(cycles, axis):
                for first, last in _segments(chosen, round(SETTLING_S / period) if kind != "free" else 0):
                    if (last - first) * period >= SHORTEST_S:
                        self._add(kind, axis, cycles.part(first, last), period)

    def results(self) -> list[Rendered]:
        """What was rendered, for the springs and axes with enough motion to tell."""
        found = []
        for (kind, axis), sums in sorted(self._sums.items(), key=lambda one: (_ORDER[one[0][0]], one[0][1])):
            if len(sums.gram) >= FEWEST_PIECES:
                one = self._result(kind, axis, sums)
                if one is not None:
                    found.append(one)
        return found

    def _kinds(self, cycles: Cycles, axis: int) -> Iterator[tuple[str, np.ndarray]]:
        phase, asked = cycles.phase[:, axis], self._asked
        within = np.abs(cycles.spring_force[:, axis]) < _SATURATED * asked.position_force_max
        yield "position spring", (phase == 1.0) & within
        is_assisted = (cycles.assist_force != 0.0) if axis == 2 else np.zeros(len(phase), dtype=bool)
        if axis == 2:
            within = np.abs(cycles.assist_force) < _SATURATED * asked.assist_force_max
            yield "assist", (phase == 0.0) & is_assisted & within
        yield "free", (phase == 0.0) & ~is_assisted

    def _add(self, kind: str, axis: int, cycles: Cycles, period: float) -> None:
        width = max(1, round(SMOOTHING_S / period))
        velocity = cycles.velocity[:, axis]
        acceleration = np.gradient(velocity, period)
        force = cycles.force[:, axis]
        if not self._asked.is_bias_a_spring:
            force = force + cycles.bias_force[:, axis]
        if kind == "free":
            terms = [velocity, np.ones(len(velocity)), acceleration]
        else:
            rest, speed = cycles.reference[:, axis], cycles.reference_velocity[:, axis]
            if kind == "assist":
                rest, speed = cycles.assist_reference, np.gradient(cycles.assist_reference, period)
            terms = [velocity - speed, np.ones(len(velocity)), cycles.position[:, axis] - rest]
            if self._asked.mass is None:
                terms.append(acceleration)
            else:
                force = force - self._asked.mass * acceleration
        smooth = [
            np.convolve(one, np.full(width, 1.0 / width), "valid")[:: max(1, width // 2)]
            for one in (*terms, force)
        ]
        rows, right = np.column_stack(smooth[:-1]), smooth[-1]
        if not np.isfinite(rows).all() or not np.isfinite(right).all():
            return
        sums = self._sums.setdefault((kind, axis), _Sums())
        sums.time_s += len(force) * period
        size = max(1, round(PIECE_S / (period * max(1, width // 2))))
        for first in range(0, len(right), size):
            X, y = rows[first : first + size], right[first : first + size]
            sums.gram.append(X.T @ X)
            sums.right.append(X.T @ y)
            sums.squares.append((float(y @ y), float(y.sum()), len(y)))
            if kind != "free" and len(sums.samples) < _POINTS // 10:
                sums.samples.append(np.column_stack((X, y))[:: max(1, len(y) // 10)])

    def _result(self, kind: str, axis: int, sums: _Sums) -> Rendered | None:
        gram, right = np.array(sums.gram), np.array(sums.right)
        scale = np.sqrt(np.maximum(np.diagonal(gram.sum(axis=0)), 1e-300))
        scaled = gram.sum(axis=0) / np.outer(scale, scale)
        if np.linalg.cond(scaled) > 1e10:
            return None
        solution = np.linalg.solve(scaled, right.sum(axis=0) / scale) / scale
        halves = _jackknife(gram, right, scale)
        of = [Estimate(float(value), float(half)) for value, half in zip(solution, halves, strict=True)]
        squares, total, n = (sum(one[place] for one in sums.squares) for place in range(3))
        residue = squares - float(solution @ right.sum(axis=0))
        spread = squares - total * total / n
        is_free, samples = kind == "free", np.concatenate(sums.samples or [np.empty((0, len(solution) + 1))])
        asked_K, asked_B = self._wanted(kind)
        return Rendered(
            kind=kind,
            axis=AXES[axis],
            time_s=sums.time_s,
            stiffness=None if is_free else of[2],
            damping=of[0],
            mass=of[2] if is_free else of[3] if len(of) > 3 else None,
            r2=1.0 - residue / spread if spread > 0.0 else math.nan,
            asked_stiffness=asked_K,
            asked_damping=asked_B,
            deflection=samples[:, 2],
            restoring=samples[:, -1] - samples[:, [0, 1]] @ solution[:2] - samples[:, 3:-1] @ solution[3:],
        )

    def _wanted(self, kind: str) -> tuple[float | None, float | None]:
        asked = self._asked
        if kind == "position spring":
            return asked.position_stiffness, asked.position_damping
        return (asked.assist_stiffness, asked.assist_damping) if kind == "assist" else (None, None)


_ORDER = {"position spring": 0, "assist": 1, "free": 2}


def _segments(chosen: np.ndarray, settling: int) -> Iterator[tuple[int, int]]:
    """First and end of each run of chosen cycles, those in which a spring settles left out."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], chosen, [False])).astype(np.int8)))
    for first, last in edges.reshape(-1, 2).tolist():
        begin = first + settling if first else first
        if begin < last:
            yield begin, last


def _jackknife(gram: FloatArray, right: FloatArray, scale: FloatArray) -> FloatArray:
    """Half the widths of the 95 % intervals: how the solution changes where a piece is left out."""
    n = len(gram)
    left = (gram.sum(axis=0) - gram) / np.outer(scale, scale)
    left += 1e-12 * np.eye(len(scale))
    solutions = np.linalg.solve(left, ((right.sum(axis=0) - right) / scale)[..., None])[..., 0] / scale
    spread: FloatArray = np.sqrt((n - 1) / n * ((solutions - solutions.mean(axis=0)) ** 2).sum(axis=0))
    return 1.96 * spread

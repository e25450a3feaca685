"""Where the arm shall be at which time: straight moves, and paths through given points."""

import bisect
import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol, Self

from hm_driver.errors import ConfigurationError

Vector = tuple[float, float, float]

_FEWEST_STEPS = 4
_PEAK_SPEED = 1.875
"""Largest speed of the quintic step of unit length and duration."""
_PEAK_ACCELERATION = 10.0 / math.sqrt(3.0)
"""Its largest acceleration."""


class Point(NamedTuple):
    """A trajectory at one time."""

    position: Vector
    """[m]."""
    velocity: Vector
    """[m/s]."""


class _Axis(NamedTuple):
    """One axis at one time."""

    value: float
    slope: float


class Trajectory(Protocol):
    """A motion in time; begins at 0 s."""

    @property
    def duration_s(self) -> float:
        """When it ends [s]."""
        ...

    def at(self, time_s: float) -> Point:
        """The point at a time [s]; before the start the first one, behind the end the last one."""
        ...

    def sample_times(self) -> Sequence[float]:
        """Times [s] that are near enough for a check to miss nothing in between."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class StraightMove:
    """A straight line from rest to rest, by the quintic step of least jerk.

    >>> StraightMove.within((0, 0, 0), (0.1, 0, 0), speed=0.1, acceleration=0.5).duration_s
    1.875
    """

    start: Vector
    """[m]."""
    goal: Vector
    """[m]."""
    duration_s: float
    """[s]."""

    @classmethod
    def within(cls, start: Vector, goal: Vector, *, speed: float, acceleration: float) -> Self:
        """The shortest move that exceeds neither the speed [m/s] nor the acceleration [m/s^2]."""
        length = math.dist(start, goal)
        duration = max(_PEAK_SPEED * length / speed, math.sqrt(_PEAK_ACCELERATION * length / acceleration))
        return cls(start=start, goal=goal, duration_s=duration)

    def sample_times(self) -> Sequence[float]:
        """Times [s], every 2 mm or nearer."""
        count = max(50, math.ceil(2.0 * _PEAK_SPEED * math.dist(self.start, self.goal) / 0.002))
        return [self.duration_s * i / count for i in range(count + 1)]

    def slowed(self, factor: float) -> Self:
        """The same line in `factor` times the time."""
        return type(self)(start=self.start, goal=self.goal, duration_s=self.duration_s * factor)

    def at(self, time_s: float) -> Point:
        """The point at a time [s]."""
        if time_s >= self.duration_s:
            return Point(self.goal, (0.0, 0.0, 0.0))
        share = max(0.0, time_s) / self.duration_s
        way = share**3 * (10.0 + share * (6.0 * share - 15.0))
        rate = 30.0 * share**2 * (1.0 - share) ** 2 / self.duration_s
        x, y, z = (
            _Axis(a + way * (b - a), rate * (b - a)) for a, b in zip(self.start, self.goal, strict=True)
        )
        return Point((x.value, y.value, z.value), (x.slope, y.slope, z.slope))


class PathThrough:
    """A path through points at given times, cubic in between; speed and position are continuous.

    Args:
        times_s: Times of the points [s], rising; the first is taken for 0 s.
        positions: The points [m].
        velocities: The velocity at each point [m/s]; None lets the path run smoothly through them, from rest
            to rest.

    Raises:
        ConfigurationError: Fewer than two points, or times that do not rise.
    """

    def __init__(
        self,
        times_s: Sequence[float],
        positions: Sequence[Vector],
        velocities: Sequence[Vector] | None = None,
    ) -> None:
        if len(times_s) < 2:
            raise ConfigurationError("trajectory", f"has {len(times_s)} points; two are the least")
        if any(later <= earlier for earlier, later in itertools.pairwise(times_s)):
            raise ConfigurationError("trajectory", "its times do not rise")
        self.times_s = tuple(time_s - times_s[0] for time_s in times_s)
        """Times of the points from the start [s]."""
        self.positions = tuple(positions)
        """The points [m]."""
        given = _smooth_velocities(self.times_s, self.positions) if velocities is None else velocities
        self.velocities = tuple(given)
        """Velocity at each point [m/s]."""

    @property
    def duration_s(self) -> float:
        """When the path ends [s]."""
        return self.times_s[-1]

    def sample_times(self) -> Sequence[float]:
        """Times [s]: every point, and some between it and the next, every 5 mm or nearer."""
        times = []
        for index in range(len(self.times_s) - 1):
            start, span = self.times_s[index], self.times_s[index + 1] - self.times_s[index]
            reach = math.dist(self.positions[index], self.positions[index + 1])
            count = max(_FEWEST_STEPS, math.ceil(reach / 0.005))
            times += [start + span * i / count for i in range(count)]
        return [*times, self.duration_s]

    def at(self, time_s: float) -> Point:
        """The point at a time [s]."""
        if time_s <= 0.0:
            return Point(self.positions[0], self.velocities[0])
        if time_s >= self.duration_s:
            return Point(self.positions[-1], (0.0, 0.0, 0.0))
        index = bisect.bisect_right(self.times_s, time_s) - 1
        span = self.times_s[index + 1] - self.times_s[index]
        share = (time_s - self.times_s[index]) / span
        x, y, z = (
            _hermite(
                self.positions[index][axis],
                self.positions[index + 1][axis],
                self.velocities[index][axis] * span,
                self.velocities[index + 1][axis] * span,
                share,
                span,
            )
            for axis in range(3)
        )
        return Point((x.value, y.value, z.value), (x.slope, y.slope, z.slope))


def _hermite(start: float, end: float, out: float, into: float, share: float, span: float) -> _Axis:
    """Cubic between two values with given slopes, all per unit of the span [s] but the result's slope."""
    gap = end - start
    curve = (out + into - 2.0 * gap) * share
    value = start + share * (out + share * (3.0 * gap - 2.0 * out - into + curve))
    slope = out + share * (2.0 * (3.0 * gap - 2.0 * out - into) + 3.0 * curve)
    return _Axis(value, slope / span)


def _smooth_velocities(times_s: Sequence[float], positions: Sequence[Vector]) -> list[Vector]:
    """Velocity of the parabola through each point and its two neighbours; at rest at both ends."""
    rest = (0.0, 0.0, 0.0)
    velocities: list[Vector] = [rest]
    for index in range(1, len(times_s) - 1):
        before = times_s[index] - times_s[index - 1]
        behind = times_s[index + 1] - times_s[index]
        x, y, z = (
            (
                behind * (positions[index][axis] - positions[index - 1][axis]) / before
                + before * (positions[index + 1][axis] - positions[index][axis]) / behind
            )
            / (before + behind)
            for axis in range(3)
        )
        velocities.append((x, y, z))
    return [*velocities, rest]

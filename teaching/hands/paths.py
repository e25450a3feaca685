"""Paths over the plane: raster lines and a point that walks along them."""

import math
from collections import deque
from collections.abc import Iterable
from typing import NamedTuple

Point = tuple[float, float]


class Area(NamedTuple):
    """An axis-aligned rectangle on the plane, as one sees it [m]."""

    x_min: float
    x_max: float
    y_min: float
    y_max: float

    @property
    def centre(self) -> Point:
        """Middle of the area [m]."""
        return (self.x_min + self.x_max) / 2.0, (self.y_min + self.y_max) / 2.0

    def contains(self, x: float, y: float) -> bool:
        """Whether a point lies in the area."""
        return self.x_min <= x <= self.x_max and self.y_min <= y <= self.y_max


def raster(area: Area, spacing: float, margin: float, *, along_x: bool = True, start: Point) -> list[Point]:
    """Boustrophedon lines over an area, from the corner nearest to the start.

    Args:
        area: What to cover.
        spacing: Largest distance of two lines [m]; they are spread evenly.
        margin: Distance of the outermost lines and of the turns from the area's edge [m];
            in an area that is narrower than two of it the lines run through the middle.
        along_x: Whether the lines run along x.
        start: Where one comes from [m].

    Returns:
        Way points [m].
    """
    margin_x = min(margin, 0.5 * (area.x_max - area.x_min))
    margin_y = min(margin, 0.5 * (area.y_max - area.y_min))
    x0, x1 = area.x_min + margin_x, area.x_max - margin_x
    y0, y1 = area.y_min + margin_y, area.y_max - margin_y
    if abs(start[0] - x1) < abs(start[0] - x0):
        x0, x1 = x1, x0
    if abs(start[1] - y1) < abs(start[1] - y0):
        y0, y1 = y1, y0
    length, width = (x1 - x0, y1 - y0) if along_x else (y1 - y0, x1 - x0)
    n = max(1, math.ceil(abs(width) / spacing - 1e-9))
    points: list[Point] = []
    for i in range(n + 1):
        across = width * i / n
        ends = (0.0, length) if i % 2 == 0 else (length, 0.0)
        points += [(x0 + end, y0 + across) if along_x else (x0 + across, y0 + end) for end in ends]
    return points


class Walker:
    """A point that walks along way points.

    Args:
        position: Where it starts [m].
        speed: Its speed [m/s].
        acceleration: At which it starts and brakes, coming nearly to rest at each way point [m/s^2];
            without it the point turns at full speed.
    """

    def __init__(self, position: Point, speed: float, acceleration: float = math.inf) -> None:
        self.position = position
        self.velocity: Point = (0.0, 0.0)
        self._speed_max = speed
        self._speed = 0.0
        self._acceleration = acceleration
        self._points: deque[Point] = deque()

    @property
    def is_done(self) -> bool:
        """Whether no way point is left."""
        return not self._points

    @property
    def way_points_left(self) -> int:
        """How many way points are left."""
        return len(self._points)

    @property
    def way_points(self) -> list[Point]:
        """The way points that are left [m]."""
        return list(self._points)

    def go(self, points: Iterable[Point]) -> None:
        """Forget the path and take this one."""
        self._points = deque(points)

    def step(self, dt: float, *, moving: bool = True) -> Point:
        """Walk for a time [s], or stand still, and return the position [m]."""
        x, y = x_old, y_old = self.position
        left = self._pace(dt) * dt if moving else 0.0
        while left > 0.0 and self._points:
            px, py = self._points[0]
            distance = math.sqrt((px - x) ** 2 + (py - y) ** 2)
            if distance <= left:
                x, y = self._points.popleft()
                left = left - distance if math.isinf(self._acceleration) else 0.0
            else:
                x += (px - x) * left / distance
                y += (py - y) * left / distance
                left = 0.0
        self.position = (x, y)
        self.velocity = ((x - x_old) / dt, (y - y_old) / dt) if dt > 0.0 else (0.0, 0.0)
        return self.position

    def _pace(self, dt: float) -> float:
        """Speed of this step [m/s]."""
        if not self._points:
            self._speed = 0.0
        elif math.isinf(self._acceleration):
            self._speed = self._speed_max
        else:
            x, y = self.position
            px, py = self._points[0]
            gap = math.sqrt((px - x) ** 2 + (py - y) ** 2)
            brake = math.sqrt(2.0 * self._acceleration * gap)
            start = self._speed + self._acceleration * dt
            self._speed = max(min(self._speed_max, start, brake), self._acceleration * dt)
        return self._speed

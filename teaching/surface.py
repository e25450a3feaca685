"""A plane of objects with outlines, colours and stiffness: which object is where, and where two meet."""

import itertools
import math
import re
from dataclasses import dataclass, field
from typing import Final

from hm_driver.errors import ConfigurationError

Point = tuple[float, float]
Segment = tuple[Point, Point]

PALETTE: Final[dict[str, str]] = {
    "orange": "#e69f00",
    "sky blue": "#56b4e9",
    "green": "#009e73",
    "yellow": "#f0e442",
    "blue": "#0072b2",
    "vermilion": "#d55e00",
    "purple": "#cc79a7",
    "black": "#000000",
}
"""Colours by name that people with any colour vision tell apart (Okabe and Ito)."""

STIFFNESS_RANGE: Final = (1.0, 100_000.0)
"""Stiffness that an object may have [N/m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SurfaceObject:
    """One object: a closed outline in the manipulator's plane, with a stiffness.

    Raises:
        ConfigurationError: A value is out of range.
    """

    name: str
    """Name, for people."""
    outline: tuple[Point, ...]
    """Corners in order, either way around [m]."""
    stiffness: float
    """Stiffness in z at the middle of the outline's bounding box [N/m]."""
    gradient: Point = (0.0, 0.0)
    """Change of the stiffness with x and y [N/m per m]."""
    colour: str
    """Name of a colour of :data:`PALETTE`, or ``#rrggbb``."""
    hex: str = field(init=False)
    """The colour as ``#rrggbb``."""
    box: tuple[float, float, float, float] = field(init=False)
    """Bounding box x_min, y_min, x_max, y_max [m]."""
    is_rectangle: bool = field(init=False)
    """Whether the outline is its bounding box."""

    def __post_init__(self) -> None:
        code = PALETTE.get(self.colour, self.colour)
        if not re.fullmatch(r"#[0-9a-fA-F]{6}", code):
            raise ConfigurationError(
                "colour", f"{self.colour!r} is neither #rrggbb nor one of {', '.join(PALETTE)}"
            )
        if len(self.outline) < 3 or not all(math.isfinite(v) for point in self.outline for v in point):
            raise ConfigurationError("polygon", f"{self.outline} needs at least three finite corners")
        low, high = STIFFNESS_RANGE
        if not low <= self.stiffness <= high:
            raise ConfigurationError(
                "stiffness", f"{self.stiffness:g} N/m is outside {low:g} to {high:g} N/m"
            )
        xs, ys = [p[0] for p in self.outline], [p[1] for p in self.outline]
        box = (min(xs), min(ys), max(xs), max(ys))
        if area(self.outline) < 1e-6:
            raise ConfigurationError("polygon", f"{self.outline} encloses less than 1 square millimetre")
        corners = {(x, y) for x in (box[0], box[2]) for y in (box[1], box[3])}
        object.__setattr__(self, "hex", code.lower())
        object.__setattr__(self, "box", box)
        object.__setattr__(self, "is_rectangle", len(self.outline) == 4 and set(self.outline) == corners)

    def contains(self, x: float, y: float) -> bool:
        """Whether a point [m] is inside the outline; a rectangle's edges belong to it."""
        x_min, y_min, x_max, y_max = self.box
        if not (x_min <= x <= x_max and y_min <= y <= y_max):
            return False
        return self.is_rectangle or is_inside(self.outline, x, y)

    def stiffness_at(self, x: float, y: float) -> float:
        """Stiffness [N/m] at a point [m]."""
        gx, gy = self.gradient
        if gx == 0.0 and gy == 0.0:
            return self.stiffness
        x_min, y_min, x_max, y_max = self.box
        return self.stiffness + gx * (x - 0.5 * (x_min + x_max)) + gy * (y - 0.5 * (y_min + y_max))


def area(outline: tuple[Point, ...]) -> float:
    """Area [m^2] that an outline encloses."""
    total = 0.0
    for (ax, ay), (bx, by) in edges(outline):
        total += ax * by - bx * ay
    return 0.5 * abs(total)


def edges(outline: tuple[Point, ...]) -> list[Segment]:
    """The edges of an outline, the closing one last."""
    return list(zip(outline, (*outline[1:], outline[0]), strict=True))


def is_inside(outline: tuple[Point, ...], x: float, y: float) -> bool:
    """Whether a point is inside an outline, by the even-odd rule."""
    inside = False
    for (ax, ay), (bx, by) in edges(outline):
        if (ay > y) != (by > y) and x < ax + (bx - ax) * (y - ay) / (by - ay):
            inside = not inside
    return inside


def rotated(outline: tuple[Point, ...], angle: float) -> tuple[Point, ...]:
    """An outline turned about the origin by an angle [rad], from x towards y."""
    if angle == 0.0:
        return outline
    c, s = math.cos(angle), math.sin(angle)
    return tuple((c * x - s * y, s * x + c * y) for x, y in outline)


def topmost(objects: tuple[SurfaceObject, ...], x: float, y: float) -> int:
    """Index of the last object that contains a point, or -1: later objects lie on earlier ones."""
    for index in range(len(objects) - 1, -1, -1):
        if objects[index].contains(x, y):
            return index
    return -1


def distance(segment: Segment, x: float, y: float) -> float:
    """Distance [m] of a point from a segment."""
    (ax, ay), (bx, by) = segment
    dx, dy = bx - ax, by - ay
    t = ((x - ax) * dx + (y - ay) * dy) / (dx * dx + dy * dy)
    t = min(1.0, max(0.0, t))
    return math.hypot(x - ax - t * dx, y - ay - t * dy)


def borders(objects: tuple[SurfaceObject, ...], half: float) -> tuple[Segment, ...]:
    """Where two different objects meet within the plane |x|, |y| <= half [m].

    Every edge is cut where it meets another one or the plane's edge; a piece is a border if the objects on
    its two sides differ.
    """
    plane = ((-half, -half), (half, -half), (half, half), (-half, half))
    every = [edge for thing in objects for edge in edges(thing.outline)]
    found: dict[tuple[Point, ...], Segment] = {}
    for edge in every:
        for a, b in pieces(edge, every + edges(plane)):
            key = tuple(sorted((round(p[0], 9), round(p[1], 9)) for p in (a, b)))
            if key not in found and separates(objects, a, b, half):
                found[key] = (a, b)
    return tuple(found.values())


def pieces(edge: Segment, others: list[Segment]) -> list[Segment]:
    """An edge, cut wherever another one crosses or touches it."""
    (ax, ay), (bx, by) = edge
    dx, dy = bx - ax, by - ay
    length = math.hypot(dx, dy)
    if length == 0.0:
        return []
    cuts = {0.0, 1.0}
    for (cx, cy), (ex, ey) in others:
        for px, py in ((cx, cy), (ex, ey)):
            if abs((px - ax) * dy - (py - ay) * dx) <= 1e-9 * length:
                cuts.add(((px - ax) * dx + (py - ay) * dy) / (length * length))
        cross = dx * (ey - cy) - dy * (ex - cx)
        if abs(cross) > 1e-15:
            t = ((cx - ax) * (ey - cy) - (cy - ay) * (ex - cx)) / cross
            u = ((cx - ax) * dy - (cy - ay) * dx) / cross
            if 0.0 <= u <= 1.0:
                cuts.add(t)
    ordered = sorted(t for t in cuts if 0.0 <= t <= 1.0)
    return [
        ((ax + s * dx, ay + s * dy), (ax + t * dx, ay + t * dy))
        for s, t in itertools.pairwise(ordered)
        if (t - s) * length > 1e-7
    ]


def separates(objects: tuple[SurfaceObject, ...], a: Point, b: Point, half: float) -> bool:
    """Whether a piece of an edge lies within the plane and between two different objects."""
    x, y = 0.5 * (a[0] + b[0]), 0.5 * (a[1] + b[1])
    step = 1e-6 / math.hypot(b[0] - a[0], b[1] - a[1])
    nx, ny = -(b[1] - a[1]) * step, (b[0] - a[0]) * step
    if max(abs(x), abs(y)) >= half - 1e-6:
        return False
    return topmost(objects, x + nx, y + ny) != topmost(objects, x - nx, y - ny)

"""The task: a surface of unknown stiffness, the force to produce on it, and the handle's mapping.

Frames. The handle's is the device's: x towards the user, y to the right, z up, origin at the
workspace centre. The manipulator's has the same directions and its origin in the middle of the plane::

    manipulator = scale * (handle - offset)

The surface is at ``surface_z`` in the manipulator's z. The displacement that a skill predicts
is the depth of the commanded position z_r below the surface, positive downwards; the force is
K * depth, eq. (12), and 0 above the surface.
"""

import math
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from teaching.stiffness_array import StiffnessArray
from teaching.surface import Segment, SurfaceObject, borders, distance, topmost

FloatArray = NDArray[np.float64]
Vector = tuple[float, float, float]

DEPTH_MARGIN: Final = 1.2
"""The arm must reach this many times the depth that the softest spot needs."""
CLEARANCE: Final = 0.03
"""The arm must reach this far above the surface [m], to move about without contact."""


class Contact(NamedTuple):
    """The manipulator against the surface."""

    z_a: float
    """Actual height of the end effector, which the surface holds up [m]."""
    depth: float
    """Depth of the commanded position below the surface, at least 0 [m]."""
    force: float
    """Interaction force of eq. (12), positive while pressing [N]."""
    stiffness: float
    """Stiffness of the object there [N/m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Task:
    """A plane of objects, the reference force, and the mapping between handle and manipulator.

    Beyond the plane's edge the stiffness of its nearest point goes on, so that a hand that overshoots does
    not fall off, but there is no object there. Where objects overlap the later one counts. With an array the
    objects are its regions, for people to name and to see, and the stiffness is the array's.

    Raises:
        ConfigurationError: A value is out of range, or a part of the plane has no object.
    """

    name: str
    """Short name."""
    objects: tuple[SurfaceObject, ...] = ()
    """The objects, in the order in which a demonstrator takes them; with an array, its regions."""
    array: StiffnessArray | None = None
    """Stiffness as an array, in place of objects."""
    description: str = ""
    """One sentence."""
    size: float = 0.4
    """Edge of the square plane, centred at the manipulator's origin [m]."""
    surface_z: float = 0.0
    """Height of the surface in the manipulator's frame [m]."""
    reference_force: float = 10.0
    """Force to produce [N]."""
    scale: Vector = (1.3, 1.3, 1.0)
    """Manipulator's movement by the handle's, per axis."""
    offset: Vector = (0.005, 0.0, 0.06)
    """Where the manipulator's origin is for the handle [m]."""
    depth_max: float = field(init=False)
    """Depth that the arm must reach: what the softest spot needs, with a margin [m]."""
    border_segments: tuple[Segment, ...] = field(init=False)
    """Where two objects meet, as segments [m]."""

    def __post_init__(self) -> None:
        check_range("plane.size", (self.size,), 0.01, 2.0, "m")
        check_range("plane.surface_z", (self.surface_z,), -1.0, 1.0, "m")
        check_range("reference.force", (self.reference_force,), 0.1, 100.0, "N")
        check_range("mapping.scale", self.scale, 0.1, 10.0, "")
        check_range("mapping.offset", self.offset, -1.0, 1.0, "m")
        half = 0.5 * self.size
        if self.array is not None:
            if self.objects:
                raise ConfigurationError("objects", "there is an array as well; give either of them")
            if not self.array.covers(half):
                raise ConfigurationError(
                    "array.extent", f"{list(self.array.extent)} m must reach {half:g} m to every side"
                )
            object.__setattr__(self, "objects", self.array.objects())
        elif not self.objects:
            raise ConfigurationError(
                "objects", "there is none; a task needs at least one object, or an array"
            )
        segments = borders(self.objects, half) if self.array is None else self.array.borders(half)
        object.__setattr__(self, "border_segments", segments)
        object.__setattr__(self, "depth_max", DEPTH_MARGIN * self.reference_force / self._softest())

    def _softest(self) -> float:
        """Smallest stiffness on the plane [N/m].

        Raises:
            ConfigurationError: A part of the plane has no object, or one that is softer than 1 N/m.
        """
        softest = math.inf
        for x, y in self.grid(40).tolist():
            index = self.object_at(x, y)
            if index < 0:
                raise ConfigurationError(
                    "objects", f"none lies at x = {x:g} m, y = {y:g} m; they must fill the plane"
                )
            stiffness = self.stiffness(x, y)
            if stiffness < 1.0:
                where = f"at x = {x:g} m, y = {y:g} m"
                raise ConfigurationError(
                    f"objects[{index}].gradient", f"makes {stiffness:g} N/m {where}; at least 1 N/m"
                )
            softest = min(softest, stiffness)
        return softest

    def to_manipulator(self, x: float, y: float, z: float) -> Vector:
        """Position of the manipulator [m] for a position of the handle [m]."""
        (sx, sy, sz), (ox, oy, oz) = self.scale, self.offset
        return sx * (x - ox), sy * (y - oy), sz * (z - oz)

    def to_handle(self, x: float, y: float, z: float) -> Vector:
        """Position of the handle [m] for a position of the manipulator [m]."""
        (sx, sy, sz), (ox, oy, oz) = self.scale, self.offset
        return x / sx + ox, y / sy + oy, z / sz + oz

    def handle_z(self, depth: float) -> float:
        """Height of the handle [m] for a depth of the manipulator below the surface [m]."""
        return (self.surface_z - depth) / self.scale[2] + self.offset[2]

    def depth(self, z: float) -> float:
        """Depth [m] of the manipulator below the surface for a height of the handle [m]; negative above."""
        return self.surface_z - self.scale[2] * (z - self.offset[2])

    def object_at(self, x: float, y: float) -> int:
        """Index of the object at a point [m], -1 beyond the plane's edge."""
        half = 0.5 * self.size
        if not (-half <= x <= half and -half <= y <= half):
            return -1
        return topmost(self.objects, x, y) if self.array is None else self.array.region_at(x, y)

    def stiffness(self, x: float, y: float) -> float:
        """Stiffness K(x, y) [N/m] at a point of the plane [m]."""
        half = 0.5 * self.size
        x, y = min(half, max(-half, x)), min(half, max(-half, y))
        if self.array is not None:
            return self.array.stiffness_at(x, y)
        return self.objects[topmost(self.objects, x, y)].stiffness_at(x, y)

    def contact(self, x: float, y: float, z_r: float) -> Contact:
        """What the commanded height z_r [m] does at a point of the plane [m], eq. (12)."""
        stiffness = self.stiffness(x, y)
        depth = self.surface_z - z_r
        if depth <= 0.0:
            return Contact(z_r, 0.0, 0.0, stiffness)
        return Contact(self.surface_z, depth, stiffness * depth, stiffness)

    def press(self, x: float, y: float, depth: float) -> tuple[int, float, float]:
        """As :meth:`object_at` and :meth:`contact` in one, for a control loop.

        Args:
            x: Point of the plane [m].
            y: Point of the plane [m].
            depth: Commanded displacement below the surface [m].

        Returns:
            Index of the object or -1, interaction force of eq. (12) [N], stiffness [N/m].
        """
        index = self.object_at(x, y)
        stiffness = self.objects[index].stiffness_at(x, y) if index >= 0 else self.stiffness(x, y)
        return index, stiffness * depth if depth > 0.0 else 0.0, stiffness

    def required_depth(self, x: float, y: float) -> float:
        """Depth [m] that produces the reference force at a point of the plane [m]."""
        return self.reference_force / self.stiffness(x, y)

    def border_distance(self, x: float, y: float) -> float:
        """Distance [m] of a point from the nearest border between two objects; infinite if there is none."""
        return min((distance(segment, x, y) for segment in self.border_segments), default=math.inf)

    def grid(self, n: int = 80) -> FloatArray:
        """Middles of n x n equal cells of the plane, shape (n^2, 2) [m]; y changes fastest."""
        steps = self.size * ((np.arange(n) + 0.5) / n - 0.5)
        x, y = np.meshgrid(steps, steps, indexing="ij")
        return np.stack((x.ravel(), y.ravel()), axis=1)

    def stiffness_at(self, points: ArrayLike) -> FloatArray:
        """Stiffness [N/m], shape (n,), at points of shape (n, 2) [m]."""
        return np.array([self.stiffness(x, y) for x, y in np.asarray(points, dtype=float).tolist()])

    def border_distances(self, points: ArrayLike) -> FloatArray:
        """Distance from the nearest border [m], shape (n,), of points of shape (n, 2) [m]."""
        places = np.asarray(points, dtype=float).reshape(-1, 2)
        nearest = np.full(len(places), np.inf)
        for start, end in np.asarray(self.border_segments, dtype=float).reshape(-1, 2, 2):
            way = end - start
            t = np.clip((places - start) @ way / (way @ way), 0.0, 1.0)
            offset = places - start - t[:, None] * way
            np.minimum(nearest, np.hypot(offset[:, 0], offset[:, 1]), out=nearest)
        return nearest

    def check_reach(
        self, geometry: ArmGeometry, *, deepest: float | None = None, clearance: float = CLEARANCE
    ) -> None:
        """Refuse a task that the arm cannot reach everywhere.

        Args:
            geometry: The arm.
            deepest: Depth below the surface to be reached [m]; default: the task's own.
            clearance: Height above the surface to be reached [m].

        Raises:
            ConfigurationError: Names the corner or the middle of the edge, and the limit of the arm.
        """
        half = 0.5 * self.size
        corners = [(sx * half, sy * half) for sx in (-1, 1) for sy in (-1, 1)]
        middles = [(-half, 0.0), (half, 0.0), (0.0, -half), (0.0, half)]
        for depth in (self.depth_max if deepest is None else deepest, -clearance):
            for kind, points in (("corner", corners), ("edge", middles)):
                for x, y in points:
                    handle = self.to_handle(x, y, self.surface_z - depth)
                    violation = geometry.violation(*handle)
                    if violation is not None:
                        raise ConfigurationError(
                            "mapping",
                            f"the plane's {kind} x = {x:g} m, y = {y:g} m at a depth of {depth:g} m is out "
                            f"of the arm's reach, {violation}; raise scale or move offset",
                            source=self.name,
                        )

    def to_dict(self) -> dict[str, Any]:
        """The task as its file holds it: ``teaching.task_file.task_from_dict`` reads it back."""
        described: dict[str, Any] = {
            "name": self.name,
            "description": self.description,
            "plane": {"size": self.size, "surface_z": self.surface_z},
            "reference": {"force": self.reference_force},
            "mapping": {"scale": list(self.scale), "offset": list(self.offset)},
        }
        if self.array is not None:
            described["array"] = {
                "values": [list(row) for row in self.array.values],
                "extent": list(self.array.extent),
                "interpolation": self.array.interpolation.value,
                "border": self.array.border,
            }
            return described
        described["objects"] = [
            {
                "name": thing.name,
                "colour": thing.colour,
                "stiffness": thing.stiffness,
                "gradient": list(thing.gradient),
                "polygon": [list(point) for point in thing.outline],
            }
            for thing in self.objects
        ]
        return described


def check_range(name: str, values: tuple[float, ...], low: float, high: float, unit: str) -> None:
    """Refuse values outside low to high.

    Raises:
        ConfigurationError: A value is not finite or out of range.
    """
    for value in values:
        if not low <= value <= high:
            raise ConfigurationError(
                name, f"{value:g} {unit} is outside {low:g} to {high:g} {unit}".replace("  ", " ")
            )

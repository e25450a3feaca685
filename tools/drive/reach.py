"""Whether the arm can follow a trajectory: its reach, and the speed of its joints, before anything moves."""

import math
from typing import NamedTuple

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime.modes import LimitOptions
from tools.drive.trajectory import Point, Trajectory, Vector

_JOINT_SHARE = 0.9
"""Share of a joint's velocity limit that a commanded motion may use."""


class Peak(NamedTuple):
    """Where a trajectory asks the most of a joint."""

    share: float
    """Speed over limit; 1 is what may be used."""
    joint: str
    value: float
    limit: float
    unit: str
    time_s: float


def check_point(field: str, position: Vector, geometry: ArmGeometry) -> None:
    """Refuse a position [m] that the arm cannot reach.

    Raises:
        ConfigurationError: It is outside; names the joint, its value and its limits.
    """
    if not all(math.isfinite(value) for value in position):
        raise ConfigurationError(field, f"{_shown(position)} is no position: give three finite numbers in m")
    problem = geometry.violation(*position)
    if problem:
        raise ConfigurationError(
            field, f"{_shown(position)} m is outside the workspace: {problem}; {_hint(geometry)}"
        )


def check_path(field: str, trajectory: Trajectory, geometry: ArmGeometry) -> None:
    """Refuse a trajectory that leaves the arm's reach anywhere on its way.

    The reach is no convex body: a straight line between two points may pass too near the column.

    Raises:
        ConfigurationError: It leaves the workspace; names where, the joint, its value and its limits.
    """
    for time_s in trajectory.sample_times():
        point = trajectory.at(time_s)
        problem = geometry.violation(*point.position)
        if problem:
            raise ConfigurationError(
                field,
                f"the way leaves the workspace after {time_s:.2f} s, at {_shown(point.position)} m: "
                f"{problem}; go there over a point in between",
            )


def joint_peak(trajectory: Trajectory, geometry: ArmGeometry, limits: LimitOptions) -> Peak:
    """The largest share of a joint's velocity limit that the trajectory uses."""
    best = Peak(0.0, "", 0.0, 0.0, "", 0.0)
    for time_s in trajectory.sample_times():
        point = trajectory.at(time_s)
        for joint, value, limit, unit in _joint_speeds(point, geometry, limits):
            share = abs(value) / (_JOINT_SHARE * limit)
            if share > best.share:
                best = Peak(share, joint, value, _JOINT_SHARE * limit, unit, time_s)
    return best


def _joint_speeds(
    point: Point, geometry: ArmGeometry, limits: LimitOptions
) -> tuple[tuple[str, float, float, str], ...]:
    x, y = geometry.r0 + point.position[0], point.position[1]
    radius = max(1e-6, math.hypot(x, y))
    vx, vy, vz = point.velocity
    return (
        ("r", (x * vx + y * vy) / radius, limits.velocity_r, "m/s"),
        ("phi", (x * vy - y * vx) / radius**2, limits.velocity_phi, "rad/s"),
        ("z", vz, limits.velocity_z, "m/s"),
    )


def _shown(position: Vector) -> str:
    return "[{:g}, {:g}, {:g}]".format(*position)


def _hint(geometry: ArmGeometry) -> str:
    low, high = geometry.r_min, geometry.r_max
    return (
        f"straight ahead x may be {low:g} to {high:g} m, z {geometry.z_min:g} to {geometry.z_max:g} m "
        "('limits' shows all)"
    )


def bounding_box(geometry: ArmGeometry) -> tuple[Vector, Vector]:
    """Lowest and highest coordinates of the workspace [m]."""
    inner, outer = geometry.r0 + geometry.r_min, geometry.r0 + geometry.r_max
    widest = max(abs(geometry.phi_min), abs(geometry.phi_max))
    return (
        (inner * math.cos(widest) - geometry.r0, outer * math.sin(geometry.phi_min), geometry.z_min),
        (geometry.r_max, outer * math.sin(geometry.phi_max), geometry.z_max),
    )

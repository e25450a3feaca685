"""Geometry of the arm: cylindrical joints r, phi, z and the Cartesian frame of the device.

The frame has its origin at the workspace centre, x towards the user, y to the right, z up. With the
distance R0 from the column's axis to the workspace centre (device facts, confidence H)::

    x = (R0 + r) cos(phi) - R0        y = (R0 + r) sin(phi)        z = z

The functions are scalar and free of objects, so that a kernel can compile them as they stand.
"""

import math
from dataclasses import dataclass

from hm_driver.errors import ConfigurationError


def joint_to_cartesian(r: float, phi: float, z: float, r0: float) -> tuple[float, float, float]:
    """Position [m] of the end effector for joints r [m], phi [rad], z [m]; r0 is R0 [m]."""
    radius = r0 + r
    return radius * math.cos(phi) - r0, radius * math.sin(phi), z


def cartesian_to_joint(x: float, y: float, z: float, r0: float) -> tuple[float, float, float]:
    """Joints r [m], phi [rad], z [m] for a position [m] in front of the column; inverse of the above."""
    return math.sqrt((r0 + x) * (r0 + x) + y * y) - r0, math.atan2(y, r0 + x), z


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmGeometry:
    """Reach of one arm: R0 and the end stops of its joints.

    The defaults are the end stops of one real arm (confidence H) and R0 of about 0.45 m.
    """

    r0: float = 0.45
    """Distance from the column's axis to the workspace centre [m]."""
    r_min: float = -0.19
    """Inner end stop of the radial arm [m]."""
    r_max: float = 0.19
    """Outer end stop of the radial arm [m]."""
    phi_min: float = -0.504
    """End stop of the base rotation, clockwise seen from above [rad]."""
    phi_max: float = 0.507
    """End stop of the base rotation, counter-clockwise [rad]."""
    z_min: float = -0.228
    """Lower end stop [m]."""
    z_max: float = 0.228
    """Upper end stop [m]."""

    def __post_init__(self) -> None:
        for joint in ("r", "phi", "z"):
            low, high = getattr(self, f"{joint}_min"), getattr(self, f"{joint}_max")
            if not (math.isfinite(low) and math.isfinite(high) and low < high):
                raise ConfigurationError(
                    f"{joint}_min", f"{low} must be finite and below {joint}_max = {high}"
                )
        if not (math.isfinite(self.r0) and self.r0 + self.r_min > 0.0):
            raise ConfigurationError("r0", f"{self.r0} m must exceed -r_min = {-self.r_min} m")

    def joint_limits(self) -> tuple[tuple[str, str, float, float], ...]:
        """Name, unit, lower and upper limit of each joint."""
        return (
            ("r", "m", self.r_min, self.r_max),
            ("phi", "rad", self.phi_min, self.phi_max),
            ("z", "m", self.z_min, self.z_max),
        )

    def violation(self, x: float, y: float, z: float) -> str | None:
        """Say which joint limit a position [m] breaks, or None where it is within reach."""
        joints = cartesian_to_joint(x, y, z, self.r0)
        for (name, unit, low, high), value in zip(self.joint_limits(), joints, strict=True):
            if not low <= value <= high:
                return f"{name} = {value:.4g} {unit} is outside {low:g} to {high:g} {unit}"
        return None

    def volume(self) -> float:
        """Volume of the workspace [m^3], in closed form."""
        radial = ((self.r0 + self.r_max) ** 2 - (self.r0 + self.r_min) ** 2) / 2.0
        return radial * (self.phi_max - self.phi_min) * (self.z_max - self.z_min)

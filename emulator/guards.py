"""The device's guards: limits that the control loop watches, and that put the arm into ``fault``.

That guards exist is known, what they compare with what is not: these are choices, which
``docs/fidelity.md`` lists.
"""

import math
from dataclasses import dataclass
from struct import Struct

from emulator.layout import O_MEASURED_FORCE, O_MEASURED_POSITION, O_MEASURED_VELOCITY, O_MODEL_POSITION
from hm_driver.errors import ConfigurationError

_VECTOR = Struct("3d")


@dataclass(frozen=True, slots=True, kw_only=True)
class Guards:
    """Limits of the guards."""

    speed: float = 2.0
    """Largest measured speed of the end effector [m/s]."""
    force: float = 250.0
    """Largest measured force [N]."""
    following_error: float = 0.03
    """Largest distance between the measured and the model's position [m]."""

    def __post_init__(self) -> None:
        for name in ("speed", "force", "following_error"):
            value = getattr(self, name)
            if not value > 0.0:
                raise ConfigurationError(f"guards.{name}", f"{value} must be above 0")

    def violation(self, outputs: memoryview) -> str:
        """Say which limit the arm's outputs break, with value and limit; empty if none.

        Args:
            outputs: Numbers of the arm's output array, as `emulator.layout` lays it out.
        """
        x, y, z = _VECTOR.unpack_from(outputs, 8 * O_MEASURED_POSITION)
        a, b, c = _VECTOR.unpack_from(outputs, 8 * O_MODEL_POSITION)
        error = math.sqrt((x - a) * (x - a) + (y - b) * (y - b) + (z - c) * (z - c))
        if not error <= self.following_error:
            return f"following error {error:.3g} m above {self.following_error:g} m"
        x, y, z = _VECTOR.unpack_from(outputs, 8 * O_MEASURED_VELOCITY)
        speed = math.sqrt(x * x + y * y + z * z)
        if not speed <= self.speed:
            return f"speed {speed:.3g} m/s above {self.speed:g} m/s"
        x, y, z = _VECTOR.unpack_from(outputs, 8 * O_MEASURED_FORCE)
        force = math.sqrt(x * x + y * y + z * z)
        if not force <= self.force:
            return f"force {force:.3g} N above {self.force:g} N"
        return ""

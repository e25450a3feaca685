"""How the human corrects the skill: what is forgotten, and when his effort against the robot counts."""

from dataclasses import dataclass
from typing import NamedTuple

from hm_driver.errors import ConfigurationError


class Region(NamedTuple):
    """A part of the plane whose models are to go."""

    x: float
    """Middle, in the manipulator's frame [m]."""
    y: float
    radius: float
    """Models go whose centre is at most so far along x and along y [m], and those that the middle activates
    enough to cost the human control."""

    def contains(self, x: float, y: float) -> bool:
        """Whether a place [m] lies in it."""
        return abs(x - self.x) <= self.radius and abs(y - self.y) <= self.radius


@dataclass(frozen=True, slots=True, kw_only=True)
class CorrectionOptions:
    """How the human may correct the skill. The paper names it as future work; all of it is ours."""

    radius: float = 0.05
    """Half the edge of the square about the manipulator that is forgotten [m]."""
    insist_force: float = 0.0
    """Force of the hand in z against the robot that takes control back [N]; 0: it cannot be taken so."""
    insist_time: float = 0.5
    """How long that force must last [s]."""
    hold: float = 1.0
    """How long control stays the human's at least, once he has had something forgotten [s]."""
    undo_steps: int = 20
    """How many changes of the skill can be undone; each keeps one skill in memory."""

    def __post_init__(self) -> None:
        if not 0.0 < self.radius <= 10.0:
            raise ConfigurationError("radius", f"{self.radius} m must be above 0 and at most 10 m")
        for name in ("insist_force", "insist_time", "hold"):
            if not 0.0 <= getattr(self, name) <= 1000.0:
                raise ConfigurationError(name, f"{getattr(self, name)} must be 0 to 1000")
        if not 0 <= self.undo_steps <= 1000:
            raise ConfigurationError("undo_steps", f"{self.undo_steps} must be 0 to 1000")


class Insistence:
    """Tells a sustained effort of the hand against the robot from a passing one.

    Args:
        options: Force and time that make an effort.
    """

    def __init__(self, options: CorrectionOptions) -> None:
        self._force, self._time = options.insist_force, options.insist_time
        self._pushed = 0.0
        self.is_possible = options.insist_force > 0.0
        """Whether effort counts at all."""

    def step(self, push: float, dt: float, *, is_robot: bool) -> bool:
        """Whether he has insisted.

        Args:
            push: Smoothed force of the hand in z [N]; it must keep its direction.
            dt: Time since the last call [s].
            is_robot: Whether the robot is in control; else there is nothing to take back.
        """
        if not is_robot or abs(push) < self._force:
            self._pushed = 0.0
            return False
        if (push > 0.0) != (self._pushed > 0.0):
            self._pushed = 0.0
        self._pushed += dt if push > 0.0 else -dt
        if abs(self._pushed) < self._time:
            return False
        self._pushed = 0.0
        return True

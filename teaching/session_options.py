"""How a session goes: its stages, its hand-overs, and what counts as a demonstration."""

from dataclasses import dataclass
from enum import Enum

from hm_driver.errors import ConfigurationError


class ForceFeedback(Enum):
    """How the demonstrator learns of the interaction force."""

    VISUAL = "visual"
    """On the screen: the reading of the paper taken here."""
    RENDERED = "rendered"
    """On the screen, and as a bias force on the hand."""


class Coupling(Enum):
    """What the blend of eq. (8) moves."""

    COUPLED = "coupled"
    """The handle, by a spring, and the manipulator with it: the paper. While C < 1 the human's command is an
    estimate of his intention."""
    UNCOUPLED = "uncoupled"
    """The manipulator alone: the handle stays free, and is the human's command at any C. Ours, for methods
    with which both act at once for long."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionOptions:
    """How a session goes."""

    practice: float = 4.0
    """Duration of practice before teaching: C = 1, nothing is accumulated [s]."""
    autonomy_coverage: float = 0.99
    """Share of the plane with a model, from which on the skill goes on alone; above 1: never by itself."""
    examination: float = 5.0
    """How long the demonstrator may examine the skill before the autonomous stage begins [s]."""
    give_up: float = 300.0
    """Duration after which teaching ends without having covered the plane [s]."""
    hand_over: float = 0.3
    """Least duration of a full change of control [s]. The blend zone of eq. (9) is 4 mm wide, 2 ticks at the
    speed of the demonstration; C follows eq. (9) no faster than this, and a hand-over takes its time."""
    stay: float = 0.0
    """How long control stays the human's at least, once it is his alone again [s]: he can show something, and
    it does not go to and fro. 0 lets it go at once, as eq. (9) does."""
    coupling: Coupling = Coupling.COUPLED
    """Whether the blend moves the handle, as in the paper, or the manipulator alone."""
    samples_per_tick: int = 50
    """How many samples of an update are learned in a tick."""
    transient_speed: float = 0.05
    """Vertical speed of the handle above which no sample is accumulated [m/s]: on his way to a depth after a
    hand-over, a demonstrator does not demonstrate it. A large value takes every sample, as eq. (10) does."""
    transient_rate: float = 0.0
    """The same by the depth at which the handle is [1/s]: a speed that is a transient on a hard object is the
    unsteadiness of the hand on a soft one. 0 does not ask for it."""
    settling: float = 0.0
    """How long no sample is accumulated after the human has got control back [s]: a take-over is no
    demonstration. 0 takes them at once, as eq. (10) does."""
    hindsight: float = 0.0
    """How long before a transient samples are dropped as well [s]: what he held just before he went to
    another depth is not what he wanted. 0 keeps them, as eq. (10) does."""
    flush: int = 0
    """Number of samples from which on a hand-over to the skill makes an update of what is in the buffer; 0
    waits until it is full, as eq. (10) does."""
    record_without_contact: bool = False
    """Whether samples are accumulated while the manipulator does not touch the surface."""
    depth_limit: float = 0.2
    """Largest displacement that the skill may command [m]; the arm reaches 0.29 m for the paper's task."""
    autonomous_speed: float = 0.15
    """Speed of the manipulator in the autonomous run [m/s]."""
    autonomous_acceleration: float = 1.0
    """Acceleration of the manipulator in the autonomous run [m/s^2]."""
    autonomous_spacing: float = 0.02
    """Distance of the lines of the autonomous run [m]."""
    force_feedback: ForceFeedback = ForceFeedback.VISUAL
    """How the interaction force reaches the hand."""
    feedback_gain: float = 0.3
    """Share of the interaction force that is rendered on the hand."""

    def __post_init__(self) -> None:
        for name in (
            "practice",
            "examination",
            "hand_over",
            "feedback_gain",
            "settling",
            "stay",
            "transient_rate",
        ):
            if not 0.0 <= getattr(self, name):
                raise ConfigurationError(name, f"{getattr(self, name)} must not be negative")
        for name in (
            "give_up",
            "autonomous_speed",
            "autonomous_acceleration",
            "autonomous_spacing",
            "depth_limit",
            "transient_speed",
        ):
            if not 0.0 < getattr(self, name):
                raise ConfigurationError(name, f"{getattr(self, name)} must be above 0")
        if not 0.0 < self.autonomy_coverage:
            raise ConfigurationError("autonomy_coverage", f"{self.autonomy_coverage} must be above 0")
        if not 0.0 <= self.hindsight <= 10.0:
            raise ConfigurationError("hindsight", f"{self.hindsight} s must be 0 to 10 s")
        if not 0 <= self.flush <= 1_000_000:
            raise ConfigurationError("flush", f"{self.flush} must be 0 to 1000000")
        if self.hand_over > 10.0:
            raise ConfigurationError("hand_over", f"{self.hand_over} s must be 0 to 10 s")
        if self.autonomous_spacing < 0.001:
            raise ConfigurationError(
                "autonomous_spacing", f"{self.autonomous_spacing} m must be at least 0.001 m"
            )
        if not 1 <= self.samples_per_tick <= 100_000:
            raise ConfigurationError("samples_per_tick", f"{self.samples_per_tick} must be 1 to 100000")

"""The modes' and limits' options, and the flat parameters that the cycle reads."""

import math
from dataclasses import dataclass
from enum import Enum

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime import cycle

STIFFNESS_MAX = 100e3
"""Stiffest spring that the device takes [N/m]."""
ARM_FORCE_MAX = 250.0
"""Largest force that the arm itself can give [N]."""


class PositionControl(Enum):
    """Who renders the springs of position mode; published programs use both ways."""

    SPRING = "spring"
    """The device: springs whose position and velocity move. They hold the arm also when the loop is gone."""
    BIAS_FORCE = "bias_force"
    """The loop: a PD law whose force is sent as a bias force. The device keeps pushing with the last force
    that it was told, until it is told another one or is stopped."""


def _require_positive(options: object, unit: str, highest: float, *names: str) -> None:
    for name in names:
        value = getattr(options, name)
        if not 0.0 < value <= highest:
            raise ConfigurationError(name, f"{value} must be above 0 and at most {highest:g} {unit}".rstrip())


@dataclass(frozen=True, slots=True, kw_only=True)
class ModeOptions:
    """Admittance and position mode."""

    inertia: float = 3.0
    """Virtual mass that the hand moves [kg]; the device takes 2 kg at least."""
    coulomb_friction: float = 0.0
    """Virtual Coulomb friction [N]."""
    position_control: PositionControl = PositionControl.SPRING
    """Who renders the springs of position mode: the device ("spring"), or the loop ("bias_force")."""
    position_stiffness: float = 5000.0
    """Of the springs of position mode [N/m]; Kp where the loop renders them."""
    position_damping_ratio: float = 1.0
    """Of the springs of position mode, on the virtual mass; Kd is the damping that it makes there."""
    position_force_max: float = 30.0
    """Largest force of a spring of position mode [N]."""
    assist_stiffness: float = 300.0
    """Of the spring that helps the hand to hold its own height [N/m]."""
    assist_damping_ratio: float = 0.7
    """Of that spring, on the virtual mass."""
    assist_force_max: float = 10.0
    """Largest force of that spring [N]."""
    assist_time: float = 0.3
    """Time constant of the low-pass by which that spring follows the hand's own height [s]."""
    follow_time: float = 0.03
    """Time constant by which a reference approaches its target [s]."""

    def __post_init__(self) -> None:
        _require_positive(self, "N/m", STIFFNESS_MAX, "position_stiffness", "assist_stiffness")
        _require_positive(self, "", 100.0, "position_damping_ratio", "assist_damping_ratio")
        _require_positive(self, "N", ARM_FORCE_MAX, "position_force_max", "assist_force_max")
        _require_positive(self, "s", 60.0, "assist_time", "follow_time")
        if not 2.0 <= self.inertia <= 20.0:
            raise ConfigurationError(
                "inertia", f"{self.inertia} kg must be 2 to 20 kg; the device refuses less"
            )
        if not 0.0 <= self.coulomb_friction <= 10.0:
            raise ConfigurationError("coulomb_friction", f"{self.coulomb_friction} N must be 0 to 10 N")

    def check_rate(self, rate_hz: float) -> None:
        """Refuse gains that a loop of this rate [Hz] cannot render stably by a bias force.

        A force that is computed from one measurement acts from the next exchange on, for a period: 1.5
        periods of delay T. Of the damping Kd - 1.5 Kp T has to remain at least a half, and of a speed no
        more than a quarter may be taken off in a period, Kd T / m <= 0.25: four times as much shakes.

        Raises:
            ConfigurationError: The stiffness is too high, or the damping too high or too low.
        """
        if self.position_control is not PositionControl.BIAS_FORCE:
            return
        stiffness, ratio = self.position_stiffness, self.position_damping_ratio
        damping = self.damping(stiffness, ratio)
        if damping > 0.25 * self.inertia * rate_hz or damping < 3.0 * stiffness / rate_hz:
            raise ConfigurationError(
                "position_stiffness",
                f"{stiffness:g} N/m with a damping ratio of {ratio:g} cannot be rendered by a bias force at "
                f"{rate_hz:g} Hz: the damping, {damping:.0f} N·s/m, must be {3.0 * stiffness / rate_hz:.0f} "
                f"to {0.25 * self.inertia * rate_hz:.0f} N·s/m there; lower the stiffness, raise the rate, "
                'or leave position_control at "spring"',
            )

    def damping(self, stiffness: float, ratio: float) -> float:
        """Damping [N*s/m] that the device gives a spring [N/m] of a damping ratio on the virtual mass."""
        return 2.0 * ratio * math.sqrt(stiffness * self.inertia)


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitOptions:
    """Limits below every mode."""

    force_rate: float = 500.0
    """Largest change of the commanded spring force [N/s]: 500 N/s is 0.5 N per ms. Of it, 70 % are the
    position spring's and 30 % the assist's, so that both together keep it."""
    bias_rate: float = 150.0
    """Largest change of the bias force [N/s]."""
    bias_max: float = 10.0
    """Largest bias force per axis [N]."""
    reference_speed: float = 0.3
    """Largest speed of a reference [m/s]."""
    velocity_r: float = 0.3
    """Velocity limit of the radial arm [m/s]; a cycle within 2 % of it counts as saturated."""
    velocity_phi: float = 0.7
    """Velocity limit of the base rotation [rad/s]."""
    velocity_z: float = 0.3
    """Velocity limit of the vertical axis [m/s]."""
    velocity_trip: float = 1.5
    """Multiple of a joint's velocity limit at which the arm is stopped."""
    force_trip: float = 80.0
    """Force of the hand at which the arm is stopped [N]."""
    workspace_margin: float = 0.005
    """How far beyond an end stop a measured position may be before the arm is stopped [m], [rad]."""

    def __post_init__(self) -> None:
        _require_positive(self, "N/s", 1e6, "force_rate", "bias_rate")
        _require_positive(self, "N", 1e3, "force_trip")
        _require_positive(self, "m/s", 10.0, "reference_speed", "velocity_r", "velocity_z")
        _require_positive(self, "rad/s", 20.0, "velocity_phi")
        if not self.velocity_trip > 1.0:
            raise ConfigurationError("velocity_trip", f"{self.velocity_trip} must be above 1")
        if not 0.0 <= self.bias_max <= ARM_FORCE_MAX:
            raise ConfigurationError("bias_max", f"{self.bias_max} N must be 0 to {ARM_FORCE_MAX:g} N")
        if not 0.0 <= self.workspace_margin <= 0.1:
            raise ConfigurationError("workspace_margin", f"{self.workspace_margin} must be 0 to 0.1 m, rad")


def cycle_parameters(
    modes: ModeOptions, limits: LimitOptions, geometry: ArmGeometry, *, tick_s: float
) -> list[float]:
    """Flat parameters for `cycle.cycle`.

    Args:
        modes: Springs and virtual mass.
        limits: Limits below them.
        geometry: Reach of the arm.
        tick_s: Time between two set-points of the application [s].
    """
    p = [0.0] * cycle.PARAMETER_SIZE
    p[cycle.P_TICK] = tick_s
    p[cycle.P_FORCE_RATE] = 0.7 * limits.force_rate
    p[cycle.P_ASSIST_RATE] = 0.3 * limits.force_rate
    p[cycle.P_SPEED_MAX] = limits.reference_speed
    p[cycle.P_FOLLOW] = modes.follow_time
    p[cycle.P_ASSIST_TIME] = modes.assist_time
    position = modes.damping(modes.position_stiffness, modes.position_damping_ratio)
    assist = modes.damping(modes.assist_stiffness, modes.assist_damping_ratio)
    for spring in range(cycle.SPRINGS):
        base = cycle.P_SPRING + spring * cycle.P_STRIDE
        p[base : base + cycle.P_STRIDE] = (
            (modes.assist_stiffness, assist, modes.assist_force_max)
            if spring == cycle.ASSIST
            else (modes.position_stiffness, position, modes.position_force_max)
        )
    p[cycle.P_BIAS_MAX] = limits.bias_max
    p[cycle.P_BIAS_RATE] = limits.bias_rate
    p[cycle.P_R0] = geometry.r0
    for joint, (_, _, low, high) in enumerate(geometry.joint_limits()):
        p[cycle.P_JOINT + 2 * joint] = low - limits.workspace_margin
        p[cycle.P_JOINT + 2 * joint + 1] = high + limits.workspace_margin
    p[cycle.P_JOINT_SPEED : cycle.P_JOINT_SPEED + 3] = (
        limits.velocity_r,
        limits.velocity_phi,
        limits.velocity_z,
    )
    p[cycle.P_SPEED_TRIP] = limits.velocity_trip
    p[cycle.P_FORCE_TRIP] = limits.force_trip
    p[cycle.P_BY_FORCE] = float(modes.position_control is PositionControl.BIAS_FORCE)
    return p

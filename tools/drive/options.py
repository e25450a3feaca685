"""The configuration of a drive: how fast it moves, and what the loop below it is told."""

from dataclasses import dataclass, field, replace
from typing import Self

from hm_driver.errors import ConfigurationError
from hm_driver.realtime.modes import LimitOptions, ModeOptions
from hm_driver.realtime.options import TimingOptions, WatchOptions

TICK_S = 0.01
"""Set-points are published at 100 Hz."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionOptions:
    """Motions that are commanded, all below the limits of the loop."""

    speed: float = 0.1
    """Largest speed of a motion that names none [m/s]."""
    speed_max: float = 0.25
    """Largest speed that may be asked for [m/s]."""
    acceleration: float = 0.5
    """Largest acceleration [m/s^2]."""
    brake_time: float = 0.25
    """Time in which an interrupted motion comes to rest on its own path [s]."""
    settle_time: float = 1.5
    """Longest wait for the arm to arrive behind its reference [s]."""
    tolerance: float = 0.003
    """Distance from its goal at which the arm has arrived [m]."""

    def __post_init__(self) -> None:
        for name, low, high, unit in (
            ("speed_max", 0.001, 1.0, "m/s"),
            ("acceleration", 0.01, 1.0, "m/s^2"),
            ("brake_time", 0.05, 2.0, "s"),
            ("settle_time", 0.05, 60.0, "s"),
            ("tolerance", 1e-4, 0.1, "m"),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise ConfigurationError(name, f"{value:g} is outside {low:g} to {high:g} {unit}")
        if not 0.001 <= self.speed <= self.speed_max:
            raise ConfigurationError(
                "speed", f"{self.speed:g} is outside 0.001 to speed_max = {self.speed_max:g} m/s"
            )

    def below(self, speed_max: float) -> Self:
        """The same with no speed above a limit [m/s]."""
        highest = min(self.speed_max, speed_max)
        return replace(self, speed=min(self.speed, highest), speed_max=highest)


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveOptions:
    """Everything about a drive."""

    motion: MotionOptions = field(default_factory=MotionOptions)
    modes: ModeOptions = field(default_factory=ModeOptions)
    limits: LimitOptions = field(default_factory=LimitOptions)
    timing: TimingOptions = field(default_factory=TimingOptions)
    watch: WatchOptions = field(default_factory=WatchOptions)
    init_timeout_s: float = 30.0
    """How long the device may take to initialise [s]."""

    def __post_init__(self) -> None:
        if self.motion.speed_max > self.limits.reference_speed:
            raise ConfigurationError(
                "motion.speed_max",
                f"{self.motion.speed_max:g} m/s is above limits.reference_speed = "
                f"{self.limits.reference_speed:g} m/s, which the loop keeps",
            )

"""What the loop is told at its start, beside the modes and their limits."""

from dataclasses import dataclass, field

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime import cycle
from hm_driver.realtime.modes import LimitOptions, ModeOptions, cycle_parameters

SPRING_NAMES = ("spring_x", "spring_y", "spring_z", "assist")
"""Names of the device's springs, in the order of the cycle function."""
BIAS_NAME = "feedback"
"""Name of the device's bias force."""
SESSION_STATES = ("force", "position")
"""States of the device in which the loop can run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TimingOptions:
    """Rate and scheduling of the loop."""

    rate_hz: float = 1000.0
    """Cycles in a second, 100 to 2500."""
    spin_duty: float = 0.15
    """Largest share of a core that may be spun for punctuality; 0 never spins."""
    priority: int = 80
    """SCHED_FIFO priority that is asked for."""
    cpu: int | None = None
    """CPU to pin the loop to, or None."""
    lock_memory: bool = True
    """Whether to lock the loop process's memory."""
    require_realtime: bool = False
    """Whether to refuse to run below SCHED_FIFO."""

    def __post_init__(self) -> None:
        _check_range(self, "rate_hz", 100.0, 2500.0, "Hz")
        _check_range(self, "spin_duty", 0.0, 0.5, "of a core")
        _check_range(self, "priority", 1, 99, "")


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchOptions:
    """When the loop, and the guardian behind it, give up and make the arm safe. 0 switches a watch off."""

    heartbeat_s: float = 0.06
    """Silence of the application that trips [s]."""
    exchange_timeout_s: float = 0.05
    """Silence of the device after which the link counts as lost [s]."""
    freeze_s: float = 0.06
    """Silence of the loop after which the guardian stops the device [s], longer than the device may take."""
    missed_s: float = 0.25
    """Missed periods at once, or in excess of every other one, that trip [s]."""
    stale_s: float = 0.07
    """Time without a change in any digit of the measurements that trips [s]: a force sensor is never still.
    In lock-step nothing can be stale."""
    ramp_s: float = 0.005
    """Time in which the forces are ramped down after a trip, before the stop [s]; where it is shorter than a
    period, the stop is sent at once. Each cycle of the ramp is an exchange that a stall can hold up."""
    release_s: float = 1.0
    """Longest time for the gentle release at a requested stop [s]."""
    soft_budget: float = 0.5
    """Share of the period in which a cycle should end; later ones are counted, nothing else."""

    def __post_init__(self) -> None:
        for name in ("heartbeat_s", "freeze_s", "missed_s", "stale_s"):
            _check_range(self, name, 0.0, 60.0, "s")
        _check_range(self, "exchange_timeout_s", 0.002, 10.0, "s")
        _check_range(self, "ramp_s", 0.001, 1.0, "s")
        _check_range(self, "release_s", 0.001, 10.0, "s")
        _check_range(self, "soft_budget", 0.01, 1.0, "of the period")


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopOptions:
    """Everything about one run of the loop."""

    url: str
    """The device, as ``tcp://HOST[:7654]``."""
    state: str = "force"
    """State of the device during the run: ``force``, where it answers to the hand, or ``position``, where it
    renders the springs but does not respond to the force sensor."""
    modes: ModeOptions = field(default_factory=ModeOptions)
    """Admittance and position mode."""
    limits: LimitOptions = field(default_factory=LimitOptions)
    """Limits below them."""
    geometry: ArmGeometry = field(default_factory=ArmGeometry)
    """Reach of the arm."""
    timing: TimingOptions = field(default_factory=TimingOptions)
    """Rate and scheduling."""
    watch: WatchOptions = field(default_factory=WatchOptions)
    """Time-outs."""
    tick_s: float = 0.01
    """Time between two set-points of the application [s]."""
    init_timeout_s: float = 30.0
    """How long the device may take to initialise [s]."""
    connect_timeout_s: float = 1.0
    """How long a connection, and each command outside the grid, may take [s]."""
    law: str = ""
    """A control law of the user, ``module:Class``; empty for none."""
    ring: str = ""
    """Path of the shared block whose ring takes a record a cycle; empty for none."""
    trace: str = ""
    """Path of the shared block whose trace takes the timing of each cycle; empty for none."""
    epoch_ns: int = 0
    """Unix time minus the loop's clock [ns]: what makes times of the log out of times of the clock."""
    has_guardian: bool = True
    """Whether a guardian process watches the loop over a connection of its own."""

    def __post_init__(self) -> None:
        if self.state not in SESSION_STATES:
            raise ConfigurationError("state", f"{self.state!r} is not one of {', '.join(SESSION_STATES)}")
        try:
            self.modes.check_rate(self.timing.rate_hz)
        except ConfigurationError as error:
            raise ConfigurationError(f"modes.{error.field}", error.problem) from error
        _check_range(self, "tick_s", 0.0004, 1.0, "s")
        _check_range(self, "init_timeout_s", 0.001, 600.0, "s")
        _check_range(self, "connect_timeout_s", 0.01, 60.0, "s")

    def parameters(self) -> list[float]:
        """Flat parameters of the cycle function; a law, asked in every cycle, needs no interpolation."""
        tick_s = 1.0 / self.timing.rate_hz if self.law else self.tick_s
        return cycle_parameters(self.modes, self.limits, self.geometry, tick_s=tick_s)


def ramp_down_parameters(parameters: list[float], ramp_s: float) -> list[float]:
    """The same parameters with rates that bring the largest force to nothing within ``ramp_s`` [s]."""
    p = list(parameters)
    caps = [p[cycle.P_SPRING + i * cycle.P_STRIDE + cycle.FORCE_MAX] for i in range(cycle.SPRINGS)]
    p[cycle.P_FORCE_RATE] = max(p[cycle.P_FORCE_RATE], max(caps[: cycle.ASSIST]) / ramp_s)
    p[cycle.P_ASSIST_RATE] = max(p[cycle.P_ASSIST_RATE], caps[cycle.ASSIST] / ramp_s)
    p[cycle.P_BIAS_RATE] = max(p[cycle.P_BIAS_RATE], p[cycle.P_BIAS_MAX] / ramp_s)
    return p


def _check_range(options: object, name: str, low: float, high: float, unit: str) -> None:
    value = getattr(options, name)
    if not (isinstance(value, (int, float)) and low <= value <= high):
        raise ConfigurationError(name, f"{value!r} is outside {low:g} to {high:g} {unit}".rstrip())

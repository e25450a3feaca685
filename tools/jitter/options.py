"""What a run of the jitter suite is told."""

from dataclasses import dataclass, field
from enum import StrEnum

from hm_driver.errors import ConfigurationError
from hm_driver.realtime.modes import LimitOptions, ModeOptions

LOWEST_RATE_HZ, HIGHEST_RATE_HZ = 100.0, 2500.0
SHORTEST_S, LONGEST_S = 1.0, 86_400.0


class Load(StrEnum):
    """What runs beside the loop."""

    NONE = "none"
    """Nothing."""
    SPINNER = "spinner"
    """A busy Python thread in the application's process."""
    NUMPY = "numpy"
    """Matrix products in the application's process."""
    INTERFACE = "interface"
    """A user interface that the application draws 60 times a second."""
    GIL = "gil"
    """Calls into C of some 20 ms in the application's process that do not release the interpreter lock."""
    GC = "gc"
    """Garbage collection of a large heap in the application's process."""
    RECORDING = "recording"
    """5000 messages a second into a real recorder."""
    LOAD = "load"
    """Busy processes on every core."""


LOADS = tuple(load for load in Load if load is not Load.NONE)
"""Every load that is one."""
ALL = "all"
"""Every load at once."""


class LoopKind(StrEnum):
    """What carries the loop."""

    PROCESS = "process"
    """A process of its own: the way that keeps time."""
    THREAD = "thread"
    """A thread of the application: the portable fallback."""


class Fault(StrEnum):
    """A fault that is put into the loop, to see that the suite finds it."""

    NONE = ""
    """None."""
    SLEEP = "sleep"
    """The control law sleeps for 2 ms now and then."""
    RELATIVE = "relative"
    """The next deadline is the last wake-up plus a period, instead of a place on an absolute grid."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """One stretch of the run."""

    name: str
    """As the user named it: one load, several joined by ``+``, or ``all``."""
    loads: tuple[Load, ...]
    """What runs beside the loop."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a scenario must reach; times in [µs]."""

    excess_p99_9_us: float = 100.0
    """99.9th percentile of the lateness beyond the canary's."""
    excess_max_us: float | None = 300.0
    """Largest lateness beyond the canary's; None where a run is too long to promise one."""
    own_missed: int | None = 0
    """Deadlines missed that no canary missed; None where no canary runs."""
    drift_us_per_s: float = 1.0
    """Drift of the deadlines against the clock, either way."""
    lateness_p50_us: float | None = None
    """Median lateness, without privileges."""

    def __post_init__(self) -> None:
        for name in ("excess_p99_9_us", "excess_max_us", "drift_us_per_s", "lateness_p50_us"):
            value = getattr(self, name)
            if value is not None and not value > 0.0:
                raise ConfigurationError(name, f"{value!r} must be positive")
        if self.own_missed is not None and self.own_missed < 0:
            raise ConfigurationError("own_missed", f"{self.own_missed} must not be negative")


@dataclass(frozen=True, slots=True, kw_only=True)
class JitterOptions:
    """One run of the suite."""

    scenarios: tuple[Scenario, ...]
    """What to run, in order."""
    rate_hz: float = 1000.0
    """Rate of the loop [Hz]."""
    duration_s: float = 10.0
    """Length of each scenario [s]."""
    device: str = ""
    """Address of the device; empty for an emulator of the suite's own."""
    is_robot: bool = False
    """Whether the device is taken for a robot: then the loop is no more patient than in a session."""
    loop: LoopKind = LoopKind.PROCESS
    fault: Fault = Fault.NONE
    is_unprivileged: bool = False
    """Whether the loop gives up every privilege before it asks for scheduling."""
    spin_duty: float = 0.15
    """Largest share of a core that the loop may spin."""
    cpu: int | None = None
    """CPU of the loop; None for the last one allowed."""
    limits: Limits = field(default_factory=Limits)
    modes: ModeOptions = field(default_factory=ModeOptions)
    """Modes of the loop."""
    motion: LimitOptions = field(default_factory=LimitOptions)
    """Limits of the loop's forces and speeds."""

    def __post_init__(self) -> None:
        check_rate(self.rate_hz)
        if not SHORTEST_S <= self.duration_s <= LONGEST_S:
            raise ConfigurationError(
                "--duration",
                f"{self.duration_s:g} s is outside {SHORTEST_S:g} to {LONGEST_S:g} s; 10 is usual",
            )
        if not 0.0 <= self.spin_duty <= 0.5:
            raise ConfigurationError("--spin", f"{self.spin_duty:g} is outside 0 to 0.5 of a core")
        if self.loop is LoopKind.THREAD and (self.fault or self.is_unprivileged):
            raise ConfigurationError(
                "--loop", "thread is judged as it is: leave --inject and --unprivileged out"
            )


def check_rate(rate_hz: float) -> None:
    """Refuse a rate that the loop does not run.

    Raises:
        ConfigurationError: It is outside 100 to 2500 Hz.
    """
    if not LOWEST_RATE_HZ <= rate_hz <= HIGHEST_RATE_HZ:
        raise ConfigurationError(
            "--rate",
            f"{rate_hz:g} Hz is outside {LOWEST_RATE_HZ:g} to {HIGHEST_RATE_HZ:g} Hz, what the loop can run; "
            "1000 is usual",
        )


def parse_scenario(name: str) -> Scenario:
    """Read ``spinner``, ``spinner+interface+recording`` or ``all``.

    Raises:
        ConfigurationError: A load is unknown.
    """
    if name == ALL:
        return Scenario(name=name, loads=LOADS)
    words = name.split("+")
    unknown = [word for word in words if word not in tuple(Load)]
    if unknown:
        known = ", ".join([*Load, ALL])
        raise ConfigurationError(
            "--scenario", f"{unknown[0]!r} is none of {known}; join several by +, as in spinner+recording"
        )
    return Scenario(name=name, loads=tuple(dict.fromkeys(Load(w) for w in words if w != Load.NONE)))

"""What a run of the suite amounted to, as values that go into a file and come back."""

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Self

from hm_driver.errors import ConfigurationError
from tools.jitter.pairing import CoursePoint, Event
from tools.jitter.spread import Spread

FORMAT = 1
SPREADS = ("lateness", "canary", "excess", "response", "execution", "exchange")
"""Fields of a scenario that are spreads."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScenarioResult:
    """One scenario; durations of spreads in [µs]."""

    name: str
    rate_hz: float
    duration_s: float
    """Time measured [s]."""
    cycles: int
    """Cycles run, from the loop's start to its end."""
    missed: int
    """Periods missed, from the loop's start to its end."""
    grid_length: int
    """Deadlines from the loop's start to its last wake-up, by the clock."""
    window_cycles: int
    """Cycles run in the time measured."""
    window_missed: int
    """Periods missed in the time measured."""
    own_missed: int | None
    """Those at which no canary was held up; None where none ran."""
    canary_missed: int | None
    """Deadlines that the canary on the loop's CPU missed; None where none ran."""
    device_canary_missed: int | None
    """Deadlines that the canary on the emulator's CPU missed; None without one."""
    drift_us_per_s: float
    """Drift of the deadlines [µs/s]."""
    drift_resolution_us_per_s: float
    """Drift that the spread of the lateness hides [µs/s]."""
    lateness: Spread
    """Wake-up behind the deadline; the canary runs first and is part of it."""
    canary: Spread
    """Lateness of the canary on the loop's CPU."""
    excess: Spread
    """Wake-up behind the canary's."""
    response: Spread
    """End of the cycle behind the deadline."""
    execution: Spread
    """Wake-up to end of cycle."""
    exchange: Spread
    """Exchange with the device."""
    rung: str
    scheduling: str
    canary_rung: str
    requests_per_cycle: float
    dialect: str
    is_combined: bool
    cpu_us_per_cycle: float
    """Processor time of a cycle [µs], without what was spun."""
    spun_share: float
    """Share of a core that was spun."""
    heartbeats: int
    """Signs of life that the application gave."""
    longest_silence_ms: float
    """Longest time between two of them [ms]."""
    loads: tuple[str, ...]
    """What ran beside the loop, and how much it did."""
    course: tuple[CoursePoint, ...]
    """The time series."""
    worst: tuple[Event, ...]
    """The events of the largest excess."""
    own_misses_s: tuple[float, ...]
    """When the loop missed deadlines of its own [s]; the first ones."""
    problem: str
    """What ended the loop before its time, or empty."""

    @property
    def has_identity(self) -> bool:
        """Whether cycles run + periods missed = length of the grid."""
        return self.cycles + self.missed == self.grid_length

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """What `dataclasses.asdict` made."""
        values = dict(values)
        for name in SPREADS:
            values[name] = Spread.from_dict(values[name])
        values["course"] = tuple(CoursePoint(*point) for point in values["course"])
        values["worst"] = tuple(Event(*event) for event in values["worst"])
        for name in ("loads", "own_misses_s"):
            values[name] = tuple(values[name])
        return cls(**values)


@dataclass(frozen=True, slots=True, kw_only=True)
class CyclictestResult:
    """The loop beside cyclictest, in slices that take turns; pooled lateness in [µs]."""

    slices: int
    slice_s: float
    command: str
    cyclictest: Spread
    spin: Spread
    """The loop with its spin."""
    no_spin: Spread
    """The loop without."""

    @property
    def spin_ratio(self) -> float:
        """p99 of the loop with spin over that of cyclictest."""
        return self.spin.p99 / max(self.cyclictest.p99, 1e-3)

    @property
    def no_spin_ratio(self) -> float:
        """p99 of the loop without spin over that of cyclictest."""
        return self.no_spin.p99 / max(self.cyclictest.p99, 1e-3)

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> Self:
        """What `dataclasses.asdict` made."""
        spreads = {name: Spread.from_dict(values[name]) for name in ("cyclictest", "spin", "no_spin")}
        return cls(**(values | spreads))


@dataclass(frozen=True, slots=True, kw_only=True)
class Run:
    """A whole run."""

    started: str
    """When it began, ISO 8601."""
    version: str
    host: dict[str, str]
    """What it ran on."""
    options: dict[str, Any]
    """What it was told."""
    scenarios: tuple[ScenarioResult, ...]
    cyclictest: CyclictestResult | None
    checks: tuple[dict[str, Any], ...]
    """Each limit, what was reached, and whether that is good."""

    @property
    def has_passed(self) -> bool:
        """Whether every limit was kept."""
        return all(check["passed"] for check in self.checks)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, for JSON."""
        return {"format": FORMAT, "passed": self.has_passed} | asdict(self)

    def save(self, path: Path) -> None:
        """Write it as JSON.

        Raises:
            ConfigurationError: The file cannot be written.
        """
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(self.as_dict(), allow_nan=False) + "\n", encoding="utf-8")
        except OSError as error:
            raise ConfigurationError("--output", f"{path} cannot be written: {error.strerror}") from error

    @classmethod
    def load(cls, path: Path) -> Self:
        """Read what `save` wrote.

        Raises:
            ConfigurationError: The file cannot be read, or holds no run.
        """
        try:
            values = json.loads(path.read_text(encoding="utf-8"))
        except OSError as error:
            raise ConfigurationError(str(path), f"cannot be read: {error.strerror}") from error
        except ValueError as error:
            raise ConfigurationError(str(path), f"is no run of hm jitter: {error}") from error
        try:
            return cls._from_dict(values)
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise ConfigurationError(
                str(path),
                f"is no run of hm jitter of format {FORMAT}: {error!r}; give the run.json of --output",
            ) from error

    @classmethod
    def _from_dict(cls, values: dict[str, Any]) -> Self:
        if values["format"] != FORMAT:
            raise ValueError(f"format {values['format']}")
        fields = {name: value for name, value in values.items() if name not in ("format", "passed")}
        fields["scenarios"] = tuple(ScenarioResult.from_dict(value) for value in fields["scenarios"])
        if fields["cyclictest"] is not None:
            fields["cyclictest"] = CyclictestResult.from_dict(fields["cyclictest"])
        fields["checks"] = tuple(fields["checks"])
        return cls(**fields)

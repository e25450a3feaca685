"""Where a loop stands between two cycles, for another one to go on from there."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Checkpoint:
    """A loop on a virtual clock, which has missed no period, after a cycle without trip or error."""

    cycles: int
    """Cycles run; each sent one request."""
    state: list[float]
    """State of the cycle function."""
    set_point: list[float]
    """The set-point of the last cycle."""
    measurement: list[float]
    """The measurement of the last cycle."""
    changes: list[str]
    """Commands for the next request."""
    told: list[float]
    """What the springs were told last, laid out as their part of the state; NaN for nothing."""
    enabled: list[bool]
    """Which springs are enabled."""
    bias: tuple[float, float, float]
    """Bias force that was told last [N]."""
    heartbeat: int
    """The application's heartbeat, as last seen."""
    silence_ns: int
    """Time since it changed [ns]; negative before the first sign of life."""

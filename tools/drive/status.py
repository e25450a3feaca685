"""What ``state`` shows: one look at the device and at the loop, as text and as JSON."""

from typing import NamedTuple

from hm_driver.realtime.setpoint import LoopState
from tools.drive.trajectory import Vector

AXES = "xyz"
_MODES = ("admittance", "position", "releasing")


class DriveStatus(NamedTuple):
    """The device at one moment."""

    state: str
    """State of the device."""
    position: Vector
    """Measured position [m]."""
    velocity: Vector
    """Velocity [m/s]."""
    force: Vector
    """Force of the hand [N]."""
    modes: tuple[str, str, str] | None = None
    """Mode of each axis, ``admittance``, ``position`` or ``releasing``; None without a loop."""
    target: Vector | None = None
    """Where the loop's springs pull to [m]; of meaning on axes in position mode."""
    rate_hz: float | None = None
    """Cycles of the loop in a second; None without a loop."""
    cycles: int | None = None
    missed: int | None = None
    """Periods that the loop missed."""
    recording: str | None = None
    """The log that is being written."""

    @property
    def mode(self) -> str:
        """The mode in words: of all axes, or of each."""
        if self.modes is None:
            return "no loop"
        if len(set(self.modes)) == 1:
            return self.modes[0]
        return " ".join(f"{axis}:{mode}" for axis, mode in zip(AXES, self.modes, strict=True))

    def as_dict(self) -> dict[str, object]:
        """Plain values, for JSON."""
        return {
            "state": self.state,
            "mode": None if self.modes is None else dict(zip(AXES, self.modes, strict=True)),
            "position_m": list(self.position),
            "velocity_m_per_s": list(self.velocity),
            "force_n": list(self.force),
            "target_m": None if self.target is None else list(self.target),
            "rate_hz": self.rate_hz,
            "cycles": self.cycles,
            "missed_periods": self.missed,
            "recording": self.recording,
        }

    def line(self) -> str:
        """All of it on one line.

        >>> DriveStatus("stop", (0, 0, 0.1), (0, 0, 0), (0, 0, 1)).line()
        'stop, no loop  pos   +0.0   +0.0 +100.0 mm  vel   +0   +0   +0 mm/s  force  +0.0  +0.0  +1.0 N'
        """
        text = (
            f"{self.state}, {self.mode}  pos {_numbers(self.position, 1e3, '+6.1f')} mm  "
            f"vel {_numbers(self.velocity, 1e3, '+4.0f')} mm/s  force {_numbers(self.force, 1.0, '+5.1f')} N"
        )
        if self.rate_hz is not None:
            rate = f"{self.rate_hz:.0f}" if self.rate_hz else "?"
            text += f"  {rate} Hz, {self.missed} missed"
        return text + ("  recording" if self.recording else "")

    def rows(self) -> list[tuple[str, str]]:
        """All of it, a line each."""
        rows = [
            ("state", self.state),
            ("mode", self.mode),
            ("position", f"{_numbers(self.position, 1e3, '+.2f')} mm"),
            ("velocity", f"{_numbers(self.velocity, 1e3, '+.1f')} mm/s"),
            ("force", f"{_numbers(self.force, 1.0, '+.2f')} N"),
        ]
        if self.target is not None:
            rows.append(("target", f"{_numbers(self.target, 1e3, '+.2f')} mm"))
        if self.rate_hz is None:
            rows.append(("loop", "none; 'hold' or 'release' starts it"))
        else:
            total = (self.cycles or 0) + (self.missed or 0)
            rows.append(("loop", f"{self.rate_hz:.0f} Hz, {self.missed} of {total} periods missed"))
        return [*rows, ("recording", self.recording)] if self.recording else rows


class LoopMeter:
    """Turns the loop's counters into a rate."""

    def __init__(self) -> None:
        self._since: tuple[float, float] | None = None
        self._rate_hz = 0.0

    def rate_hz(self, state: LoopState) -> float:
        """Cycles in a second, over a tenth of a second or more."""
        if self._since is None or state.cycle < self._since[0]:
            self._since = (state.cycle, state.time_ns)
        cycles, elapsed_ns = state.cycle - self._since[0], state.time_ns - self._since[1]
        if elapsed_ns >= 1e8:
            self._rate_hz = cycles / (elapsed_ns * 1e-9)
            self._since = (state.cycle, state.time_ns)
        return self._rate_hz


def loop_modes(state: LoopState) -> tuple[str, str, str]:
    """The mode of each axis, in words."""
    x, y, z = (_MODES[int(value)] for value in (state.engaged_x, state.engaged_y, state.engaged_z))
    return x, y, z


def _numbers(vector: Vector, factor: float, form: str) -> str:
    return " ".join(format(factor * component + 0.0, form) for component in vector)

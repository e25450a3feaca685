"""The first run on a robot: asked for, slow and weak.

Whatever is not known to be our emulator is a robot. An emulator is known by its world endpoint, which no
robot has, and only where that endpoint tells the state and the position that the device tells. A host counts
as known once a run with reduced limits on it has ended in order; this is remembered in a file of the user.

    approach = approach_device("tcp://192.168.0.25", world=None, yes=False, terminal=terminal)
    modes, limits = approach.reduce(modes, limits, geometry)
    ...                     # the run
    approach.completed()    # only where it ended in order
"""

import json
import math
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import hm_driver
from emulator.world import WorldClient
from hm_driver.errors import ConfigurationError, HapticMasterError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime.modes import LimitOptions, ModeOptions
from hm_driver.transport.urls import parse_device_url
from tools.check.doubts import DOUBTS

SPEED = 0.1
"""Fastest joint of a first run; the arm is stopped above it [m/s]."""
FORCE = 10.0
"""Largest force of a first run: commanded, and of the hand [N]."""
_SPRING, _BIAS = 8.0, 2.0
"""Springs and the force feedback add up to the largest force [N]."""
_SAME_PLACE_M = 2e-4
_ANSWER = "yes"


class Terminal(NamedTuple):
    """Where a person is told and asked."""

    tell: Callable[[str], object]
    """Shows a line."""
    ask: Callable[[str], str] | None
    """Asks and returns the answer; None where nobody can answer."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Approach:
    """How a device may be driven."""

    host: str
    """The device, as it is remembered; empty for an emulator."""
    is_first_run: bool
    """Whether limits are reduced."""
    memory: Path
    """File of the hosts that are known."""

    def reduce(
        self, modes: ModeOptions, limits: LimitOptions, geometry: ArmGeometry
    ) -> tuple[ModeOptions, LimitOptions]:
        """The modes and limits of this run; in a first run none is above `SPEED` and `FORCE`."""
        if not self.is_first_run:
            return modes, limits
        joint = SPEED / limits.velocity_trip
        return (
            replace(
                modes,
                position_force_max=min(modes.position_force_max, _SPRING),
                assist_force_max=min(modes.assist_force_max, _SPRING),
            ),
            replace(
                limits,
                bias_max=min(limits.bias_max, _BIAS),
                reference_speed=min(limits.reference_speed, SPEED / 2.0),
                velocity_r=min(limits.velocity_r, joint),
                velocity_z=min(limits.velocity_z, joint),
                velocity_phi=min(limits.velocity_phi, joint / (geometry.r0 + geometry.r_max)),
                force_trip=min(limits.force_trip, FORCE),
            ),
        )

    def completed(self) -> None:
        """Remember that a run on this host ended in order; an emulator is not remembered.

        Raises:
            ConfigurationError: The file cannot be written.
        """
        if not self.host or not self.is_first_run:
            return
        known = _read(self.memory)
        known[self.host] = {"first_run": datetime.now(UTC).isoformat(timespec="seconds")}
        try:
            self.memory.parent.mkdir(parents=True, exist_ok=True)
            fresh = self.memory.with_suffix(f".{os.getpid()}.new")
            fresh.write_text(json.dumps(known, indent=2) + "\n", encoding="utf-8")
            fresh.replace(self.memory)
        except OSError as error:
            raise ConfigurationError(
                "state directory", f"{self.memory} cannot be written: {error}"
            ) from error


def approach_device(
    url: str, *, world: str | None, yes: bool, terminal: Terminal, memory: Path | None = None
) -> Approach:
    """Find out whether a device is a robot, and ask before it is driven for the first time.

    Args:
        url: The device.
        world: World endpoint of an emulator, as the user named it; None for none.
        yes: Whether the user has answered on the command line (``--yes-real-robot``).
        terminal: Where a person is told and asked.
        memory: File of the known hosts; None for the user's.

    Raises:
        ConfigurationError: Nobody said yes.
        TransportError: The device or the world endpoint cannot be reached.
    """
    memory = memory or memory_path()
    if is_emulator(url, world):
        return Approach(host="", is_first_run=False, memory=memory)
    target = parse_device_url(url)
    host = f"{target.host}:{target.port}" if target.host else target.url
    known = _read(memory).get(host)
    if known is not None:
        terminal.tell(f"{host} is taken for a robot; its first run was on {known.get('first_run', 'record')}")
        return Approach(host=host, is_first_run=False, memory=memory)
    for line in _warning(host, memory):
        terminal.tell(line)
    if not (yes or _is_confirmed(terminal)):
        raise ConfigurationError(
            "--device", f"{host} is taken for a robot, and nobody confirmed its first run: --yes-real-robot"
        )
    return Approach(host=host, is_first_run=True, memory=memory)


def is_emulator(url: str, world: str | None) -> bool:
    """Whether a device is an emulator beyond doubt; asks both, and moves nothing.

    Raises:
        TransportError: One of them cannot be reached.
        ConfigurationError: The world endpoint belongs to another emulator.
    """
    if parse_device_url(url).scheme == "sim":
        return True
    if world is None:
        return False
    client = WorldClient(world)
    try:
        arm = hm_driver.connect(url)
        try:
            truth = client.observe()
            told = (arm.state.value, arm.measured_position())
        finally:
            arm.close()
    finally:
        client.close()
    if told[0] != truth.state or math.dist(told[1], truth.position) > _SAME_PLACE_M:
        raise ConfigurationError(
            "--world",
            f"{world} tells state {truth.state} at {truth.position} m, the device at {url} tells "
            f"{told[0]} at {told[1]} m: they are not one emulator; for a robot, leave --world out",
        )
    return True


def memory_path() -> Path:
    """File of the hosts on which a first run has ended in order."""
    if sys.platform == "win32":
        base = Path(os.environ.get("LOCALAPPDATA") or Path.home() / "AppData" / "Local")
    else:
        base = Path(os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state")
    return base / "hapticmaster" / "robots.json"


def _read(path: Path) -> dict[str, dict[str, str]]:
    """The known hosts; a file that cannot be read knows none, which is the careful reading."""
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return {k: v for k, v in known.items() if isinstance(v, dict)} if isinstance(known, dict) else {}


def _warning(host: str, memory: Path) -> list[str]:
    return [
        f"{host} is not known to be an emulator, so it is taken for a robot. This is the first run on it.",
        f"The arm is stopped above {SPEED:g} m/s of a joint or {FORCE:g} N of the hand, and commanded forces",
        f"stay below {FORCE:g} N. After a run that ends in order the configured limits hold; {memory}",
        "remembers that. Read docs/safety.md, and have the emergency button in somebody's hand.",
        "What rests on facts that are not sure (M one source, L inferred, C our choice):",
        *(f"  {doubt.confidence}  {doubt.fact}: {doubt.consequence}" for doubt in DOUBTS),
    ]


def _is_confirmed(terminal: Terminal) -> bool:
    if terminal.ask is None:
        return False
    try:
        return terminal.ask(f"Type {_ANSWER} to go on: ").strip().lower() == _ANSWER
    except (EOFError, HapticMasterError):
        return False

"""Bring the device up for the loop, and down behind it, as published programs do.

``remove all``, ``get os``, emergency button and relay, ``set state init`` and poll where the position is not
calibrated, ``set state force``, ``remove all``, ``set inertia``, create the springs; at the end
``set state stop``, ``remove all``.
"""

from collections.abc import Callable
from typing import NamedTuple

from hm_driver.errors import DeviceError, DeviceFault
from hm_driver.protocol.numbers import format_number
from hm_driver.protocol.replies import parse_bool, parse_vector, parse_word
from hm_driver.realtime.clock import Clock
from hm_driver.realtime.measurements import CycleLink
from hm_driver.realtime.options import BIAS_NAME, SPRING_NAMES, LoopOptions

_POLL_NS = 20_000_000
_DIRECTIONS = ("[1,0,0]", "[0,1,0]", "[0,0,1]", "[0,0,1]")


class DeviceInfo(NamedTuple):
    """What the device said while it was brought up."""

    os: str
    was_calibrated: bool
    """Whether the search for the end stops was skipped."""
    workspace_r: tuple[float, float, float]
    """Lower end stop, distance to the column's axis, upper end stop [m]."""
    workspace_phi: tuple[float, float, float]
    """Lower end stop, unused, upper end stop [rad]."""
    workspace_z: tuple[float, float, float]
    """Lower end stop, unused, upper end stop [m]."""

    def describe(self) -> str:
        """One line for a log or a person."""
        (r0, _, r1), (p0, _, p1), (z0, _, z1) = self.workspace_r, self.workspace_phi, self.workspace_z
        return (
            f"{self.os}, r {r0:g} to {r1:g} m, phi {p0:g} to {p1:g} rad, z {z0:g} to {z1:g} m, "
            f"{'already calibrated' if self.was_calibrated else 'initialised'}"
        )


def initialise(
    link: CycleLink, clock: Clock, *, timeout_s: float, on_poll: Callable[[], object] | None = None
) -> DeviceInfo:
    """Bring the device to state ``stop``, calibrated and without objects.

    Args:
        link: Connection of the loop.
        clock: What the time-out is measured on; waiting on it moves a virtual one.
        timeout_s: How long the search for the end stops may take [s].
        on_poll: Called whenever the state was polled; what it raises ends the wait.

    Raises:
        DeviceFault: The emergency button is pushed, its relay is open, or ``init`` does not end.
        DeviceError: The device refused a command.
        TransportError: The device does not answer.
    """
    ask(link, "remove all")
    system = parse_word(ask(link, "get os"))
    _check_emergency(link)
    is_calibrated = parse_bool(ask(link, "get position_calibrated"))
    if not is_calibrated:
        _initialise(link, clock, timeout_s, on_poll)
    return DeviceInfo(
        system,
        is_calibrated,
        parse_vector(ask(link, "get workspace_r")),
        parse_vector(ask(link, "get workspace_phi")),
        parse_vector(ask(link, "get workspace_z")),
    )


def enter_session(link: CycleLink, options: LoopOptions) -> None:
    """Enter the session's state, and make the springs and the bias force, all but the last one disabled.

    Raises:
        DeviceFault: The device does not enter the state.
        DeviceError: The device refused a command.
        TransportError: The device does not answer.
    """
    state = options.state
    ask(link, f"set state {state}")
    reached = parse_word(ask(link, "get state"))
    if reached != state:
        raise DeviceFault(
            f"the device was told to enter state '{state}' and is in '{reached}'; "
            "look at the emergency button"
        )
    for command in session_commands(options):
        ask(link, command)


def session_commands(options: LoopOptions) -> list[str]:
    """Commands that make the session's objects."""
    modes = options.modes
    position = (modes.position_stiffness, modes.position_damping_ratio, modes.position_force_max)
    assist = (modes.assist_stiffness, modes.assist_damping_ratio, modes.assist_force_max)
    commands = [
        "remove all",
        f"set inertia {format_number(modes.inertia)}",
        f"set coulombfriction {format_number(modes.coulomb_friction)}",
    ]
    springs = (position, position, position, assist)
    for name, direction, spring in zip(SPRING_NAMES, _DIRECTIONS, springs, strict=True):
        stiffness, ratio, force_max = map(format_number, spring)
        commands += [
            f"create spring {name}",
            f"set {name} stiffness {stiffness}",
            f"set {name} dampfactor {ratio}",
            f"set {name} maxforce {force_max}",
            f"set {name} direction {direction}",
        ]
    return [
        *commands,
        f"create biasforce {BIAS_NAME}",
        f"set {BIAS_NAME} force [0,0,0]",
        f"set {BIAS_NAME} enable",
    ]


def make_safe(link: CycleLink) -> None:
    """Stop the device, then remove its objects: the stop comes first, everything else may fail.

    Raises:
        DeviceError: The device refused to stop.
        TransportError: The device does not answer.
    """
    ask(link, "set state stop")


def clear(link: CycleLink) -> None:
    """Remove the session's objects from a device that was stopped; raises as `make_safe`."""
    ask(link, "remove all")


def ask(link: CycleLink, command: str) -> str:
    """Exchange one command, and return its reply without the closing ``;``.

    Raises:
        DeviceError: The device refused the command.
        TransportError: The device does not answer.
    """
    return link.exchange(command).rstrip("; ")


def _check_emergency(link: CycleLink) -> None:
    if parse_bool(ask(link, "get emergencybuttonpushed")):
        raise DeviceFault("the emergency button is pushed; release it, and start again")
    try:
        ask(link, "get emergencyrelay")
    except DeviceError:
        return  # asked because programs do; which value means "closed" is not known


def _initialise(
    link: CycleLink, clock: Clock, timeout_s: float, on_poll: Callable[[], object] | None
) -> None:
    ask(link, "set state init")
    started_ns = clock.now_ns()
    while (state := parse_word(ask(link, "get state"))) != "stop":
        waited_s = (clock.now_ns() - started_ns) * 1e-9
        if waited_s > timeout_s:
            raise DeviceFault(
                f"the device is still in state '{state}' {waited_s:.1f} s after 'set state init', "
                f"{timeout_s:g} s are allowed; look at the emergency button and for obstacles"
            )
        if on_poll is not None:
            on_poll()
        clock.sleep_until_ns(clock.now_ns() + _POLL_NS)
    if not parse_bool(ask(link, "get position_calibrated")):
        raise DeviceFault("the device ended 'init' without a calibrated position; look at the arm's way")

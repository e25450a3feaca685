"""Carries out requests to the world endpoint, whoever brings them."""

import json
from collections.abc import Mapping
from typing import Any, NamedTuple

from emulator.device import EmulatedDevice
from emulator.faults import FaultInjector
from emulator.grid import steps_until
from emulator.world import Hand, Truth, Vector, WorldError, fault_request
from hm_driver.errors import ConfigurationError

MAX_LINE = 4096
"""Longest request [bytes]."""
MAX_ADVANCE_S = 10.0
"""Longest time to pass at one request [s]."""

_ZERO = (0.0, 0.0, 0.0)


class _Limits(NamedTuple):
    low: float
    high: float
    is_required: bool


HAND_LIMITS = {
    "position": _Limits(-2.0, 2.0, is_required=True),
    "velocity": _Limits(-20.0, 20.0, is_required=False),
    "stiffness": _Limits(0.0, 20e3, is_required=True),
    "damping": _Limits(0.0, 2e3, is_required=True),
    "force": _Limits(-500.0, 500.0, is_required=False),
}
"""Range of each number of a hand, in the order of `parse_hand`."""


class WorldService:
    """Carries out requests to the world endpoint, whoever brings them.

    Args:
        device: The device whose arm is held.
        faults: Where faults are injected.
        is_lockstep: Whether time passes on request.
    """

    def __init__(self, device: EmulatedDevice, faults: FaultInjector, *, is_lockstep: bool = False) -> None:
        self._device = device
        self._faults = faults
        self._is_lockstep = is_lockstep
        self._time_ns = 0
        self._holder: object = None
        self.missed = 0
        """Missed periods, as the server counts them."""

    def answer(self, line: bytes, *, asker: object = None) -> bytes:
        """Reply line to a request line; refusals are replies too, nothing is raised.

        Args:
            line: One JSON object.
            asker: Whoever asks; the hand that he sets is let go by `lost`.
        """
        try:
            request = _parse_object(line)
            truth = self.carry_out(request)
        except WorldError as error:
            return json.dumps({"error": str(error)}).encode() + b"\n"
        if "hand" in request:
            self._holder = asker
        return json.dumps(truth._asdict()).encode() + b"\n"

    def lost(self, asker: object) -> None:
        """Have the hand let go if `asker`, who is gone, set it last."""
        if asker is not None and self._holder is asker:
            self._holder = None
            self.let_go()

    def carry_out(self, request: Mapping[str, Any]) -> Truth:
        """Carry out one request.

        Raises:
            WorldError: Something unknown, malformed or out of range; says what would be accepted.
        """
        unknown = set(request) - {"hand", "advance_s", "fault"}
        if unknown:
            raise WorldError(f"unknown key {min(unknown)!r}; accepted: hand, advance_s, fault")
        hand = parse_hand(request["hand"]) if request.get("hand") is not None else None
        advance_s = self._parse_advance(request["advance_s"]) if "advance_s" in request else 0.0
        if "fault" in request:
            self._change_faults(request["fault"])
        if hand is not None:
            self.hold(hand)
        elif "hand" in request:
            self.let_go()
        if advance_s:
            self._time_ns += round(advance_s * 1e9)
            self.advance_to_ns(self._time_ns)
        return self.truth()

    def advance_to_ns(self, time_ns: int) -> None:
        """Run the device up to a time [ns], in lock-step: floor(t * 2500) steps in all."""
        self._time_ns = max(self._time_ns, time_ns)
        due = steps_until(time_ns) - self._device.step
        if due > 0:
            self._device.advance(due)

    def hold(self, hand: tuple[Vector, Vector, Vector, Vector, Vector]) -> None:
        """Have a hand hold the arm: position, velocity, stiffness, damping, force."""
        position, velocity, stiffness, damping, force = hand
        self._device.arm.set_hand(position, velocity, stiffness, damping, force)

    def let_go(self) -> None:
        """Have the hand let go."""
        self._device.arm.release_hand()

    def truth(self) -> Truth:
        """What is true now."""
        device = self._device
        truth = device.arm.truth()
        return Truth(
            time_s=device.time_s,
            step=device.step,
            position=truth.tip_position,
            velocity=truth.tip_velocity,
            hand_force=truth.hand_force,
            contact_force=truth.contact_force,
            state=device.state.value,
            fault=device.machine.fault_reason,
            missed=self.missed,
            faults=self._faults.active_kinds(),
        )

    def _change_faults(self, request: object) -> None:
        try:
            self._faults.carry_out(request)
        except ConfigurationError as error:
            raise WorldError(str(error)) from error

    def _parse_advance(self, value: object) -> float:
        if not self._is_lockstep:
            raise WorldError("advance_s: this emulator follows the wall clock; start it with --lockstep")
        if (
            isinstance(value, bool)
            or not isinstance(value, (int, float))
            or not 0.0 <= value <= MAX_ADVANCE_S
        ):
            raise WorldError(f"advance_s: {_shown(value)} must be a number of 0 to {MAX_ADVANCE_S:g} s")
        return float(value)


class LocalWorld:
    """The world endpoint of an emulator in this process."""

    def __init__(self, service: WorldService) -> None:
        self._service = service

    def exchange(self, hand: Hand | None) -> Truth:
        """Hold the arm as `hand` says, or let go for None; returns what is true now.

        Raises:
            WorldError: A malformed hand.
        """
        if hand is None:
            self._service.let_go()
        else:
            self._service.hold(parse_hand(hand))
        return self._service.truth()

    def observe(self) -> Truth:
        """What is true now, without touching the arm."""
        return self._service.truth()

    def inject(
        self, kind: str, *, value: float | Vector | None = None, duration_s: float | None = None
    ) -> Truth:
        """Let a fault happen; see `WorldClient.inject`."""
        return self._service.carry_out({"fault": fault_request(kind, value, duration_s)})

    def clear_faults(self, kind: str = "all") -> Truth:
        """End one kind of injected fault, or all."""
        return self._service.carry_out({"fault": {"clear": kind}})

    def release(self) -> None:
        """Let the arm go."""
        self._service.let_go()

    def close(self) -> None:
        """Let the arm go."""
        self._service.let_go()


def parse_hand(hand: object) -> tuple[Vector, Vector, Vector, Vector, Vector]:
    """Check a hand: position, velocity, stiffness, damping, force.

    Raises:
        WorldError: Unknown or missing field, wrong form or out of range; says what would be accepted.
    """
    if not isinstance(hand, Mapping):
        raise WorldError(f"hand: {_shown(hand)} must be null or an object with {', '.join(HAND_LIMITS)}")
    unknown = set(hand) - set(HAND_LIMITS)
    if unknown:
        raise WorldError(f"hand: unknown key {min(unknown)!r}; accepted: {', '.join(HAND_LIMITS)}")
    position, velocity, stiffness, damping, force = (
        _parse_field(hand, name, limits) for name, limits in HAND_LIMITS.items()
    )
    return position, velocity, stiffness, damping, force


def _parse_field(hand: Mapping[str, Any], name: str, limits: _Limits) -> Vector:
    if name not in hand:
        if limits.is_required:
            raise WorldError(f"hand.{name} is missing")
        return _ZERO
    low, largest = limits.low, limits.high
    try:
        x, y, z = hand[name]
        is_number = bool not in (type(x), type(y), type(z))
        if is_number and low <= x <= largest and low <= y <= largest and low <= z <= largest:
            return float(x), float(y), float(z)
    except (TypeError, ValueError):
        pass
    raise WorldError(f"hand.{name}: {_shown(hand[name])} must be three numbers of {low:g} to {largest:g}")


def _parse_object(line: bytes) -> Mapping[str, Any]:
    try:
        request = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise WorldError(f"no JSON: {error}; accepted: one JSON object a line") from None
    if not isinstance(request, dict):
        raise WorldError(f"{_shown(request)} is no JSON object")
    return request


def _shown(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 40 else f"{text[:37]}..."

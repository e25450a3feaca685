"""Faults on demand: of the link, of the sensors, of power and of the initialisation.

They come from Python, over the world endpoint, from the command line, or from a schedule in TOML, in
device time::

    [[fault]]
    at_s = 5.0
    kind = "reply_delay"
    value = 0.02        # unit and range as `KINDS` says; left out where the kind has no value
    duration_s = 1.0    # left out: until it is cleared
"""

import difflib
import random
import tomllib
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from emulator.device import EmulatedDevice, InitOutcome
from emulator.grid import STEP_RATE_HZ
from hm_driver.errors import ConfigurationError

Value = float | tuple[float, float, float] | None
_LONGEST_S = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class FaultKind:
    """What one kind of fault does, and what it takes."""

    doc: str
    size: int = 0
    """Numbers of its value: 0, 1, or 3 for a vector."""
    unit: str = ""
    low: float = 0.0
    high: float = 0.0
    is_momentary: bool = False
    """It happens at once and needs no end."""

    def expected(self) -> str:
        """Say what value is accepted."""
        if not self.size:
            return "no value"
        form = "a number" if self.size == 1 else "three numbers"
        return f"{form} of {self.low:g} to {self.high:g} {self.unit}".rstrip()


KINDS: dict[str, FaultKind] = {
    "reply_delay": FaultKind(doc="every reply waits", size=1, unit="s", high=60.0),
    "reply_jitter": FaultKind(doc="every reply waits a random time", size=1, unit="s", high=60.0),
    "reply_lost": FaultKind(doc="a reply is never sent, this often", size=1, high=1.0),
    "reply_corrupted": FaultKind(doc="a reply has a wrong bit, this often", size=1, high=1.0),
    "reply_error": FaultKind(doc="a command is answered by an error, this often", size=1, high=1.0),
    "reply_split": FaultKind(doc="the second half of every reply comes later", size=1, unit="s", high=10.0),
    "reply_merged": FaultKind(doc="replies wait until there are as many", size=1, low=2.0, high=16.0),
    "frozen": FaultKind(doc="requests are neither carried out nor answered; the arm goes on"),
    "connection_reset": FaultKind(doc="every connection of a client is reset", is_momentary=True),
    "force_bias": FaultKind(doc="the force sensor reads too much", size=3, unit="N", low=-500.0, high=500.0),
    "force_noise": FaultKind(doc="the force sensor is noisier by this factor", size=1, low=1.0, high=10e3),
    "force_stuck": FaultKind(doc="the force sensor stays at its last reading"),
    "encoder_jump": FaultKind(doc="encoders read too much", size=3, unit="m, rad, m", low=-0.5, high=0.5),
    "emergency_button": FaultKind(doc="the emergency button is pushed, until this ends"),
    "relay_off": FaultKind(doc="the emergency relay is open, until this ends"),
    "init_fails": FaultKind(doc="an initialisation ends in state fault"),
    "init_never_ends": FaultKind(doc="an initialisation goes on and on"),
    "init_takes": FaultKind(doc="an initialisation takes this long", size=1, unit="s", high=600.0),
}  # fmt: skip
"""Every kind of fault by name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """One fault, checked.

    Raises:
        ConfigurationError: Unknown kind, or a value or a time out of range.
    """

    kind: str
    value: Value = None
    duration_s: float | None = None
    """Device time until it ends by itself [s]; None: until it is cleared."""
    at_s: float = 0.0
    """Device time at which it begins [s]."""

    def __post_init__(self) -> None:
        kind = KINDS.get(self.kind) if isinstance(self.kind, str) else None
        if kind is None:
            raise ConfigurationError("fault.kind", _unknown(self.kind, KINDS))
        if not _fits(self.value, kind):
            raise ConfigurationError(
                "fault.value", f"{self.kind} takes {kind.expected()}, not {self.value!r}"
            )
        for name, seconds in (("duration_s", self.duration_s), ("at_s", self.at_s)):
            if seconds is not None and not (_is_number(seconds) and 0.0 <= seconds <= _LONGEST_S):
                raise ConfigurationError(f"fault.{name}", f"{seconds!r} must be 0 to {_LONGEST_S:g} s")


@dataclass(slots=True)
class LinkFaults:
    """What happens to replies on their way; the server asks at every reply."""

    delay_s: float = 0.0
    jitter_s: float = 0.0
    lost: float = 0.0
    corrupted: float = 0.0
    error: float = 0.0
    split_s: float = 0.0
    merged: int = 1
    is_frozen: bool = False
    resets: int = 0
    """How many times the connections were to be reset so far."""
    is_active: bool = False
    """Whether anything but the count of resets differs from a healthy link."""


class FaultInjector:
    """Begins and ends faults, at once or at a device time.

    Args:
        device: The device that they befall.
        seed: Of everything random about them.
    """

    def __init__(self, device: EmulatedDevice, *, seed: int = 0) -> None:
        self.link = LinkFaults()
        self.random = random.Random(seed)
        self._device = device
        self._active: dict[str, Value] = {}
        self._normal_init_seconds = device.init_seconds
        self._effects: dict[str, Callable[[Value], None]] = {
            "force_bias": lambda _: self._set_sensor(),
            "force_noise": lambda _: self._set_sensor(),
            "force_stuck": lambda _: self._set_sensor(),
            "encoder_jump": lambda value: device.arm.set_encoder_offset(_vector(value)),
            "emergency_button": lambda _: device.set_emergency(
                button_pushed="emergency_button" in self._active
            ),
            "relay_off": lambda _: device.set_emergency(relay_closed="relay_off" not in self._active),
            "init_fails": lambda _: self._set_init(),
            "init_never_ends": lambda _: self._set_init(),
            "init_takes": lambda _: self._set_init(),
        }

    def active_kinds(self) -> tuple[str, ...]:
        """The kinds that are active now."""
        return tuple(self._active)

    def schedule(self, faults: Iterable[Fault]) -> None:
        """Have faults begin at their times; those whose time has come begin at the next step."""
        for fault in faults:
            due = round(fault.at_s * STEP_RATE_HZ)
            self._device.agenda.enter(due, lambda fault=fault: self.inject(fault), topic="fault schedule")  # type: ignore[misc]  # mypy cannot infer a lambda's default

    def inject(self, fault: Fault) -> None:
        """Have a fault begin now; one of its kind that is active is replaced."""
        agenda = self._device.agenda
        agenda.strike_out(f"end of {fault.kind}")
        if fault.kind == "connection_reset":
            self.link.resets += 1
            return
        self._active[fault.kind] = fault.value
        self._apply(fault.kind, fault.value)
        if fault.duration_s is not None:
            end = self._device.step + max(1, round(fault.duration_s * STEP_RATE_HZ))
            agenda.enter(end, lambda: self.clear(fault.kind), topic=f"end of {fault.kind}")

    def clear(self, kind: str = "all") -> None:
        """End one kind of fault, or all that are active.

        Raises:
            ConfigurationError: No such kind.
        """
        if kind != "all" and kind not in KINDS:
            raise ConfigurationError("fault.clear", _unknown(kind, ("all", *KINDS)))
        for name in tuple(self._active) if kind == "all" else (kind,):
            if name in self._active:
                del self._active[name]
                self._device.agenda.strike_out(f"end of {name}")
                self._apply(name, None)

    def carry_out(self, request: object) -> None:
        """Carry out the ``fault`` of a request to the world endpoint.

        Raises:
            ConfigurationError: Not a fault; says what would be accepted.
        """
        if isinstance(request, Mapping) and set(request) == {"clear"} and isinstance(request["clear"], str):
            self.clear(request["clear"])
        else:
            self.inject(parse_fault(request))

    def _apply(self, kind: str, value: Value) -> None:
        effect = self._effects.get(kind)
        if effect is not None:
            effect(value)
            return
        link, active = self.link, self._active
        link.delay_s = _number(active.get("reply_delay"))
        link.jitter_s = _number(active.get("reply_jitter"))
        link.lost = _number(active.get("reply_lost"))
        link.corrupted = _number(active.get("reply_corrupted"))
        link.error = _number(active.get("reply_error"))
        link.split_s = _number(active.get("reply_split"))
        link.merged = round(_number(active.get("reply_merged"), 1.0))
        link.is_frozen = "frozen" in active
        link.is_active = link.is_frozen or any(name.startswith("reply_") for name in active)

    def _set_sensor(self) -> None:
        active = self._active
        self._device.arm.set_sensor_fault(
            bias=_vector(active.get("force_bias")),
            noise=_number(active.get("force_noise"), 1.0),
            stuck="force_stuck" in active,
        )

    def _set_init(self) -> None:
        device, active = self._device, self._active
        if "init_never_ends" in active:
            device.init_outcome = InitOutcome.NEVER_ENDS
        else:
            device.init_outcome = InitOutcome.FAILS if "init_fails" in active else InitOutcome.NORMAL
        device.init_seconds = _number(active.get("init_takes"), self._normal_init_seconds)


def parse_fault(entry: object, *, is_scheduled: bool = False) -> Fault:
    """Check a fault that came as data.

    Raises:
        ConfigurationError: Unknown or missing key, unknown kind, value or time out of range.
    """
    accepted = {"kind", "value", "duration_s"} | ({"at_s"} if is_scheduled else set())
    if not isinstance(entry, Mapping) or "kind" not in entry or set(entry) - accepted:
        raise ConfigurationError(
            "fault", f"{entry!r:.60} must have kind, and may have {', '.join(sorted(accepted))}"
        )
    fields: dict[str, Any] = dict(entry)
    if isinstance(fields.get("value"), list):
        fields["value"] = tuple(fields["value"])
    return Fault(**fields)


def load_schedule(path: Path) -> tuple[Fault, ...]:
    """Read a schedule of faults.

    Raises:
        ConfigurationError: The file cannot be read, or an entry is wrong; names file and entry.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigurationError("faults", f"cannot be read: {error}", source=str(path)) from error
    entries = document.get("fault", [])
    if set(document) - {"fault"} or not isinstance(entries, list):
        raise ConfigurationError("faults", "must consist of [[fault]] tables", source=str(path))
    faults = []
    for number, entry in enumerate(entries, start=1):
        try:
            faults.append(parse_fault(entry, is_scheduled=True))
        except ConfigurationError as error:
            raise ConfigurationError(
                f"{error.field} (entry {number})", error.problem, source=str(path)
            ) from error
    return tuple(faults)


def _unknown(kind: object, accepted: Collection[str]) -> str:
    near = difflib.get_close_matches(str(kind), list(accepted), n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    return f"{kind!r:.60} is unknown; {hint}accepted: {', '.join(accepted)}"


def _fits(value: object, kind: FaultKind) -> bool:
    if kind.size == 0:
        return value is None
    numbers = (value,) if kind.size == 1 else value
    if not isinstance(numbers, tuple) or len(numbers) != kind.size:
        return False
    return all(_is_number(number) and kind.low <= number <= kind.high for number in numbers)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _number(value: Value, default: float = 0.0) -> float:
    return value if isinstance(value, (int, float)) else default


def _vector(value: Value) -> tuple[float, float, float]:
    return value if isinstance(value, tuple) else (0.0, 0.0, 0.0)

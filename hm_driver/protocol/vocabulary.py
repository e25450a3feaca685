"""The command language as data: quantities, states, object types, their parameters and the reply texts.

Both sides read it: the driver to know what it may ask and what answers to expect, the emulator to answer.
Names, units and the reply texts are device facts (``docs/fidelity.md``). No source gives the device's ranges
and defaults, save the virtual mass of at least 2 kg: all other `low`, `high` and `default` are choices of
ours, wide enough for every value that published programs use. The driver does not enforce them; the device
answers.
"""

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass
from enum import Enum
from types import MappingProxyType

from hm_driver.errors import ProtocolError

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
Value = bool | float | str | Vector | Quaternion
"""What a command can carry: a bool, a number, a word, a vector or a quaternion [x, y, z, w]."""


class State(Enum):
    """State of the device; not to be mixed up with a mode of the driver loop."""

    OFF = "off"
    """Unpowered."""
    INIT = "init"
    """Calibrating the force sensor and searching the end stops; goes to `STOP` by itself."""
    STOP = "stop"
    """Powered, renders nothing."""
    POSITION = "position"
    """Powered, renders effects, does not respond to the force sensor."""
    FORCE = "force"
    """Admittance: responds to the force sensor by Newton's law."""
    HOME = "home"
    """Drives to the home pose."""
    FAULT = "fault"
    """A guard tripped; can be read, never set (a choice of the emulator, not known of the device)."""


SETTABLE_STATES = tuple(state.value for state in State if state is not State.FAULT)
"""The words that ``set state`` takes."""


class Kind(Enum):
    """Form of a value."""

    NUMBER = "a number"
    VECTOR = "a vector [x,y,z]"
    UNIT_VECTOR = "a direction [x,y,z]"
    """A vector other than zero; the device normalises it (a choice)."""
    QUATERNION = "a quaternion [x,y,z,w]"
    """Four numbers, not all zero; the device normalises them (a choice)."""
    BOOL = "true or false"
    WORD = "a word"


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One value of an object or of the device, as the command language knows it."""

    name: str
    kind: Kind
    unit: str
    """SI unit; "" for a word, a truth value or a pure number."""
    doc: str
    default: Value
    reply: str
    """Text that acknowledges a ``set``; "" where the value can only be read."""
    low: float = -math.inf
    """Smallest number, or component of a vector, that is accepted."""
    high: float = math.inf
    """Largest number, or component of a vector, that is accepted."""
    zero_allowed: bool = False
    """Whether a direction may be [0,0,0], which unsets it."""
    words: tuple[str, ...] = ()
    """The words that are accepted, for `Kind.WORD`."""

    def check(self, value: Value) -> Value:
        """Return the value as the device keeps it: directions and quaternions with unit length.

        Raises:
            ProtocolError: Wrong form or out of range; the text names what would be accepted.
        """
        checked = self.check_form(value)
        if self.kind is Kind.NUMBER or self.kind is Kind.VECTOR:
            for component in checked if isinstance(checked, tuple) else (checked,):
                if not self.low <= float(component) <= self.high:
                    raise self._refusal(value, "is out of range")
        return checked

    def check_form(self, value: Value) -> Value:
        """As `check`, without the range, which is the device's to judge.

        Raises:
            ProtocolError: Wrong form.
        """
        if self.kind is Kind.BOOL or self.kind is Kind.WORD:
            return self._check_word(value)
        if self.kind is not Kind.NUMBER:
            return self._check_components(value)
        if isinstance(value, (bool, str, tuple)) or not math.isfinite(value):
            raise self._refusal(value, "is no finite number")
        return value

    def expected(self) -> str:
        """Say what is accepted: form, range and unit."""
        if self.words:
            return " ".join(self.words)
        text = self.kind.value
        if math.isfinite(self.low) or math.isfinite(self.high):
            text += f" {self.low:g} to {self.high:g}"
        return f"{text} {self.unit}".rstrip()

    def _check_word(self, value: Value) -> Value:
        if self.kind is Kind.BOOL and not isinstance(value, bool):
            raise self._refusal(value, "is no truth value")
        if self.kind is Kind.WORD and value not in self.words:
            raise self._refusal(value, "is unknown")
        return value

    def _check_components(self, value: Value) -> Value:
        size = 4 if self.kind is Kind.QUATERNION else 3
        if not isinstance(value, tuple) or len(value) != size:
            raise self._refusal(value, f"has not {size} components")
        if not all(math.isfinite(component) for component in value):
            raise self._refusal(value, "is not finite")
        if self.kind is Kind.VECTOR:
            return value
        length = math.hypot(*value)
        if length < 1e-9 and self.zero_allowed:
            return value
        if not 1e-9 <= length < 1e150:
            raise self._refusal(value, "has no direction")
        x, y, z = (component / length for component in value[:3])
        return (x, y, z) if len(value) == 3 else (x, y, z, value[3] / length)

    def _refusal(self, value: Value, problem: str) -> ProtocolError:
        shown = str(value).replace(" ", "")
        shown = shown if len(shown) <= 24 else f"{shown[:21]}..."
        return ProtocolError(f"{self.name} {shown} {problem}; accepted: {self.expected()}")


@dataclass(frozen=True, slots=True, kw_only=True)
class ObjectType:
    """A type of effect or shape that ``create`` knows."""

    name: str
    doc: str
    is_shape: bool
    parameters: MappingProxyType[str, Parameter]
    """By name, with the ones that every object has: pos, vel, att."""

    def parameter(self, name: str) -> Parameter:
        """Look up a parameter.

        Raises:
            ProtocolError: This type has no such parameter; the text lists those that it has.
        """
        try:
            return self.parameters[name]
        except KeyError:
            known = " ".join(self.parameters)
            raise ProtocolError(f"{self.name} has no {name[:24]!r}; accepted: {known}") from None


def _index(parameters: Iterable[Parameter]) -> MappingProxyType[str, Parameter]:
    return MappingProxyType({parameter.name: parameter for parameter in parameters})


def _number(
    name: str, unit: str, doc: str, reply: str, *, default: float, low: float = 0.0, high: float
) -> Parameter:
    return Parameter(
        name=name, kind=Kind.NUMBER, unit=unit, doc=doc, default=default, reply=reply, low=low, high=high
    )


def _vector(
    name: str, unit: str, doc: str, reply: str, *, default: Vector, low: float, high: float
) -> Parameter:
    return Parameter(
        name=name, kind=Kind.VECTOR, unit=unit, doc=doc, default=default, reply=reply, low=low, high=high
    )


def _direction(name: str, doc: str, reply: str, *, default: Vector, zero_allowed: bool = False) -> Parameter:
    return Parameter(
        name=name,
        kind=Kind.UNIT_VECTOR,
        unit="",
        doc=doc,
        default=default,
        reply=reply,
        zero_allowed=zero_allowed,
    )


def _flag(name: str, doc: str, reply: str, *, default: bool) -> Parameter:
    return Parameter(name=name, kind=Kind.BOOL, unit="", doc=doc, default=default, reply=reply)


_ZERO = (0.0, 0.0, 0.0)

COMMON_PARAMETERS = (
    _vector("pos", "m", "Position", "Effect's position set", default=_ZERO, low=-2.0, high=2.0),
    _vector("vel", "m/s", "Velocity", "Effect's velocity set", default=_ZERO, low=-10.0, high=10.0),
    Parameter(
        name="att",
        kind=Kind.QUATERNION,
        unit="",
        doc="Attitude, quaternion [x,y,z,w]",
        default=(0.0, 0.0, 0.0, 1.0),
        reply="Effect's attitude set",
    ),
)
"""Parameters of every object."""


def _spring_like(owner: str) -> tuple[Parameter, ...]:
    """Parameters that springs and shakers share; `owner` begins the reply texts."""
    return (
        _number("stiffness", "N/m", "Stiffness", f"{owner}'s stiffness set", default=0.0, high=100e3),
        _number("dampfactor", "", "Damping ratio", f"{owner}'s damp factor set", default=0.0, high=100.0),
        _number(
            "deadband", "m", "Free play about the position", f"{owner}'s deadband set", default=0.0, high=1.0
        ),
        _number("maxforce", "N", "Largest force", f"{owner}'s maximum force set", default=250.0, high=1000.0),
    )


_SPRING = (
    *_spring_like("Spring"),
    _direction(
        "direction",
        "Axis of the spring; [0,0,0], the default, for all three",
        "Spring's direction set",
        default=_ZERO,
        zero_allowed=True,
    ),
    _flag("dampglobal", "Damp the motion against the world", "Spring's damping global set", default=False),
)

_DAMPER = (
    _vector(
        "dampcoef",
        "N·s/m",
        "Coefficient per axis",
        "Damper's damp coefficient set",
        default=_ZERO,
        low=0.0,
        high=10e3,
    ),
)

_BIAS_FORCE = (
    _vector("force", "N", "Force", "Bias force's force set", default=_ZERO, low=-1000.0, high=1000.0),
)

_SHAKER = (
    *_spring_like("Shaker"),
    _number("frequency1", "Hz", "First frequency", "Shaker's frequency1 set", default=0.0, high=1000.0),
    _number("frequency2", "Hz", "Second frequency", "Shaker's frequency2 set", default=0.0, high=1000.0),
    _direction("direction", "Axis of the shaker", "Shaker's direction set", default=(1.0, 0.0, 0.0)),
    _number("posmax", "m", "Amplitude limit", "Shaker's maximum position set", default=0.0, high=0.5),
    _number("velmax", "m/s", "Velocity limit", "Shaker's maximum velocity set", default=1.0, high=10.0),
    _number(
        "accmax",
        "m/s^2",
        "Acceleration limit",
        "Shaker's maximum acceleration set",
        default=50.0,
        high=1000.0,
    ),
)

_SHAPE = (
    # sic: the only reply that says Shapes's; a client tests for it
    _number(
        "stiffness", "N/m", "Stiffness of the surface", "Shapes's stiffness set", default=10e3, high=200e3
    ),
    _number("dampfactor", "", "Damping ratio in contact", "Shape's damp factor set", default=1.0, high=100.0),
    _flag("no_pull", "Never pull towards the surface", "Shape's no pull set", default=True),
    _number(
        "tang_damping",
        "N·s/m",
        "Damping along the surface",
        "Shape's tangential damping set",
        default=0.0,
        high=10e3,
    ),
    _number(
        "damping_forcemax",
        "N",
        "Largest damping force",
        "Shape's damping force max set",
        default=250.0,
        high=1000.0,
    ),
    _number("friction", "", "Friction coefficient mu", "Shape's friction mu set", default=0.0, high=10.0),
    _number(
        "ejection_velmax",
        "m/s",
        "Largest ejection velocity",
        "Shape's ejection velocity max set",
        default=0.5,
        high=10.0,
    ),
    _number(
        "ejection_damping",
        "N·s/m",
        "Damping of the ejection",
        "Shape's ejection velocity damping set",
        default=100.0,
        high=10e3,
    ),
    _number(
        "outward_forcemax",
        "N",
        "Largest force outwards",
        "Shape's outward force max set",
        default=250.0,
        high=1000.0,
    ),
    _number(
        "powermax", "W", "Largest power given to the hand", "Shape's power max set", default=250.0, high=10e3
    ),
)


def _length(name: str, doc: str, reply: str, default: float) -> Parameter:
    return _number(name, "m", doc, reply, default=default, low=1e-4, high=10.0)


def _type(name: str, doc: str, *own: Parameter, is_shape: bool = False) -> ObjectType:
    shared = _SHAPE if is_shape else ()
    return ObjectType(
        name=name, doc=doc, is_shape=is_shape, parameters=_index((*own, *shared, *COMMON_PARAMETERS))
    )


_BLOCK_SIZE = _vector(
    "size",
    "m",
    "Edge lengths; pos is the centre",
    "Block's size set",
    default=(0.1, 0.1, 0.1),
    low=1e-4,
    high=10.0,
)
_PLANE_NORMAL = _direction(
    "normal", "Normal, towards the free side", "Flat plane's normal set", default=(0.0, 0.0, 1.0)
)

OBJECT_TYPES: MappingProxyType[str, ObjectType] = MappingProxyType(
    {
        kind.name: kind
        for kind in (
            _type("spring", "Spring and damper between pos and the end effector", *_SPRING),
            _type("damper", "Viscous damping per axis", *_DAMPER),
            _type("biasforce", "Constant force", *_BIAS_FORCE),
            _type("shaker", "Spring whose position oscillates", *_SHAKER),
            _type("block", "Box", _BLOCK_SIZE, is_shape=True),
            _type("sphere", "Ball", _length("radius", "Radius", "Sphere's radius set", 0.05), is_shape=True),
            _type("flatplane", "Half space", _PLANE_NORMAL, is_shape=True),
            _type(
                "cylinder",
                "Cylinder along its z axis",
                _length("radius", "Radius", "Cylinder's radius set", 0.05),
                _length("length", "Length", "Cylinder's length set", 0.1),
                is_shape=True,
            ),
            _type(
                "torus",
                "Torus about its z axis",
                _length("ringradius", "Radius of the ring", "Torus's ring radius set", 0.1),
                _length("tuberadius", "Radius of the tube", "Torus's tube radius set", 0.03),
                is_shape=True,
            ),
        )
    }
)
"""The types that ``create`` knows, by name."""


def _read_vector(name: str, unit: str, doc: str) -> Parameter:
    return Parameter(name=name, kind=Kind.VECTOR, unit=unit, doc=doc, default=_ZERO, reply="")


_STATE = Parameter(
    name="state",
    kind=Kind.WORD,
    unit="",
    doc="State of the device",
    default=State.OFF.value,
    reply="state set to '{}'",
    words=SETTABLE_STATES,
)
_OS = Parameter(
    name="os", kind=Kind.WORD, unit="", doc="Operating system of the device", default="Linux", reply=""
)

QUANTITIES: MappingProxyType[str, Parameter] = _index(
    (
        _STATE,
        _flag("position_calibrated", "End stops were found", "", default=False),
        _flag("force_calibrated", "Force sensor was zeroed", "", default=False),
        _number(
            "inertia",
            "kg",
            "Virtual mass; the device's minimum is 2 kg",
            "Inertia set",
            default=3.0,
            low=2.0,
            high=100.0,
        ),
        _number(
            "coulombfriction",
            "N",
            "Virtual Coulomb friction",
            "Coulomb friction set",
            default=0.0,
            high=100.0,
        ),
        _read_vector("measpos", "m", "Measured position"),
        _read_vector("measvel", "m/s", "Measured velocity"),
        _read_vector("measforce", "N", "Measured force"),
        _read_vector("modelpos", "m", "Position of the virtual mass"),
        _read_vector("modelvel", "m/s", "Velocity of the virtual mass"),
        _read_vector("modelacc", "m/s^2", "Acceleration of the virtual mass"),
        _read_vector("measposjoint", "m, rad, m", "Measured joints r, phi, z"),
        _read_vector("measforcejoint", "N, N·m, N", "Measured force on the joints r, phi, z"),
        _read_vector("modelposjoint", "m, rad, m", "Joints r, phi, z of the virtual mass"),
        _read_vector("modelveljoint", "m/s, rad/s, m/s", "Joint velocities of the virtual mass"),
        _read_vector("modelaccjoint", "m/s^2, rad/s^2, m/s^2", "Joint accelerations of the virtual mass"),
        _read_vector("workspace_r", "m", "Reach of r: low, offset of the centre to the real axis, high"),
        _read_vector("workspace_phi", "rad", "Reach of phi: low, unused, high"),
        _read_vector("workspace_z", "m", "Reach of z: low, unused, high"),
        _OS,
        _flag("emergencybuttonpushed", "The emergency button is pushed", "", default=False),
        _flag("emergencyrelay", "The emergency relay has power", "", default=True),
    )
)
"""What ``get`` knows of the device itself, by name; those with a reply text can be set."""

SETTABLE_QUANTITIES = tuple(name for name, quantity in QUANTITIES.items() if quantity.reply)
"""state, inertia, coulombfriction."""

ENABLED = _flag("enabled", "Whether the object is rendered; new objects are not", "", default=False)
"""Read by ``get NAME enabled``, changed by ``set NAME enable`` and ``set NAME disable``."""

# Reply texts that belong to a command rather than to a value.
REMOVED = "Removed"
EFFECT_ENABLED = "Effect enabled"
EFFECT_DISABLED = "Effect disabled"
FORCE_SENSOR_CALIBRATED = "Force sensor calibrated"
ERROR_MARK = "--- ERROR"
"""Every error reply contains it (device facts, confidence H); what follows it is not known of the device."""

MAX_NAME_LENGTH = 64
"""Longest name of an object, so that every framed reply fits (a choice)."""

_HARMLESS = str.maketrans({";": ",", '"': "'", "\t": " ", "\n": " ", "\r": " "})
_NAME = re.compile(rf"[A-Za-z_][A-Za-z0-9_.-]{{0,{MAX_NAME_LENGTH - 1}}}")
_RESERVED_NAMES = frozenset(QUANTITIES) | {"all"}


def created_reply(type_name: str, name: str) -> str:
    """Text that acknowledges ``create TYPE NAME``."""
    return f"Effect {type_name} with name {name} created"


def state_reply(state: str) -> str:
    """Text that acknowledges ``set state STATE``."""
    return f"state set to '{state}'"


def error_reply(reason: str) -> str:
    """Text that refuses a command; characters that would end or quote a reply are replaced."""
    shown = reason.encode("ascii", "replace").decode("ascii").translate(_HARMLESS)
    return f"{ERROR_MARK}: {shown}"


def check_name(name: str) -> None:
    """Check that an object can have this name; letter case matters.

    Raises:
        ProtocolError: The name has other characters, is too long or has a meaning of its own.
    """
    if not _NAME.fullmatch(name):
        raise ProtocolError(
            f"{name[:24]!r} is no name; accepted: a letter, then letters, digits, '_', '.' and '-', "
            f"at most {MAX_NAME_LENGTH} in all"
        )
    if name in _RESERVED_NAMES:
        raise ProtocolError(f"{name!r} is a word of the command language and cannot name an object")


def object_type(name: str) -> ObjectType:
    """Look up a type that ``create`` knows.

    Raises:
        ProtocolError: No such type; the text lists those there are.
    """
    try:
        return OBJECT_TYPES[name]
    except KeyError:
        raise ProtocolError(f"no type {name[:24]!r}; accepted: {' '.join(OBJECT_TYPES)}") from None

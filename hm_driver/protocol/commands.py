"""Typed commands: each encodes itself to text, and `parse_command` makes it from text.

>>> SetParameter("ball", "force", (0.0, 1.25, 0.0)).encode()
'set ball force [0,1.25,0]'
>>> parse_command("set ball force [0, 1.25, 0]")
SetParameter(object='ball', name='force', value=(0.0, 1.25, 0.0))
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from hm_driver.errors import ProtocolError
from hm_driver.protocol import vocabulary
from hm_driver.protocol.numbers import format_number, format_vector
from hm_driver.protocol.vocabulary import QUANTITIES, SETTABLE_QUANTITIES, Kind, Quaternion, Value, Vector

VERBS = ("get", "set", "create", "remove", "calibrateforcesensor")
"""First words of a command; lower case."""


@dataclass(frozen=True, slots=True)
class GetQuantity:
    """``get NAME``: read a quantity of the device."""

    name: str

    def encode(self) -> str:
        """Text of the command."""
        return f"get {self.name}"


@dataclass(frozen=True, slots=True)
class SetQuantity:
    """``set NAME VALUE``: change a quantity of the device."""

    name: str
    value: Value

    def encode(self) -> str:
        """Text of the command; raises `ProtocolError` for NaN and infinity."""
        return f"set {self.name} {format_value(self.value)}"


@dataclass(frozen=True, slots=True)
class GetParameter:
    """``get OBJECT NAME``: read a parameter of an object, or ``enabled``."""

    object: str
    name: str

    def encode(self) -> str:
        """Text of the command."""
        return f"get {self.object} {self.name}"


@dataclass(frozen=True, slots=True)
class SetParameter:
    """``set OBJECT NAME VALUE``: change a parameter of an object.

    The form of the value is checked against the object's type by the one who knows it, with
    `hm_driver.protocol.vocabulary.Parameter.check`.
    """

    object: str
    name: str
    value: Value

    def encode(self) -> str:
        """Text of the command; raises `ProtocolError` for NaN and infinity."""
        return f"set {self.object} {self.name} {format_value(self.value)}"


@dataclass(frozen=True, slots=True)
class Create:
    """``create TYPE NAME``: make an effect or a shape; it starts disabled."""

    type: str
    name: str

    def __post_init__(self) -> None:
        vocabulary.object_type(self.type)
        vocabulary.check_name(self.name)

    def encode(self) -> str:
        """Text of the command."""
        return f"create {self.type} {self.name}"


@dataclass(frozen=True, slots=True)
class Remove:
    """``remove NAME``."""

    name: str

    def encode(self) -> str:
        """Text of the command."""
        return f"remove {self.name}"


@dataclass(frozen=True, slots=True)
class RemoveAll:
    """``remove all``."""

    def encode(self) -> str:
        """Text of the command."""
        return "remove all"


@dataclass(frozen=True, slots=True)
class Enable:
    """``set OBJECT enable``."""

    object: str

    def encode(self) -> str:
        """Text of the command."""
        return f"set {self.object} enable"


@dataclass(frozen=True, slots=True)
class Disable:
    """``set OBJECT disable``."""

    object: str

    def encode(self) -> str:
        """Text of the command."""
        return f"set {self.object} disable"


@dataclass(frozen=True, slots=True)
class CalibrateForceSensor:
    """``calibrateforcesensor``: take the force that is measured now for zero."""

    def encode(self) -> str:
        """Text of the command."""
        return "calibrateforcesensor"


Command = (
    GetQuantity
    | SetQuantity
    | GetParameter
    | SetParameter
    | Create
    | Remove
    | RemoveAll
    | Enable
    | Disable
    | CalibrateForceSensor
)


def format_value(value: Value) -> str:
    """Print a value as a command carries it.

    Raises:
        ProtocolError: NaN or infinity.
    """
    if isinstance(value, tuple):
        return format_vector(value)
    if isinstance(value, str):
        return value
    if isinstance(value, bool):
        return "true" if value else "false"
    return format_number(value)


def parse_value(text: str) -> bool | float | Vector | Quaternion:
    """Read a number, a vector, a quaternion, ``true`` or ``false``; blanks inside brackets are accepted.

    Raises:
        ProtocolError: It is none of these, or not finite.
    """
    try:
        if text[0] == "[":
            if text[-1] == "]" and "_" not in text:
                return _finite_components(text)
        elif "_" not in text:
            number = float(text)
            if number - number == 0.0:
                return number
    except (ValueError, IndexError):
        if text == "true":
            return True
        if text == "false":
            return False
    raise ProtocolError(
        f"{_shown(text)} is no value; accepted: a finite number, [x,y,z], [x,y,z,w], true, false",
        received=text,
    )


def parse_command(text: str) -> Command:
    """Read one command; a trailing blank or ``;`` is accepted.

    Names of quantities, verbs and types, and values of quantities are checked here, names of objects
    and of their parameters by the one who keeps the objects.

    Raises:
        ProtocolError: Not a command; the text says what would be accepted.
    """
    known = _PLAIN_COMMANDS.get(text)
    if known is not None:
        return known
    words = (text.rstrip(_ENDINGS) if text[-1:] in _ENDINGS else text).split(None, 3)
    if len(words) == 4 and words[0] == "set" and words[1] not in _SETTABLE:
        return SetParameter(words[1], words[2], parse_value(words[3]))
    parser = _PARSERS.get(words[0]) if words else None
    if parser is None:
        raise ProtocolError(f"unknown command {_shown(text)}; accepted: {' '.join(VERBS)}", received=text)
    return parser(words, text)


def split_request(text: str) -> list[str]:
    """Split a request of several commands at ``;``; a trailing ``;`` ends the last one.

    An empty command in between stays, so that every command gets its reply.
    """
    parts = text.split(";")
    if len(parts) > 1 and not parts[-1].strip():
        del parts[-1]
    return [part.strip() for part in parts]


def _finite_components(text: str) -> Vector | Quaternion:
    components = text[1:-1].split(",")
    value: Vector | Quaternion
    if len(components) == 3:
        value = float(components[0]), float(components[1]), float(components[2])
        total = value[0] + value[1] + value[2]
    else:
        x, y, z, w = components
        value = float(x), float(y), float(z), float(w)
        total = sum(value)
    if total - total != 0.0:
        raise ValueError(text)
    return value


def _parse_get(words: list[str], text: str) -> Command:
    if len(words) == 3:
        return GetParameter(words[1], words[2])
    if len(words) == 2 and words[1] in QUANTITIES:
        return GetQuantity(words[1])
    raise ProtocolError(
        f"{_shown(text)} asks nothing that is known; accepted: get NAME PARAMETER, "
        f"or get one of {' '.join(QUANTITIES)}",
        received=text,
    )


def _parse_set(words: list[str], text: str) -> Command:
    count = len(words)
    if count >= 3 and words[1] in _SETTABLE:
        return _parse_set_quantity(words, text)
    if count == 3 and words[2] == "enable":
        return Enable(words[1])
    if count == 3 and words[2] == "disable":
        return Disable(words[1])
    settable = ", ".join(f"set {name} VALUE" for name in SETTABLE_QUANTITIES)
    raise ProtocolError(
        f"{_shown(text)} sets nothing; accepted: set NAME PARAMETER VALUE, set NAME enable, "
        f"set NAME disable, {settable}",
        received=text,
    )


def _parse_set_quantity(words: list[str], text: str) -> Command:
    quantity = QUANTITIES[words[1]]
    if len(words) > 3:
        raise ProtocolError(f"{_shown(text)}: one value, please: {quantity.expected()}", received=text)
    value = words[2] if quantity.kind is Kind.WORD else parse_value(words[2])
    return SetQuantity(words[1], quantity.check(value))


def _parse_create(words: list[str], text: str) -> Command:
    if len(words) != 3:
        raise ProtocolError(f"{_shown(text)}: accepted: create TYPE NAME", received=text)
    return Create(words[1], words[2])


def _parse_remove(words: list[str], text: str) -> Command:
    if len(words) != 2:
        raise ProtocolError(f"{_shown(text)}: accepted: remove NAME, remove all", received=text)
    return RemoveAll() if words[1] == "all" else Remove(words[1])


def _parse_plain(words: list[str], text: str) -> Command:
    if len(words) != 1:
        raise ProtocolError(f"{_shown(text)}: {words[0]} takes no argument", received=text)
    return CalibrateForceSensor()


def _shown(text: str) -> str:
    return repr(text if len(text) <= 32 else f"{text[:29]}...")


_ENDINGS = "; \t\r\n"
_SETTABLE = frozenset(SETTABLE_QUANTITIES)

_PARSERS: Mapping[str, Callable[[list[str], str], Command]] = MappingProxyType(
    {
        "get": _parse_get,
        "set": _parse_set,
        "create": _parse_create,
        "remove": _parse_remove,
        "calibrateforcesensor": _parse_plain,
    }
)

# Commands without arguments, made once: a request at the loop's rate is mostly these.
_PLAIN_COMMANDS: Mapping[str, Command] = MappingProxyType(
    {f"get {name}": GetQuantity(name) for name in QUANTITIES}
    | {"remove all": RemoveAll(), "calibrateforcesensor": CalibrateForceSensor()}
)

"""The effects and shapes that this drive made, and how hard they would pull."""

import math
from dataclasses import dataclass, field

from hm_driver.errors import ConfigurationError, ProtocolError
from hm_driver.protocol.commands import (
    Command,
    Create,
    Disable,
    Enable,
    Remove,
    RemoveAll,
    SetParameter,
)
from hm_driver.protocol.vocabulary import OBJECT_TYPES, ObjectType, Value
from tools.drive.trajectory import Vector


@dataclass(slots=True)
class KnownObject:
    """An object on the device, as far as this drive made it."""

    type: ObjectType
    settings: dict[str, Value] = field(default_factory=dict)
    is_enabled: bool = False

    def value(self, name: str) -> Value:
        """A parameter's value, or the default that our vocabulary has for it."""
        return self.settings.get(name, self.type.parameters[name].default)

    def number(self, name: str) -> float:
        """A parameter that is a number."""
        value = self.value(name)
        return float(value) if isinstance(value, (bool, int, float)) else 0.0

    def components(self, name: str) -> tuple[float, ...]:
        """A parameter that is a vector or a quaternion."""
        value = self.value(name)
        return value if isinstance(value, tuple) else ()


class EffectTable:
    """What this drive created, set and enabled, so that it can be made again and be told.

    The device has no command that lists its objects: those that others made are not known here.
    """

    def __init__(self) -> None:
        self.objects: dict[str, KnownObject] = {}

    def apply(self, command: Command) -> None:
        """Note a command that the device has carried out."""
        match command:
            case Create(kind, name):
                self.objects[name] = KnownObject(OBJECT_TYPES[kind])
            case Remove(name):
                self.objects.pop(name, None)
            case RemoveAll():
                self.objects.clear()
            case SetParameter(name, parameter, value) if name in self.objects:
                self.objects[name].settings[parameter] = value
            case Enable(name) | Disable(name) if name in self.objects:
                self.objects[name].is_enabled = isinstance(command, Enable)
            case _:
                pass

    def disable_all(self) -> None:
        """Note that the device renders none of them any more."""
        for known in self.objects.values():
            known.is_enabled = False

    def commands(self) -> list[Command]:
        """What makes all of them again; those that are enabled are so behind their last parameter."""
        commands: list[Command] = []
        for name, known in self.objects.items():
            commands.append(Create(known.type.name, name))
            commands += [SetParameter(name, key, value) for key, value in known.settings.items()]
            if known.is_enabled:
                commands.append(Enable(name))
        return commands

    def check_step(self, command: Command, handle: Vector, force_max: float) -> None:
        """Refuse a command behind which an effect would pull at once with more than a force.

        Args:
            command: What is about to be sent.
            handle: Where the handle is [m].
            force_max: Largest step [N].

        Raises:
            ConfigurationError: The step would be too large; the text names it and what to do.
        """
        known = self._after(command)
        if known is None or not known.is_enabled:
            return
        force = pull(known, handle)
        if force > force_max:
            name = command.object if isinstance(command, Enable | SetParameter) else ""
            raise ConfigurationError(
                name,
                f"would act on the handle at once with {force:.1f} N; the limit is {force_max:g} N; "
                f"{_way_out(known)}",
            )

    def _after(self, command: Command) -> KnownObject | None:
        """The object as it would be behind the command, where that could make it pull."""
        if isinstance(command, Enable) and command.object in self.objects:
            known = self.objects[command.object]
            return KnownObject(known.type, known.settings, is_enabled=True)
        if isinstance(command, SetParameter) and command.object in self.objects:
            known = self.objects[command.object]
            try:
                value = known.type.parameter(command.name).check(command.value)
            except ProtocolError:
                return None  # the device answers it
            return KnownObject(known.type, known.settings | {command.name: value}, known.is_enabled)
        return None


def pull(known: KnownObject, handle: Vector) -> float:
    """Static force of an object on the handle [N], with the parameters known here."""
    kind = known.type.name
    if kind == "biasforce":
        return math.hypot(*known.components("force"))
    if kind == "damper":
        return 0.0
    offset = tuple(a - b for a, b in zip(handle, known.components("pos"), strict=True))
    if not known.type.is_shape:
        direction = known.components("direction")
        stretch = math.hypot(*offset)
        if kind == "spring" and any(direction):
            length = math.hypot(*direction)
            stretch = abs(sum(a * b for a, b in zip(offset, direction, strict=True))) / length
        free = max(0.0, stretch - known.number("deadband"))
        return min(known.number("maxforce"), known.number("stiffness") * free)
    depth = max(0.0, _depth(known, _turned_back(offset, known.components("att"))))
    return min(known.number("outward_forcemax"), known.number("stiffness") * depth)


def _depth(known: KnownObject, local: Vector) -> float:
    """How deep a point of the shape's own frame is inside it [m]; negative outside."""
    x, y, z = local
    radius = math.hypot(x, y)
    match known.type.name:
        case "sphere":
            return known.number("radius") - math.hypot(x, y, z)
        case "flatplane":
            normal = known.components("normal")
            return -sum(a * b for a, b in zip(local, normal, strict=True)) / (math.hypot(*normal) or 1.0)
        case "block":
            return min(size / 2.0 - abs(a) for size, a in zip(known.components("size"), local, strict=True))
        case "cylinder":
            return min(known.number("radius") - radius, known.number("length") / 2.0 - abs(z))
        case _:
            return known.number("tuberadius") - math.hypot(radius - known.number("ringradius"), z)


def _turned_back(offset: tuple[float, ...], attitude: tuple[float, ...]) -> Vector:
    """An offset in the frame of a shape with an attitude [x, y, z, w]."""
    length = math.hypot(*attitude) or 1.0
    qx, qy, qz, qw = (component / length for component in attitude)
    x, y, z = offset
    # v + 2 q x (q x v - w v), the rotation by the conjugate
    tx, ty, tz = qy * z - qz * y - qw * x, qz * x - qx * z - qw * y, qx * y - qy * x - qw * z
    return (
        x + 2.0 * (qy * tz - qz * ty),
        y + 2.0 * (qz * tx - qx * tz),
        z + 2.0 * (qx * ty - qy * tx),
    )


def _way_out(known: KnownObject) -> str:
    if known.type.name == "biasforce":
        return "set a smaller force"
    if known.type.is_shape:
        return "move the handle out of it, or lower its stiffness or outward_forcemax"
    return "move its pos to the handle, or lower its stiffness or maxforce"

"""Effects and shapes as values: what is left None stays at the device's own default.

Field names are the words of the command language, so that a value, a log and a manual name a thing alike.

>>> Spring(stiffness=500.0, pos=(0.0, 0.0, 0.1)).commands("guide")
['create spring guide', 'set guide pos [0,0,0.1]', 'set guide stiffness 500']
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields
from typing import ClassVar

from hm_driver.errors import ConfigurationError, ProtocolError
from hm_driver.protocol.commands import Create, SetParameter
from hm_driver.protocol.vocabulary import OBJECT_TYPES, Quaternion, Value, Vector


@dataclass(frozen=True, slots=True, kw_only=True)
class Surface:
    """How a shape's surface feels; None stays at the device's default."""

    stiffness: float | None = None
    """[N/m]."""
    dampfactor: float | None = None
    """Damping ratio."""
    no_pull: bool | None = None
    """Never pull towards the surface."""
    tang_damping: float | None = None
    """Damping along the surface [N·s/m]."""
    damping_forcemax: float | None = None
    """Largest damping force [N]."""
    friction: float | None = None
    """Friction coefficient mu."""
    ejection_velmax: float | None = None
    """Largest velocity at which the end effector is pushed out [m/s]."""
    ejection_damping: float | None = None
    """[N·s/m]."""
    outward_forcemax: float | None = None
    """Largest force outwards [N]."""
    powermax: float | None = None
    """Largest power that the surface gives to the hand [W]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Effect:
    """What effects and shapes have in common; make one of the classes below."""

    type_name: ClassVar[str] = ""
    """What ``create`` calls it."""

    pos: Vector | None = None
    """Position [m]."""
    vel: Vector | None = None
    """Velocity [m/s]."""
    att: Quaternion | None = None
    """Attitude, quaternion [x, y, z, w]."""

    def __post_init__(self) -> None:
        known = OBJECT_TYPES[self.type_name].parameters
        for name, value in self.settings():
            try:
                known[name].check_form(value)
            except ProtocolError as error:
                raise ConfigurationError(f"{self.type_name}.{name}", str(error)) from error

    def settings(self) -> Iterator[tuple[str, Value]]:
        """Names and values of the parameters that are not None."""
        yield from _settings(self)

    def commands(self, name: str) -> list[str]:
        """Commands that create the object and set its parameters; it is not enabled yet.

        Raises:
            ProtocolError: The name cannot be an object's.
        """
        sets = [SetParameter(name, parameter, value).encode() for parameter, value in self.settings()]
        return [Create(self.type_name, name).encode(), *sets]


def _settings(values: Effect | Surface) -> Iterator[tuple[str, Value]]:
    for field in fields(values):
        value = getattr(values, field.name)
        if isinstance(value, Surface):
            yield from _settings(value)
        elif value is not None:
            yield field.name, value


@dataclass(frozen=True, slots=True, kw_only=True)
class Spring(Effect):
    """Spring and damper between `pos` and the end effector."""

    type_name: ClassVar[str] = "spring"

    stiffness: float | None = None
    """[N/m]."""
    dampfactor: float | None = None
    """Damping ratio."""
    deadband: float | None = None
    """Free play about the position [m]."""
    direction: Vector | None = None
    """Axis, of any length; None or (0, 0, 0) for all three axes."""
    maxforce: float | None = None
    """Largest force [N]."""
    dampglobal: bool | None = None
    """Damp the motion against the world."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Damper(Effect):
    """Viscous damping along each axis."""

    type_name: ClassVar[str] = "damper"

    dampcoef: Vector | None = None
    """Coefficient per axis [N·s/m]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BiasForce(Effect):
    """Constant force."""

    type_name: ClassVar[str] = "biasforce"

    force: Vector | None = None
    """[N]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shaker(Effect):
    """Spring whose position oscillates."""

    type_name: ClassVar[str] = "shaker"

    frequency1: float | None = None
    """[Hz]."""
    frequency2: float | None = None
    """[Hz]."""
    direction: Vector | None = None
    """Axis, of any length but zero."""
    posmax: float | None = None
    """Largest amplitude [m]."""
    velmax: float | None = None
    """Largest velocity [m/s]."""
    accmax: float | None = None
    """Largest acceleration [m/s^2]."""
    stiffness: float | None = None
    """[N/m]."""
    dampfactor: float | None = None
    """Damping ratio."""
    deadband: float | None = None
    """Free play [m]."""
    maxforce: float | None = None
    """Largest force [N]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Block(Effect):
    """Box; `pos` is its centre."""

    type_name: ClassVar[str] = "block"

    size: Vector | None = None
    """Edge lengths [m]."""
    surface: Surface = Surface()
    """How it feels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sphere(Effect):
    """Ball; `pos` is its centre."""

    type_name: ClassVar[str] = "sphere"

    radius: float | None = None
    """[m]."""
    surface: Surface = Surface()
    """How it feels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FlatPlane(Effect):
    """Half space behind a plane through `pos`."""

    type_name: ClassVar[str] = "flatplane"

    normal: Vector | None = None
    """Points to the free side; of any length but zero."""
    surface: Surface = Surface()
    """How it feels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cylinder(Effect):
    """Cylinder about its own z axis; `pos` is its centre."""

    type_name: ClassVar[str] = "cylinder"

    radius: float | None = None
    """[m]."""
    length: float | None = None
    """[m]."""
    surface: Surface = Surface()
    """How it feels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Torus(Effect):
    """Torus about its own z axis; `pos` is its centre."""

    type_name: ClassVar[str] = "torus"

    ringradius: float | None = None
    """Radius of the ring [m]."""
    tuberadius: float | None = None
    """Radius of the tube [m]."""
    surface: Surface = Surface()
    """How it feels."""

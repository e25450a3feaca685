"""Constants of the emulated arm: read from ``arm.toml`` and from a file that overrides parts of it."""

import math
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, NamedTuple, get_type_hints

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry

Vector = tuple[float, float, float]


class Quantity(NamedTuple):
    """What a field is called in the file, and the range it must be in."""

    key: str
    unit: str
    low: float
    high: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmParameters:
    """Constants of one arm, explained in ``arm.toml``. Vectors are in the order r, phi, z."""

    r0: Annotated[float, Quantity("geometry.r0", "m", 0.2, 2.0)]
    joint_min: Annotated[Vector, Quantity("geometry.joint_min", "m, rad, m", -1.5, 0.0)]
    joint_max: Annotated[Vector, Quantity("geometry.joint_max", "m, rad, m", 0.0, 1.5)]
    initial: Annotated[Vector, Quantity("geometry.initial", "m, rad, m", -1.5, 1.5)]
    rate_hz: Annotated[float, Quantity("control.rate", "Hz", 500.0, 20000.0)]
    inertia: Annotated[float, Quantity("virtual.inertia", "kg", 0.1, 100.0)]
    inertia_min: Annotated[float, Quantity("virtual.inertia_min", "kg", 0.1, 100.0)]
    coulomb_friction: Annotated[float, Quantity("virtual.coulomb_friction", "N", 0.0, 100.0)]
    velocity_max: Annotated[Vector, Quantity("limits.velocity", "m/s, rad/s, m/s", 0.01, 10.0)]
    acceleration_max: Annotated[float, Quantity("limits.acceleration", "m/s²", 1.0, 1000.0)]
    stop_deceleration: Annotated[float, Quantity("limits.stop_deceleration", "m/s²", 0.1, 1000.0)]
    end_stop_zone: Annotated[float, Quantity("end_stop.zone", "m", 0.0, 0.05)]
    end_stop_stiffness: Annotated[float, Quantity("end_stop.stiffness", "N/m", 100.0, 1e6)]
    end_stop_damping_ratio: Annotated[float, Quantity("end_stop.damping_ratio", "1", 0.0, 10.0)]
    end_stop_margin: Annotated[float, Quantity("end_stop.margin", "m", 0.0, 0.05)]
    homing_speed: Annotated[Vector, Quantity("homing.speed", "m/s, rad/s, m/s", 0.001, 2.0)]
    homing_acceleration: Annotated[Vector, Quantity("homing.acceleration", "m/s², rad/s², m/s²", 0.01, 50.0)]
    homing_rate: Annotated[float, Quantity("homing.rate", "1/s", 0.1, 50.0)]
    mass_r: Annotated[float, Quantity("moving_mass.r", "kg", 0.5, 200.0)]
    mass_z: Annotated[float, Quantity("moving_mass.z", "kg", 0.5, 200.0)]
    column_inertia: Annotated[float, Quantity("moving_mass.column", "kg·m²", 0.0, 100.0)]
    arm_mass: Annotated[float, Quantity("moving_mass.arm", "kg", 0.1, 200.0)]
    friction_coulomb: Annotated[Vector, Quantity("friction.coulomb", "N, N·m, N", 0.0, 200.0)]
    friction_viscous: Annotated[Vector, Quantity("friction.viscous", "N·s/m, N·m·s/rad, N·s/m", 0.0, 1000.0)]
    friction_compensation: Annotated[float, Quantity("friction.compensation", "1", 0.0, 1.0)]
    friction_compensation_speed: Annotated[float, Quantity("friction.compensation_speed", "m/s", 1e-5, 1.0)]
    drive_bandwidth_hz: Annotated[float, Quantity("drive.bandwidth", "Hz", 20.0, 1e5)]
    drive_limit: Annotated[Vector, Quantity("drive.limit", "N, N·m, N", 1.0, 1e4)]
    servo_frequency_hz: Annotated[float, Quantity("servo.frequency", "Hz", 1.0, 200.0)]
    servo_damping_ratio: Annotated[float, Quantity("servo.damping_ratio", "1", 0.1, 5.0)]
    servo_integral_rate: Annotated[float, Quantity("servo.integral_rate", "1/s", 0.0, 200.0)]
    servo_integral_max: Annotated[float, Quantity("servo.integral_max", "m/s²", 0.0, 100.0)]
    servo_velocity_filter_hz: Annotated[float, Quantity("servo.velocity_filter", "Hz", 10.0, 1e5)]
    structure_stiffness: Annotated[Vector, Quantity("structure.stiffness", "N/m, N/m, N/m", 1000.0, 1e7)]
    encoder_resolution: Annotated[Vector, Quantity("encoder.resolution", "m, rad, m", 1e-9, 1e-3)]
    encoder_velocity_filter_hz: Annotated[float, Quantity("encoder.velocity_filter", "Hz", 5.0, 1e5)]
    sensor_noise: Annotated[float, Quantity("force_sensor.noise", "N", 0.0, 10.0)]
    sensor_resolution: Annotated[float, Quantity("force_sensor.resolution", "N", 1e-9, 1.0)]
    sensor_offset: Annotated[float, Quantity("force_sensor.offset", "N", 0.0, 50.0)]
    sensor_drift: Annotated[float, Quantity("force_sensor.drift", "N/√s", 0.0, 1.0)]
    sensor_range: Annotated[float, Quantity("force_sensor.range", "N", 10.0, 1e5)]
    sensor_calibration_filter_hz: Annotated[
        float, Quantity("force_sensor.calibration_filter", "Hz", 0.1, 1000.0)
    ]
    hand_hold_s: Annotated[float, Quantity("hand.hold", "s", 0.0, 1.0)]
    hand_fade_s: Annotated[float, Quantity("hand.fade", "s", 0.001, 1.0)]
    shaker_sweep_s: Annotated[float, Quantity("shaker.sweep", "s", 0.1, 1000.0)]
    shaker_ramp_s: Annotated[float, Quantity("shaker.ramp", "s", 0.001, 10.0)]

    def __post_init__(self) -> None:
        for name, quantity in quantities().items():
            _check_range(quantity, getattr(self, name))
        if self.r0 + self.joint_min[0] <= 0.05:
            raise ConfigurationError(
                "geometry.joint_min", f"r0 + r = {self.r0 + self.joint_min[0]:g} m must exceed 0.05 m"
            )
        if self.inertia < self.inertia_min:
            raise ConfigurationError(
                "virtual.inertia", f"{self.inertia:g} kg is below inertia_min = {self.inertia_min:g} kg"
            )
        for low, start, high in zip(self.joint_min, self.initial, self.joint_max, strict=True):
            if not low <= start <= high:
                raise ConfigurationError("geometry.initial", f"{start:g} must lie from {low:g} to {high:g}")

    @property
    def geometry(self) -> ArmGeometry:
        """Reach of the arm."""
        low, high = self.joint_min, self.joint_max
        return ArmGeometry(
            r0=self.r0,
            r_min=low[0],
            r_max=high[0],
            phi_min=low[1],
            phi_max=high[1],
            z_min=low[2],
            z_max=high[2],
        )


@cache
def quantities() -> Mapping[str, Quantity]:
    """Key, unit and range of each field of :class:`ArmParameters`."""
    hints = get_type_hints(ArmParameters, include_extras=True)
    return {name: hint.__metadata__[0] for name, hint in hints.items()}


def load_parameters(path: Path | None = None) -> ArmParameters:
    """Read the arm that comes with the emulator, changed by the entries of a file.

    Args:
        path: TOML file in the form of ``arm.toml``; it may hold any part of it.

    Raises:
        ConfigurationError: an unknown key, a wrong type, unit or range; the message names file, key and
            limit.
    """
    content = resources.files("emulator").joinpath("arm.toml").read_text(encoding="utf-8")
    values = read_values(tomllib.loads(content), source="arm.toml")
    if path is None:
        return build_parameters(values, source="arm.toml")
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigurationError("file", f"cannot be read as TOML: {error}", source=str(path)) from error
    values |= read_values(document, source=str(path))
    return build_parameters(values, source=str(path))


def read_values(document: Mapping[str, Any], *, source: str) -> dict[str, float | Vector]:
    """Values by field name from the sections of a document, with keys, types and units checked.

    Raises:
        ConfigurationError: an unknown section or key, a wrong type or unit.
    """
    known = {quantity.key: (name, quantity.unit) for name, quantity in quantities().items()}
    values: dict[str, float | Vector] = {}
    for section, entries in document.items():
        names = [key.split(".")[1] for key in known if key.split(".")[0] == section]
        if not names:
            sections = sorted({key.split(".")[0] for key in known})
            raise ConfigurationError(
                section, f"unknown section; there are {', '.join(sections)}", source=source
            )
        if not isinstance(entries, Mapping):
            raise ConfigurationError(section, "must be a section: [" + section + "]", source=source)
        for name, entry in entries.items():
            key = f"{section}.{name}"
            if key not in known:
                raise ConfigurationError(
                    key, f"unknown key; [{section}] has {', '.join(names)}", source=source
                )
            field, unit = known[key]
            values[field] = _read_entry(key, entry, unit, source=source)
    return values


def build_parameters(values: Mapping[str, Any], *, source: str) -> ArmParameters:
    """Parameters from values by field name.

    Raises:
        ConfigurationError: a value is out of range, or one is missing.
    """
    for name, quantity in quantities().items():
        if name not in values:
            raise ConfigurationError(quantity.key, "is missing", source=source)
    try:
        return ArmParameters(**values)
    except ConfigurationError as error:
        raise ConfigurationError(error.field, error.problem, source=source) from error


def _read_entry(key: str, entry: object, unit: str, *, source: str) -> float | Vector:
    if isinstance(entry, Mapping):
        extra = set(entry) - {"value", "unit", "confidence", "source"}
        if extra or "value" not in entry:
            raise ConfigurationError(
                key, "takes value, unit, confidence and source; value is required", source=source
            )
        if entry.get("unit", unit) != unit:
            raise ConfigurationError(
                key, f"unit {entry['unit']!r} is not {unit!r}; convert the value", source=source
            )
        entry = entry["value"]
    if ", " not in unit:
        return _read_number(key, entry, source=source)
    if not isinstance(entry, list) or len(entry) != 3:
        raise ConfigurationError(
            key, f"must be a list of three numbers [{unit}], not {entry!r}", source=source
        )
    first, second, third = (_read_number(key, item, source=source) for item in entry)
    return first, second, third


def _read_number(key: str, item: object, *, source: str) -> float:
    if isinstance(item, bool) or not isinstance(item, (int, float)):
        raise ConfigurationError(key, f"must be a number, not {item!r}", source=source)
    return float(item)


def _check_range(quantity: Quantity, value: float | Vector) -> None:
    low, high = quantity.low, quantity.high
    for item in value if isinstance(value, tuple) else (value,):
        if not (math.isfinite(item) and low <= item <= high):
            problem = f"{item:g} must lie from {low:g} to {high:g} {quantity.unit}"
            raise ConfigurationError(quantity.key, problem)

"""The effects and shapes that the arm renders, as rows of one flat array."""

import math
from collections.abc import Sequence
from enum import Enum
from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from emulator import layout

CAPACITY = 64
"""Most objects at one time; the limit of the real device is unknown."""


class EffectKind(Enum):
    """Type of an object, by its word in the command language."""

    SPRING = "spring"
    DAMPER = "damper"
    BIAS_FORCE = "biasforce"
    SHAKER = "shaker"
    BLOCK = "block"
    SPHERE = "sphere"
    FLAT_PLANE = "flatplane"
    CYLINDER = "cylinder"
    TORUS = "torus"


class _Column(NamedTuple):
    start: int
    width: int
    default: tuple[float, ...]


_CODES = {kind: float(i + 1) for i, kind in enumerate(EffectKind)}
_NONE = (math.inf,)
_COLUMNS = {
    "pos": _Column(layout.E_POSITION, 3, (0.0, 0.0, 0.0)),
    "vel": _Column(layout.E_VELOCITY, 3, (0.0, 0.0, 0.0)),
    "att": _Column(layout.E_ATTITUDE, 4, (0.0, 0.0, 0.0, 1.0)),
    "stiffness": _Column(layout.E_STIFFNESS, 1, (0.0,)),
    "dampfactor": _Column(layout.E_DAMPING_RATIO, 1, (0.0,)),
    "deadband": _Column(layout.E_DEADBAND, 1, (0.0,)),
    "direction": _Column(layout.E_DIRECTION, 3, (0.0, 0.0, 0.0)),
    "maxforce": _Column(layout.E_MAX_FORCE, 1, _NONE),
    "dampglobal": _Column(layout.E_DAMPING_GLOBAL, 1, (0.0,)),
    "dampcoef": _Column(layout.E_DAMPING, 3, (0.0, 0.0, 0.0)),
    "force": _Column(layout.E_BIAS, 3, (0.0, 0.0, 0.0)),
    "frequency1": _Column(layout.E_FREQUENCY_1, 1, (0.0,)),
    "frequency2": _Column(layout.E_FREQUENCY_2, 1, (0.0,)),
    "posmax": _Column(layout.E_POSITION_MAX, 1, (0.0,)),
    "velmax": _Column(layout.E_VELOCITY_MAX, 1, _NONE),
    "accmax": _Column(layout.E_ACCELERATION_MAX, 1, _NONE),
    "size": _Column(layout.E_SIZE_XYZ, 3, (0.1, 0.1, 0.1)),
    "radius": _Column(layout.E_RADIUS, 1, (0.05,)),
    "length": _Column(layout.E_LENGTH, 1, (0.1,)),
    "ringradius": _Column(layout.E_RING_RADIUS, 1, (0.05,)),
    "tuberadius": _Column(layout.E_TUBE_RADIUS, 1, (0.01,)),
    "normal": _Column(layout.E_NORMAL, 3, (0.0, 0.0, 1.0)),
    "no_pull": _Column(layout.E_NO_PULL, 1, (1.0,)),
    "tang_damping": _Column(layout.E_TANGENTIAL_DAMPING, 1, (0.0,)),
    "damping_forcemax": _Column(layout.E_DAMPING_FORCE_MAX, 1, _NONE),
    "friction": _Column(layout.E_FRICTION, 1, (0.0,)),
    "ejection_velmax": _Column(layout.E_EJECTION_VELOCITY_MAX, 1, _NONE),
    "ejection_damping": _Column(layout.E_EJECTION_DAMPING, 1, (0.0,)),
    "outward_forcemax": _Column(layout.E_OUTWARD_FORCE_MAX, 1, _NONE),
    "powermax": _Column(layout.E_POWER_MAX, 1, _NONE),
}
PARAMETERS = tuple(_COLUMNS)
"""Names of all parameters, as in the command language."""


class EffectTable:
    """Up to 64 objects in the form that the kernels read. Only enabled ones cost time.

    Values are taken as they are: types, ranges and unit vectors are the interpreter's to check. A limit of
    infinity is no limit, and a ``direction`` of zero length means that none is set.

    Attributes:
        flat: All rows, one after the other.
        active: Index of the first number of each enabled row, in ascending order of slots.
        n_active: How many entries of ``active`` count.
    """

    def __init__(self) -> None:
        self._rows: npt.NDArray[np.float64] = np.zeros((CAPACITY, layout.E_SIZE))
        self.flat: npt.NDArray[np.float64] = self._rows.reshape(-1)
        self.active: npt.NDArray[np.int64] = np.zeros(CAPACITY, dtype=np.int64)
        self.n_active = 0

    def allocate(self, kind: EffectKind) -> int:
        """Take a free slot for a new, disabled object with default parameters.

        Raises:
            OverflowError: all slots are taken.
        """
        for slot in range(CAPACITY):
            row = self._rows[slot]
            if row[layout.E_KIND] == layout.KIND_FREE:
                row[:] = 0.0
                row[layout.E_KIND] = _CODES[kind]
                for column in _COLUMNS.values():
                    row[column.start : column.start + column.width] = column.default
                if kind is EffectKind.SHAKER:
                    self.set(slot, "direction", (1.0, 0.0, 0.0))
                return slot
        raise OverflowError(f"all {CAPACITY} objects are in use; remove one first")

    def free(self, slot: int) -> None:
        """Remove an object."""
        self._rows[slot] = 0.0
        self._refresh()

    def free_all(self) -> None:
        """Remove all objects."""
        self._rows[:] = 0.0
        self._refresh()

    def kind(self, slot: int) -> EffectKind:
        """Type of an object.

        Raises:
            KeyError: the slot is free.
        """
        code = self._rows[slot, layout.E_KIND]
        for kind, value in _CODES.items():
            if value == code:
                return kind
        raise KeyError(slot)

    def set(self, slot: int, parameter: str, value: float | Sequence[float]) -> None:
        """Set a parameter by its name in the command language.

        Raises:
            KeyError: there is no such parameter.
            ValueError: the value has the wrong length.
        """
        column = _COLUMNS[parameter]
        values = (value,) if isinstance(value, (int, float)) else tuple(value)
        if len(values) != column.width:
            raise ValueError(f"{parameter} takes {column.width} numbers, not {len(values)}")
        row = self._rows[slot]
        for i, item in enumerate(values):
            row[column.start + i] = item
        if parameter == "direction":
            row[layout.E_HAS_DIRECTION] = float(any(item != 0.0 for item in values))

    def get(self, slot: int, parameter: str) -> float | tuple[float, ...]:
        """Value of a parameter; a tuple where it has more than one number.

        Raises:
            KeyError: there is no such parameter.
        """
        column = _COLUMNS[parameter]
        values = self._rows[slot, column.start : column.start + column.width].tolist()
        return tuple(values) if column.width > 1 else float(values[0])

    def is_enabled(self, slot: int) -> bool:
        """Whether the object is rendered."""
        return bool(self._rows[slot, layout.E_ENABLED])

    def set_enabled(self, slot: int, *, enabled: bool) -> None:
        """Render an object or not; a shaker starts anew."""
        row = self._rows[slot]
        row[layout.E_ENABLED] = float(enabled)
        row[layout.E_TIME] = row[layout.E_PHASE] = 0.0
        self._refresh()

    def _refresh(self) -> None:
        slots = np.flatnonzero(self._rows[:, layout.E_ENABLED])
        self.n_active = len(slots)
        self.active[: self.n_active] = slots * layout.E_SIZE

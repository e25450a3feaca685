"""The emulated HapticMASTER: arm, controller, command language, world and faults.

>>> with Emulator(init_seconds=0.5) as emulator:  # doctest: +SKIP
...     print(emulator.url, emulator.world_url)

`Emulator` runs it in a process of its own against the wall clock, `LockstepEmulator` in this one on a virtual
clock. Names are looked up when they are first used, so that importing the package costs nothing.
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from emulator.in_process import LockstepEmulator
    from emulator.process import Emulator, EmulatorOptions
    from emulator.world import Truth, World, WorldClient, WorldError

__all__ = ["Emulator", "EmulatorOptions", "LockstepEmulator", "Truth", "World", "WorldClient", "WorldError"]

_HOMES = {
    "Emulator": "emulator.process",
    "EmulatorOptions": "emulator.process",
    "LockstepEmulator": "emulator.in_process",
    "Truth": "emulator.world",
    "World": "emulator.world",
    "WorldClient": "emulator.world",
    "WorldError": "emulator.world",
}


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module 'emulator' has no attribute {name!r}")
    from importlib import import_module

    value: object = getattr(import_module(_HOMES[name]), name)
    return value

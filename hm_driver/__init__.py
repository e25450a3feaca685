"""Driver of the Moog HapticMASTER: protocol, transports, typed client, real-time loop, recording.

::

    import hm_driver

    with hm_driver.connect("tcp://192.168.0.25") as arm:
        arm.initialise()
        arm.set_state(hm_driver.State.FORCE)
        print(arm.measured_position())

What is named here is loaded at its first use: the processes of a session import parts of this package, and
should not wait for the rest.
"""

from typing import TYPE_CHECKING

from hm_driver.version import __version__

if TYPE_CHECKING:
    from hm_driver import errors
    from hm_driver.device import effects
    from hm_driver.device.haptic_master import HapticMaster, connect
    from hm_driver.protocol.vocabulary import State

__all__ = ["HapticMaster", "State", "__version__", "connect", "effects", "errors"]


def __getattr__(name: str) -> object:
    from importlib import import_module

    if name == "errors":
        return import_module("hm_driver.errors")
    if name == "effects":
        return import_module("hm_driver.device.effects")
    if name == "State":
        return import_module("hm_driver.protocol.vocabulary").State
    if name in {"HapticMaster", "connect"}:
        return getattr(import_module("hm_driver.device.haptic_master"), name)
    raise AttributeError(f"module 'hm_driver' has no attribute {name!r}; it offers: {', '.join(__all__)}")

"""How a motion can end, for the one who asked for it."""

from typing import NamedTuple

from hm_driver.errors import HapticMasterError
from tools.drive.pilot import Tracking
from tools.drive.trajectory import Vector


class EndRequested(KeyboardInterrupt):
    """A signal asks the program to end; unlike Ctrl-C it is not asked twice."""


class MotionStopped(KeyboardInterrupt):
    """Ctrl-C during a motion: the arm was braked on its way and is held there."""


class NotArrived(HapticMasterError):
    """The arm did not come to where it was led: something holds it."""


class CommandRefused(HapticMasterError):
    """The device refused a command that the user gave it; link, device and loop are well.

    Args:
        command: The command as sent.
        reply: The reply as received.
    """

    def __init__(self, command: str, reply: str) -> None:
        self.command = command
        self.reply = reply
        super().__init__(f"the device refused {command!r}: {reply}")


class Arrival(NamedTuple):
    """How a motion went that came to its end."""

    duration_s: float
    tracking: Tracking
    position: Vector
    """Where the arm is [m]."""
    error_m: float
    """How far that is from the goal."""

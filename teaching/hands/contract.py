"""A hand: whoever holds the end effector, seen from the session.

A hand sees what a person at the screen sees and answers with what his arm does: an intended position and an
impedance about it. How that moves the end effector is up to the robot, or to the emulator; nothing here
touches the device.
"""

from typing import NamedTuple, Protocol

Vector = tuple[float, float, float]


class Seen(NamedTuple):
    """What the demonstrator sees and feels at a tick."""

    handle: Vector
    """Position of the end effector in the device's frame [m]; he feels where his hand is."""
    x: float
    """Manipulator's position on the plane [m]."""
    y: float
    depth: float
    """Commanded displacement below the surface [m]; negative above it."""
    force: float
    """Interaction force of the manipulator, as the bar on the screen shows it [N]."""
    C: float
    """Control factor of eq. (8): 1 he is in control, 0 the skill is."""
    surface: int
    """Index of the colour under the manipulator; -1 beside the plane."""
    autonomous: bool
    """Whether the screen asks him to let go, for the autonomous stage."""
    is_free: bool = False
    """Whether the handle is his at any C, and he goes on demonstrating: the uncoupled variant."""


class HandIntent(NamedTuple):
    """What a hand does: an impedance about a moving point, in the device's frame."""

    position: Vector
    """Intended position [m]."""
    velocity: Vector
    """Velocity of the intended position [m/s]."""
    stiffness: Vector
    """Of the arm about it [N/m]."""
    damping: Vector
    """Of the arm about it [N*s/m]."""
    force: Vector = (0.0, 0.0, 0.0)
    """Force on top [N]."""


class Hand(Protocol):
    """Whoever holds the end effector.

    `step` is called once a tick, in order, with the true time since the last call. It keeps no clock and
    draws its randomness from a generator that it was given. None means that the hand lets go.
    """

    @property
    def button(self) -> bool:
        """Whether it holds the button that takes control, for those methods that ask the human."""
        return False

    def step(self, seen: Seen, dt: float) -> HandIntent | None:
        """Answer what is seen with an intent.

        Args:
            seen: What the demonstrator sees.
            dt: Time since the last call [s].
        """
        ...


class PersonHand:
    """A person at a real handle: the session does not move him."""

    button = False
    """His button is a key of the keyboard."""

    def step(self, seen: Seen, dt: float) -> HandIntent | None:  # noqa: ARG002  # the contract's signature
        """Leave the end effector to the person."""
        return None

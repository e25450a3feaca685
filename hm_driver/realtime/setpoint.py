"""What crosses between the application and the loop: set-points one way, the loop's state the other.

Both are flat tuples of numbers, so that they can be laid into shared memory, into a log record or into the
arrays of a compiled kernel as they stand. All quantities are in the device's frame and in SI units.
"""

from typing import NamedTuple


class SetPoint(NamedTuple):
    """What the application asks of the loop, about 100 times a second.

    An axis whose ``engage_*`` is 1 is in position mode: a virtual spring pulls it to the target. An axis at 0
    is in admittance mode: it follows the hand.
    """

    sequence: float = 0.0
    """Counts the set-points; a new number starts a new interpolation."""
    assist: float = 0.0
    """1 where the spring-damper that helps the hand to hold its own height is wanted."""
    engage_x: float = 0.0
    engage_y: float = 0.0
    engage_z: float = 0.0
    target_x: float = 0.0
    """Target of the reference at the end of this tick [m]."""
    target_y: float = 0.0
    target_z: float = 0.0
    velocity_x: float = 0.0
    """Velocity of the target [m/s]."""
    velocity_y: float = 0.0
    velocity_z: float = 0.0
    bias_x: float = 0.0
    """Force fed back to the hand [N], ramped and limited by the loop."""
    bias_y: float = 0.0
    bias_z: float = 0.0


class LoopState(NamedTuple):
    """What the loop knows after a cycle."""

    cycle: float = 0.0
    """Cycles run."""
    time_ns: float = 0.0
    """Deadline of the cycle on the loop's clock [ns]; exact up to 2**53 ns, which is 104 days of uptime."""
    missed: float = 0.0
    """Whole periods missed so far."""
    saturated: float = 0.0
    """Cycles with a joint at its velocity limit so far."""
    measured_x: float = 0.0
    """Measured position of the end effector [m]."""
    measured_y: float = 0.0
    measured_z: float = 0.0
    velocity_x: float = 0.0
    """Velocity of the device's virtual mass [m/s]."""
    velocity_y: float = 0.0
    velocity_z: float = 0.0
    force_x: float = 0.0
    """Measured force of the hand on the end effector [N]."""
    force_y: float = 0.0
    force_z: float = 0.0
    reference_x: float = 0.0
    """Reference of the position springs [m]."""
    reference_y: float = 0.0
    reference_z: float = 0.0
    spring_x: float = 0.0
    """Commanded force of the position springs [N]."""
    spring_y: float = 0.0
    spring_z: float = 0.0
    engaged_x: float = 0.0
    """0 admittance, 1 position, 2 the spring is being released."""
    engaged_y: float = 0.0
    engaged_z: float = 0.0
    assist_force: float = 0.0
    """Commanded force of the assist spring in z [N]."""

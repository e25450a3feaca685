"""Move the arm by 2 cm and hold it there for a second: ``python examples/hold.py URL``.

URL is tcp://HOST[:7654] of a HapticMASTER or of ``hm emulate``. Neither the loop nor a real-time system is
needed. On a robot: docs/safety.md first.
"""

import sys

import hm_driver
from hm_driver.device.positioner import Positioner


def main(url: str) -> None:
    """Move, hold and tell."""
    with hm_driver.connect(url) as arm:
        if not arm.is_position_calibrated():
            arm.initialise()
        x, y, z = arm.measured_position()
        with Positioner(arm, force_max=10.0) as positioner:
            positioner.move_to((x, y, z + 0.02), speed=0.1)
            positioner.hold(1.0)
            _, _, force = arm.measured_force()
        z = arm.measured_position()[2]
        print(f"{arm.dialect.value} dialect; z {z:.4f} m, the hand pushed {force:.2f} N")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "tcp://127.0.0.1:7654")

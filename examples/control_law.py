"""A control law of your own in the 1 kHz loop: ``python examples/control_law.py URL [SECONDS]``.

The arm is free within 1 cm of where it was, and held at that distance: a soft box without a shape. The law
runs in the loop's process, which imports it from here; everything that it asks for passes the limits below
every mode. On a robot: docs/safety.md first.
"""

import sys
import time

from hm_driver.realtime.options import LoopOptions
from hm_driver.realtime.process import LoopProcess
from hm_driver.realtime.setpoint import LoopState, SetPoint

HALF = 0.01
"""Half the box's edge [m]."""


class Box:
    """Position mode at the wall, admittance mode inside."""

    def __init__(self) -> None:
        self.centre: tuple[float, float, float] | None = None

    def step(self, state: LoopState, command: SetPoint, dt: float) -> SetPoint:  # noqa: ARG002  # a law's
        """Called in every cycle with the newest state; returns the set-point of the cycle."""
        place = (state.measured_x, state.measured_y, state.measured_z)
        if self.centre is None:
            if state.cycle < 2.0:
                return command
            self.centre = place
        pairs = list(zip(place, self.centre, strict=True))
        targets = [min(max(here, middle - HALF), middle + HALF) for here, middle in pairs]
        engaged = [float(abs(here - middle) > HALF) for here, middle in pairs]
        return SetPoint(command.sequence, 0.0, *engaged, *targets)


def main(url: str, seconds: float = 5.0) -> None:
    """Run the loop with the law, and be there: an application that falls silent stops the arm."""
    with LoopProcess(LoopOptions(url=url, law="control_law:Box")) as loop:
        loop.start()
        ends = time.monotonic() + seconds
        while time.monotonic() < ends:
            loop.publish(SetPoint())
            loop.check()
            time.sleep(0.01)
        state = loop.state()
    print(f"{loop.result().cycles} cycles; ended at z = {state.measured_z:.4f} m, {loop.result().scheduling}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "tcp://127.0.0.1:7654", *map(float, sys.argv[2:3]))

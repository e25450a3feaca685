"""Control laws that go wrong when the arm is lifted, for `tools.bench.safety`."""

import time

from hm_driver.realtime.setpoint import LoopState, SetPoint

HEIGHT = 0.01
"""Above which they do [m]."""


class RaisesAbove:
    """Raises an error."""

    def step(self, state: LoopState, command: SetPoint, dt: float) -> SetPoint:  # noqa: ARG002
        """Pass the command on, or raise."""
        if state.measured_z > HEIGHT:
            raise ValueError("the arm is too high")
        return command


class BlocksAbove:
    """Does not return for a long time."""

    def step(self, state: LoopState, command: SetPoint, dt: float) -> SetPoint:  # noqa: ARG002
        """Pass the command on, or sleep."""
        if state.measured_z > HEIGHT:
            time.sleep(2.0)
        return command

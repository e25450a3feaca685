"""The loop's process and the pilot that leads it, as one thing that runs or does not."""

from collections.abc import Callable

from hm_driver.errors import HapticMasterError, LoopError
from hm_driver.realtime.options import LoopOptions
from hm_driver.realtime.process import LoopProcess
from hm_driver.realtime.setpoint import LoopState
from tools.drive.pilot import Pilot
from tools.drive.status import LoopMeter

_STOP_PATIENCE_S = 10.0


class Engine:
    """Starts and ends loops, one after the other, each with a pilot of its own."""

    def __init__(self) -> None:
        self._loop: LoopProcess | None = None
        self._meter = LoopMeter()
        self.pilot: Pilot | None = None
        """Who leads the loop, or None while there is none."""
        self.has_driven = False
        """Whether a loop drove the arm."""
        self.has_failed = False
        """Whether one ended otherwise than in order."""

    @property
    def is_running(self) -> bool:
        """Whether a loop drives the arm."""
        return self.pilot is not None and self.pilot.failure is None

    @property
    def state(self) -> LoopState:
        """What the loop knew after its last cycle.

        Raises:
            LoopError: There is no loop.
        """
        if self._loop is None:
            raise LoopError("no loop runs")
        return self._loop.state()

    @property
    def rate_hz(self) -> float:
        """Cycles in a second; 0 until it is known, a tenth of a second after the start."""
        return self._meter.rate_hz(self.state)

    def start(
        self, options: LoopOptions, *, brake_time: float, on_failure: Callable[[HapticMasterError], None]
    ) -> Pilot:
        """Start a loop and hold the arm where it is.

        Args:
            options: What the loop is told.
            brake_time: Time in which an interrupted motion comes to rest [s].
            on_failure: Called from another thread with what ended the loop.

        Raises:
            HapticMasterError: What keeps the loop from running; the device was made safe.
        """
        loop = LoopProcess(options)
        loop.__enter__()
        try:
            loop.start()
            pilot = Pilot(loop, brake_time=brake_time, on_failure=on_failure)
            self._loop, self.pilot, self._meter = loop, pilot, LoopMeter()
            pilot.start()
        except BaseException:
            self._loop = self.pilot = None
            loop.close()
            raise
        self.has_driven = True
        self._meter.rate_hz(loop.state())
        return pilot

    def end(self) -> None:
        """End the loop gently, while the pilot goes on with its heartbeat; the device is in ``stop`` then.

        Raises:
            LoopError: It does not end, or died.
        """
        loop, pilot = self._loop, self.pilot
        if loop is None or pilot is None:
            return
        try:
            self.has_failed |= pilot.failure is not None
            if pilot.failure is None:
                loop.request_stop()
                loop.wait(_STOP_PATIENCE_S)
        finally:
            self._clear()

    def take_failure(self) -> HapticMasterError | None:
        """What ended the loop since this was asked last, or None; the loop is cleared away."""
        if self.pilot is None or self.pilot.failure is None:
            return None
        failure = self.pilot.failure
        self.has_failed = True
        self._clear()
        return failure

    def _clear(self) -> None:
        loop, pilot = self._loop, self.pilot
        self._loop = self.pilot = None
        if loop is not None and pilot is not None:
            pilot.close()
            loop.close()

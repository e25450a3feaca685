"""The 100 Hz end of a drive: a thread that publishes set-points, whatever the prompt above it does."""

import math
import threading
import time
from collections.abc import Callable, Iterable
from enum import Enum
from typing import NamedTuple

from hm_driver.errors import HapticMasterError
from hm_driver.realtime.process import LoopHandle
from hm_driver.realtime.scheduling import enter_realtime
from hm_driver.realtime.setpoint import LoopState, SetPoint
from tools.drive.options import TICK_S
from tools.drive.trajectory import Trajectory, Vector

_PRIORITY = 60
_LONGEST_STEP_S = 2.0 * TICK_S
"""A motion does not catch up with what a stalled machine missed: it would have to jump."""
_PATIENCE_S = 5.0

ALL_AXES = (0, 1, 2)


class Ending(Enum):
    """How a motion ended."""

    ARRIVED = "arrived"
    """The reference is at the goal."""
    STOPPED = "stopped"
    """It was braked on its way."""
    LOST = "lost"
    """The loop ended under it."""


class Tracking(NamedTuple):
    """How far the arm was from where the motion wanted it, at 100 Hz."""

    samples: int
    rms_m: float
    max_m: float
    max_at_s: float
    """Time of the largest error on the motion's own clock [s]."""


class Motion:
    """A motion that is under way; made by `Pilot.move`.

    Args:
        trajectory: What is followed.
    """

    def __init__(self, trajectory: Trajectory) -> None:
        self.trajectory = trajectory
        self.time_s = 0.0
        """How far it is on the trajectory's clock [s]."""
        self.ending: Ending | None = None
        self.rate = 1.0
        """Speed on the trajectory's clock: 1, less while it is braked."""
        self.is_braking = False
        self._done = threading.Event()
        self._count = 0
        self._squares = 0.0
        self._max = (0.0, 0.0)

    def wait(self, timeout_s: float) -> bool:
        """Wait for its end; whether it has ended."""
        return self._done.wait(timeout_s)

    def finish(self, ending: Ending) -> None:
        """Say that it has ended."""
        self.ending = ending
        self._done.set()

    def note_error(self, error_m: float) -> None:
        """Keep a distance between the arm and the motion [m]."""
        self._count += 1
        self._squares += error_m * error_m
        if error_m > self._max[0]:
            self._max = (error_m, self.time_s)

    @property
    def tracking(self) -> Tracking:
        """The distances so far."""
        rms = math.sqrt(self._squares / self._count) if self._count else 0.0
        return Tracking(self._count, rms, *self._max)


class Pilot:
    """Publishes set-points at 100 Hz: it holds axes, releases them, and leads the arm along trajectories.

    It begins by holding every axis where the handle is.

    Args:
        loop: A loop that runs.
        brake_time: Time in which an interrupted motion comes to rest on its path [s].
        on_failure: Called once, from the pilot's thread, with what ended the loop.
    """

    def __init__(
        self,
        loop: LoopHandle,
        *,
        brake_time: float,
        on_failure: Callable[[HapticMasterError], None] = lambda _error: None,
    ) -> None:
        self._loop = loop
        self._brake_time = brake_time
        self._on_failure = on_failure
        self._lock = threading.Lock()
        self._ending = threading.Event()
        self._begun = threading.Event()
        self._thread: threading.Thread | None = None
        self._sequence = 0
        self._engaged = [True, True, True]
        self._was_engaged = [False, False, False]
        self._target = [0.0, 0.0, 0.0]
        self._motion: Motion | None = None
        self.failure: HapticMasterError | None = None
        """What ended the loop, or None."""

    def start(self) -> None:
        """Start the thread and wait until it holds the arm, or the loop has ended."""
        self._thread = threading.Thread(target=self._run, name="pilot", daemon=True)
        self._thread.start()
        self._begun.wait(_PATIENCE_S)

    def close(self) -> None:
        """End the thread; the loop then misses its heartbeat unless it has ended. Idempotent."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(_PATIENCE_S)

    @property
    def engaged(self) -> tuple[bool, bool, bool]:
        """Which axes are held or led, in the order x, y, z; the others are free."""
        x, y, z = self._engaged
        return x, y, z

    @property
    def target(self) -> Vector:
        """Where the held axes are held [m]."""
        with self._lock:
            x, y, z = self._target
        return x, y, z

    @property
    def motion(self) -> Motion | None:
        """The motion under way, or None."""
        return self._motion

    def hold(self, axes: Iterable[int] = ALL_AXES) -> None:
        """Hold axes where they are; those that are held stay held at their place."""
        with self._lock:
            for axis in axes:
                self._engaged[axis] = True

    def release(self, axes: Iterable[int] = ALL_AXES) -> None:
        """Let the hand move axes."""
        with self._lock:
            for axis in axes:
                self._engaged[axis] = False

    def move(self, trajectory: Trajectory, axes: Iterable[int] = ALL_AXES) -> Motion:
        """Lead axes along a trajectory, which begins where they are held; the others stay as they are."""
        motion = Motion(trajectory)
        with self._lock:
            for axis in axes:
                self._engaged[axis] = True
            if self.failure is None:
                self._motion = motion
            else:
                motion.finish(Ending.LOST)
        return motion

    def brake(self) -> None:
        """Bring the motion under way to rest on its path; the arm is then held there."""
        motion = self._motion
        if motion is not None:
            motion.is_braking = True

    def _run(self) -> None:
        granted = enter_realtime(_PRIORITY, hold_dma_latency=False)
        last_s = time.monotonic()
        deadline_s = last_s + TICK_S
        try:
            while not self._ending.is_set():
                now_s = time.monotonic()
                self._tick(min(now_s - last_s, _LONGEST_STEP_S))
                last_s = now_s
                behind = max(0, int((time.monotonic() - deadline_s) / TICK_S))
                time.sleep(max(0.0, deadline_s + behind * TICK_S - time.monotonic()))
                deadline_s += (1 + behind) * TICK_S
        except HapticMasterError as error:
            self._fail(error)
        finally:
            granted.release()
            self._begun.set()

    def _fail(self, error: HapticMasterError) -> None:
        with self._lock:
            self.failure = error
            if self._motion is not None:
                self._motion.finish(Ending.LOST)
                self._motion = None
        self._on_failure(error)

    def _tick(self, dt: float) -> None:
        self._loop.check()
        state = self._loop.state()
        if state.cycle == 0.0:
            self._loop.heartbeat()
            return
        with self._lock:
            set_point = self._next(state, dt)
        self._loop.publish(set_point)
        self._begun.set()

    def _next(self, state: LoopState, dt: float) -> SetPoint:
        handle = (state.measured_x, state.measured_y, state.measured_z)
        for axis in ALL_AXES:
            if not self._was_engaged[axis]:
                self._target[axis] = handle[axis]
            self._was_engaged[axis] = self._engaged[axis]
        velocity = (0.0, 0.0, 0.0) if self._motion is None else self._advance(self._motion, handle, dt)
        self._sequence += 1
        x, y, z = (float(engaged) for engaged in self._engaged)
        return SetPoint(
            sequence=float(self._sequence),
            engage_x=x,
            engage_y=y,
            engage_z=z,
            target_x=self._target[0],
            target_y=self._target[1],
            target_z=self._target[2],
            velocity_x=velocity[0],
            velocity_y=velocity[1],
            velocity_z=velocity[2],
        )

    def _advance(self, motion: Motion, handle: Vector, dt: float) -> Vector:
        """Move the target along; the loop reaches it at the end of this tick, when the next one compares."""
        axes = [axis for axis in ALL_AXES if self._engaged[axis]]
        motion.note_error(math.dist([handle[i] for i in axes], [self._target[i] for i in axes]))
        if motion.is_braking:
            motion.rate = max(0.0, motion.rate - dt / self._brake_time)
        motion.time_s += motion.rate * dt
        point = motion.trajectory.at(motion.time_s)
        for axis in axes:
            self._target[axis] = point.position[axis]
        x, y, z = point.velocity
        if motion.time_s >= motion.trajectory.duration_s or motion.rate == 0.0:
            has_arrived = motion.time_s >= motion.trajectory.duration_s
            self._motion = None
            motion.finish(Ending.ARRIVED if has_arrived else Ending.STOPPED)
            return (0.0, 0.0, 0.0)
        return x * motion.rate, y * motion.rate, z * motion.rate

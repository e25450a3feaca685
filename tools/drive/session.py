"""A drive: one device, the loop that moves it while it is wanted, and another connection for all else."""

import contextlib
import math
import time
from collections.abc import Callable, Iterable
from dataclasses import replace
from types import TracebackType
from typing import Self

from hm_driver.device.haptic_master import HapticMaster, connect
from hm_driver.errors import (
    ConfigurationError,
    DeviceError,
    DeviceFault,
    HapticMasterError,
    LoopError,
    TransportError,
)
from hm_driver.geometry import ArmGeometry
from hm_driver.protocol.commands import Command
from hm_driver.protocol.vocabulary import State
from hm_driver.realtime.claim import DeviceClaim
from hm_driver.realtime.modes import PositionControl
from hm_driver.realtime.options import LoopOptions
from tools.drive.effects import EffectTable
from tools.drive.engine import Engine
from tools.drive.log import DriveLog
from tools.drive.options import TICK_S, DriveOptions
from tools.drive.outcome import Arrival, CommandRefused, EndRequested, MotionStopped, NotArrived
from tools.drive.pilot import ALL_AXES, Ending, Motion, Pilot
from tools.drive.raw import Explainer, doubts, is_question, read_command, why_forbidden
from tools.drive.reach import check_path, check_point, joint_peak
from tools.drive.status import AXES, DriveStatus, loop_modes
from tools.drive.trajectory import StraightMove, Trajectory, Vector

_WAIT_S = 0.05
_BRAKE_PATIENCE_S = 3.0
_AT_REST = 0.005
_HOME_TIMEOUT_S = 30.0
_UNPOWERED = (State.OFF, State.FAULT)


class Drive:
    """Drives one device; a context manager whose end leaves the arm stopped.

    The loop starts with the first word that needs it, holding the arm where it is, and ends with `stop`. As
    long as only questions were asked, nothing at all is commanded, not even the stop at the end.

    Args:
        url: The device.
        options: The configuration.
        log: Where recordings go.
        tell: Is handed what a person should know meanwhile.
        approach: Called once, before anything is commanded, with the configuration and the arm's reach; it
            returns what to go on with, as slow as a first run has to be, or raises where nobody agrees.
    """

    def __init__(
        self,
        url: str,
        options: DriveOptions,
        log: DriveLog,
        *,
        tell: Callable[[str], None],
        approach: Callable[[DriveOptions, ArmGeometry], DriveOptions] = lambda options, _geometry: options,
    ) -> None:
        self.url = url
        self.options = options
        self.log = log
        self.effects = EffectTable()
        self.on_progress: Callable[[], None] = lambda: None
        """Called about 20 times a second while a motion is waited for."""
        self.on_failure: Callable[[HapticMasterError], None] = lambda _error: None
        """Called from another thread with what ended the loop, as soon as that happens."""
        self.engine = Engine()
        """The loop, while one runs."""
        self._tell = tell
        self._approach = approach
        self._is_approached = False
        self._arm: HapticMaster | None = None
        self._geometry: ArmGeometry | None = None
        self._loop_state = State.FORCE
        self._has_commanded = False

    def __enter__(self) -> Self:
        self._arm = connect(self.url)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except HapticMasterError as problem:
            if error is None:
                raise
            error.add_note(f"and then: {problem}")

    # What there is

    @property
    def arm(self) -> HapticMaster:
        """The connection that is not the loop's; opened anew where it was lost.

        Raises:
            TransportError: The device cannot be reached.
        """
        if self._arm is None:
            raise TransportError("the drive is not open; use it in a 'with' statement")
        if self._arm.link.is_broken:
            self._tell("the connection was lost: connecting again")
            self._arm.reconnect()
        return self._arm

    @property
    def pilot(self) -> Pilot | None:
        """Who leads the loop, or None while there is none."""
        return self.engine.pilot

    @property
    def is_driving(self) -> bool:
        """Whether a loop drives the arm."""
        return self.engine.is_running

    @property
    def geometry(self) -> ArmGeometry:
        """The arm's reach, as the device reports it."""
        if self._geometry is None:
            self._geometry = self.arm.workspace()
        return self._geometry

    @property
    def handle(self) -> Vector:
        """Where the end effector is [m]."""
        if self.is_driving:
            state = self.engine.state
            return state.measured_x, state.measured_y, state.measured_z
        return self.arm.measured_position()

    def status(self) -> DriveStatus:
        """One look at everything; costs the device no question while a loop drives."""
        recording = None if self.log.path is None else str(self.log.path)
        pilot = self.pilot
        if pilot is None or not self.is_driving:
            measured = self.arm.measure()
            return DriveStatus(self.arm.state.value, *measured, recording=recording)
        state = self.engine.state
        return DriveStatus(
            state=self._loop_state.value,
            position=(state.measured_x, state.measured_y, state.measured_z),
            velocity=(state.velocity_x, state.velocity_y, state.velocity_z),
            force=(state.force_x, state.force_y, state.force_z),
            modes=loop_modes(state),
            target=pilot.target,
            rate_hz=self.engine.rate_hz,
            cycles=int(state.cycle),
            missed=int(state.missed),
            recording=recording,
        )

    # The loop's life

    def take_failure(self) -> HapticMasterError | None:
        """What ended the loop since this was asked last, or None; the loop is cleared away."""
        failure = self.engine.take_failure()
        if failure is not None:
            self.effects.disable_all()
            with contextlib.suppress(HapticMasterError):  # the failure itself is what is told
                self._make_effects_again()
        return failure

    def ensure_loop(self) -> Pilot:
        """Start the loop where none runs; the arm is then held where it is.

        Raises:
            HapticMasterError: What ended the loop before, or keeps it from starting.
        """
        failure = self.take_failure()
        if failure is not None:
            raise failure
        if self.pilot is not None:
            return self.pilot
        self._begin_commanding()
        options = self._loop_options(self.options, self._loop_state)
        if not self.arm.is_position_calibrated():
            self._tell("the arm initialises: it moves by itself, keep your hands off")
        pilot = self.engine.start(
            options, brake_time=self.options.motion.brake_time, on_failure=self.on_failure
        )
        self._make_effects_again()
        return pilot

    def stop(self) -> None:
        """End the loop gently and put the device into state ``stop``; its effects are disabled."""
        self.effects.disable_all()
        self._end_loop()
        self._has_commanded = True
        self.arm.set_state(State.STOP)

    def enter(self, state: State) -> None:
        """Put the device into a state; ``force`` and ``position`` start the loop there, holding the arm.

        Raises:
            DeviceFault: The device does not get there.
        """
        if state in (State.FORCE, State.POSITION):
            if self._loop_state is not state or self.pilot is None:
                self._change(self.options, state)
                self.ensure_loop()
            return
        self._begin_commanding()
        self.stop()
        try:
            if state is State.INIT:
                self.arm.initialise(timeout_s=self.options.init_timeout_s)
            elif state is State.HOME:
                self._go_home()
            elif state is State.OFF:
                self.arm.set_state(state)
        except KeyboardInterrupt:
            self.arm.set_state(State.STOP)
            raise

    def configure(self, options: DriveOptions) -> None:
        """Go on with another configuration; a loop that runs is started anew, the arm held meanwhile."""
        self._change(options, self._loop_state)

    def set_inertia(self, mass: float) -> None:
        """Set the virtual mass [kg], of the loop and of the device."""
        self._begin_commanding()
        self.configure(replace(self.options, modes=replace(self.options.modes, inertia=mass)))
        if not self.is_driving:
            self.arm.inertia = mass

    def set_control(self, control: PositionControl) -> None:
        """Choose who renders the springs of position mode."""
        self.configure(replace(self.options, modes=replace(self.options.modes, position_control=control)))

    def close(self) -> None:
        """End the loop, leave the device in ``stop`` if anything was commanded, and close the connection.

        A device that has no power, in ``off`` or ``fault``, is left so.
        """
        try:
            self._end_loop()
        finally:
            arm, self._arm = self._arm, None
            if arm is not None:
                try:
                    if self._has_commanded:
                        _leave_stopped(arm)
                finally:
                    arm.close()

    # Motions

    def hold(self, axes: Iterable[int] = ALL_AXES) -> None:
        """Hold axes where they are."""
        self.ensure_loop().hold(axes)

    def release(self, axes: Iterable[int] = ALL_AXES) -> None:
        """Let the hand move axes.

        Raises:
            ConfigurationError: The device is in a state that does not answer to the hand.
        """
        if self._loop_state is State.POSITION:
            raise ConfigurationError(
                "state", "position does not respond to the hand: 'state force' first, then release"
            )
        self.ensure_loop().release(axes)

    def check_goal(self, field: str, goal: Vector) -> None:
        """Refuse a goal [m] out of reach, before anything moves; raises `ConfigurationError`."""
        check_point(field, goal, self.geometry)

    def go(
        self, field: str, goal: Vector, *, speed: float | None = None, axes: Iterable[int] = ALL_AXES
    ) -> Arrival:
        """Lead the arm straight to a goal and wait until it is there.

        Args:
            field: What to call it in an error.
            goal: Where to [m]; along other axes than `axes` it says where they are.
            speed: Largest speed [m/s]; None for the configured one.
            axes: The axes that are led.

        Raises:
            ConfigurationError: The goal, or a point of the way, is out of reach.
            NotArrived: Something holds the arm.
            MotionStopped: Ctrl-C; the arm was braked and is held.
            HapticMasterError: What ended the loop.
        """
        self.check_goal(field, goal)
        self._begin_commanding()
        motion = self.options.motion
        if speed is not None and speed > motion.speed_max:
            raise ConfigurationError(
                f"{field} --speed", f"{speed:g} m/s is above {motion.speed_max:g} m/s, the limit of this run"
            )
        pilot = self.ensure_loop()
        move = StraightMove.within(
            self.place(), goal, speed=speed or motion.speed, acceleration=motion.acceleration
        )
        check_path(field, move, self.geometry)
        peak = joint_peak(move, self.geometry, self.options.limits)
        if peak.share > 1.0:
            move = move.slowed(peak.share)
            self._tell(
                f"slowed down by {peak.share:.2f}: joint {peak.joint} may do {peak.limit:.3g} {peak.unit}"
            )
        return self._follow(pilot, move, goal, axes)

    def place(self) -> Vector:
        """Where the arm is led from: held axes where they are held, the others where they are [m]."""
        handle, pilot = self.handle, self.pilot
        if pilot is None:
            return handle
        x, y, z = (
            target if engaged else measured
            for target, measured, engaged in zip(pilot.target, handle, pilot.engaged, strict=True)
        )
        return x, y, z

    def follow(self, trajectory: Trajectory) -> Arrival:
        """Lead the arm along a trajectory that was checked and that begins where the arm is; as `go`."""
        goal = trajectory.at(trajectory.duration_s).position
        return self._follow(self.ensure_loop(), trajectory, goal, ALL_AXES)

    # The device's own language

    def command(self, text: str) -> str:
        """Send one command of the device's own language and return the answer.

        Raises:
            ConfigurationError: It would undermine the loop, or pull at the handle at once.
            CommandRefused: The device refused it; a note explains why in plain words.
        """
        if not is_question(text):
            if self.is_driving:
                reason = why_forbidden(text)
                if reason:
                    error = ConfigurationError(text, f"not while the loop drives the arm: {reason}")
                    if read_command(text) is None:
                        error.add_note(self._explain(text))
                    raise error
            self._begin_commanding()
        command = read_command(text)
        if command is not None:
            self.effects.check_step(command, self.handle, self.options.modes.position_force_max)
        try:
            reply = self.arm.command(text)
        except DeviceError as error:
            refused = CommandRefused(error.command, error.reply)
            refused.add_note(self._explain(text))
            raise refused from error
        if command is not None:
            self.effects.apply(command)
        doubt = doubts(text, self.effects)
        if doubt:
            self._tell(f"note: {doubt}")
        return reply

    def send(self, command: Command) -> str:
        """Send a command; raises as `command`."""
        return self.command(command.encode())

    # Inside

    def _explain(self, text: str) -> str:
        return Explainer(self.effects, self.arm.command).explain(text)

    def _loop_options(self, options: DriveOptions, state: State) -> LoopOptions:
        return LoopOptions(
            url=self.url,
            state=state.value,
            modes=options.modes,
            limits=options.limits,
            geometry=self.geometry,
            timing=options.timing,
            watch=options.watch,
            tick_s=TICK_S,
            init_timeout_s=options.init_timeout_s,
            ring=self.log.loop_ring,
            epoch_ns=self.log.epoch_ns,
        )

    def _change(self, options: DriveOptions, state: State) -> None:
        self._loop_options(options, state)  # refused here, before the loop that runs is ended
        engaged = None if self.pilot is None else self.pilot.engaged
        enabled = {name for name, known in self.effects.objects.items() if known.is_enabled}
        if engaged is not None:
            self._tell("the loop starts anew; the arm stands still meanwhile")
            self._end_loop()
        self.options, self._loop_state = options, state
        if engaged is not None:
            for name in enabled & set(self.effects.objects):
                self.effects.objects[name].is_enabled = True
            pilot = self.ensure_loop()
            if state is State.FORCE:
                pilot.release(axis for axis in ALL_AXES if not engaged[axis])

    def restart_loop(self) -> None:
        """Start a loop that runs anew, so that it takes up what only a start can."""
        self._change(self.options, self._loop_state)

    def _end_loop(self) -> None:
        """End a loop that runs, and make the effects again that it removes from the device."""
        if self.pilot is not None:
            self.engine.end()
            self.effects.disable_all()
            self._make_effects_again()

    def _make_effects_again(self) -> None:
        """Make what the loop's start or end has removed from the device."""
        if self._arm is None:
            return
        for command in self.effects.commands():
            try:
                self.effects.check_step(command, self.handle, self.options.modes.position_force_max)
            except ConfigurationError as error:
                self.effects.objects[error.field].is_enabled = False
                self._tell(f"not enabled again: {error}")
            else:
                self.arm.command(command.encode())

    def _begin_commanding(self) -> None:
        """Make sure that this drive may command the device; before each command, cheap while a loop drives.

        Raises:
            ConfigurationError: Nobody agrees to drive a robot for the first time.
            LoopError: Another program of this machine drives the device.
        """
        if not self._is_approached:
            self.options = self._approach(self.options, self.geometry)
            self._is_approached = True
        if self.pilot is None:
            with DeviceClaim(self.url):
                pass
        self._has_commanded = True

    def _go_home(self) -> None:
        self.arm.set_state(State.HOME)
        deadline = time.monotonic() + _HOME_TIMEOUT_S
        quiet_since = time.monotonic()
        while time.monotonic() - quiet_since < 0.3:
            if time.monotonic() > deadline:
                raise DeviceFault(f"the arm still moves {_HOME_TIMEOUT_S:g} s after 'set state home'")
            if self.arm.state is not State.HOME:
                raise DeviceFault(f"the device left state home for {self.arm.state.value}")
            time.sleep(_WAIT_S)
            if math.hypot(*self.arm.measured_velocity()) > _AT_REST:
                quiet_since = time.monotonic()
        self.arm.set_state(State.STOP)

    def _follow(self, pilot: Pilot, trajectory: Trajectory, goal: Vector, axes: Iterable[int]) -> Arrival:
        axes = tuple(axes)
        motion = pilot.move(trajectory, axes)
        self._wait(pilot, motion)
        error_m = self._settle(goal, axes)
        arrival = Arrival(trajectory.duration_s, motion.tracking, self.handle, error_m)
        if error_m > self.options.motion.tolerance:
            raise NotArrived(
                f"the arm is {1e3 * error_m:.1f} mm from its goal and is held; allowed are "
                f"{1e3 * self.options.motion.tolerance:g} mm (motion.tolerance). Something keeps it at "
                f"{_shown(arrival.position)} m: {self._suspects()}"
            )
        return arrival

    def _wait(self, pilot: Pilot, motion: Motion) -> None:
        try:
            while not motion.wait(_WAIT_S):
                self.on_progress()
        except EndRequested:
            raise
        except KeyboardInterrupt:
            pilot.brake()
            motion.wait(_BRAKE_PATIENCE_S)
            if motion.ending is not Ending.LOST:
                raise MotionStopped(f"stopped on the way, held at {_shown(self.handle)} m") from None
        if motion.ending is Ending.LOST:
            raise self.take_failure() or LoopError("the loop ended during the motion")

    def _suspects(self) -> str:
        enabled = [name for name, known in self.effects.objects.items() if known.is_enabled]
        return f"the effects {', '.join(enabled)} act too" if enabled else "a hand, or an obstacle"

    def _settle(self, goal: Vector, axes: Iterable[int]) -> float:
        """Wait until the led axes are where they were led, and return how far they are from it [m]."""
        deadline = time.monotonic() + self.options.motion.settle_time
        while True:
            failure = self.take_failure()
            if failure is not None:
                raise failure
            handle = self.handle
            error_m = math.dist([handle[i] for i in axes], [goal[i] for i in axes])
            if error_m < self.options.motion.tolerance / 2.0 or time.monotonic() > deadline:
                return error_m
            time.sleep(_WAIT_S / 5.0)


def axis_index(name: str) -> int:
    """Index of an axis by its letter."""
    return AXES.index(name)


def _leave_stopped(arm: HapticMaster) -> None:
    with contextlib.suppress(TransportError):
        if arm.link.is_broken:
            arm.reconnect()
        if arm.state in _UNPOWERED:
            return
    arm.safe_stop()


def _shown(position: Vector) -> str:
    return "[{:.4f}, {:.4f}, {:.4f}]".format(*position)

"""A session in lock-step: emulator, loop and session in one thread, on a virtual clock, over the protocol."""

from emulator.in_process import LockstepEmulator
from hm_driver.device.link import CommandLink
from hm_driver.errors import HapticMasterError, SafetyTrip
from hm_driver.protocol.framing import Dialect
from hm_driver.realtime import bring_up
from hm_driver.realtime.clock import VirtualClock
from hm_driver.realtime.core import LoopCore, Recording
from hm_driver.realtime.grid import Grid, period_ns_of
from hm_driver.realtime.options import LoopOptions
from hm_driver.realtime.segment import Segment, Trip, Word
from hm_driver.realtime.setpoint import LoopState, SetPoint
from hm_driver.transport.in_process import InProcessTransport
from teaching.hands.contract import Hand
from tools.run.compiled_loop import CompiledLoop
from tools.run.demonstrator import build_demonstrator
from tools.run.hands import EmulatedWorld
from tools.run.log import SessionLog
from tools.run.options import TICK_S, build_session
from tools.run.recording import open_recording
from tools.run.request import Outcome, TeachRequest
from tools.run.runner import Plugs, View, run_ticks

EPOCH_NS = 1_577_836_800_000_000_000
"""Log time at which every virtual session begins: 2020-01-01 00:00 UTC."""
_INIT_S = 1.0


class AnsweredLink:
    """The loop's connection, over which the request of a cycle may have been answered before.

    Args:
        link: The connection.
        reply: What it made of the first line that is going to be sent; None where that is still to be sent.
    """

    def __init__(self, link: CommandLink, reply: bytes | HapticMasterError | None) -> None:
        self._link = link
        self._reply = reply
        self.combined = link.combined

    def exchange(self, request: str) -> str:
        """As `CommandLink.exchange`."""
        return self._link.exchange(request)

    def send_line(self, line: bytes) -> None:
        """As `CommandLink.send_line`."""
        if self._reply is None:
            self._link.send_line(line)

    def receive_line(self) -> bytes:
        """As `CommandLink.receive_line`."""
        reply, self._reply = self._reply, None
        if reply is None:
            return self._link.receive_line()
        if isinstance(reply, HapticMasterError):
            raise reply
        return reply


class LockstepLoop:
    """The driver's loop, run whenever the session waits: compiled as long as nothing unusual happens.

    Args:
        options: The loop's options.
        emulator: The device.
        recording: Where the cycles' records go.
        is_compiled: False runs every cycle interpreted, with the same result.
    """

    def __init__(
        self,
        options: LoopOptions,
        emulator: LockstepEmulator,
        recording: Recording,
        *,
        is_compiled: bool = True,
    ) -> None:
        self._clock = VirtualClock()
        self._clock.on_advance(emulator.advance_to_ns)
        self._segment = Segment.in_memory()
        self._options = options
        self._period_ns = period_ns_of(options.timing.rate_hz)
        link = CommandLink(InProcessTransport(emulator), Dialect.TEXT)
        self._link = link
        link.probe_combined()
        bring_up.initialise(link, self._clock, timeout_s=options.init_timeout_s)
        bring_up.enter_session(link, options)
        self.start_ns = (self._clock.now_ns() // 10_000_000 + 1) * 10_000_000
        """Deadline of the first cycle and of the first tick on the virtual clock [ns]."""
        self._next_ns = self.start_ns
        self._recording = recording._replace(epoch_ns=EPOCH_NS - self.start_ns)
        self._core: LoopCore | None = None
        self._compiled = CompiledLoop(
            link,
            emulator,
            self._clock,
            self._segment,
            start_ns=self.start_ns,
            period_ns=self._period_ns,
            parameters=options.parameters(),
            watch=options.watch,
            recording=self._recording,
            session_state=options.state,
        )
        if not is_compiled or not link.combined:
            self._interpret()

    def now_ns(self) -> int:
        """The virtual time [ns]."""
        return self._clock.now_ns()

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Run the cycles up to and with the one at the deadline [ns]."""
        if self._core is None:
            cycles = (deadline_ns - self.start_ns) // self._period_ns + 1
            if self._compiled.run_to(cycles):
                return
        core = self._interpret()
        while self._next_ns <= deadline_ns and core.run_cycle():
            self._next_ns += self._period_ns

    def spin_until_ns(self, deadline_ns: int) -> int:
        """As `sleep_until_ns`; returns the time [ns]."""
        self.sleep_until_ns(deadline_ns)
        return self.now_ns()

    def state(self) -> LoopState:
        """The newest state of the loop."""
        return self._segment.state()

    def publish(self, set_point: SetPoint) -> None:
        """Hand over the set-point."""
        self._segment.publish(set_point)
        self._segment.words[Word.APP_HEARTBEAT_NS] = self._clock.now_ns()

    def check(self) -> None:
        """Raise what ended the loop.

        Raises:
            SafetyTrip: A limit tripped.
        """
        if self._segment.trip is not Trip.NONE:
            raise SafetyTrip(self._segment.trip.name.lower(), self._segment.text("trip"))

    def stop(self) -> None:
        """Release the springs and stop the device."""
        try:
            core = self._interpret()
            core.stop()
            while core.run_cycle():
                pass
        finally:
            bring_up.make_safe(self._link)
            bring_up.clear(self._link)

    def _interpret(self) -> LoopCore:
        """The interpreted loop, which goes on for good where the compiled one stands."""
        if self._core is None:
            options, compiled = self._options, self._compiled
            self._core = LoopCore(
                AnsweredLink(self._link, compiled.reply),
                Grid(self._clock, self._period_ns, start_ns=self.start_ns),
                self._clock,
                self._segment,
                parameters=options.parameters(),
                watch=options.watch,
                recording=self._recording,
                keeps_timing=False,
                session_state=options.state,
            )
            self._core.resume(compiled.checkpoint())
            self._next_ns += compiled.cycles * self._period_ns
        return self._core


def run_lockstep(request: TeachRequest, view: View, *, name: str, is_compiled: bool = True) -> Outcome:
    """Run a session as fast as it goes; the same seed gives the same log, message for message.

    Args:
        request: The session.
        view: Who watches it.
        name: Name of the log, without suffix.
        is_compiled: False runs the loop interpreted, with the same result.

    Raises:
        SafetyTrip: A limit tripped; the log is complete up to there.
        RecordingError: The log cannot be written.
    """
    shuffle, hand_rng, emulator_seed = request.streams()
    options = request.options
    with open_recording(
        request, name=name, clock="virtual", device="emulator", is_lockstep=True, tell=view.tell
    ) as recording:
        emulator = LockstepEmulator(seed=emulator_seed, init_seconds=_INIT_S)
        recording.wait_until_open()
        try:
            loop_options = LoopOptions(
                url="sim://",
                modes=options.modes,
                limits=options.limits,
                geometry=options.geometry,
                timing=options.timing,
                watch=options.watch,
                tick_s=TICK_S,
                init_timeout_s=options.init_timeout_s,
            )
            loop = LockstepLoop(loop_options, emulator, Recording(recording.ring, 0), is_compiled=is_compiled)
            world = EmulatedWorld(emulator.world)
            hand: Hand = build_demonstrator(
                request.task, options.demonstrator, hand_rng, handle=emulator.truth().position
            )
            session = build_session(options, request.task, shuffle)
            log = SessionLog(recording.ring, reference_force=request.task.reference_force)
            plugs = Plugs(clock=loop, loop=loop, hand=hand, world=world, log=log, view=view)
            try:
                run_ticks(session, plugs, start_ns=loop.start_ns, epoch_ns=EPOCH_NS - loop.start_ns)
            finally:
                world.move(loop.now_ns(), None)
                loop.stop()
        finally:
            status = recording.finish()
    return Outcome(log=recording.path, lost=status.lost, loop={}, ticks=None)

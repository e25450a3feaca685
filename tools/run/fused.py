"""A session without wire and log, for studies: as `tools.run.lockstep` decides, at a fraction of its cost."""

import math
from struct import Struct

from emulator.in_process import LockstepEmulator
from emulator.layout import E_SIZE
from emulator.world_service import HAND_LIMITS, parse_hand
from hm_driver.device.link import CommandLink
from hm_driver.errors import SafetyTrip
from hm_driver.protocol.framing import Dialect
from hm_driver.realtime import bring_up
from hm_driver.realtime.checkpoint import Checkpoint
from hm_driver.realtime.clock import VirtualClock
from hm_driver.realtime.commands import EffectCommands
from hm_driver.realtime.core import LoopCore
from hm_driver.realtime.cycle import (
    ADMITTANCE,
    ASSIST,
    P_BY_FORCE,
    PHASE,
    S_PUSH,
    SETPOINT_SIZE,
    SPRING_STRIDE,
    SPRINGS,
)
from hm_driver.realtime.grid import Grid, period_ns_of
from hm_driver.realtime.options import BIAS_NAME, SPRING_NAMES, LoopOptions
from hm_driver.realtime.segment import Segment, Trip, Word
from hm_driver.realtime.setpoint import LoopState, SetPoint
from hm_driver.transport.in_process import InProcessTransport
from teaching.hands.contract import HandIntent
from teaching.session import Session, Tick
from tools.run.demonstrator import build_demonstrator
from tools.run.fused_kernels import (
    ADVANCE,
    DONE,
    F_BIAS_LIMIT,
    F_HAND,
    F_HAND_HIGH,
    F_HAND_LOW,
    F_LOOP_STATE,
    F_SPRING_LIMIT,
    HAND_SIZE,
    N_CYCLES,
    N_ENABLED,
    N_HAND,
    N_IS_ADVANCED,
    N_PLACES,
    N_STEP,
    REFUSED,
    SWITCH,
    make_memory,
    run_cycles,
)
from tools.run.options import TICK_S, build_session
from tools.run.request import TeachRequest
from tools.run.runner import Felt, Log, Plugs, run_ticks

_SET_POINT = Struct(f"={SETPOINT_SIZE}d")
_HAND = Struct(f"={HAND_SIZE}d")
_HAND_AT = 8 * F_HAND
_LOOP_STATE = Struct(f"={len(LoopState._fields)}d")
_LOOP_STATE_AT = 8 * F_LOOP_STATE
_HOLDS, _LETS_GO = 1, 2
INIT_S = 1.0
"""Device time that the emulated search for the end stops takes [s], as in lock-step."""


class FusedLoop:
    """Clock, loop and the hand's way to the emulated arm in one, fused as long as nothing unusual happens.

    What is unusual, a trip above all, is run by the interpreted loop, over the protocol, from there on.

    Args:
        options: The loop's options.
        emulator: The device.
    """

    def __init__(self, options: LoopOptions, emulator: LockstepEmulator) -> None:
        self._options = options
        self._emulator = emulator
        self._clock = VirtualClock()
        self._clock.on_advance(emulator.advance_to_ns)
        self._link = link = CommandLink(InProcessTransport(emulator), Dialect.TEXT)
        link.probe_combined()
        bring_up.initialise(link, self._clock, timeout_s=options.init_timeout_s)
        bring_up.enter_session(link, options)
        self._period_ns = period_ns_of(options.timing.rate_hz)
        self.start_ns = (self._clock.now_ns() // 10_000_000 + 1) * 10_000_000
        """Deadline of the first cycle and of the first tick on the virtual clock [ns]."""
        self._memory = make_memory(options.parameters())
        self._counts = self._memory.counts.data
        self._numbers = self._memory.numbers.data.cast("B")
        self._lay_out()
        self._intent: HandIntent | None = None
        self._published_ns = 0
        self._cycles_asked = 0
        self._now_ns = self._clock.now_ns()
        self._segment: Segment | None = None
        self._core: LoopCore | None = None
        self._next_ns = self.start_ns
        self._look_around()
        if not link.combined:
            self._interpret()

    @property
    def is_fused(self) -> bool:
        """Whether nothing unusual has happened yet."""
        return self._core is None

    def now_ns(self) -> int:
        """The virtual time [ns]."""
        return self._now_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Run the cycles up to and with the one at the deadline [ns].

        Raises:
            WorldError: The hand intends what no hand can.
        """
        self._now_ns = max(self._now_ns, deadline_ns)
        if self._core is None and self._run_to((deadline_ns - self.start_ns) // self._period_ns + 1):
            return
        core = self._interpret()
        while self._next_ns <= deadline_ns and core.run_cycle():
            self._next_ns += self._period_ns

    def spin_until_ns(self, deadline_ns: int) -> int:
        """As `sleep_until_ns`; returns the time [ns]."""
        self.sleep_until_ns(deadline_ns)
        return self._now_ns

    def state(self) -> LoopState:
        """The newest state of the loop."""
        if self._segment is not None:
            return self._segment.state()
        return LoopState._make(_LOOP_STATE.unpack_from(self._numbers, _LOOP_STATE_AT))

    def publish(self, set_point: SetPoint) -> None:
        """Hand over the set-point."""
        self._published_ns = self._now_ns
        if self._segment is None:
            _SET_POINT.pack_into(self._numbers, 0, *set_point)
        else:
            self._segment.publish(set_point)
            self._segment.words[Word.APP_HEARTBEAT_NS] = self._now_ns

    def check(self) -> None:
        """Raise what ended the loop.

        Raises:
            SafetyTrip: A limit tripped.
        """
        if self._segment is not None and self._segment.trip is not Trip.NONE:
            raise SafetyTrip(self._segment.trip.name.lower(), self._segment.text("trip"))

    def move(self, time_ns: int, intent: HandIntent | None) -> list[Felt]:  # noqa: ARG002  # a world's signature
        """Have the hand hold the arm as it intends, None to let go; tells nothing.

        Raises:
            WorldError: The hand intends what no hand can.
        """
        if self._core is not None:
            self._emulator.world.exchange(None if intent is None else intent._asdict())
        elif intent is None:
            self._counts[N_HAND] = _LETS_GO
        else:
            self._intent = intent
            position, velocity, stiffness, damping, force = intent
            _HAND.pack_into(self._numbers, _HAND_AT, *position, *velocity, *stiffness, *damping, *force)
            self._counts[N_HAND] = _HOLDS
        return []

    def _lay_out(self) -> None:
        """Tell the kernel where the objects are, and which values device and world endpoint take."""
        counts, numbers, device = self._memory.counts, self._memory.numbers, self._emulator.device
        counts[N_STEP] = device.step
        springs, bias = [device.find(name) for name in SPRING_NAMES], device.find(BIAS_NAME)
        counts[N_PLACES:N_ENABLED] = [entry.slot * E_SIZE for entry in (*springs, bias)]
        described = [springs[0].type.parameter(name) for name in ("pos", "vel", "maxforce")]
        for at, parameter in enumerate(described):
            numbers[F_SPRING_LIMIT + 2 * at : F_SPRING_LIMIT + 2 * at + 2] = parameter.low, parameter.high
        force = bias.type.parameter("force")
        numbers[F_BIAS_LIMIT : F_BIAS_LIMIT + 2] = force.low, force.high
        numbers[F_HAND_LOW:F_HAND_HIGH] = [limits.low for limits in HAND_LIMITS.values() for _ in range(3)]
        numbers[F_HAND_HIGH : F_HAND_HIGH + HAND_SIZE] = [
            limits.high for limits in HAND_LIMITS.values() for _ in range(3)
        ]

    def _look_around(self) -> None:
        """See what the device has come to; good until Python has had it."""
        inside = self._emulator.inside()
        self._arm, self._active_effects, self._next_step = inside.arm, inside.active_effects, inside.next_step
        self._is_ready = inside.is_plain and self._emulator.device.state.value == self._options.state

    def _run_to(self, cycles: int) -> bool:
        """Run cycles until so many have been run; False where the interpreted loop has to go on."""
        self._cycles_asked = cycles - self._counts[N_CYCLES]
        while True:
            code = run_cycles(
                self._arm,
                self._active_effects,
                self._next_step,
                self._is_ready,
                self._memory,
                cycles,
                self.start_ns,
                self._period_ns,
            )
            if code == DONE:
                return True
            if code == REFUSED and self._intent is not None:
                parse_hand(self._intent._asdict())
            self._emulator.ran_to(self._counts[N_STEP], 0)
            self._clock.sleep_until_ns(self.start_ns + self._counts[N_CYCLES] * self._period_ns)
            if code == ADVANCE:
                self._counts[N_STEP] = self._emulator.device.step
                self._counts[N_IS_ADVANCED] = 1
            elif code == SWITCH:
                self._switch()
            else:
                return False
            self._look_around()

    def _switch(self) -> None:
        s, counts = self._memory.s, self._counts
        for change in self._pending(s.tolist()):
            if change.endswith("able"):
                self._link.exchange(change)
        for spring in range(SPRINGS):
            counts[N_ENABLED + spring] = int(self._emulator.device.find(SPRING_NAMES[spring]).is_enabled)

    def _pending(self, s: list[float]) -> list[str]:
        """Commands that bring the device to where the last cycle wants it."""
        commands = EffectCommands(are_springs_ours=self._memory.p[P_BY_FORCE] > 0.0)
        enabled = [bool(self._counts[N_ENABLED + spring]) for spring in range(SPRINGS)]
        commands.resume([math.nan] * (SPRINGS * SPRING_STRIDE), enabled, (math.nan, math.nan, math.nan))
        return commands.changes(s)

    def _interpret(self) -> LoopCore:
        """The interpreted loop, which goes on for good where the fused one stands."""
        if self._core is None or self._segment is None:
            options, memory = self._options, self._memory
            self._segment = segment = Segment.in_memory()
            cycles = self._counts[N_CYCLES]
            segment.publish(SetPoint._make(memory.u.tolist()))
            segment.publish_state(_LOOP_STATE.unpack_from(self._numbers, _LOOP_STATE_AT))
            segment.words[Word.APP_HEARTBEAT_NS] = self._published_ns
            self._core = LoopCore(
                self._link,
                Grid(self._clock, self._period_ns, start_ns=self.start_ns),
                self._clock,
                segment,
                parameters=options.parameters(),
                watch=options.watch,
                keeps_timing=False,
                session_state=options.state,
            )
            self._core.resume(self._checkpoint(cycles))
            self._next_ns += cycles * self._period_ns
        return self._core

    def _checkpoint(self, cycles: int) -> Checkpoint:
        """Where the loop stands, with all that the last cycle wants still to be said."""
        memory = self._memory
        s = memory.s.tolist()
        phases = s[PHASE : SPRINGS * SPRING_STRIDE : SPRING_STRIDE]
        first = ASSIST if memory.p[P_BY_FORCE] > 0.0 else 0
        return Checkpoint(
            cycles=cycles,
            state=s,
            set_point=memory.u.tolist(),
            measurement=memory.m.tolist(),
            changes=self._pending(s),
            told=[math.nan] * (SPRINGS * SPRING_STRIDE),
            enabled=[spring >= first and phase != ADMITTANCE for spring, phase in enumerate(phases)],
            bias=(s[S_PUSH], s[S_PUSH + 1], s[S_PUSH + 2]),
            heartbeat=self._published_ns,
            silence_ns=(self._cycles_asked - 1) * self._period_ns if self._published_ns else -1,
        )


class NoView:
    """Nobody watches."""

    def show(self, time_s: float, session: Session, tick: Tick, state: LoopState) -> None:
        """Look away."""

    def tell(self, text: str) -> None:
        """Nobody listens."""


def run_fused(request: TeachRequest, log: Log) -> Session:
    """Run a session with the decisions of `tools.run.lockstep.run_lockstep`, without wire and log file.

    Args:
        request: The session; where it would be written does not matter.
        log: Takes every tick.

    Returns:
        The session as it ended.

    Raises:
        SafetyTrip: A limit tripped; the log has the ticks up to there.
    """
    shuffle, hand_rng, emulator_seed = request.streams()
    options = request.options
    emulator = LockstepEmulator(seed=emulator_seed, init_seconds=INIT_S)
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
    loop = FusedLoop(loop_options, emulator)
    hand = build_demonstrator(request.task, options.demonstrator, hand_rng, handle=emulator.truth().position)
    session = build_session(options, request.task, shuffle)
    plugs = Plugs(clock=loop, loop=loop, hand=hand, world=loop, log=log, view=NoView())
    run_ticks(session, plugs, start_ns=loop.start_ns, epoch_ns=0)
    return session

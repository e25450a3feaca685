"""One cycle of the loop, the same in the real-time process and in lock-step.

A cycle waits for its deadline, sends the changes that the cycle before computed and the questions, reads
the answers, runs the cycle function of the modes and their limits, and publishes. While the device answers,
what is not urgent is done: the records and statistics of the cycle before, and a look around. It owns no
clock, socket or memory: all of them are handed to it.
"""

from math import isfinite
from typing import Protocol

from hm_driver.errors import DeviceError, HapticMasterError, ProtocolError, TransportError
from hm_driver.realtime import cycle
from hm_driver.realtime.checkpoint import Checkpoint
from hm_driver.realtime.clock import Clock
from hm_driver.realtime.commands import EffectCommands
from hm_driver.realtime.folding import fold
from hm_driver.realtime.grid import Grid
from hm_driver.realtime.law import LawRunner
from hm_driver.realtime.measurements import CycleLink, Exchange
from hm_driver.realtime.options import WatchOptions, ramp_down_parameters
from hm_driver.realtime.publisher import Publisher, Recording
from hm_driver.realtime.segment import PARENT_LOST, Segment, Trip, Word
from hm_driver.realtime.surroundings import Surroundings
from hm_driver.realtime.trace import Trace

__all__ = ["CycleFunction", "LoopCore", "Recording", "folded_cycle"]

# Plain integers: an enumeration's member costs a look-up in every cycle.
_STOP_REQUESTED = int(Word.STOP_REQUESTED)
_APP_HEARTBEAT = int(Word.APP_HEARTBEAT_NS)
_LOOP_HEARTBEAT = int(Word.LOOP_HEARTBEAT_NS)
STATE_EVERY_S = 0.02
"""How often the device is asked for its state [s]."""
_LIMITS = {
    cycle.TRIP_DATA: (Trip.DATA, "the device sent a number that is not finite"),
    cycle.TRIP_WORKSPACE: (Trip.WORKSPACE, "a joint is beyond its end stop and the margin"),
    cycle.TRIP_VELOCITY: (Trip.VELOCITY, "a joint is faster than its limit allows"),
    cycle.TRIP_FORCE: (Trip.FORCE, "the hand's force is above its limit"),
}


class CycleFunction(Protocol):
    """``cycle.cycle``, or a compiled one that computes the same."""

    def __call__(self, s: list[float], p: list[float], u: list[float], m: list[float], dt: float, /) -> int:
        """Run one cycle on the state, the parameters, the set-point and the measurement."""
        ...


def folded_cycle() -> CycleFunction:
    """The cycle function to interpret: constants are folded in, for the same results in half the time."""
    function: CycleFunction = fold(cycle, inlined="clamp")["cycle"]
    return function


class LoopCore:
    """The loop without its surroundings.

    Args:
        link: Connection to a device that has been brought up.
        grid: The deadlines.
        clock: The clock of the grid.
        segment: Where set-points come from, and state and statistics go.
        parameters: Flat parameters of the cycle function.
        watch: Time-outs; the heartbeat is watched from the application's first sign of life on.
        recording: Where the records go, or None.
        trace: Where the timing of each cycle goes, or None.
        law: The user's control law, or None.
        step: The cycle function.
        keeps_timing: Whether durations are kept and stale data looked for; in lock-step durations are all
            zero, and the device steps before every cycle.
        session_state: Device state that the loop needs; another one trips.
    """

    def __init__(
        self,
        link: CycleLink,
        grid: Grid,
        clock: Clock,
        segment: Segment,
        *,
        parameters: list[float],
        watch: WatchOptions,
        recording: Recording | None = None,
        trace: Trace | None = None,
        law: LawRunner | None = None,
        step: CycleFunction = cycle.cycle,
        keeps_timing: bool = True,
        session_state: str = "force",
    ) -> None:
        self._exchange = Exchange(link)
        self._grid = grid
        self._now_ns = clock.now_ns
        self._segment = segment
        self._words = segment.words
        self._set_points = segment.set_points
        self._set_point_count = segment.set_points.count
        self._p = parameters
        self._watch = watch
        self._surroundings = Surroundings(grid, watch, beat=segment.words[_APP_HEARTBEAT])
        self._publisher = Publisher(
            segment,
            grid,
            clock,
            recording=recording,
            trace=trace,
            keeps_timing=keeps_timing,
            soft_budget=watch.soft_budget,
        )
        self._keeps_timing = keeps_timing
        self._law = law
        self._step = step
        self._session_state = session_state
        self._s = [0.0] * cycle.STATE_SIZE
        self._u = [0.0] * cycle.SETPOINT_SIZE
        self._last_good = [0.0] * cycle.MEASUREMENT_SIZE
        self._commands = EffectCommands(are_springs_ours=parameters[cycle.P_BY_FORCE] > 0.0)
        self._changes: list[str] = []
        self._state_every = max(1, round(STATE_EVERY_S * 1e9 / grid.period_ns))
        self._stale_limit = int(watch.stale_s * 1e9 / grid.period_ns) if keeps_timing else 0
        self._stale_cycles = 0
        self._ramp_end_ns: int | None = None
        self._has_tripped = False
        self.is_link_usable = True
        """False once an exchange failed: nothing more may be sent on this connection."""

    @property
    def grid(self) -> Grid:
        """The deadlines, with the counts of cycles and missed periods."""
        return self._grid

    @property
    def is_stopping(self) -> bool:
        """Whether the forces are being ramped down."""
        return self._ramp_end_ns is not None

    @property
    def forces(self) -> tuple[float, ...]:
        """Commanded forces of the springs x, y, z and of the assist [N]."""
        return tuple(self._s[cycle.S_FORCE : cycle.S_FORCE + cycle.SPRINGS])

    def resume(self, checkpoint: Checkpoint) -> None:
        """Go on where another loop on the same grid and segment stands; before the first cycle."""
        self._s[:] = checkpoint.state
        self._u[:] = checkpoint.set_point
        self._last_good = list(checkpoint.measurement)
        self._changes = checkpoint.changes
        self._commands.resume(checkpoint.told, checkpoint.enabled, checkpoint.bias)
        self._exchange.requests = checkpoint.cycles
        self._grid.resume(checkpoint.cycles)
        self._surroundings = Surroundings(
            self._grid, self._watch, beat=checkpoint.heartbeat, silence_ns=checkpoint.silence_ns
        )

    def run_cycle(self) -> bool:
        """Wait for the next deadline and run its cycle.

        Returns:
            False when the loop is over: stopped or tripped, with the forces ramped down. The caller then
            stops the device, over this link if ``is_link_usable``, and calls `finish`.
        """
        grid, exchange, publisher, now_ns = self._grid, self._exchange, self._publisher, self._now_ns
        grid.wait()
        self._words[_LOOP_HEARTBEAT] = grid.wake_ns
        asks_state = not grid.cycles % self._state_every
        started_ns = now_ns()
        try:
            exchange.begin(self._changes, ask_state=asks_state)
        except HapticMasterError as error:
            return self._fail_exchange(error)
        publisher.keep()
        if self._ramp_end_ns is None:
            self._look_around()
        try:
            m = exchange.finish()
        except HapticMasterError as error:
            return self._fail_exchange(error)
        exchange_ns = now_ns() - started_ns
        dt = grid.dt_ns * 1e-9
        if asks_state and exchange.state != self._session_state:
            self._lose_state(exchange.state)
        self._compute(m, dt)
        publisher.publish(self._s, self._last_good, dt, exchange_ns, exchange.requests)
        return self._ramp_end_ns is None or not (self._is_released() or now_ns() >= self._ramp_end_ns)

    def finish(self) -> None:
        """Leave the records and statistics of the last cycle; behind it the counts add up."""
        self._publisher.keep()
        self._publisher.finish()

    def stop(self) -> None:
        """Begin the gentle release: the forces go down at the rate of every hand-over."""
        if self._ramp_end_ns is None:
            self._begin_release(self._watch.release_s)

    def trip(self, reason: Trip, detail: str) -> None:
        """Begin the fast ramp-down of a trip, and note the reason; only the first trip counts."""
        if self._has_tripped:
            return
        self._has_tripped = True
        self._segment.set_trip(reason, detail, self._now_ns())
        period_s = self._grid.period_ns * 1e-9
        self._p = ramp_down_parameters(self._p, max(period_s, self._watch.ramp_s - period_s))
        self._begin_release(self._watch.ramp_s)
        self.log_event("error", f"trip.{reason.name.lower()}", detail)

    def log_event(self, level: str, name: str, text: str) -> None:
        """Write an event into the log, where there is one."""
        self._publisher.log_event(level, name, text)

    def _begin_release(self, within_s: float) -> None:
        self._ramp_end_ns = (
            self._now_ns() + int(within_s * 1e9) - self._grid.period_ns
        )  # no cycle begins later
        sequence = self._s[cycle.S_SEQUENCE]
        self._u = [0.0] * cycle.SETPOINT_SIZE
        self._u[cycle.U_SEQUENCE] = sequence

    def _is_released(self) -> bool:
        s = self._s
        phases = s[cycle.PHASE : cycle.S_BIAS : cycle.SPRING_STRIDE]
        return not any(phases) and not any(s[cycle.S_BIAS : cycle.S_BIAS + cycle.AXES])

    def _look_around(self) -> None:
        """Take the newest set-point, and see whether the loop has to end."""
        words = self._words
        count = self._set_points.count
        if count != self._set_point_count:
            self._set_point_count = count
            set_point = self._set_points.read()
            if not isfinite(sum(set_point)):
                self.trip(Trip.COMMAND, f"the application's set-point {set_point} is not finite")
                return
            self._u[:] = set_point
        if words[_STOP_REQUESTED]:
            if words[_STOP_REQUESTED] == PARENT_LOST:
                self.trip(Trip.PARENT, "the application ended without stopping the loop")
            self.stop()
            return
        problem = self._surroundings.problem(words[_APP_HEARTBEAT])
        if problem is not None:
            self.trip(*problem)

    def _fail_exchange(self, error: HapticMasterError) -> bool:
        """Decide what an exchange that failed means; whether the loop goes on."""
        if isinstance(error, TransportError):
            self.is_link_usable = False
            self.trip(Trip.LINK, f"{error}; the guardian stops the device over its own connection")
            return False
        was_stopping = self.is_stopping
        if isinstance(error, (DeviceError, ProtocolError)):
            self.trip(Trip.DEVICE, str(error))
        self._changes = []
        return not was_stopping

    def _compute(self, m: list[float], dt: float) -> None:
        """Run the law, the cycle function and the checks; leaves the changes for the next exchange."""
        u = self._u
        if self._law is not None and not self.is_stopping:
            u = self._run_law(self._law, dt)
        trip = self._step(self._s, self._p, u, m, dt)
        if trip:
            m = self._trip_limit(trip, m, dt)
        elif self._stale_limit:
            self._watch_staleness(m)
        self._last_good = m
        self._changes = self._commands.changes(self._s)

    def _lose_state(self, state: str) -> None:
        if not self.is_stopping:
            self.trip(
                Trip.DEVICE,
                f"the device left state '{self._session_state}' for '{state}': "
                "look at the emergency button, then initialise again",
            )

    def _trip_limit(self, code: int, m: list[float], dt: float) -> list[float]:
        """Trip; returns the measurement that the ramp goes on with, the last that was one."""
        reason, text = _LIMITS[code]
        if not self.is_stopping:
            values = ", ".join("[%g, %g, %g]" % tuple(m[i : i + 3]) for i in (0, 3, 6))  # noqa: UP031  # short
            self.trip(reason, f"{text}; position [m], velocity [m/s], force [N]: {values}")
        if code == cycle.TRIP_DATA:
            m = self._last_good
            self._step(self._s, self._p, self._u, m, dt)
        return m

    def _watch_staleness(self, m: list[float]) -> None:
        self._stale_cycles = self._stale_cycles + 1 if m == self._last_good else 0
        if self._stale_cycles > self._stale_limit:
            self.trip(
                Trip.DEVICE,
                f"no digit of the measurements changed for {self._watch.stale_s:g} s: "
                "the device sends stale data",
            )

    def _run_law(self, law: LawRunner, dt: float) -> list[float]:
        set_point, problem = law.step(self._segment.state(), self._u, dt)
        if problem:
            self.trip(Trip.LAW, problem)
            return self._u
        return set_point

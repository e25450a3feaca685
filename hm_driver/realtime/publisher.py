"""What a cycle leaves behind: the newest state, counters, statistics, and one record in the log."""

from typing import NamedTuple

from hm_driver.realtime import cycle
from hm_driver.realtime.clock import Clock
from hm_driver.realtime.grid import Grid
from hm_driver.realtime.segment import Segment, Word
from hm_driver.realtime.trace import Trace
from hm_driver.recording.ring import Ring
from hm_driver.recording.schemas import EVENT, EVENT_LEVELS, EVENTS_CHANNEL, LOOP_BUNDLE

# Plain integers: an enumeration's member costs a look-up in every cycle.
_CYCLES, _MISSED, _LENGTH = int(Word.CYCLES), int(Word.MISSED), int(Word.GRID_LENGTH)
_EXCHANGES, _SOFT_OVERRUNS = int(Word.EXCHANGES), int(Word.SOFT_OVERRUNS)

_AXES = cycle.AXES * cycle.SPRING_STRIDE
_REFERENCES = slice(cycle.REFERENCE, _AXES, cycle.SPRING_STRIDE)
_VELOCITIES = slice(cycle.VELOCITY, _AXES, cycle.SPRING_STRIDE)
_PHASES = slice(cycle.PHASE, _AXES, cycle.SPRING_STRIDE)
_FORCES = slice(cycle.S_FORCE, cycle.S_FORCE + cycle.AXES)
_BIAS = slice(cycle.S_BIAS, cycle.S_BIAS + cycle.AXES)
_ASSIST_REFERENCE = cycle.ASSIST * cycle.SPRING_STRIDE + cycle.REFERENCE
_ASSIST_FORCE = cycle.S_FORCE + cycle.ASSIST
_SATURATED = cycle.S_SATURATED


class Recording(NamedTuple):
    """Where the records of the cycles go."""

    ring: Ring
    epoch_ns: int
    """Time of the log minus time of the loop's clock [ns]."""


class Publisher:
    """Publishes after each cycle.

    Args:
        segment: Where state, counters and statistics go.
        grid: The deadlines.
        clock: The clock of the grid.
        recording: Where the records go, or None.
        trace: Where the timing of each cycle goes, or None.
        keeps_timing: Whether durations are kept; on a virtual clock they are all zero.
        soft_budget: Share of the period beyond which a cycle is counted as a soft overrun.
    """

    __slots__ = (
        "_events",
        "_exchange",
        "_execution",
        "_grid",
        "_keeps_timing",
        "_lateness",
        "_now_ns",
        "_pack_into",
        "_publish_state",
        "_recording",
        "_response",
        "_soft_ns",
        "_trace",
        "_words",
    )

    def __init__(
        self,
        segment: Segment,
        grid: Grid,
        clock: Clock,
        *,
        recording: Recording | None,
        trace: Trace | None,
        keeps_timing: bool,
        soft_budget: float,
    ) -> None:
        self._grid = grid
        self._now_ns = clock.now_ns
        self._words = segment.words
        self._publish_state = segment.publish_state
        self._lateness = segment.lateness.record
        self._execution = segment.execution.record
        self._exchange = segment.exchange.record
        self._response = segment.response.record
        self._recording = recording
        self._pack_into = LOOP_BUNDLE.pack_into
        self._trace = trace
        self._keeps_timing = keeps_timing
        self._soft_ns = int(soft_budget * grid.period_ns)
        self._events = 0

    def publish(self, s: list[float], m: list[float], dt: float, exchange_ns: int, requests: int) -> None:
        """Publish one cycle.

        Args:
            s: State of the cycle function.
            m: Measurement.
            dt: True duration handed to the cycle function [s].
            exchange_ns: Duration of the exchange [ns].
            requests: Requests sent to the device so far.
        """
        grid, words = self._grid, self._words
        cycles, missed = grid.cycles, grid.missed
        references, forces, phases = s[_REFERENCES], s[_FORCES], s[_PHASES]
        assist_force = s[_ASSIST_FORCE]
        self._publish_state(
            (cycles, grid.deadline_ns, missed, s[_SATURATED], *m, *references, *forces, *phases, assist_force)
        )
        words[_CYCLES] = cycles
        words[_MISSED] = missed
        words[_LENGTH] = cycles + missed
        words[_EXCHANGES] = requests
        lateness_ns = grid.lateness_ns
        execution_ns = self._now_ns() - grid.wake_ns if self._keeps_timing else 0
        if self._recording is not None:
            ring, epoch_ns = self._recording
            time_ns = grid.deadline_ns + epoch_ns
            offset = ring.reserve(LOOP_BUNDLE.id, time_ns, LOOP_BUNDLE.size)
            if offset >= 0:
                index = grid.index
                self._pack_into(
                    ring.data, offset,
                    index, time_ns, *m,
                    index, time_ns, *references, *s[_VELOCITIES], *forces, *phases,
                    s[_ASSIST_REFERENCE], assist_force, *s[_BIAS],
                    index, time_ns, lateness_ns, execution_ns, exchange_ns, lateness_ns + execution_ns,
                    missed, dt, int(s[_SATURATED]),
                )  # fmt: skip
                ring.commit()
        if self._keeps_timing:
            self._keep_timing(exchange_ns)

    def log_event(self, level: str, name: str, text: str) -> None:
        """Write an event into the log, where there is one."""
        if self._recording is None:
            return
        self._events += 1
        time_ns = self._now_ns() + self._recording.epoch_ns
        payload = EVENT.pack(self._events, time_ns, EVENT_LEVELS[level], name, text, ())
        self._recording.ring.write(EVENTS_CHANNEL.id, time_ns, payload)

    def _keep_timing(self, exchange_ns: int) -> None:
        grid = self._grid
        lateness_ns = grid.lateness_ns
        self._lateness(lateness_ns)
        self._exchange(exchange_ns)
        execution_ns = self._now_ns() - grid.wake_ns
        response_ns = lateness_ns + execution_ns
        self._execution(execution_ns)
        self._response(response_ns)
        if self._trace is not None:
            number = grid.index - grid.skipped  # the deadline that was waited for
            self._trace.record(number, lateness_ns, response_ns, grid.wake_ns, exchange_ns)
        if response_ns > self._soft_ns:
            self._words[_SOFT_OVERRUNS] += 1

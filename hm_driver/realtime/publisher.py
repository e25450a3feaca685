"""What a cycle leaves behind: the newest state, counters, statistics, and one record in the log."""

from typing import NamedTuple, TypeAlias

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
_KEPT = 8
"""Cycles whose durations are entered at a time."""
_BUNDLE_ID, _BUNDLE_SIZE = LOOP_BUNDLE.id, LOOP_BUNDLE.size

_SPRINGS = slice(0, cycle.ASSIST * cycle.SPRING_STRIDE + 1)
_FORCES = slice(cycle.S_FORCE, cycle.S_SATURATED + 1)
_BIAS = slice(cycle.S_BIAS, cycle.S_BIAS + cycle.AXES)


_Cycle: TypeAlias = tuple[
    list[float], list[float], float, int, int, int, int, int, int, int, int, int, int
]  # a plain tuple: it is made in every cycle


class Recording(NamedTuple):
    """Where the records of the cycles go."""

    ring: Ring
    epoch_ns: int
    """Time of the log minus time of the loop's clock [ns]."""


class Publisher:
    """Publishes after each cycle.

    The newest state is published at once. What nobody waits for, `keep` and `finish` do: in the next cycle
    while the device answers, or at once where no time passes within a cycle.

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
        "_counts",
        "_events",
        "_grid",
        "_keeps_timing",
        "_kept",
        "_now_ns",
        "_pack_record",
        "_pending",
        "_publish_state",
        "_record_durations",
        "_recording",
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
        self._record_durations = segment.record_durations
        self._recording = recording
        self._pack_record = LOOP_BUNDLE.packer()
        self._trace = trace
        self._keeps_timing = keeps_timing
        self._soft_ns = int(soft_budget * grid.period_ns)
        self._events = 0
        self._pending: _Cycle | None = None
        self._kept: list[tuple[int, int, int, int]] = []
        self._counts = (0, 0, 0, 0)

    def publish(self, s: list[float], m: list[float], dt: float, exchange_ns: int, requests: int) -> None:
        """Publish one cycle.

        Args:
            s: State of the cycle function.
            m: Measurement.
            dt: True duration handed to the cycle function [s].
            exchange_ns: Duration of the exchange [ns].
            requests: Requests sent to the device so far.
        """
        grid = self._grid
        cycles, missed, deadline_ns = grid.cycles, grid.missed, grid.deadline_ns
        x, _, _, phase_x, y, _, _, phase_y, z, _, _, phase_z, _ = s[_SPRINGS]
        force_x, force_y, force_z, assist_force, saturated = s[_FORCES]
        self._publish_state((
            cycles, deadline_ns, missed, saturated, *m,
            x, y, z, force_x, force_y, force_z, phase_x, phase_y, phase_z, assist_force,
        ))  # fmt: skip
        wake_ns = grid.wake_ns
        self._pending = (
            s, m, dt, exchange_ns, self._now_ns() - wake_ns, requests,
            cycles, missed, deadline_ns, grid.index, grid.skipped, wake_ns, grid.lateness_ns,
        )  # fmt: skip
        if not self._keeps_timing:
            self.keep()
            self.finish()

    def keep(self) -> None:
        """Leave the record of the cycle that was published last, once, and note its durations.

        The state of the cycle function must not have changed since.
        """
        if self._pending is None:
            return
        (
            s, m, dt, exchange_ns, execution_ns, requests,
            cycles, missed, deadline_ns, index, skipped, wake_ns, lateness_ns,
        ) = self._pending  # fmt: skip
        self._pending = None
        response_ns = lateness_ns + execution_ns
        if self._recording is not None:
            ring, epoch_ns = self._recording
            time_ns = deadline_ns + epoch_ns
            offset = ring.reserve(_BUNDLE_ID, time_ns, _BUNDLE_SIZE)
            if offset >= 0:
                x, vx, _, phase_x, y, vy, _, phase_y, z, vz, _, phase_z, assist_reference = s[_SPRINGS]
                force_x, force_y, force_z, assist_force, saturated = s[_FORCES]
                self._pack_record(ring.data, offset, (
                    index, time_ns, *m,
                    index, time_ns, x, y, z, vx, vy, vz, force_x, force_y, force_z, phase_x, phase_y, phase_z,
                    assist_reference, assist_force, *s[_BIAS],
                    index, time_ns, lateness_ns, execution_ns, exchange_ns, response_ns,
                    missed, dt, int(saturated),
                ))  # fmt: skip
                ring.commit()
        if self._trace is not None:  # by the deadline that was waited for
            self._trace.record(index - skipped, lateness_ns, response_ns, wake_ns, exchange_ns)
        self._counts = (cycles, missed, cycles + missed, requests)
        self._kept.append((lateness_ns, execution_ns, exchange_ns, response_ns))
        if len(self._kept) == _KEPT:
            self.finish()

    def finish(self) -> None:
        """Enter the counts, and the durations that were noted, into the segment.

        A few cycles at a time: code that runs once in a period runs from a cold cache.
        """
        words, kept = self._words, self._kept
        words[_CYCLES], words[_MISSED], words[_LENGTH], words[_EXCHANGES] = self._counts
        if self._keeps_timing:
            for durations in kept:
                self._record_durations(durations)
                if durations[-1] > self._soft_ns:
                    words[_SOFT_OVERRUNS] += 1
        kept.clear()

    def log_event(self, level: str, name: str, text: str) -> None:
        """Write an event into the log, where there is one."""
        self.keep()
        if self._recording is None:
            return
        self._events += 1
        time_ns = self._now_ns() + self._recording.epoch_ns
        payload = EVENT.pack(self._events, time_ns, EVENT_LEVELS[level], name, text, ())
        self._recording.ring.write(EVENTS_CHANNEL.id, time_ns, payload)

"""The loop's cycles beside those of two canaries: what the loop has to answer for, and what the machine.

One canary sleeps to the loop's deadlines on the loop's CPU, one on the emulator's, both at a priority above.
The loop's *excess* is its wake-up minus that of the canary on its CPU. A deadline that the loop missed is
its own where no canary was held up there.

Rows come in from shared memory, and leave as histograms, as bins of a time series and as the worst events, so
that the length of a run does not matter.
"""

import heapq
from collections.abc import Iterable
from dataclasses import dataclass
from typing import NamedTuple

from hm_driver.realtime.trace import TracePoint
from tools.jitter.spread import new_histogram

WORST = 20
"""Worst events that are kept."""
BINS = 300
"""Most points of a time series."""
_BIN_CYCLES = 40
_OWN_MISSES = 200
_HELD_UP = 0.5
"""Share of a period from which on a late canary was held up: no cycle with an exchange fits behind it."""
_EARLY = 0.1
_DRIFT_MINIMUM, _DRIFT_SAMPLES = 100, 100_000


class Event(NamedTuple):
    """One wake-up that stands out; times in [µs]."""

    time_s: float
    """Since the start of the measurement [s]."""
    number: int
    """Number of the deadline."""
    lateness: float
    """Of the loop."""
    excess: float
    """Beyond the canary's."""
    canary: float
    """Lateness of the canary on the loop's CPU."""
    response: float
    """End of the cycle behind the deadline."""


class CoursePoint(NamedTuple):
    """A bin of the time series; times in [µs], None where nothing was measured."""

    time_s: float
    """Middle of the bin [s]."""
    lateness_p50: float | None
    lateness_max: float | None
    excess_p99: float | None
    excess_max: float | None
    canary_max: float | None
    response_max: float | None
    missed: int
    own_missed: int


class Drift(NamedTuple):
    """How fast the deadlines that were served move away from those that were asked for."""

    us_per_s: float
    """By the medians of the lateness [µs/s]; of a run with few cycles by the first and the last."""
    resolution_us_per_s: float
    """What the spread of the lateness hides [µs/s]: its interquartile range over the time."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """The deadlines that were asked for."""

    start_ns: int
    """Deadline 0 [ns]."""
    period_ns: int
    first: int
    """Number of the first deadline that counts."""
    end: int
    """Number behind the last one."""

    def deadline_ns(self, number: int) -> int:
        """A deadline [ns]."""
        return self.start_ns + number * self.period_ns


class Pairing:
    """Joins the rows of the loop and of its canaries, deadline by deadline.

    Args:
        grid: The deadlines.
        canaries: How many canaries there are: the first on the loop's CPU, the second on the emulator's.
    """

    def __init__(self, grid: Grid, *, canaries: int) -> None:
        self.grid = grid
        """The deadlines."""
        self._grid = grid
        self._pending: list[dict[int, TracePoint]] = [{} for _ in range(1 + canaries)]
        self._next = grid.first
        self._held_ns = int(_HELD_UP * grid.period_ns)
        self._held: dict[int, bool] = {}
        self._gap: list[int] = []
        self.lateness = new_histogram()
        self.canary_lateness = new_histogram()
        self.excess = new_histogram()
        self.response = new_histogram()
        self.execution = new_histogram()
        self.exchange = new_histogram()
        self.cycles = 0
        """Deadlines that the loop served."""
        self.missed = 0
        """Deadlines that it missed."""
        self.own_missed = 0
        """Those at which no canary was held up."""
        self.canary_missed = [0] * canaries
        """Deadlines that each canary missed."""
        self.own_misses: list[int] = []
        """Numbers of the first of the loop's own."""
        self._worst: list[tuple[float, Event]] = []
        self._course = _Course(grid)
        self._ends = ((0, 0.0), (0, 0.0))
        self._drift_stride = max(1, (grid.end - grid.first) // _DRIFT_SAMPLES)
        self._early: list[float] = []
        self._late: list[float] = []

    @property
    def next_number(self) -> int:
        """The next deadline to look at; rows before it are done with."""
        return self._next

    @property
    def worst(self) -> tuple[Event, ...]:
        """The events of the largest excess, in the order of time."""
        return tuple(sorted(event for _, event in self._worst))

    @property
    def course(self) -> tuple[CoursePoint, ...]:
        """The time series."""
        return self._course.finish()

    @property
    def drift(self) -> Drift:
        """How fast the deadlines move away from the clock: from the first tenth of the run to the last."""
        grid = self._grid
        if min(len(self._early), len(self._late)) < _DRIFT_MINIMUM:
            (first, early_us), (last, late_us) = self._ends
            seconds = (last - first) * grid.period_ns * 1e-9
            return Drift((late_us - early_us) / seconds if seconds else 0.0, 0.0)
        early, late = sorted(self._early), sorted(self._late)
        span_s = (1.0 - _EARLY) * (grid.end - grid.first) * grid.period_ns * 1e-9
        spread_us = max(_quantile(values, 0.75) - _quantile(values, 0.25) for values in (early, late))
        return Drift((_quantile(late, 0.5) - _quantile(early, 0.5)) / span_s, spread_us / span_s)

    def add(self, *streams: Iterable[TracePoint], upto: int) -> None:
        """Take rows, and finish every deadline before a number.

        Args:
            streams: New rows of the loop, of the canary on its CPU, and of the one on the emulator's.
            upto: The first deadline whose rows may still be on their way.
        """
        first, end = self._next, min(upto, self._grid.end)
        for pending, rows in zip(self._pending, streams, strict=True):
            pending.update((row.number, row) for row in rows if row.number >= first)
        for number in range(first, end):
            self._take(number)
        self._next = max(first, end)
        for pending in self._pending:
            for number in [number for number in pending if number < self._next]:
                del pending[number]

    def finish(self) -> None:
        """Judge a gap that reaches to the end."""
        self._judge_gap()

    def _take(self, number: int) -> None:
        row, *canaries = (pending.get(number) for pending in self._pending)
        self._note_canaries(number, canaries)
        canary = canaries[0] if canaries else None
        if row is None:
            self.missed += 1
            self._gap.append(number)
            self._course.miss(number)
            return
        self._judge_gap()
        self.cycles += 1
        late_ns = row.wake_ns - self._grid.deadline_ns(number)
        execution_ns = row.response_ns - row.lateness_ns
        self.lateness.record(late_ns)
        self.execution.record(execution_ns)
        self.exchange.record(row.exchange_ns)
        self.response.record(late_ns + execution_ns)
        self._note_drift(number, late_ns * 1e-3)
        excess_us = None
        if canary is not None:
            excess_ns = row.wake_ns - self._released_ns(number, row.wake_ns, canary)
            self.excess.record(excess_ns)
            excess_us = excess_ns * 1e-3
            self._note_worst(number, row, late_ns, excess_us, canary)
        self._course.add(
            number,
            late_ns * 1e-3,
            excess_us,
            None if canary is None else canary.lateness_ns * 1e-3,
            (late_ns + execution_ns) * 1e-3,
        )

    def _released_ns(self, number: int, wake_ns: int, canary: TracePoint) -> int:
        """When the machine let go of the CPU at the latest, as the canary knows [ns].

        A stall may begin between the canary's wake-up and the loop's. The canary then is held up at a later
        deadline, which the loop has not reached either.
        """
        released_ns = canary.wake_ns
        last = (wake_ns - self._grid.start_ns) // self._grid.period_ns
        for later in range(number + 1, last + 1):
            row = self._pending[1].get(later)
            if row is not None and row.lateness_ns > self._held_ns and released_ns < row.wake_ns <= wake_ns:
                released_ns = row.wake_ns
        return released_ns

    def _note_canaries(self, number: int, canaries: list[TracePoint | None]) -> None:
        is_held = False
        for index, canary in enumerate(canaries):
            self.canary_missed[index] += canary is None
            is_held |= canary is None or canary.lateness_ns > self._held_ns
        self._held[number] = is_held
        if canaries and canaries[0] is not None:
            self.canary_lateness.record(canaries[0].lateness_ns)
        if not self._gap:
            self._held.pop(number - 3, None)

    def _judge_gap(self) -> None:
        """A gap is the machine's where a canary was held up in it, or at the two deadlines before it."""
        gap = self._gap
        if not gap:
            return
        if not any(self._held.get(number, False) for number in range(gap[0] - 2, gap[-1] + 1)):
            self.own_missed += len(gap)
            self.own_misses += gap[: max(0, _OWN_MISSES - len(self.own_misses))]
            self._course.miss_own(gap)
        for number in range(gap[0] - 3, gap[-1] - 1):
            self._held.pop(number, None)
        self._gap = []

    def _note_worst(
        self, number: int, row: TracePoint, late_ns: int, excess_us: float, canary: TracePoint
    ) -> None:
        if len(self._worst) == WORST and excess_us <= self._worst[0][0]:
            return
        event = Event(
            time_s=(number - self._grid.first) * self._grid.period_ns * 1e-9,
            number=number,
            lateness=late_ns * 1e-3,
            excess=excess_us,
            canary=canary.lateness_ns * 1e-3,
            response=(late_ns + row.response_ns - row.lateness_ns) * 1e-3,
        )
        if len(self._worst) < WORST:
            heapq.heappush(self._worst, (excess_us, event))
        else:
            heapq.heapreplace(self._worst, (excess_us, event))

    def _note_drift(self, number: int, late_us: float) -> None:
        grid = self._grid
        self._ends = (self._ends[0] if self.cycles > 1 else (number, late_us), (number, late_us))
        if number % self._drift_stride:
            return
        share = (number - grid.first) / (grid.end - grid.first)
        if share < _EARLY:
            self._early.append(late_us)
        elif share >= 1.0 - _EARLY:
            self._late.append(late_us)


class _Course:
    """Values of the present bin, and the bins that are done."""

    def __init__(self, grid: Grid) -> None:
        self._grid = grid
        self._width = max(_BIN_CYCLES, (grid.end - grid.first + BINS - 1) // BINS)
        self._bin = 0
        self._values: list[tuple[float, float | None, float | None, float]] = []
        self._missed = 0
        self._own_missed: dict[int, int] = {}
        self._points: list[tuple[int, CoursePoint]] = []

    def add(
        self, number: int, late: float, excess: float | None, canary: float | None, response: float
    ) -> None:
        self._turn(number)
        self._values.append((late, excess, canary, response))

    def miss(self, number: int) -> None:
        self._turn(number)
        self._missed += 1

    def miss_own(self, numbers: Iterable[int]) -> None:
        for number in numbers:
            place = self._place(number)
            self._own_missed[place] = self._own_missed.get(place, 0) + 1

    def finish(self) -> tuple[CoursePoint, ...]:
        self._close()
        return tuple(
            point._replace(own_missed=self._own_missed.get(place, 0)) for place, point in self._points
        )

    def _place(self, number: int) -> int:
        return (number - self._grid.first) // self._width

    def _turn(self, number: int) -> None:
        place = self._place(number)
        if place != self._bin:
            self._close()
            self._bin = place

    def _close(self) -> None:
        if not self._values and not self._missed:
            return
        late = sorted(value[0] for value in self._values)
        excess = sorted(value[1] for value in self._values if value[1] is not None)
        canary = [value[2] for value in self._values if value[2] is not None]
        point = CoursePoint(
            time_s=(self._bin + 0.5) * self._width * self._grid.period_ns * 1e-9,
            lateness_p50=late[len(late) // 2] if late else None,
            lateness_max=late[-1] if late else None,
            excess_p99=excess[(len(excess) - 1) * 99 // 100] if excess else None,
            excess_max=excess[-1] if excess else None,
            canary_max=max(canary, default=None),
            response_max=max((value[3] for value in self._values), default=None),
            missed=self._missed,
            own_missed=0,
        )
        self._points.append((self._bin, point))
        self._values, self._missed = [], 0


def _quantile(ordered: list[float], share: float) -> float:
    return ordered[int(share * (len(ordered) - 1))]

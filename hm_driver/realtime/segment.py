"""The one segment of memory through which the loop exchanges with everything else.

It works on any writable buffer: shared memory between processes, a ``bytearray`` in lock-step. All that is
written by the loop is wait-free: the newest state, a heartbeat, counters and histograms. All zeros is the
segment of a loop that has not started.
"""

import contextlib
import mmap
from collections.abc import Sequence
from enum import IntEnum
from typing import NamedTuple, Self

from hm_driver.errors import LoopError
from hm_driver.realtime.histogram import SIZE as HISTOGRAM_SIZE
from hm_driver.realtime.histogram import Histogram, record_each
from hm_driver.realtime.latch import Latch, latch_size
from hm_driver.realtime.setpoint import LoopState, SetPoint

STOP_GENTLY = 1
"""The application asks for the end: release the springs, stop the device."""
PARENT_LOST = 2
"""The application is gone: a trip."""
_MAGIC = 0x31474553_4D48  # "HMSEG1"


class Status(IntEnum):
    """Life of the loop."""

    STARTING = 0
    """The process starts; the device has not been spoken to."""
    BRINGING_UP = 1
    """The device is being connected and initialised."""
    RUNNING = 2
    """The grid is running."""
    STOPPING = 3
    """The arm is being ramped down on request."""
    STOPPED = 4
    """Ended on request; the device was stopped."""
    TRIPPED = 5
    """A limit tripped, and the loop brought the arm to a stop; the trip and its detail are in the segment."""
    FAILED = 6
    """Ended by an error; its text is in the segment."""

    @property
    def has_ended(self) -> bool:
        """Whether the loop is over."""
        return self >= Status.STOPPED


class Trip(IntEnum):
    """Why the arm was brought to a safe state. The first five are the codes of ``cycle.cycle``."""

    NONE = 0
    """Nothing tripped."""
    DATA = 1
    """The device sent a number that is not finite."""
    WORKSPACE = 2
    """A joint left its range."""
    VELOCITY = 3
    """A joint was faster than its limit allows."""
    FORCE = 4
    """The hand's force was above its limit."""
    HEARTBEAT = 10
    """The application was silent for too long."""
    LINK = 11
    """The device did not answer in time, or the link was cut."""
    DEVICE = 12
    """The device refused a command, or left the state that the session needs."""
    DEADLINE = 13
    """Too many periods were missed."""
    LAW = 14
    """The control law raised an error, took too long or returned what is no set-point."""
    PARENT = 15
    """The application ended without stopping the loop."""
    LOOP_LOST = 16
    """The loop died or froze; the guardian stopped the device."""
    COMMAND = 17
    """The application's set-point was not a row of finite numbers."""


class GuardianStatus(IntEnum):
    """What the guardian does or did."""

    ABSENT = 0
    """There is none."""
    WATCHING = 1
    """Connected, and watching the loop's heartbeat."""
    STOPPED_DEVICE = 2
    """It sent the safe stop, and the device acknowledged it."""
    FAILED = 3
    """It could not stop the device, or could not connect."""
    ENDED = 4
    """The loop ended in order; there was nothing to do."""


class Word(IntEnum):
    """64-bit integers at the start of the segment."""

    MAGIC = 0
    STATUS = 1
    TRIP = 2
    STOP_REQUESTED = 3
    """`STOP_GENTLY` or `PARENT_LOST`."""
    APP_HEARTBEAT_NS = 4
    LOOP_HEARTBEAT_NS = 5
    APP_PID = 6
    LOOP_PID = 7
    RUNG = 8
    CYCLES = 9
    MISSED = 10
    GRID_LENGTH = 11
    SPUN_NS = 12
    CPU_NS = 13
    ELAPSED_NS = 14
    EXCHANGES = 15
    """Requests sent by the cycles so far."""
    FRAMED = 16
    """1 where the device speaks the framed dialect."""
    COMBINED = 17
    """1 where one request holds all commands of a cycle."""
    GUARDIAN = 18
    GUARDIAN_PID = 19
    GUARDIAN_HEARTBEAT_NS = 20
    GUARDIAN_NOTICED_NS = 21
    """When the guardian saw that the loop was lost [ns]."""
    GUARDIAN_STOPPED_NS = 22
    """When the device acknowledged the guardian's stop [ns]."""
    SOFT_OVERRUNS = 23
    """Cycles that ran beyond the soft budget."""
    TRIP_NS = 24
    """When a limit tripped [ns]."""
    STOPPED_NS = 25
    """When the device acknowledged the loop's stop [ns]."""
    START_NS = 26
    """Deadline 0 of the grid [ns]."""
    MEMORY_LOCKED = 27
    STOPS_SENT = 28
    """Times that the loop sent the safe stop; 1 at the end of every session whose link lived."""
    DEVICE_TOUCHED = 29
    """1 from the first command that may move the arm on: from then on a lost loop means a stop."""


class GuardianReport(NamedTuple):
    """What the guardian did, times on CLOCK_MONOTONIC [ns]."""

    status: GuardianStatus
    noticed_ns: int
    stopped_ns: int
    text: str


_WORDS = 64
_TEXT_SIZE = 2048
_STATE_AT = _WORDS * 8
_SET_POINT_AT = _STATE_AT + latch_size(len(LoopState._fields))
_TEXT_AT = _SET_POINT_AT + latch_size(len(SetPoint._fields))
_TEXTS = ("kind", "error", "trip", "grant", "guardian", "device")
_HISTOGRAM_AT = _TEXT_AT + len(_TEXTS) * _TEXT_SIZE
_HISTOGRAMS = 4
SEGMENT_SIZE = _HISTOGRAM_AT + _HISTOGRAMS * HISTOGRAM_SIZE
"""Bytes of a segment."""


class Segment:
    """A view of ``SEGMENT_SIZE`` bytes.

    Args:
        buffer: Writable bytes, at least ``SEGMENT_SIZE``.

    Raises:
        LoopError: The buffer is too small, or holds something else.
    """

    __slots__ = (
        "_durations",
        "_state",
        "_view",
        "exchange",
        "execution",
        "lateness",
        "publish_state",
        "response",
        "set_points",
        "words",
    )

    def __init__(self, buffer: bytearray | memoryview | mmap.mmap) -> None:
        view = memoryview(buffer)
        if view.nbytes < SEGMENT_SIZE:
            raise LoopError(f"a segment takes {SEGMENT_SIZE} bytes; the buffer has {view.nbytes}")
        self._view = view
        self.words = view[:_STATE_AT].cast("q")
        """The integers named by `Word`."""
        if self.words[Word.MAGIC] not in (0, _MAGIC):
            raise LoopError("the shared block holds no segment of this version of the driver")
        self.words[Word.MAGIC] = _MAGIC
        self._state = Latch(view[_STATE_AT:_SET_POINT_AT], len(LoopState._fields))
        self.publish_state = self._state.write
        """Publishes a row in the order of `LoopState`."""
        self.set_points = Latch(view[_SET_POINT_AT:_TEXT_AT], len(SetPoint._fields))
        """What the application asks, newest row."""
        self.lateness = self._histogram(0)
        """Wake-up minus deadline."""
        self.execution = self._histogram(1)
        """Wake-up to end of cycle, exchange included."""
        self.exchange = self._histogram(2)
        """Exchange with the device: first byte out to last byte in."""
        self.response = self._histogram(3)
        """Deadline to end of cycle."""
        self._durations = view[_HISTOGRAM_AT:SEGMENT_SIZE].cast("q")

    @classmethod
    def in_memory(cls) -> Self:
        """A segment on memory of its own, for lock-step and tests."""
        return cls(bytearray(SEGMENT_SIZE))

    @property
    def status(self) -> Status:
        """Where the loop is in its life."""
        return Status(self.words[Word.STATUS])

    @status.setter
    def status(self, status: Status) -> None:
        self.words[Word.STATUS] = status

    @property
    def trip(self) -> Trip:
        """What tripped first, or ``Trip.NONE``."""
        return Trip(self.words[Word.TRIP])

    def set_trip(self, trip: Trip, detail: str, now_ns: int) -> bool:
        """Note the first trip; a later one changes nothing. Whether this was the first."""
        if self.words[Word.TRIP] != Trip.NONE:
            return False
        self.write_text("trip", detail)
        self.words[Word.TRIP_NS] = now_ns
        self.words[Word.TRIP] = trip
        return True

    def record_durations(self, durations_ns: Sequence[int]) -> None:
        """Count lateness, execution, exchange and response of a cycle [ns] in the four histograms."""
        record_each(self._durations, durations_ns)

    def state(self) -> LoopState:
        """The newest state; all zeros before the first cycle."""
        return LoopState(*self._state.read())

    @property
    def states_published(self) -> int:
        """Number of states published so far."""
        return self._state.count

    def publish(self, set_point: SetPoint) -> None:
        """Hand over what the loop shall do from its next cycle on."""
        self.set_points.write(set_point)

    def set_point(self) -> SetPoint:
        """The newest set-point; all zeros before the first."""
        return SetPoint(*self.set_points.read())

    def write_text(self, name: str, text: str) -> None:
        """Keep a text of at most 2040 bytes; the rest is cut off.

        Args:
            name: ``kind`` and ``error`` of a failure, ``trip``, ``grant``, ``guardian`` or ``device``.
            text: What to keep.
        """
        start = _text_offset(name)
        data = text.encode()[: _TEXT_SIZE - 8].decode(errors="ignore").encode()
        self._view[start + 8 : start + 8 + len(data)] = data
        self._view[start : start + 8].cast("q")[0] = len(data)

    def text(self, name: str) -> str:
        """A text that was kept under this name, or an empty one."""
        start = _text_offset(name)
        length = self._view[start : start + 8].cast("q")[0]
        return bytes(self._view[start + 8 : start + 8 + length]).decode(errors="replace")

    def guardian(self) -> GuardianReport:
        """What the guardian did."""
        words = self.words
        return GuardianReport(
            GuardianStatus(words[Word.GUARDIAN]),
            int(words[Word.GUARDIAN_NOTICED_NS]),
            int(words[Word.GUARDIAN_STOPPED_NS]),
            self.text("guardian"),
        )

    def close(self) -> None:
        """Let go of the memory; idempotent."""
        with contextlib.suppress(BufferError):  # a view of a view lives on; the memory goes with it
            self._state.release()
            self.set_points.release()
            self._durations.release()
            for histogram in (self.lateness, self.execution, self.exchange, self.response):
                histogram.release()
            self.words.release()
            self._view.release()

    def _histogram(self, index: int) -> Histogram:
        start = _HISTOGRAM_AT + index * HISTOGRAM_SIZE
        return Histogram(self._view[start : start + HISTOGRAM_SIZE].cast("q"))


def _text_offset(name: str) -> int:
    return _TEXT_AT + _TEXTS.index(name) * _TEXT_SIZE

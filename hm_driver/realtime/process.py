"""The application's handle of a loop: in a process of its own, or in a thread as the portable fallback."""

import contextlib
import os
import signal
import subprocess
import threading
import time
from abc import ABC, abstractmethod
from types import TracebackType
from typing import Self

from hm_driver.errors import DeviceFault, HapticMasterError, LoopError, SafetyTrip
from hm_driver.realtime.child import spawn
from hm_driver.realtime.failure import decode_error
from hm_driver.realtime.guardian import GuardianOptions
from hm_driver.realtime.options import LoopOptions
from hm_driver.realtime.result import LoopResult, loop_result
from hm_driver.realtime.segment import (
    SEGMENT_SIZE,
    STOP_GENTLY,
    GuardianReport,
    GuardianStatus,
    Segment,
    Status,
    Trip,
    Word,
)
from hm_driver.realtime.setpoint import LoopState, SetPoint
from hm_driver.realtime.shared import SharedBlock

_POLL_S = 0.002
_SPARE_S = 10.0
_LAST_WORDS_S = 2.0


class LoopHandle(ABC):
    """A loop as the application sees it; a context manager whose end leaves the device stopped.

    Args:
        options: What to run.
    """

    def __init__(self, options: LoopOptions) -> None:
        self._options = options
        self._block: SharedBlock | None = None
        self._segment: Segment | None = None
        self._guardian: subprocess.Popen[bytes] | None = None
        self._has_started = False
        self._result: LoopResult | None = None

    def __enter__(self) -> Self:
        self._block = SharedBlock.create(SEGMENT_SIZE, tag="segment")
        self._segment = Segment(self._block.buffer)
        self._segment.words[Word.APP_PID] = os.getpid()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def segment(self) -> Segment:
        """The shared segment.

        Raises:
            LoopError: The handle is not open: use it in a ``with`` statement.
        """
        if self._segment is None:
            raise LoopError("the loop is not open; use it in a 'with' statement")
        return self._segment

    def start(self) -> None:
        """Start the loop, and wait until it runs and `state` tells what its first cycle measured.

        Raises:
            HapticMasterError: What stopped it from running, as the loop met it: `DeviceFault`,
                `TransportError`, `ConfigurationError`, `LoopError` and so on.
        """
        segment = self.segment
        if self._has_started:
            raise LoopError("a loop runs once; make a new one")
        self._has_started = True
        self._spawn(self._options, segment, self._path)
        if self._options.has_guardian:
            self._guardian = spawn("hm_driver.realtime.guardian", "main", self._guardian_options())
        limit_s = self._options.init_timeout_s + 4 * self._options.connect_timeout_s + _SPARE_S
        deadline = time.monotonic() + limit_s
        while not _has_measured(segment):
            self._raise_if_dead()
            if time.monotonic() > deadline:
                raise LoopError(f"the loop did not run within {limit_s:g} s: {segment.status.name.lower()}")
            time.sleep(_POLL_S)
        self.check()

    def publish(self, set_point: SetPoint) -> None:
        """Hand over a set-point, which is a heartbeat too."""
        segment = self.segment
        segment.set_points.write(set_point)
        segment.words[Word.APP_HEARTBEAT_NS] = time.monotonic_ns()

    def heartbeat(self) -> None:
        """Say that the application lives. From the first one on the loop expects them."""
        self.segment.words[Word.APP_HEARTBEAT_NS] = time.monotonic_ns()

    def state(self) -> LoopState:
        """What the loop knew after its last cycle."""
        return self.segment.state()

    @property
    def status(self) -> Status:
        """Where the loop is in its life."""
        return self.segment.status

    def guardian(self) -> GuardianReport:
        """What the guardian does or did."""
        return self.segment.guardian()

    def check(self) -> None:
        """Raise what ended the loop, if it did not end on request; cheap enough for each tick.

        Raises:
            SafetyTrip: A limit tripped; the arm was made safe.
            HapticMasterError: The loop failed, or its process died.
        """
        segment = self.segment
        status = segment.status
        if status is Status.TRIPPED or (segment.trip is not Trip.NONE and self._is_over(status)):
            raise SafetyTrip(segment.trip.name.lower(), segment.text("trip"))
        if status is Status.FAILED:
            raise decode_error(segment.text("kind"), segment.text("error"))
        if not status.has_ended:
            self._raise_if_dead()

    def request_stop(self) -> None:
        """Ask for the gentle end: springs released, device stopped."""
        self.segment.words[Word.STOP_REQUESTED] = STOP_GENTLY

    def wait(self, timeout_s: float | None = None) -> Status:
        """Wait until the loop has ended; returns its status.

        Raises:
            LoopError: It did not end in time, or its process died without a word.
        """
        segment = self.segment
        deadline = None if timeout_s is None else time.monotonic() + timeout_s
        while not segment.status.has_ended:
            self._raise_if_dead()
            if deadline is not None and time.monotonic() > deadline:
                raise LoopError(f"the loop did not end within {timeout_s:g} s")
            time.sleep(_POLL_S)
        return segment.status

    def result(self) -> LoopResult:
        """Statistics so far, and after the end those of the whole run."""
        if self._segment is None and self._result is not None:
            return self._result
        return loop_result(self.segment)

    def close(self) -> None:
        """End the loop, with the device stopped, and let go of everything; idempotent."""
        if self._segment is None or self._block is None:
            return
        if self._has_started:
            self.request_stop()
            patience_s = self._options.watch.release_s + self._options.connect_timeout_s + _SPARE_S
            if self.guardian().status is GuardianStatus.STOPPED_DEVICE:
                patience_s = _LAST_WORDS_S  # the device is safe, and the loop may be frozen for good
            with contextlib.suppress(HapticMasterError):
                self.wait(patience_s)
            self._end()
            self._end_guardian()
            if not self._segment.status.has_ended:
                self._segment.status = Status.TRIPPED if self._segment.trip else Status.FAILED
        self._result = loop_result(self._segment)
        self._segment.close()
        self._segment = None
        self._block.close()
        self._block = None

    @abstractmethod
    def _spawn(self, options: LoopOptions, segment: Segment, path: str) -> None:
        """Start what carries the loop, and enter its process id into the segment."""

    @abstractmethod
    def _death(self) -> str:
        """How the carrier ended, or an empty text while it lives."""

    @abstractmethod
    def _end(self) -> None:
        """End the carrier, by force where it does not end by itself."""

    @property
    def _path(self) -> str:
        return "" if self._block is None else str(self._block.path)

    def _guardian_options(self) -> GuardianOptions:
        return GuardianOptions(
            url=self._options.url,
            segment=self._path,
            freeze_s=self._options.watch.freeze_s,
            connect_timeout_s=self._options.connect_timeout_s,
            priority=min(99, self._options.timing.priority + 5),
        )

    def _is_over(self, status: Status) -> bool:
        """Whether the loop has ended, or the guardian has dealt with one that cannot."""
        return status.has_ended or self.segment.words[Word.GUARDIAN] > GuardianStatus.WATCHING

    def _raise_if_dead(self) -> None:
        death = self._death()
        if not death or self.segment.status.has_ended:
            return
        report = self._last_words_of_the_guardian()
        detail = f"{death}; guardian: {report.text or report.status.name.lower()}"
        if report.status is GuardianStatus.STOPPED_DEVICE:
            raise SafetyTrip(Trip.LOOP_LOST.name.lower(), detail)
        if self.segment.words[Word.DEVICE_TOUCHED]:
            raise DeviceFault(f"{detail}; the device may still be powered: use the emergency button")
        raise LoopError(detail)

    def _last_words_of_the_guardian(self) -> GuardianReport:
        deadline = time.monotonic() + _LAST_WORDS_S
        while self._guardian is not None and time.monotonic() < deadline:
            if self.guardian().status > GuardianStatus.WATCHING or self._guardian.poll() is not None:
                break
            time.sleep(_POLL_S)
        return self.guardian()

    def _end_guardian(self) -> None:
        if self._guardian is not None:
            end_process(self._guardian, patience_s=_LAST_WORDS_S)


class LoopProcess(LoopHandle):
    """The loop on a real-time thread in a process of its own: the way that keeps time."""

    def __init__(self, options: LoopOptions) -> None:
        super().__init__(options)
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def pid(self) -> int | None:
        """Process id of the loop, or None before the start."""
        return None if self._process is None else self._process.pid

    def _spawn(self, options: LoopOptions, segment: Segment, path: str) -> None:
        self._process = spawn("hm_driver.realtime.loop_main", "main", (options, path))
        segment.words[Word.LOOP_PID] = self._process.pid

    def _death(self) -> str:
        if self._process is None or (code := self._process.poll()) is None:
            return ""
        how = f"killed by {_signal_name(-code)}" if code < 0 else f"exit code {code}"
        return f"the loop's process died ({how})"

    def _end(self) -> None:
        if self._process is not None:
            end_process(self._process, patience_s=_LAST_WORDS_S)


class LoopThread(LoopHandle):
    """The loop in a thread of the application: the fallback for platforms without the means of the process.

    It shares the interpreter with the application. Beside one busy Python thread its wake-ups are 5 ms late
    at the median, and most deadlines of 1 kHz are missed; no priority helps. It neither spins nor
    locks memory.
    """

    def __init__(self, options: LoopOptions) -> None:
        super().__init__(options)
        self._thread: threading.Thread | None = None

    def _spawn(self, options: LoopOptions, segment: Segment, path: str) -> None:
        del path
        segment.words[Word.LOOP_PID] = os.getpid()
        self._thread = threading.Thread(
            target=_run_in_thread, args=(options, segment), name="loop", daemon=True
        )
        self._thread.start()

    def _death(self) -> str:
        return "" if self._thread is None or self._thread.is_alive() else "the loop's thread died"

    def _end(self) -> None:
        if self._thread is not None:
            self._thread.join(_LAST_WORDS_S)


def end_process(process: "subprocess.Popen[bytes]", *, patience_s: float) -> None:
    """Close a child's standard input, give it time to end [s], then kill it."""
    if process.stdin is not None:
        with contextlib.suppress(OSError):
            process.stdin.close()
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


def _has_measured(segment: Segment) -> bool:
    """Whether the loop has run a cycle, or will run none any more."""
    status = segment.status
    return status > Status.RUNNING or (status is Status.RUNNING and segment.state().cycle > 0.0)


def _signal_name(number: int) -> str:
    name = signal.Signals(number).name if number in set(signal.Signals) else f"signal {number}"
    return f"{name}: it used up RLIMIT_RTTIME" if name == "SIGXCPU" else name


def _run_in_thread(options: LoopOptions, segment: Segment) -> None:
    from hm_driver.realtime.runner import run_loop

    run_loop(options, segment, owns_process=False)

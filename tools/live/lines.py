"""The live view without a terminal: one line a second, and one whenever something changes."""

from collections.abc import Callable
from typing import TextIO

from tools.live.status import SessionStatus

_PERIOD_S = 1.0
_LEAST_GAP_S = 0.2


def line(status: SessionStatus) -> str:
    """One line that says it all.

    >>> line(SessionStatus(2.34, "teaching", 1.0, 9.8, 10.0, 31, 0.42, 1, 250, 1000, None, 0, None, "none"))
    't 2.3 s  teaching  human  C 1.00  force 9.8/10.0 N  models 31  coverage 42 %  updates 1  \
samples 250/1000  loop in lock-step'
    """
    return (
        f"t {status.time_s:.1f} s  {status.stage}  {status.control}  C {status.C:.2f}  "
        f"force {status.force_n:.1f}/{status.reference_force_n:.1f} N  models {status.models}  "
        f"coverage {100.0 * status.coverage:.0f} %  updates {status.updates}  "
        f"samples {status.accumulated}/{status.accumulation_length}  loop {loop_text(status)}"
    )


def loop_text(status: SessionStatus) -> str:
    """The driver loop in a few words."""
    if status.loop_rate_hz is None:
        return "in lock-step"
    late = "" if status.lateness_p99_us is None else f", p99 {status.lateness_p99_us:.0f} µs"
    return f"{status.loop_rate_hz:.0f} Hz, {status.missed_periods} missed{late}"


class LineScreen:
    """Writes lines to a file, a pipe or a simple terminal.

    Args:
        stream: Where to write.
        clock: Seconds, monotonic.
    """

    def __init__(self, stream: TextIO, clock: Callable[[], float]) -> None:
        self._stream = stream
        self._clock = clock
        self._written_at = float("-inf")
        self._written: SessionStatus | None = None
        self._latest: SessionStatus | None = None
        self._who = ""

    def show(self, statuses: list[SessionStatus]) -> None:
        """Write the messages, and a line where one is due."""
        for status in statuses:
            for message in status.messages:
                self._stream.write(f"t {status.time_s:.1f} s  {message}\n")
            self._latest = status
            if self._is_due(status):
                self._write(status)
        self._stream.flush()

    def finish(self) -> None:
        """Write the last state, if it was not."""
        if self._latest is not None and self._latest is not self._written:
            self._write(self._latest)
        self._stream.flush()

    def _is_due(self, status: SessionStatus) -> bool:
        if status.control != "blending" and not self._who:
            self._who = status.control
        last, elapsed = self._written, self._clock() - self._written_at
        if last is None or elapsed >= _PERIOD_S:
            return True
        if (status.stage, status.updates) != (last.stage, last.updates):
            return True
        return elapsed >= _LEAST_GAP_S and status.control not in ("blending", self._who)

    def _write(self, status: SessionStatus) -> None:
        self._stream.write(line(status) + "\n")
        self._written, self._written_at = status, self._clock()
        if status.control != "blending":
            self._who = status.control

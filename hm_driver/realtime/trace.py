"""The timing of every single cycle in shared memory: for jitter tests, where percentiles are not enough."""

import mmap
from typing import NamedTuple

_READY, _STOP, _RUNG, _ROWS, _HEADER = 0, 1, 2, 3, 8
_COLUMNS = 2


class TracePoint(NamedTuple):
    """One deadline of the grid that was run."""

    number: int
    """Number of the deadline."""
    lateness_ns: int
    """Wake-up behind the deadline [ns]."""
    response_ns: int
    """End of the cycle behind the deadline [ns]."""


def trace_size(length: int) -> int:
    """Bytes of a trace of so many deadlines."""
    return 8 * (_HEADER + _COLUMNS * length)


class Trace:
    """A row for each deadline of a grid; a deadline that was missed leaves its row empty.

    Args:
        buffer: ``trace_size(length)`` writable bytes; all zeros is the empty trace.
    """

    __slots__ = ("_view", "_words", "length")

    def __init__(self, buffer: bytearray | memoryview | mmap.mmap) -> None:
        self._view = memoryview(buffer)
        self._words = self._view.cast("q")
        self.length = (len(self._words) - _HEADER) // _COLUMNS
        """Deadlines that there is room for; later ones are not kept."""

    def record(self, index: int, lateness_ns: int, response_ns: int) -> None:
        """Keep the timing of one deadline."""
        if index < self.length:
            at = _HEADER + _COLUMNS * index
            self._words[at] = lateness_ns + 1
            self._words[at + 1] = response_ns

    def points(self) -> list[TracePoint]:
        """The deadlines that were run, in order."""
        values = self._words[_HEADER:].tolist()
        rows = enumerate(zip(values[::_COLUMNS], values[1::_COLUMNS], strict=True))
        return [TracePoint(index, late - 1, response) for index, (late, response) in rows if late]

    @property
    def is_ready(self) -> bool:
        """Whether the writer is on its grid."""
        return bool(self._words[_READY])

    def set_ready(self, rung: int) -> None:
        """Say that the writer is on its grid, and on which rung of the scheduling ladder."""
        self._words[_RUNG] = rung
        self._words[_READY] = 1

    @property
    def rung(self) -> int:
        """Level of the rung that the writer was granted, 0 the best."""
        return int(self._words[_RUNG])

    @property
    def is_stop_requested(self) -> bool:
        """Whether the writer shall end."""
        return bool(self._words[_STOP])

    def request_stop(self) -> None:
        """Ask the writer to end."""
        self._words[_STOP] = 1

    def close(self) -> None:
        """Let go of the memory; idempotent."""
        self._words.release()
        self._view.release()


def excess_ns(loop: list[TracePoint], canary: list[TracePoint]) -> list[int]:
    """Lateness of a loop beyond that of its canary [ns], at each deadline that both ran.

    Both slept to the same deadline on the same CPU: what the host did to one it did to the other.
    """
    lateness_ns = {point.number: point.lateness_ns for point in canary}
    return [point.lateness_ns - lateness_ns[point.number] for point in loop if point.number in lateness_ns]

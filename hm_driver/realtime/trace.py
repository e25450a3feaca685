"""The timing of the newest cycles in shared memory, a row each: where percentiles are not enough."""

import mmap
from typing import NamedTuple

_READY, _STOP, _RUNG, _NEXT, _HEADER = 0, 1, 2, 3, 8
_COLUMNS = 5


class TracePoint(NamedTuple):
    """One deadline of the grid that was waited for and served."""

    number: int
    """Number of the deadline."""
    lateness_ns: int
    """Wake-up behind the deadline [ns]; beyond a period where the deadlines that follow were missed."""
    response_ns: int
    """End of the cycle behind the deadline [ns]."""
    wake_ns: int = 0
    """When the loop woke up [ns], on its clock: what the grid says of itself can be checked by this."""
    exchange_ns: int = 0
    """Exchange with the device [ns]."""


def trace_size(length: int) -> int:
    """Bytes of a trace of so many deadlines."""
    return 8 * (_HEADER + _COLUMNS * length)


class Trace:
    """The rows of the newest ``length`` deadlines of a grid; one that was missed has none.

    One writer, one reader. A reader who comes often enough with `since` sees every row of any run.

    Args:
        buffer: ``trace_size(length)`` writable bytes; all zeros is the empty trace.
    """

    __slots__ = ("_view", "_words", "length")

    def __init__(self, buffer: bytearray | memoryview | mmap.mmap) -> None:
        self._view = memoryview(buffer)
        self._words = self._view.cast("q")
        self.length = (len(self._words) - _HEADER) // _COLUMNS
        """Deadlines that there is room for; a newer one replaces the oldest."""

    def record(
        self, number: int, lateness_ns: int, response_ns: int, wake_ns: int = 0, exchange_ns: int = 0
    ) -> None:
        """Keep the timing of one deadline; later ones have larger numbers."""
        words = self._words
        at = _HEADER + _COLUMNS * (number % self.length)
        words[at + 1] = lateness_ns
        words[at + 2] = response_ns
        words[at + 3] = wake_ns
        words[at + 4] = exchange_ns
        words[at] = number + 1
        words[_NEXT] = number + 1

    def points(self) -> list[TracePoint]:
        """The rows that are there, in order."""
        return self.since(0)

    def since(self, first: int) -> list[TracePoint]:
        """The rows that are there from a deadline on, in order."""
        words, length = self._words, self.length
        end = self.next_number
        start = max(first, end - length)
        rows = []
        while start < end:
            place = start % length
            count = min(end - start, length - place)
            values = words[_HEADER + _COLUMNS * place : _HEADER + _COLUMNS * (place + count)].tolist()
            numbers = values[::_COLUMNS]
            for i, number in enumerate(numbers):
                if number == start + i + 1:
                    at = i * _COLUMNS
                    rows.append(TracePoint(number - 1, *values[at + 1 : at + _COLUMNS]))
            start += count
        return rows

    @property
    def next_number(self) -> int:
        """Number behind that of the newest row; 0 while there is none."""
        return int(self._words[_NEXT])

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

"""The newest value of a fixed row of floats, handed from one writer to any number of readers without a lock.

Two slots and a counter: value n goes into slot n mod 2, and only then does the counter become n. A reader
takes slot ``counter mod 2`` and looks at the counter again: unchanged means that the writer was not in that
slot. The writer never waits, and a writer that is killed half-way spoils only the slot that nobody reads.

The counter is one aligned 64-bit store. The order of stores is kept by x86 and, because the interpreter runs
hundreds of instructions and its atomic reference counts between them, in practice by other processors.
"""

import struct
from collections.abc import Sequence

from hm_driver.errors import LoopError

_RETRIES = 1000


def latch_size(length: int) -> int:
    """Bytes that a latch of ``length`` floats takes."""
    return 8 + 2 * 8 * length


class Latch:
    """One writer's newest row of floats.

    Args:
        buffer: ``latch_size(length)`` writable bytes, aligned to 8; all zeros means "nothing yet".
        length: Number of floats.
    """

    __slots__ = ("_buffer", "_counter", "_pack", "_row", "_unpack", "length")

    def __init__(self, buffer: memoryview, length: int) -> None:
        self.length = length
        row = struct.Struct(f"@{length}d")
        self._row = row.size
        self._pack = row.pack_into
        self._unpack = row.unpack_from
        self._buffer = buffer
        self._counter = buffer[:8].cast("q")

    @property
    def count(self) -> int:
        """Values written so far; it changes exactly when there is something new."""
        return int(self._counter[0])

    def write(self, values: Sequence[float]) -> None:
        """Publish a row of ``length`` floats."""
        count = self._counter[0] + 1
        self._pack(self._buffer, 8 + (count & 1) * self._row, *values)
        self._counter[0] = count

    def read(self) -> tuple[float, ...]:
        """The newest row, never a mixture of two.

        Raises:
            LoopError: The writer overtook the reader 1000 times in a row, which a sane rate never does.
        """
        counter = self._counter
        for _ in range(_RETRIES):
            count = counter[0]
            values = self._unpack(self._buffer, 8 + (count & 1) * self._row)
            if counter[0] == count:
                return values
        raise LoopError(f"no consistent value in {_RETRIES} tries: the writer is faster than this reader")

    def release(self) -> None:
        """Let go of the memory."""
        self._counter.release()
        self._buffer.release()

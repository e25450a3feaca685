"""A ring of records between one writer and one reader, in shared memory or any other buffer.

Standard library only. Layout: eight 64-bit words (`head`, `tail`, `dropped`, `capacity`, and four spare),
then the records: ``u32 size, u16 channel, u16 flags, i64 log_time_ns, u64 sequence``, the payload,
and padding to eight bytes. `head` and `tail` only ever grow; their place in the ring is the remainder by the
capacity. The writer alone moves `head`, behind a complete record; the reader alone moves `tail`, and only
when it has brought what it read to safety: a reader that dies before leaves it to the next. Both are aligned
64-bit words written by one store, and a processor that keeps stores in order (x86) needs no more than
that. On others the interpreter's own work between two stores makes a reordering unlikely, not impossible: a
record whose header makes no sense raises.
"""

import mmap
import struct
import time
from enum import Enum
from typing import NamedTuple, TypeAlias

from hm_driver.errors import RecordingError

Memory: TypeAlias = bytearray | memoryview | mmap.mmap

HEADER_BYTES = 64
RECORD_HEADER = struct.Struct("<IHHqQ")
MINIMUM_CAPACITY = 256

_HEAD, _TAIL, _DROPPED, _CAPACITY = range(4)
_WRAP = 0xFFFFFFFF
_SIZE = struct.Struct("<I")
_POLL_S = 0.0005


class WhenFull(Enum):
    """What a writer does when the reader is behind."""

    DROP = "drop"
    """Drop the record and count it: for a loop that must not wait."""
    BLOCK = "block"
    """Wait for the reader: for a session in lock-step, which has no wall clock to miss."""


class Record(NamedTuple):
    """One record as the reader gets it."""

    channel: int
    """Id of the channel or bundle."""
    flags: int
    """Free for the user."""
    log_time_ns: int
    """Time of the record [ns]."""
    sequence: int
    """Count of the writer's records on this channel, dropped ones included: a gap is a loss."""
    payload: bytes
    """The bytes written."""


def ring_bytes(capacity: int) -> int:
    """Size of the buffer [B] that a ring of this capacity [B] needs."""
    return HEADER_BYTES + capacity


class Ring:
    """Single-producer single-consumer ring of records.

    One object writes or reads, not both; each process makes its own on the same memory. Whoever makes the
    memory calls `format` once before.

    Args:
        buffer: Writable memory, formatted, aligned to eight bytes.
        when_full: What `reserve` and `write` do when there is no room.
        patience_s: How long a blocking writer waits for the reader [s] before it raises.

    Raises:
        RecordingError: if the memory holds no ring.
    """

    def __init__(
        self, buffer: Memory, *, when_full: WhenFull = WhenFull.DROP, patience_s: float = 30.0
    ) -> None:
        whole = memoryview(buffer).cast("B")
        self._words = whole[:HEADER_BYTES].cast("Q")
        self._capacity = self._words[_CAPACITY]
        if self._capacity < MINIMUM_CAPACITY or ring_bytes(self._capacity) > len(whole):
            raise RecordingError(f"the memory of {len(whole)} B holds no formatted ring")
        self.data = whole[HEADER_BYTES : HEADER_BYTES + self._capacity]
        """Memory of the records: what `reserve` returns is an offset into it."""
        whole.release()
        self._when_full = when_full
        self._patience_s = patience_s
        self._head = self._next = self._words[_HEAD]
        self._tail = self._words[_TAIL]
        self._sequences: dict[int, int] = {}

    @staticmethod
    def format(buffer: Memory) -> None:
        """Make an empty ring of the whole buffer.

        Raises:
            ValueError: if the buffer is too small.
        """
        with memoryview(buffer).cast("B") as whole:
            capacity = (len(whole) - HEADER_BYTES) // 8 * 8
            if capacity < MINIMUM_CAPACITY:
                raise ValueError(f"a ring needs {ring_bytes(MINIMUM_CAPACITY)} B or more, got {len(whole)} B")
            with whole[:HEADER_BYTES].cast("Q") as words:
                for index in range(len(words)):
                    words[index] = 0
                words[_CAPACITY] = capacity

    @property
    def capacity(self) -> int:
        """Bytes that the ring holds, headers included."""
        return self._capacity

    @property
    def used(self) -> int:
        """Bytes written and not yet released by the reader."""
        return self._words[_HEAD] - self._words[_TAIL]

    @property
    def dropped(self) -> int:
        """Records dropped because the ring was full."""
        return self._words[_DROPPED]

    def reserve(self, channel: int, log_time_ns: int, size: int, flags: int = 0) -> int:
        """Make room for a payload of ``size`` bytes and write its header.

        The caller then writes the payload into ``data[offset : offset + size]`` and calls `commit`; until
        then the reader sees nothing.

        Returns:
            The offset into `data`, or -1 where the record was dropped.

        Raises:
            RecordingError: if a blocking ring was not drained in time, or the payload can never fit.
        """
        sequence = self._sequences.get(channel, 0)
        self._sequences[channel] = sequence + 1
        needed = (size + 31) & ~7  # header of 24 bytes, and up to the next multiple of eight
        head = self._head
        capacity = self._capacity
        place = head % capacity
        skipped = capacity - place
        if needed <= skipped:
            skipped = 0
        end = head + skipped + needed
        if end - self._tail > capacity and not self._has_room(end):
            self._words[_DROPPED] += 1
            return -1
        if skipped:
            _SIZE.pack_into(self.data, place, _WRAP)
            place = 0
        RECORD_HEADER.pack_into(self.data, place, size, channel, flags, log_time_ns, sequence)
        self._next = end
        return place + 24

    def commit(self) -> None:
        """Show the reserved record to the reader."""
        self._words[_HEAD] = self._head = self._next

    def write(self, channel: int, log_time_ns: int, payload: bytes | memoryview, flags: int = 0) -> bool:
        """Write a record; returns False where it was dropped, and raises as `reserve` does."""
        size = len(payload)
        offset = self.reserve(channel, log_time_ns, size, flags)
        if offset < 0:
            return False
        self.data[offset : offset + size] = payload
        self._words[_HEAD] = self._head = self._next
        return True

    def write_series(
        self, channel: int, log_time_ns: int, step_ns: int, payloads: memoryview, size: int
    ) -> None:
        """Write records of equal size at equal distances in time; each as `write` does.

        Args:
            channel: Id of the channel or bundle.
            log_time_ns: Time of the first record [ns].
            step_ns: Time from one record to the next [ns].
            payloads: The payloads, one behind the other.
            size: Size of each [B].
        """
        data, head, capacity = self.data, self._head, self._capacity
        place, needed = head % capacity, (size + 31) & ~7
        end = head + len(payloads) // size * needed
        if place + end - head > capacity or (end - self._tail > capacity and not self._has_room(end)):
            for start in range(0, len(payloads), size):  # around the end of the memory, or with records lost
                self.write(channel, log_time_ns, payloads[start : start + size])
                log_time_ns += step_ns
            return
        sequence = self._sequences.get(channel, 0)
        for start in range(0, len(payloads), size):
            RECORD_HEADER.pack_into(data, place, size, channel, 0, log_time_ns, sequence)
            data[place + 24 : place + 24 + size] = payloads[start : start + size]
            place += needed
            sequence += 1
            log_time_ns += step_ns
        self._sequences[channel] = sequence
        self._words[_HEAD] = self._head = end

    def _has_room(self, end: int) -> bool:
        self._tail = self._words[_TAIL]
        if end - self._tail <= self._capacity:
            return True
        if self._when_full is WhenFull.DROP:
            return False
        if end - self._head > self._capacity:  # never more than twice the record: half the ring always fits
            raise RecordingError(f"a record does not fit a ring of {self._capacity} B; make the ring larger")
        deadline = time.monotonic() + self._patience_s
        while end - self._tail > self._capacity:
            if time.monotonic() > deadline:
                raise RecordingError(
                    f"the ring was not drained for {self._patience_s:g} s: is the recorder alive?"
                )
            time.sleep(_POLL_S)
            self._tail = self._words[_TAIL]
        return True

    def drain(self, max_bytes: int = 1 << 20) -> list[Record]:
        """Read the records that follow those read before, in the order in which they were written.

        Their memory stays theirs until `release`.

        Args:
            max_bytes: Where to stop [B]; the record that passes it is still taken.

        Raises:
            RecordingError: if a record's header makes no sense: the memory is damaged.
        """
        words, data, capacity = self._words, self.data, self._capacity
        tail, head = self._tail, words[_HEAD]
        stop = min(head, tail + max_bytes)
        unpack = RECORD_HEADER.unpack_from
        records = []
        while tail < stop:
            place = tail % capacity
            if _SIZE.unpack_from(data, place)[0] == _WRAP:
                tail += capacity - place
                continue
            size, channel, flags, log_time_ns, sequence = unpack(data, place)
            start = place + 24
            end = start + size
            tail += (size + 31) & ~7
            if end > capacity or tail > head:
                raise RecordingError(f"the ring is damaged: a record of {size} B at {place} of {capacity} B")
            records.append(Record(channel, flags, log_time_ns, sequence, bytes(data[start:end])))
        self._tail = tail
        return records

    @property
    def unreleased(self) -> int:
        """Bytes that `drain` has read and `release` has not given back."""
        return self._tail - self._words[_TAIL]

    def release(self) -> None:
        """Give the memory of what `drain` has read back to the writer: it is safe elsewhere."""
        self._words[_TAIL] = self._tail

    def close(self) -> None:
        """Let go of the memory, so that its owner can release it; idempotent."""
        self.data.release()
        self._words.release()

    def __enter__(self) -> "Ring":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

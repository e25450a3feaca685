"""Log-linear histogram of durations in a fixed block of memory, written by one process and read by any."""

from collections.abc import Sequence
from typing import NamedTuple

SUB_BITS = 5
SUB_BUCKETS = 1 << SUB_BITS
MAXIMUM_BITS = 40
"""Durations of 2^40 ns (18 minutes) and more share the last bucket."""
BUCKETS = (MAXIMUM_BITS - SUB_BITS + 1) * SUB_BUCKETS
_MAXIMUM, _HEADER = 0, 1
_LENGTH = _HEADER + BUCKETS
SIZE = _LENGTH * 8
"""Bytes of one histogram."""


class Percentiles(NamedTuple):
    """Summary of a histogram, durations in [µs]."""

    samples: int
    p50_us: float
    p99_us: float
    p999_us: float
    max_us: float
    mean_us: float


def bucket_of(value_ns: int) -> int:
    """Bucket that holds a duration [ns]: exact below 64 ns, then 32 buckets an octave (3 % wide)."""
    if value_ns < SUB_BUCKETS:
        return max(0, value_ns)
    shift = value_ns.bit_length() - SUB_BITS - 1
    bucket = ((shift + 1) << SUB_BITS) + ((value_ns >> shift) & (SUB_BUCKETS - 1))
    return bucket if bucket < BUCKETS else BUCKETS - 1


def bucket_bounds(bucket: int) -> tuple[int, int]:
    """Smallest and largest duration [ns] that fall into a bucket."""
    octave, sub = bucket >> SUB_BITS, bucket & (SUB_BUCKETS - 1)
    if octave == 0:
        return sub, sub
    low = (SUB_BUCKETS + sub) << (octave - 1)
    return low, low + (1 << (octave - 1)) - 1


def record_each(words: memoryview, values_ns: Sequence[int]) -> None:
    """Count one duration [ns] in each of several histograms that lie one behind the other.

    Half a microsecond each: nothing is kept that the buckets tell, and `bucket_of` is not called.

    Args:
        words: The blocks as native 64-bit integers.
        values_ns: A duration for each; a negative one counts as 0.
    """
    start = 0
    for value_ns in values_ns:
        if value_ns < 32:  # SUB_BUCKETS
            if value_ns < 0:
                value_ns = 0
            bucket = value_ns
        else:
            shift = value_ns.bit_length() - 6  # SUB_BITS + 1
            bucket = (shift << 5) + (value_ns >> shift)  # as the value's highest bit is 32 here
            if bucket >= BUCKETS:
                bucket = BUCKETS - 1
        words[start + _HEADER + bucket] += 1
        if value_ns > words[start]:
            words[start] = value_ns
        start += _LENGTH


class Histogram:
    """A view of ``SIZE`` bytes as a histogram; all zeros is the empty one.

    One writer, any readers.

    Args:
        words: The block as native 64-bit integers (``memoryview.cast("q")``), length ``SIZE // 8``.
    """

    __slots__ = ("_words",)

    def __init__(self, words: memoryview) -> None:
        self._words = words

    def record(self, value_ns: int) -> None:
        """Count one duration [ns]; a negative one counts as 0."""
        record_each(self._words, (value_ns,))

    @property
    def count(self) -> int:
        """Durations recorded."""
        return sum(self.counts())

    @property
    def maximum_ns(self) -> int:
        """Largest duration recorded, exactly [ns]."""
        return int(self._words[_MAXIMUM])

    def counts(self) -> list[int]:
        """Number of durations in each bucket, shape (BUCKETS,)."""
        return self._words[_HEADER:].tolist()

    def percentile_ns(self, share: float) -> int:
        """Upper bound of the bucket where the given share (0 to 1) of the durations is reached [ns]."""
        counts = self.counts()
        wanted = share * sum(counts)
        reached = 0
        for bucket, count in enumerate(counts):
            reached += count
            if count and reached >= wanted:
                return min(bucket_bounds(bucket)[1], self.maximum_ns)
        return 0

    def percentiles(self) -> Percentiles:
        """The usual summary; the mean is that of the buckets' middles."""
        counts = self.counts()
        samples = sum(counts)
        total_ns = sum(sum(bucket_bounds(bucket)) * 0.5 * n for bucket, n in enumerate(counts) if n)
        return Percentiles(
            samples,
            self.percentile_ns(0.5) * 1e-3,
            self.percentile_ns(0.99) * 1e-3,
            self.percentile_ns(0.999) * 1e-3,
            self.maximum_ns * 1e-3,
            total_ns / samples * 1e-3 if samples else 0.0,
        )

    def clear(self) -> None:
        """Forget everything."""
        for index in range(len(self._words)):
            self._words[index] = 0

    def release(self) -> None:
        """Let go of the memory."""
        self._words.release()

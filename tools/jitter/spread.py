"""How a duration is spread: percentiles and a histogram of fixed size, whatever the length of the run."""

import bisect
import itertools
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Self

from hm_driver.realtime.histogram import SIZE, Histogram, bucket_bounds


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Percentiles of a duration [µs]."""

    samples: int
    """Number of durations."""
    p50: float
    p90: float
    p99: float
    p99_9: float
    max: float
    bins: tuple[tuple[float, int], ...]
    """Upper bound [µs] and count of each bucket that holds anything; buckets are 3 % wide."""

    @classmethod
    def of(cls, histogram: Histogram) -> Self:
        """The spread that a histogram tells."""
        counts = histogram.counts()
        bins = {bucket_bounds(bucket)[1] * 1e-3: count for bucket, count in enumerate(counts) if count}
        return cls.of_bins(bins, maximum=histogram.maximum_ns * 1e-3)

    @classmethod
    def of_bins(cls, bins: Mapping[float, int], *, maximum: float) -> Self:
        """The spread that counts by upper bound [µs] tell, with the largest duration [µs]."""
        ordered = sorted((upper, count) for upper, count in bins.items() if count)
        samples = sum(count for _, count in ordered)
        reached = list(itertools.accumulate(count for _, count in ordered))

        def percentile(share: float) -> float:
            place = bisect.bisect_left(reached, share * samples)
            return min(ordered[place][0], maximum) if ordered else 0.0

        return cls(
            samples=samples,
            p50=percentile(0.5),
            p90=percentile(0.9),
            p99=percentile(0.99),
            p99_9=percentile(0.999),
            max=maximum,
            bins=tuple(ordered),
        )

    @classmethod
    def pooled(cls, spreads: Iterable["Spread"]) -> Self:
        """The spread of all durations of several."""
        spreads = list(spreads)
        bins: Counter[float] = Counter()
        for spread in spreads:
            bins.update(dict(spread.bins))
        return cls.of_bins(bins, maximum=max((spread.max for spread in spreads), default=0.0))

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Self:
        """What `dataclasses.asdict` made."""
        bins = tuple((float(upper), int(count)) for upper, count in values["bins"])
        return cls(**{**values, "bins": bins})


def new_histogram() -> Histogram:
    """An empty histogram on memory of its own."""
    return Histogram(memoryview(bytearray(SIZE)).cast("q"))

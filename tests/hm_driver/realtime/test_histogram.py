import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.realtime.histogram import BUCKETS, SIZE, Histogram, bucket_bounds, bucket_of


@pytest.fixture
def histogram():
    return Histogram(memoryview(bytearray(SIZE)).cast("q"))


@given(st.integers(0, 2**39))
def test_a_duration_lies_within_the_bounds_of_its_bucket_and_they_are_3_percent_wide(value_ns):
    low, high = bucket_bounds(bucket_of(value_ns))
    assert low <= value_ns <= high
    assert high - low <= value_ns / 32


def test_buckets_follow_each_other_without_a_gap():
    bounds = [bucket_bounds(bucket) for bucket in range(BUCKETS)]
    assert all(low == high_before + 1 for (_, high_before), (low, _) in itertools.pairwise(bounds))


@given(st.integers(-5, 2**41))
def test_recording_uses_the_same_bucket_as_the_function(value_ns):
    histogram = Histogram(memoryview(bytearray(SIZE)).cast("q"))
    histogram.record(value_ns)
    assert histogram.counts()[bucket_of(value_ns)] == 1


def test_percentiles_are_those_of_the_data_within_a_bucket(histogram):
    for value_us in range(1, 1001):
        histogram.record(value_us * 1000)
    summary = histogram.percentiles()
    assert summary.samples == histogram.count == 1000
    assert summary.p50_us == pytest.approx(500, rel=0.035)
    assert summary.p99_us == pytest.approx(990, rel=0.035)
    assert summary.p999_us == pytest.approx(999, rel=0.035)
    assert summary.max_us == 1000.0
    assert summary.mean_us == pytest.approx(500.5, rel=0.01)


def test_an_empty_histogram_has_percentiles_of_zero(histogram):
    assert histogram.percentiles() == (0, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_a_cleared_histogram_is_empty(histogram):
    histogram.record(7)
    histogram.clear()
    assert histogram.count == 0
    assert sum(histogram.counts()) == 0


def test_durations_beyond_the_last_bucket_are_counted_in_it(histogram):
    histogram.record(2**50)
    assert histogram.counts()[-1] == 1
    assert histogram.maximum_ns == 2**50

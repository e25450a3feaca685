import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.realtime.trace import TracePoint
from tools.jitter.pairing import BINS, WORST, Grid, Pairing
from tools.jitter.spread import Spread, new_histogram

MS = 1_000_000
START = 5_000 * MS


def row(number, late_us, *, execution_us=100.0):
    late_ns = round(late_us * 1e3)
    wake_ns = START + number * MS + late_ns
    return TracePoint(number, late_ns, late_ns + round(execution_us * 1e3), wake_ns, 80_000)


def pair(loop, canary, device=(), *, first=0, end=10):
    grid = Grid(start_ns=START, period_ns=MS, first=first, end=end)
    pairing = Pairing(grid, canaries=2 if device else 1)
    pairing.add(loop, canary, *([device] if device else []), upto=end)
    pairing.finish()
    return pairing


def on_time(numbers, late_us=10.0):
    return [row(number, late_us) for number in numbers]


def test_the_excess_is_the_wake_up_behind_the_canarys():
    pairing = pair(on_time(range(10), 30.0), on_time(range(10), 12.0))
    excess = Spread.of(pairing.excess)
    assert excess.samples == 10
    assert excess.max == pytest.approx(18.0)
    assert Spread.of(pairing.lateness).max == pytest.approx(30.0)
    assert Spread.of(pairing.response).max == pytest.approx(130.0)


def test_a_stall_that_meets_both_is_no_excess():
    loop = [*on_time(range(4)), row(4, 30_050.0), *on_time(range(35, 40))]
    canary = [*on_time(range(4)), row(4, 30_000.0), *on_time(range(35, 40))]
    pairing = pair(loop, canary, end=40)
    assert Spread.of(pairing.excess).max == pytest.approx(50.0)
    assert (pairing.missed, pairing.own_missed) == (30, 0)


def test_a_stall_between_the_two_wake_ups_is_seen_at_the_canarys_next_deadline():
    loop = [*on_time(range(4)), row(4, 5_050.0), *on_time(range(10, 12))]
    canary = [*on_time(range(5)), row(5, 4_000.0), *on_time(range(10, 12))]
    assert Spread.of(pair(loop, canary, end=12).excess).max == pytest.approx(50.0)


def test_a_loop_that_is_late_by_itself_has_all_of_it_as_excess():
    loop = [*on_time(range(4)), row(4, 5_200.0), *on_time(range(10, 12))]
    pairing = pair(loop, on_time(range(12)), end=12)
    assert Spread.of(pairing.excess).max == pytest.approx(5_190.0)
    assert (pairing.missed, pairing.own_missed) == (5, 5)
    assert pairing.own_misses == [5, 6, 7, 8, 9]
    assert max(event.excess for event in pairing.worst) == pytest.approx(5_190.0)


def test_a_miss_behind_a_held_up_emulator_is_the_machines():
    loop = [*on_time(range(4)), row(4, 2_100.0), *on_time(range(7, 10))]
    held = [*on_time(range(3)), row(3, 2_900.0), *on_time(range(6, 10))]
    assert pair(loop, on_time(range(10)), held).own_missed == 0
    assert pair(loop, on_time(range(10)), on_time(range(10))).own_missed == 2


def test_a_gap_that_reaches_to_the_end_is_judged_too():
    assert pair(on_time(range(5)), on_time(range(10))).own_missed == 5


def test_every_deadline_is_either_run_or_missed_however_the_rows_come_in():
    numbers = [n for n in range(1000) if n % 7]
    grid = Grid(start_ns=START, period_ns=MS, first=0, end=1000)
    whole, parts = Pairing(grid, canaries=1), Pairing(grid, canaries=1)
    whole.add(on_time(numbers), on_time(range(1000)), upto=1000)
    for start in range(0, 1000, 90):
        new = [n for n in numbers if start <= n < start + 90]
        parts.add(on_time(new), on_time(range(start, min(1000, start + 90))), upto=start + 60)
    parts.add((), (), upto=1000)
    for pairing in (whole, parts):
        pairing.finish()
        assert (pairing.cycles, pairing.missed) == (len(numbers), 1000 - len(numbers))
    assert whole.course == parts.course


def test_a_relative_grid_shows_as_drift_and_an_absolute_one_does_not():
    drifting = [row(number, 10.0 + 16.0 * number) for number in range(900)]
    assert pair(drifting, on_time(range(1000)), end=1000).drift.us_per_s == pytest.approx(16_000.0, rel=0.02)
    steady = [row(number, 10.0 + number % 5) for number in range(1000)]
    drift = pair(steady, on_time(range(1000)), end=1000).drift
    assert abs(drift.us_per_s) <= drift.resolution_us_per_s < 5.0


def test_a_long_run_keeps_a_bounded_number_of_bins_and_events():
    end = 40_000
    pairing = pair([row(n, 10.0 + n % 97) for n in range(end)], on_time(range(end)), end=end)
    assert len(pairing.course) <= BINS
    assert len(pairing.worst) == WORST
    assert {event.lateness for event in pairing.worst} == {106.0}
    assert len(pairing._held) < 10


@given(st.lists(st.integers(0, 10_000_000), min_size=1, max_size=300))
def test_the_percentiles_of_a_spread_are_those_of_the_values_within_a_bucket(values_ns):
    histogram = new_histogram()
    for value_ns in values_ns:
        histogram.record(value_ns)
    spread, ordered = Spread.of(histogram), sorted(values_ns)
    assert spread.samples == len(values_ns)
    assert spread.max == pytest.approx(ordered[-1] / 1e3)
    middle = ordered[-(-len(ordered) // 2) - 1] / 1e3
    assert middle <= spread.p50 + 1e-9 <= middle * 1.04 + 0.002
    assert spread.p50 <= spread.p90 <= spread.p99 <= spread.p99_9 <= spread.max


def test_pooled_spreads_are_the_spread_of_all_values():
    parts, whole = [new_histogram(), new_histogram()], new_histogram()
    for number in range(5000):
        parts[number % 2].record(number * 37 % 90_000)
        whole.record(number * 37 % 90_000)
    assert Spread.pooled(map(Spread.of, parts)) == Spread.of(whole)

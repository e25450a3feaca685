import time

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.errors import ConfigurationError
from hm_driver.realtime.clock import VirtualClock, WallClock
from hm_driver.realtime.grid import MAXIMUM_MARGIN_NS, Grid, SpinMargin, period_ns_of

MS = 1_000_000


def test_a_virtual_clock_stands_still_until_someone_waits():
    clock = VirtualClock(5)
    assert clock.now_ns() == clock.now_ns() == 5


def test_a_virtual_clock_tells_its_listeners_every_time_it_reaches():
    clock = VirtualClock()
    reached = []
    clock.on_advance(reached.append)
    clock.sleep_until_ns(3)
    clock.sleep_until_ns(2)
    assert clock.spin_until_ns(7) == 7
    assert reached == [3, 7]


def test_the_wall_clock_never_wakes_before_the_deadline():
    clock = WallClock()
    deadline_ns = clock.now_ns() + 2 * MS
    clock.sleep_until_ns(deadline_ns)
    assert clock.now_ns() >= deadline_ns
    assert clock.spin_until_ns(deadline_ns + 1000) >= deadline_ns + 1000


@pytest.mark.parametrize(("rate_hz", "period_ns"), [(1000, 1_000_000), (2500, 400_000), (100, 10_000_000)])
def test_a_rate_becomes_a_period(rate_hz, period_ns):
    assert period_ns_of(rate_hz) == period_ns


@pytest.mark.parametrize("rate_hz", [0.0, -1.0, float("nan"), 1e6])
def test_a_rate_out_of_range_is_refused(rate_hz):
    with pytest.raises(ConfigurationError, match="10000 Hz"):
        period_ns_of(rate_hz)


def test_deadlines_lie_on_an_absolute_grid():
    clock = VirtualClock()
    grid = Grid(clock, MS, start_ns=10 * MS)
    deadlines = []
    for busy_ns in (0, 700_000, 300_000, 999_999):
        assert grid.wait() == 0
        deadlines.append(grid.deadline_ns)
        clock.sleep_until_ns(clock.now_ns() + busy_ns)
    assert deadlines == [10 * MS, 11 * MS, 12 * MS, 13 * MS]
    assert grid.dt_ns == MS


def test_whole_periods_are_skipped_counted_and_handed_over_as_true_dt():
    clock = VirtualClock()
    grid = Grid(clock, MS, start_ns=0)
    grid.wait()
    clock.sleep_until_ns(3 * MS + 200_000)
    assert grid.wait() == 2
    assert (grid.index, grid.deadline_ns, grid.cycles, grid.missed) == (3, 3 * MS, 2, 2)
    assert grid.lateness_ns == 2 * MS + 200_000
    assert grid.dt_ns == 3 * MS + 200_000


def test_a_cycle_that_is_late_by_less_than_a_period_is_run_late_and_not_missed():
    clock = VirtualClock()
    grid = Grid(clock, MS, start_ns=0)
    grid.wait()
    clock.sleep_until_ns(MS + 500_000)
    assert grid.wait() == 0
    assert (grid.index, grid.lateness_ns) == (1, 500_000)


def test_a_grid_that_began_before_is_joined_at_a_later_deadline():
    clock = VirtualClock(12 * MS + 1)
    grid = Grid(clock, MS, start_ns=10 * MS, first=3)
    assert grid.wait() == 0
    assert (grid.index, grid.deadline_ns, grid.length, grid.missed) == (3, 13 * MS, 1, 0)


def test_the_grid_starts_at_its_first_wait_where_no_start_is_given():
    clock = VirtualClock(123)
    grid = Grid(clock, MS)
    grid.wait()
    assert (grid.deadline_ns, grid.lateness_ns, grid.index) == (123, 0, 0)


@given(st.lists(st.integers(0, 5 * MS), max_size=60), st.booleans())
def test_cycles_run_plus_periods_missed_is_the_length_of_the_grid(busy_ns, spin):
    clock = VirtualClock()
    grid = Grid(clock, MS, start_ns=0, spin=SpinMargin(MS) if spin else None)
    total_dt_ns = 0
    for duration_ns in busy_ns:
        grid.wait()
        total_dt_ns += grid.dt_ns if grid.cycles > 1 else 0
        assert 0 <= grid.wake_ns - grid.deadline_ns < MS
        clock.sleep_until_ns(clock.now_ns() + duration_ns)
    assert grid.cycles == len(busy_ns)
    assert grid.cycles + grid.missed == grid.length
    assert total_dt_ns == (grid.wake_ns if busy_ns else 0)


def test_the_spin_margin_follows_the_99th_percentile_of_the_lateness():
    margin = SpinMargin(MS)
    for index in range(20_000):
        margin.observe(60_000 if index % 50 == 0 else 20_000)
    assert 60_000 <= margin.margin_ns <= 80_000
    for _ in range(10_000):
        margin.observe(1_000)
    assert margin.margin_ns < 20_000


def test_one_stall_of_the_host_moves_the_spin_margin_by_four_microseconds_at_most():
    margin = SpinMargin(MS)
    before_ns = margin.margin_ns
    margin.observe(30 * MS)
    assert margin.margin_ns - before_ns <= 4_000


def test_the_spin_margin_keeps_to_its_ceiling_and_to_the_duty_cap():
    for period_ns, duty_cap, ceiling_ns in (
        (MS, 0.15, MAXIMUM_MARGIN_NS),
        (400_000, 0.15, 60_000),
        (MS, 0.0, 0),
    ):
        margin = SpinMargin(period_ns, duty_cap=duty_cap)
        for _ in range(500):
            margin.observe(MS)
        assert margin.margin_ns == ceiling_ns


def test_a_duty_cap_out_of_range_is_refused():
    with pytest.raises(ConfigurationError, match="outside 0 to"):
        SpinMargin(MS, duty_cap=0.9)


@pytest.mark.timing
def test_a_real_grid_keeps_its_rate_over_half_a_second():
    start_ns = time.monotonic_ns() + MS
    grid = Grid(WallClock(), MS, start_ns=start_ns, spin=SpinMargin(MS))
    while grid.length < 500:
        grid.wait()
    assert grid.cycles + grid.missed == grid.length
    assert grid.deadline_ns == start_ns + grid.index * MS

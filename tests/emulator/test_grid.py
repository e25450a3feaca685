import pytest

from emulator.grid import STEP_NS, TickGrid, steps_until
from hm_driver.errors import ConfigurationError


def test_every_period_gets_its_tick_when_the_thread_is_on_time():
    grid = TickGrid(start_ns=1_000)
    steps = 0
    for _ in range(1000):
        steps += grid.take_due(grid.next_ns)
    assert steps == grid.ticks == 1000
    assert grid.missed == grid.given_up == 0
    assert grid.next_ns == 1_000 + 1000 * STEP_NS


def test_before_the_next_tick_nothing_is_due():
    grid = TickGrid(start_ns=0)
    assert grid.take_due(0) == 1
    assert grid.take_due(STEP_NS - 1) == 0


def test_a_short_stall_is_caught_up_and_counted_in_periods():
    grid = TickGrid(start_ns=0)
    grid.take_due(0)
    assert grid.take_due(10 * STEP_NS + 7) == 10
    assert (grid.missed, grid.given_up, grid.ticks) == (9, 0, 2)
    assert grid.next_ns == 11 * STEP_NS


def test_a_long_stall_gives_up_whole_steps_and_stays_on_the_grid():
    grid = TickGrid(start_ns=0, max_catch_up=50)
    grid.take_due(0)
    assert grid.take_due(1000 * STEP_NS + 123) == 50
    assert (grid.missed, grid.given_up) == (999, 950)
    assert grid.next_ns == 1001 * STEP_NS


@pytest.mark.parametrize("speed", [0.1, 0.3, 1.0, 2.0, 7.5, 20.0])
def test_device_time_follows_the_speed_exactly(speed):
    grid = TickGrid(start_ns=5, speed=speed)
    steps = 0
    while grid.next_ns < 1_000_000_000:
        steps += grid.take_due(grid.next_ns)
    assert steps == pytest.approx(2500 * speed, abs=speed + 1)
    assert grid.missed == 0


@pytest.mark.parametrize("speed", [0.0, -1.0, 1e9, float("nan")])
def test_an_impossible_speed_is_refused(speed):
    with pytest.raises(ConfigurationError, match="speed"):
        TickGrid(start_ns=0, speed=speed)


def test_lock_step_counts_steps_in_integers():
    assert [steps_until(t) for t in (0, 399_999, 400_000, 1_000_000, 10**9, 10**15 + 1)] == [
        0,
        0,
        1,
        2,
        2500,
        2500000000,
    ]

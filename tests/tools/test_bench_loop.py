import pytest

from hm_driver.realtime.histogram import SIZE, Histogram
from hm_driver.realtime.trace import TracePoint
from tools.bench.loop import Row, count_overruns, table
from tools.bench.loop_requests import Conversation, Mode, Wire
from tools.bench.loop_turns import BareOptions, Turn, pool, run_bare, run_child

PERIOD_NS = 400_000


def trace(lateness):
    return [TracePoint(number, late, late + 100_000) for number, late in lateness.items()]


def test_a_cycle_is_one_exchange_where_the_device_combines():
    for mode in Mode:
        assert Conversation(mode, Wire.COMBINED, cycles=100).exchanges == 1.0


@pytest.mark.parametrize("wire", [Wire.SEPARATE, Wire.FRAMED])
def test_one_by_one_a_cycle_asks_three_questions_and_says_what_changed(wire):
    assert Conversation(Mode.ADMITTANCE, wire, cycles=100).exchanges == 3.05
    assert Conversation(Mode.POSITION, wire, cycles=100).exchanges > 6.0


def test_the_bare_loop_keeps_to_its_grid_and_counts_what_it_misses():
    sent = []
    times = run_bare(sent.append, lambda _size: b"x", [b"a"] * 50, 1_000_000, None)
    assert sent == [b"a"] * 50
    assert len(times.response) + times.missed == times.length
    assert all(late >= 0 for late in times.lateness)
    assert all(response >= late for response, late in zip(times.response, times.lateness, strict=True))


@pytest.mark.parametrize("spin_duty", [0.0, 0.1])
def test_a_cycle_is_measured_without_an_exchange(spin_duty):
    turn = run_child("memory_main", BareOptions(cycles=100, spin_duty=spin_duty), cpu=None)
    assert turn.cycles == 100
    assert turn.adds_up
    assert turn.cpu_us > 0.0
    assert (turn.spun_ns > 0) is (spin_duty > 0.0)


def test_a_deadline_missed_while_a_canary_was_late_is_not_the_loops_own():
    points = trace({number: 10_000 for number in range(20) if number not in (5, 12)})
    quiet = trace(dict.fromkeys(range(20), 10_000))
    stalled = trace({number: 300_000 if number == 5 else 10_000 for number in range(20)})
    overruns = count_overruns(points, [quiet, stalled], period_ns=PERIOD_NS)
    assert (overruns.length, overruns.missed, overruns.beyond) == (20, 2, 1)


def test_a_cycle_that_ends_behind_the_next_deadline_is_late():
    points = trace({number: 350_000 if number == 3 else 10_000 for number in range(10)})
    overruns = count_overruns(points, [points], period_ns=PERIOD_NS)
    assert (overruns.late, overruns.beyond) == (1, 0)


def test_turns_are_pooled_and_processor_times_told_by_their_median():
    histogram = Histogram(memoryview(bytearray(SIZE)).cast("q"))
    for value in range(1_000, 101_000, 1_000):
        histogram.record(value)
    counts = histogram.counts()
    turns = [Turn(100, 0, 100, cpu * 100_000, 0, 1, 100, counts, counts) for cpu in (10, 20, 90)]
    assert pool(turn.response for turn in turns).percentile_ns(0.5) == pytest.approx(50_000, rel=0.04)
    row = Row("x", turns)
    assert row.values()["cpu_us"] == 20.0
    assert "20.0" in table({"x": row})[1]

import time

import pytest

from hm_driver.errors import ConfigurationError
from hm_driver.realtime.canary import Canary, CanaryOptions, run_canary
from hm_driver.realtime.clock import VirtualClock
from hm_driver.realtime.grid import Grid
from hm_driver.realtime.options import LoopOptions, WatchOptions
from hm_driver.realtime.process import LoopProcess
from hm_driver.realtime.segment import Word
from hm_driver.realtime.setpoint import SetPoint
from hm_driver.realtime.shared import SharedBlock
from hm_driver.realtime.trace import Trace, TracePoint, excess_ns, trace_size

MS = 1_000_000


def test_a_trace_keeps_the_deadlines_that_were_run_and_no_others():
    trace = Trace(bytearray(trace_size(4)))
    trace.record(1, 0, 7)
    trace.record(3, 20, 30, 40, 50)
    assert trace.points() == [TracePoint(1, 0, 7), TracePoint(3, 20, 30, 40, 50)]


def test_a_full_trace_keeps_the_newest_deadlines():
    trace = Trace(bytearray(trace_size(4)))
    for number in (0, 1, 2, 5, 6):
        trace.record(number, number, 0)
    assert [point.number for point in trace.points()] == [5, 6]


def test_a_trace_that_is_read_often_enough_tells_every_deadline_of_a_long_run():
    trace, seen = Trace(bytearray(trace_size(8))), []
    for number in range(100):
        trace.record(number, number, 0)
        if number % 5 == 0:
            seen += trace.since(len(seen))
    assert [point.lateness_ns for point in seen] == list(range(96))


def test_the_excess_compares_deadlines_that_both_ran():
    loop = [TracePoint(0, 50, 0), TracePoint(1, 900, 0), TracePoint(2, 40, 0)]
    canary = [TracePoint(1, 880, 0), TracePoint(2, 10, 0), TracePoint(3, 5, 0)]
    assert excess_ns(loop, canary) == [20, 30]


def test_a_canary_ends_at_its_last_deadline():
    trace = Trace(bytearray(trace_size(5)))
    run_canary(Grid(VirtualClock(), MS, start_ns=MS), trace, last=4)
    assert [point.number for point in trace.points()] == [0, 1, 2, 3, 4]


def test_a_canary_without_deadlines_is_refused():
    with pytest.raises(ConfigurationError):
        CanaryOptions(period_ns=MS, start_ns=0, length=0)


@pytest.mark.timing
def test_a_canary_sleeps_to_the_deadlines_of_the_loop(device):
    watch = WatchOptions(heartbeat_s=2.0, exchange_timeout_s=1.0, freeze_s=2.0, missed_s=5.0)
    with SharedBlock.create(trace_size(20_000), tag="trace") as block:
        trace = Trace(block.buffer)
        with LoopProcess(LoopOptions(url=device.url, watch=watch, trace=str(block.path))) as loop:
            loop.start()
            start_ns = int(loop.segment.words[Word.START_NS])
            with Canary(CanaryOptions(period_ns=MS, start_ns=start_ns, length=20_000)) as canary:
                for tick in range(50):
                    loop.publish(SetPoint(sequence=float(tick)))
                    time.sleep(0.01)
        points = trace.points()
        trace.close()
    assert 0 < len(points) <= loop.result().cycles
    assert all(point.response_ns > point.lateness_ns >= 0 for point in points)
    assert len(excess_ns(points, canary.points())) > 100

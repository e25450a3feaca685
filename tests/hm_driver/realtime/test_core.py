import itertools
import math

import pytest
from still_device import StillDevice

from hm_driver.errors import DeviceError, ProtocolError, TransportTimeout
from hm_driver.realtime import bring_up
from hm_driver.realtime.clock import VirtualClock
from hm_driver.realtime.core import LoopCore
from hm_driver.realtime.grid import Grid
from hm_driver.realtime.law import LawRunner
from hm_driver.realtime.measurements import parse_measurement
from hm_driver.realtime.options import LoopOptions, WatchOptions
from hm_driver.realtime.publisher import Recording
from hm_driver.realtime.segment import PARENT_LOST, STOP_GENTLY, Segment, Trip, Word
from hm_driver.realtime.setpoint import SetPoint
from hm_driver.recording.ring import Ring, ring_bytes
from hm_driver.recording.schemas import EVENTS_CHANNEL, LOOP_BUNDLE

MS = 1_000_000
OPTIONS = LoopOptions(url="tcp://127.0.0.1")


class Bench:
    """A loop on a virtual clock with a device that stands still."""

    def __init__(self, *, combined=True, watch=None, recording=None, law=None, period_ns=MS):
        self.device = StillDevice(combined=combined)
        self.device.state = "force"
        self.clock = VirtualClock()
        self.segment = Segment.in_memory()
        self.core = LoopCore(
            self.device,
            Grid(self.clock, period_ns),
            self.clock,
            self.segment,
            parameters=OPTIONS.parameters(),
            watch=watch or WatchOptions(),
            recording=recording,
            law=law,
        )

    def run(self, cycles):
        """Run at most so many cycles; how many it were, the last one included."""
        for cycle in range(1, cycles + 1):
            if not self.core.run_cycle():
                cycles = cycle
                break
        self.core.finish()
        return cycles

    def engage(self, target_z=0.02):
        self.segment.publish(SetPoint(sequence=1.0, engage_z=1.0, target_z=target_z))
        self.run(300)


def test_a_cycle_asks_for_everything_in_one_request():
    bench = Bench()
    bench.run(3)
    assert bench.device.requests == ["get measpos; get modelvel; get measforce"] * 3


def test_a_link_that_does_not_combine_gets_one_command_a_request():
    bench = Bench(combined=False)
    bench.run(2)
    assert bench.device.requests == ["get measpos", "get modelvel", "get measforce"] * 2
    assert bench.segment.words[Word.EXCHANGES] == 6


def test_the_state_of_the_device_is_asked_50_times_a_second():
    bench = Bench()
    bench.run(1000)
    assert sum("get state" in request for request in bench.device.requests) == 50


def test_the_measurements_are_published_with_the_counts():
    bench = Bench()
    bench.device.vectors |= {"measpos": (0.01, 0.02, 0.03), "measforce": (1.0, 2.0, 3.0)}
    bench.run(5)
    state = bench.segment.state()
    assert (state.cycle, state.time_ns, state.missed) == (5.0, 4 * MS, 0.0)
    assert (state.measured_x, state.measured_y, state.measured_z) == (0.01, 0.02, 0.03)
    assert (state.force_x, state.force_y, state.force_z) == (pytest.approx(1.0, abs=2e-3), 2.0, 3.0)


@pytest.mark.parametrize("combined", [True, False])
def test_an_engaged_spring_is_moved_first_and_enabled_then(combined):
    bench = Bench(combined=combined)
    bench.segment.publish(SetPoint(sequence=1.0, engage_z=1.0, target_z=0.01))
    bench.run(2)
    told = bench.device.told("set spring_z")
    assert [command.split()[2] for command in told] == ["pos", "vel", "maxforce", "enable"]
    assert not bench.device.told("set spring_x")


def test_values_that_do_not_change_are_said_once():
    bench = Bench()
    bench.engage()
    bench.run(2000)
    bench.device.log.clear()
    bench.run(100)
    assert bench.device.log == []


def test_a_set_point_far_away_trips_nothing_and_is_approached_at_the_reference_speed():
    bench = Bench()
    bench.segment.publish(SetPoint(sequence=1.0, engage_z=1.0, target_z=1e6))
    bench.run(1000)
    heights = [float(command.split(",")[-1].rstrip("]")) for command in bench.device.told("set spring_z pos")]
    steps = [b - a for a, b in itertools.pairwise(heights)]
    assert bench.segment.words[Word.TRIP] == Trip.NONE
    assert 0.05 < heights[-1] < 0.1  # no farther ahead of the handle, which stands, than the largest force
    assert max(steps) <= 0.3e-3 + 1e-6


def test_a_spring_that_was_released_is_disabled():
    bench = Bench()
    bench.engage()
    bench.segment.publish(SetPoint(sequence=2.0))
    bench.run(200)
    assert bench.device.log[-1] == "set spring_z disable"
    assert bench.segment.state().engaged_z == 0.0


def test_the_bias_force_is_ramped():
    bench = Bench()
    bench.segment.publish(SetPoint(sequence=1.0, bias_x=2.0))
    bench.run(100)
    forces = [
        float(command.split("[")[1].split(",")[0]) for command in bench.device.told("set feedback force")
    ]
    assert forces[-1] == 2.0
    assert max(b - a for a, b in itertools.pairwise([0.0, *forces])) <= 0.151


def test_a_requested_stop_releases_at_the_rate_of_every_hand_over_and_ends():
    bench = Bench()
    bench.engage()
    force = abs(bench.segment.state().spring_z)
    assert force > 5.0
    bench.segment.words[Word.STOP_REQUESTED] = STOP_GENTLY
    forces = [force]
    while bench.core.run_cycle():
        forces.append(abs(bench.segment.state().spring_z))
    assert max(a - b for a, b in itertools.pairwise(forces)) <= 0.5
    assert len(forces) > 10
    assert bench.segment.trip is Trip.NONE


@pytest.mark.parametrize(
    ("quantity", "value", "trip"),
    [
        ("measpos", (0.5, 0.0, 0.0), Trip.WORKSPACE),
        ("modelvel", (1.0, 0.0, 0.0), Trip.VELOCITY),
        ("measforce", (0.0, 0.0, 200.0), Trip.FORCE),
        ("measforce", (0.0, 0.0, math.nan), Trip.DATA),
    ],
)
def test_a_limit_ramps_down_within_five_milliseconds_once_and_says_why(quantity, value, trip):
    bench = Bench()
    bench.engage()
    bench.device.vectors[quantity] = value
    before_ns = bench.clock.now_ns()
    cycles = bench.run(100)
    assert cycles <= 6
    assert bench.segment.trip is trip
    assert bench.segment.words[Word.TRIP_NS] - before_ns == MS
    assert "[m/s]" in bench.segment.text("trip")
    assert bench.core.forces == (0.0, 0.0, 0.0, 0.0)
    assert float(bench.device.told("set spring_z maxforce")[-1].split()[-1]) <= 30.0 / 4


def test_a_period_longer_than_the_ramp_ends_with_the_cycle_that_trips():
    bench = Bench(period_ns=10 * MS)
    bench.engage()
    bench.device.vectors["measforce"] = (0.0, 0.0, 200.0)
    assert bench.run(10) == 1


def test_the_application_that_falls_silent_trips():
    bench = Bench()
    bench.run(500)
    assert bench.segment.trip is Trip.NONE
    bench.segment.words[Word.APP_HEARTBEAT_NS] = 1
    cycles = bench.run(500)
    assert bench.segment.trip is Trip.HEARTBEAT
    assert 60 <= cycles <= 75


def test_a_stall_of_the_whole_machine_is_not_the_silence_of_the_application():
    bench = Bench(watch=WatchOptions(missed_s=0.0))
    bench.segment.words[Word.APP_HEARTBEAT_NS] = 1
    bench.run(2)
    bench.clock.sleep_until_ns(bench.clock.now_ns() + 500 * MS)
    bench.run(3)
    assert bench.segment.trip is Trip.NONE


def test_the_end_of_the_application_trips():
    bench = Bench()
    bench.run(5)
    bench.segment.words[Word.STOP_REQUESTED] = PARENT_LOST
    bench.run(5)
    assert bench.segment.trip is Trip.PARENT


def test_a_device_that_is_silent_loses_the_link_and_nothing_more_is_sent():
    bench = Bench()
    bench.run(5)
    bench.device.failure = TransportTimeout("no byte within 0.05 s")
    assert bench.run(5) == 1
    assert bench.segment.trip is Trip.LINK
    assert not bench.core.is_link_usable


def test_a_command_that_is_refused_trips_with_command_and_reply():
    bench = Bench()
    bench.device.refused = "set spring_z maxforce"
    bench.engage()
    assert bench.segment.trip is Trip.DEVICE
    assert "set spring_z maxforce" in bench.segment.text("trip")
    assert bench.core.is_link_usable


def test_a_device_that_leaves_the_state_force_trips():
    bench = Bench()
    bench.run(5)
    bench.device.state = "stop"
    bench.run(50)
    assert bench.segment.trip is Trip.DEVICE
    assert "'stop'" in bench.segment.text("trip")


def test_too_many_missed_periods_trip_and_a_few_do_not():
    bench = Bench()
    for stall_ms, tripped in ((30, False), (30, False), (270, True)):
        bench.run(5)
        bench.clock.sleep_until_ns(bench.clock.now_ns() + stall_ms * MS)
        bench.run(20)
        assert (bench.segment.trip is Trip.DEADLINE) is tripped


@pytest.mark.parametrize("field", ["target_z", "engage_x", "bias_y", "sequence"])
def test_a_set_point_that_is_not_finite_trips_and_never_reaches_the_device(field):
    bench = Bench()
    bench.engage()
    bench.segment.publish(bench.segment.set_point()._replace(**{field: math.nan}))
    bench.run(50)
    assert bench.segment.trip is Trip.COMMAND
    assert not [request for request in bench.device.requests if "nan" in request]


def test_measurements_that_never_change_trip():
    bench = Bench(watch=WatchOptions(stale_s=0.1))
    bench.run(200)
    assert bench.segment.trip is Trip.NONE
    bench.device.stale = True
    bench.run(200)
    assert bench.segment.trip is Trip.DEVICE
    assert "stale" in bench.segment.text("trip")


def test_every_cycle_is_recorded_and_so_is_the_trip():
    memory = bytearray(ring_bytes(1 << 18))
    Ring.format(memory)
    bench = Bench(recording=Recording(Ring(memory), 1_000))
    bench.run(5)
    bench.device.vectors["measforce"] = (0.0, 0.0, 200.0)
    cycles = 5 + bench.run(50)
    records = Ring(memory).drain()
    bundles = [record for record in records if record.channel == LOOP_BUNDLE.id]
    events = [record for record in records if record.channel == EVENTS_CHANNEL.id]
    assert len(bundles) == cycles
    assert [record.log_time_ns for record in bundles[:3]] == [1_000, MS + 1_000, 2 * MS + 1_000]
    assert len(events) == 1
    assert b"trip.force" in events[0].payload


def test_statistics_count_every_cycle():
    bench = Bench()
    bench.run(50)
    assert bench.segment.lateness.count == bench.segment.response.count == 50
    words = bench.segment.words
    assert words[Word.CYCLES] + words[Word.MISSED] == words[Word.GRID_LENGTH] == 50


class Pull:
    def step(self, state, command, dt):  # noqa: ARG002  # a law's signature
        return command._replace(engage_z=1.0, target_z=0.01)


class Broken:
    def step(self, state, command, dt):  # noqa: ARG002  # a law's signature
        return (math.nan,) * 14 if state.cycle > 3 else command


def test_a_law_turns_the_command_into_another_one():
    bench = Bench(law=LawRunner(Pull(), name="pull", budget_ns=MS))
    bench.run(50)
    assert bench.segment.state().engaged_z == 1.0


def test_a_law_that_returns_nan_trips():
    bench = Bench(law=LawRunner(Broken(), name="broken", budget_ns=MS))
    bench.run(50)
    assert bench.segment.trip is Trip.LAW


@pytest.mark.parametrize("text", [b"", b"1,2,3", b"1,2,3];[4,5,6];[7,8", b"1,2,3,4];[5,6];[7,8,9x", b"1;2"])
def test_a_malformed_measurement_is_refused(text):
    with pytest.raises(ProtocolError):
        parse_measurement(text)


@pytest.mark.parametrize(
    "reply", [b"[0,0,0];[0,0,0];\n", b"done;[0,0,0];[0,0,0];[0,0,0];\n", b"\n", b"stop;a;b;\n"]
)
def test_a_reply_with_other_parts_than_were_asked_for_trips(reply):
    bench = Bench()
    bench.run(3)
    bench.device.receive_line = lambda: reply  # the device answers this to everything
    bench.run(3)
    assert bench.segment.trip is Trip.DEVICE


def test_bring_up_initialises_a_device_that_is_not_calibrated():
    device = StillDevice()
    device.calibrated = False
    info = bring_up.initialise(device, VirtualClock(), timeout_s=1.0)
    assert not info.was_calibrated
    assert device.log == ["remove all", "set state init"]
    bring_up.enter_session(device, OPTIONS)
    assert device.state == "force"
    assert "set inertia 3" in device.log


def test_bring_up_skips_the_search_of_a_calibrated_device():
    device = StillDevice()
    assert bring_up.initialise(device, VirtualClock(), timeout_s=1.0).was_calibrated
    assert not device.told("set state init")


def test_a_device_that_never_leaves_init_is_a_fault():
    device = StillDevice()
    device.calibrated, device.init_ends = False, False
    with pytest.raises(bring_up.DeviceFault, match=r"1\.0 s"):
        bring_up.initialise(device, VirtualClock(), timeout_s=1.0)


def test_a_pushed_emergency_button_is_a_fault():
    device = StillDevice()
    device.button = True
    with pytest.raises(bring_up.DeviceFault, match="button"):
        bring_up.initialise(device, VirtualClock(), timeout_s=1.0)


def test_a_refused_effect_ends_the_bring_up():
    device = StillDevice()
    device.refused = "create spring"
    with pytest.raises(DeviceError):
        bring_up.enter_session(device, OPTIONS)

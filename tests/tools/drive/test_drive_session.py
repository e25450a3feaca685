import math
import threading
import time
from dataclasses import replace

import pytest

import hm_driver.recording
from hm_driver.errors import ConfigurationError, LoopError, SafetyTrip
from hm_driver.protocol.vocabulary import State
from hm_driver.realtime.claim import DeviceClaim
from hm_driver.realtime.modes import PositionControl
from tools.drive.log import DriveLog
from tools.drive.outcome import CommandRefused, NotArrived
from tools.drive.session import Drive
from tools.drive.trajectory import PathThrough

HAND = {"position": [0.0, 0.0, 0.0], "stiffness": [0.0] * 3, "damping": [20.0] * 3}


def near(expected, *, within=0.002):
    return pytest.approx(expected, abs=within)


def wait_until(holds, timeout_s=10.0):
    deadline = time.monotonic() + timeout_s
    while not holds():
        assert time.monotonic() < deadline
        time.sleep(0.02)


@pytest.fixture
def hand(emulator):
    """A function that pushes the handle with a force [N] until it is called again."""
    with emulator.connect_world() as world:
        ended = threading.Event()
        force = [0.0, 0.0, 0.0]

        def push():
            while not ended.wait(0.005):
                world.exchange(HAND | {"force": list(force)} if any(force) else None)

        thread = threading.Thread(target=push)
        thread.start()
        yield lambda *newtons: force.__setitem__(slice(None), newtons)
        ended.set()
        thread.join()
        world.release()


def test_questions_alone_change_nothing_on_the_device(emulator, options, observer, told):
    observer.set_state(State.OFF)
    with DriveLog(emulator.url, options) as log, Drive(emulator.url, options, log, tell=told.append) as drive:
        assert drive.status().state == "off"
        assert drive.command("get os") == "Linux"
        assert drive.geometry.r_max == 0.19
    assert observer.state is State.OFF


def test_a_goal_out_of_reach_is_refused_before_the_device_is_touched(drive, observer):
    observer.set_state(State.OFF)
    with pytest.raises(ConfigurationError, match=r"goto: .* r = 0\.5 m is outside -0\.19 to 0\.19 m"):
        drive.go("goto", (0.5, 0.0, 0.0), speed=0.1)
    assert not drive.is_driving
    assert observer.state is State.OFF


def test_the_arm_goes_jogs_and_is_left_stopped(emulator, options, observer, told):
    with DriveLog(emulator.url, options) as log, Drive(emulator.url, options, log, tell=told.append) as drive:
        arrival = drive.go("goto", (0.02, 0.03, 0.01), speed=0.2)
        assert arrival.position == near((0.02, 0.03, 0.01))
        assert arrival.tracking.max_m < 0.005
        drive.go("jog", (0.02, 0.03, -0.02), speed=0.2, axes=(2,))
        assert observer.measured_position() == near((0.02, 0.03, -0.02))
        status = drive.status()
        assert (status.state, status.mode) == ("force", "position")
        assert status.target == near((0.02, 0.03, -0.02), within=1e-6)
    assert observer.state is State.STOP


def test_a_motion_stays_below_its_speed_although_a_joint_could_do_more(drive, observer):
    drive.go("goto", (0.0, 0.0, 0.0), speed=0.2)
    fastest = []
    drive.on_progress = lambda: fastest.append(math.hypot(*observer.measured_velocity()))
    drive.go("goto", (0.04, 0.0, 0.0), speed=0.05)
    assert 0.03 < max(fastest) < 0.06


def test_a_released_axis_follows_the_hand_and_a_held_one_does_not(drive, observer, hand):
    drive.go("goto", (0.0, 0.0, 0.0), speed=0.2)
    drive.release((2,))
    assert drive.pilot.engaged == (True, True, False)
    hand(3.0, 3.0, 3.0)
    wait_until(lambda: observer.measured_position()[2] > 0.02)
    hand(0.0, 0.0, 0.0)
    x, y, _ = observer.measured_position()
    assert (x, y) == near((0.0, 0.0))
    assert drive.status().mode == "x:position y:position z:admittance"
    drive.hold()
    wait_until(lambda: abs(observer.measured_velocity()[2]) < 0.002)
    assert drive.status().mode == "position"


def test_an_arm_that_is_held_back_has_not_arrived(drive, hand):
    drive.configure(replace(drive.options, motion=replace(drive.options.motion, settle_time=0.3)))
    drive.go("goto", (0.0, 0.0, 0.0), speed=0.2)
    hand(0.0, 0.0, 35.0)
    with pytest.raises(NotArrived, match=r"mm from its goal and is held; allowed are 3 mm"):
        drive.go("jog", (0.0, 0.0, -0.01), speed=0.2, axes=(2,))
    hand(0.0, 0.0, 0.0)


def test_a_braked_motion_rests_on_its_way_and_is_held_there(drive, observer):
    drive.go("goto", (0.0, 0.0, 0.0), speed=0.2)
    path = PathThrough([0.0, 2.0], [(0.0, 0.0, 0.0), (0.1, 0.0, 0.0)])
    motion = drive.ensure_loop().move(path)
    wait_until(lambda: observer.measured_position()[0] > 0.03)
    drive.pilot.brake()
    assert motion.wait(2.0)
    assert motion.ending.value == "stopped"
    place = drive.pilot.target
    assert 0.03 < place[0] < 0.07
    wait_until(lambda: observer.measured_position() == near(place))


@pytest.mark.parametrize("way", list(PositionControl))
def test_a_trajectory_is_followed_by_both_ways_of_control(drive, way):
    drive.set_control(way)
    drive.go("run", (0.0, 0.0, 0.0), speed=0.2)
    arrival = drive.follow(
        PathThrough([0.0, 0.7, 1.4], [(0.0, 0.0, 0.0), (0.03, 0.02, 0.0), (0.0, 0.0, 0.0)])
    )
    assert arrival.tracking.samples > 30
    assert 0.0 < arrival.tracking.rms_m < 0.003
    enabled = drive.command("get spring_x enabled")
    assert enabled == ("true" if way is PositionControl.SPRING else "false")


def test_in_state_position_the_arm_is_led_and_does_not_answer_to_the_hand(drive, observer, hand):
    drive.enter(State.POSITION)
    assert observer.state is State.POSITION
    drive.go("goto", (0.03, 0.0, 0.0), speed=0.2)
    hand(0.0, 0.0, 20.0)
    time.sleep(0.3)
    assert observer.measured_position() == near((0.03, 0.0, 0.0))
    hand(0.0, 0.0, 0.0)
    with pytest.raises(ConfigurationError, match="'state force' first"):
        drive.release()
    drive.enter(State.FORCE)
    assert observer.state is State.FORCE


def test_the_device_goes_home_and_initialises_by_itself(drive, observer):
    drive.enter(State.INIT)
    assert observer.is_position_calibrated()
    drive.enter(State.HOME)
    assert observer.state is State.STOP
    assert observer.measured_position() == near((0.0, 0.0, 0.0))


def test_effects_and_free_axes_survive_a_new_start_of_the_loop_and_a_stop_disables_them(drive, observer):
    drive.command("create spring guide")
    drive.command("set guide stiffness 100")
    drive.hold()
    drive.command("set guide pos " + "[{:g},{:g},{:g}]".format(*drive.handle))
    drive.command("set guide enable")
    drive.release((2,))
    drive.set_inertia(4.0)
    assert drive.pilot.engaged == (True, True, False)
    assert observer.inertia == 4.0
    assert observer.is_enabled("guide")
    assert observer.parameter("guide", "stiffness") == 100.0
    drive.stop()
    assert observer.state is State.STOP
    assert not observer.is_enabled("guide")
    drive.command("remove guide")


def test_what_would_undermine_the_loop_is_refused_and_the_arm_held_on(drive, observer):
    drive.hold()
    for line in ("set state stop", "remove all", "set spring_x maxforce 1", "set inertia 9"):
        with pytest.raises(ConfigurationError, match="not while the loop drives the arm"):
            drive.command(line)
    assert drive.is_driving
    assert observer.state is State.FORCE


def test_behind_a_stop_the_same_command_is_sent(drive, observer):
    drive.hold()
    drive.stop()
    assert drive.command("set state position") == "state set to 'position'"
    assert observer.state is State.POSITION
    assert drive.command("remove all") == "Removed"


def test_a_refusal_of_the_device_carries_its_explanation(drive):
    drive.command("create spring s1")
    with pytest.raises(CommandRefused) as caught:
        drive.command("set s1 stifness 5")
    assert "did you mean stiffness" in caught.value.__notes__[0]
    drive.command("remove s1")


def test_an_effect_that_would_jump_is_not_enabled(drive, observer):
    drive.command("create spring far")
    drive.command("set far stiffness 10000")
    drive.command("set far pos [0.15,0.1,0.1]")
    with pytest.raises(ConfigurationError, match="would act on the handle at once"):
        drive.command("set far enable")
    assert not observer.is_enabled("far")
    drive.command("remove far")


def test_a_trip_is_told_at_once_and_raised_by_the_next_word(drive, observer):
    failures = []
    drive.on_failure = failures.append
    drive.hold()
    observer.set_state(State.STOP)
    wait_until(lambda: failures)
    assert isinstance(failures[0], SafetyTrip)
    with pytest.raises(SafetyTrip, match="the device left state 'force' for 'stop'"):
        drive.hold()
    drive.hold()
    assert drive.is_driving


def test_a_trip_during_a_motion_ends_it(drive, observer):
    drive.go("goto", (0.0, 0.0, 0.0), speed=0.2)
    threading.Timer(0.4, lambda: observer.set_state(State.STOP)).start()
    with pytest.raises(SafetyTrip):
        drive.go("goto", (0.1, 0.0, 0.0), speed=0.02)
    assert not drive.is_driving


def test_a_device_that_another_loop_drives_is_not_commanded(emulator, drive):
    with DeviceClaim(emulator.url), pytest.raises(LoopError, match=r"another loop .* drives"):
        drive.command("set state stop")
    with DeviceClaim(emulator.url):
        assert drive.command("get state")


def test_a_lost_connection_is_opened_anew(drive, told):
    drive.arm.link.close()
    assert drive.command("get os") == "Linux"
    assert told == ["the connection was lost: connecting again"]


def test_a_recording_holds_what_was_done_and_what_was_typed(drive, tmp_path):
    path = tmp_path / "logs" / "drive.mcap"
    drive.log.start(path)
    drive.log.event("command", "hold")
    drive.hold()
    time.sleep(0.3)
    status = drive.log.finish()
    assert status.lost == 0
    with hm_driver.recording.open(path) as recording:
        assert recording.counts["/device/state"] > 200
        assert recording.counts["/events"] >= 1
        assert recording.metadata["session"]["program"] == "hm drive"
    with pytest.raises(ConfigurationError, match="exists and is not overwritten"):
        drive.log.start(path)
    with pytest.raises(ConfigurationError, match="nothing is being recorded"):
        drive.log.finish()

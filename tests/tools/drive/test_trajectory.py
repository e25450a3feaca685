import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime.modes import LimitOptions
from tools.drive.reach import check_path, check_point, joint_peak
from tools.drive.trajectory import PathThrough, StraightMove

COORDINATE = st.floats(-0.2, 0.2)
POINT = st.tuples(COORDINATE, COORDINATE, COORDINATE)
STEP = 1e-6


@given(POINT, POINT, st.floats(0.005, 0.25), st.floats(0.05, 1.0))
def test_a_move_keeps_speed_and_acceleration_and_rests_at_both_ends(start, goal, speed, acceleration):
    move = StraightMove.within(start, goal, speed=speed, acceleration=acceleration)
    assert move.at(0.0).position == pytest.approx(start)
    assert move.at(move.duration_s).position == goal
    assert move.at(move.duration_s).velocity == (0.0, 0.0, 0.0)
    last = move.at(0.0).velocity
    assert math.hypot(*last) == pytest.approx(0.0, abs=1e-9)
    dt = move.duration_s / 40
    for i in range(1, 41):
        velocity = move.at(i * dt).velocity
        assert math.hypot(*velocity) <= speed * (1 + 1e-9)
        if dt > 1e-5:
            assert math.dist(velocity, last) / dt <= acceleration * (1 + 1e-6)
        last = velocity


def test_a_move_of_no_length_takes_no_time():
    move = StraightMove.within((0.1, 0, 0), (0.1, 0, 0), speed=0.1, acceleration=1.0)
    assert move.duration_s == 0.0
    assert move.at(0.0).position == (0.1, 0, 0)
    assert check_path("goto", move, ArmGeometry()) is None


@st.composite
def paths(draw):
    count = draw(st.integers(2, 6))
    gaps = draw(st.lists(st.floats(0.05, 2.0), min_size=count - 1, max_size=count - 1))
    times = [0.0]
    for gap in gaps:
        times.append(times[-1] + gap)
    return PathThrough(times, draw(st.lists(POINT, min_size=count, max_size=count)))


@given(paths())
def test_a_path_runs_through_its_points_from_rest_to_rest(path):
    for time_s, position in zip(path.times_s, path.positions, strict=True):
        assert path.at(time_s).position == pytest.approx(position, abs=1e-12)
    assert path.at(0.0).velocity == (0.0, 0.0, 0.0)
    assert path.at(path.duration_s).velocity == (0.0, 0.0, 0.0)
    assert path.at(path.duration_s + 1.0).position == path.positions[-1]


@given(paths(), st.floats(0.01, 0.99))
def test_the_velocity_of_a_path_is_the_slope_of_its_position(path, share):
    time_s = share * path.duration_s
    slope = [
        (b - a) / (2 * STEP)
        for a, b in zip(path.at(time_s - STEP).position, path.at(time_s + STEP).position, strict=True)
    ]
    assert path.at(time_s).velocity == pytest.approx(slope, abs=1e-3)


@given(paths())
def test_the_samples_of_a_path_hold_all_its_points(path):
    times = path.sample_times()
    assert set(path.times_s) <= set(times)
    assert all(a < b for a, b in itertools.pairwise(times))


def test_times_that_do_not_rise_make_no_path():
    with pytest.raises(ConfigurationError, match="do not rise"):
        PathThrough([0.0, 0.0], [(0, 0, 0), (0.1, 0, 0)])


@pytest.mark.parametrize(
    ("point", "told"),
    [
        ((0.3, 0.0, 0.0), "r = 0.3 m is outside -0.19 to 0.19 m"),
        ((0.0, 0.0, 0.3), "z = 0.3 m is outside -0.228 to 0.228 m"),
        ((0.0, 0.3, 0.0), "phi = 0.588 rad is outside -0.504 to 0.507 rad"),
        ((math.nan, 0.0, 0.0), "is no position"),
    ],
)
def test_a_point_out_of_reach_is_refused_with_joint_value_and_limit(point, told):
    with pytest.raises(ConfigurationError, match="goto: ") as caught:
        check_point("goto", point, ArmGeometry())
    assert told in str(caught.value)


def test_a_straight_way_too_near_the_column_is_refused_though_both_ends_are_in_reach():
    geometry = ArmGeometry()
    start, goal = (-0.2, -0.12, 0.0), (-0.2, 0.12, 0.0)
    check_point("goto", start, geometry)
    check_point("goto", goal, geometry)
    move = StraightMove.within(start, goal, speed=0.1, acceleration=0.5)
    with pytest.raises(ConfigurationError, match=r"leaves the workspace after .*: r = -0.19.* is outside"):
        check_path("goto", move, geometry)


def test_near_the_column_a_joint_is_what_limits_the_speed():
    move = StraightMove.within((-0.15, -0.05, 0.0), (-0.15, 0.05, 0.0), speed=0.25, acceleration=1.0)
    peak = joint_peak(move, ArmGeometry(), LimitOptions())
    assert peak.joint == "phi"
    assert peak.share > 1.0
    slowed = move.slowed(peak.share)
    assert joint_peak(slowed, ArmGeometry(), LimitOptions()).share == pytest.approx(1.0, abs=1e-6)

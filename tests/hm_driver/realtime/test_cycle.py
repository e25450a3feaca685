"""The cycle function alone: modes, limits and trips, on measurements made up by the test."""

import math
import types

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hm_driver.errors import ConfigurationError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime import cycle as c
from hm_driver.realtime.modes import LimitOptions, ModeOptions, PositionControl, cycle_parameters
from hm_driver.realtime.setpoint import SetPoint

DT = 0.001
MODES, LIMITS, GEOMETRY = ModeOptions(), LimitOptions(), ArmGeometry()
P = cycle_parameters(MODES, LIMITS, GEOMETRY, tick_s=0.01)
BY_FORCE = ModeOptions(position_control=PositionControl.BIAS_FORCE)
P_BY_FORCE = cycle_parameters(BY_FORCE, LIMITS, GEOMETRY, tick_s=0.01)
FORCE_MAX = MODES.position_force_max
RATE = P[c.P_FORCE_RATE]
ASSIST_RATE = P[c.P_ASSIST_RATE]
SPEED_MAX = LIMITS.reference_speed
TINY = 1e-9
HAND_OVERS = settings(max_examples=40, deadline=None)


class Arm:
    """The cycle with a handle that moves as the test says."""

    def __init__(self, position=(0.0, 0.0, 0.0)):
        self.s = [0.0] * c.STATE_SIZE
        self.p = list(P)
        self.u = list(SetPoint())
        self.m = [*position, *[0.0] * 6]
        self.changes = []
        """Of every cycle and spring: phase before, phase, and the change of force by the command."""

    def ask(self, **values):
        self.u = list(SetPoint(sequence=self.u[c.U_SEQUENCE] + 1.0, **values))

    def run(self, *, velocity=(0.0, 0.0, 0.0), force=(0.0, 0.0, 0.0), dt=DT):
        for axis in range(3):
            self.m[axis] += velocity[axis] * dt
        self.m[3:6], self.m[6:9] = velocity, force
        return c.cycle(self.s, self.p, self.u, self.m, dt)

    def run_for(self, cycles, **motion):
        for _ in range(cycles):
            assert self.run(**motion) == c.OK

    def reference(self, spring=2):
        return self.s[spring * c.SPRING_STRIDE + c.REFERENCE]

    def phase(self, spring=2):
        return self.s[spring * c.SPRING_STRIDE + c.PHASE]

    def cap(self, spring=2):
        return self.s[spring * c.SPRING_STRIDE + c.CAP]

    def force(self, spring=2):
        return self.s[c.S_FORCE + spring]

    def forces(self):
        return self.s[c.S_FORCE : c.S_FORCE + c.SPRINGS]


def run_compiled(functions):
    """The cycle, compiled from the very code of the interpreted one."""
    numba = pytest.importorskip("numba")
    scope = {name: value for name, value in vars(c).items() if isinstance(value, (int, float))}
    scope |= {"math": math, "__builtins__": __builtins__}
    for name in functions:
        scope[name] = numba.njit(types.FunctionType(getattr(c, name).__code__, scope, name))
    return scope["cycle"]


@pytest.mark.parametrize("p", [P, P_BY_FORCE], ids=["spring", "bias force"])
def test_the_compiled_cycle_equals_the_interpreted_one_bit_for_bit(p):
    compiled = run_compiled(["clamp", "follow", "step_spring", "step_assist", "check", "cycle"])
    rng = np.random.default_rng(1)
    interpreted_s, compiled_s = [0.0] * c.STATE_SIZE, np.zeros(c.STATE_SIZE)
    u, m, trips = [0.0] * c.SETPOINT_SIZE, [0.0] * c.MEASUREMENT_SIZE, set()
    for k in range(6000):
        if k % 10 == 0:
            u[c.U_SEQUENCE] += 1.0
            if k % 300 == 0:
                u[1:5] = (rng.random(4) < 0.5).astype(float).tolist()
            u[5:14] = [*rng.uniform(-0.1, 0.1, 6), *rng.uniform(-20.0, 20.0, 3)]
        for axis in range(3):
            m[3 + axis] += rng.normal(0.0, 0.04) - m[3 + axis] * 0.01
            m[axis] += m[3 + axis] * DT - m[axis] * DT
        m[6:9] = rng.normal(0.0, 25.0, 3).tolist()
        measured = [math.nan if k % 997 == 996 and i == 4 else value for i, value in enumerate(m)]
        dt = DT if rng.random() < 0.9 else float(rng.uniform(0.5, 4.0)) * DT
        trip = c.cycle(interpreted_s, p, u, measured, dt)
        assert compiled(compiled_s, np.array(p), np.array(u), np.array(measured), dt) == trip
        assert np.array(interpreted_s).tobytes() == compiled_s.tobytes(), f"cycle {k}"
        trips.add(trip)
    assert {c.OK, c.TRIP_DATA, c.TRIP_FORCE} <= trips
    assert interpreted_s[c.S_SATURATED] > 0.0


# Modes


def test_without_engagement_no_spring_acts_and_the_references_follow_the_handle():
    arm = Arm()
    arm.run_for(50, velocity=(0.1, -0.1, 0.05))
    assert arm.forces() == [0.0] * c.SPRINGS
    assert [arm.reference(axis) for axis in range(3)] == arm.m[:3]


@given(st.floats(-0.1, 0.1), st.floats(-0.1, 0.1), st.floats(-0.25, 0.25))
@HAND_OVERS
def test_engaging_starts_with_no_force(position, target, velocity):
    arm = Arm((0.0, 0.0, position))
    arm.run_for(3, velocity=(0.0, 0.0, velocity))
    arm.ask(engage_z=1.0, target_z=target, velocity_z=0.1, assist=1.0)
    arm.run(velocity=(0.0, 0.0, velocity))
    assert abs(arm.force()) <= RATE * DT + TINY
    assert abs(arm.force(c.ASSIST)) <= ASSIST_RATE * DT + TINY
    assert abs(arm.reference() - arm.m[2]) <= SPEED_MAX * DT + TINY


def test_an_engaged_spring_brings_its_reference_to_the_target_and_holds_it():
    arm = Arm()
    arm.ask(engage_z=1.0, target_z=0.02)
    arm.run_for(1500)
    assert arm.reference() == pytest.approx(0.02, abs=1e-6)
    assert arm.phase() == c.POSITION


def test_a_reference_that_is_given_the_velocity_of_its_target_lags_less():
    lags = []
    for carried in (0.0, 0.1):
        arm = Arm()
        for k in range(100):
            arm.ask(engage_z=1.0, target_z=0.001 * (k + 1), velocity_z=carried)
            for _ in range(10):
                arm.run(velocity=(0.0, 0.0, arm.s[2 * c.SPRING_STRIDE + c.VELOCITY]))
                arm.m[2] = arm.reference()
        lags.append(abs(arm.s[c.S_TARGET + 2] - arm.reference()))
    assert lags[1] < 0.001 < lags[0]


def test_the_target_is_interpolated_between_two_set_points():
    arm = Arm()
    arm.ask(engage_z=1.0, target_z=0.01)
    arm.run_for(10)
    assert arm.s[c.S_TARGET + 2] == pytest.approx(0.01)
    arm.ask(engage_z=1.0, target_z=0.02)
    arm.run_for(5)
    assert arm.s[c.S_TARGET + 2] == pytest.approx(0.015)
    arm.run_for(20)
    assert arm.s[c.S_TARGET + 2] == pytest.approx(0.02)


def test_a_target_whose_set_points_stop_coming_stops_too():
    arm = Arm()
    arm.ask(engage_z=1.0, target_z=0.01, velocity_z=0.2)
    for _ in range(3000):
        arm.run()
        arm.m[2] = arm.reference()
    assert arm.reference() == pytest.approx(0.01, abs=1e-4)


@given(st.floats(-0.05, 0.05), st.integers(1, 300), st.floats(-0.1, 0.1))
@HAND_OVERS
def test_releasing_ends_within_the_cap_over_the_rate(target, engaged, velocity):
    arm = Arm()
    arm.ask(engage_z=1.0, target_z=target)
    arm.run_for(engaged)
    cap = arm.cap()
    arm.ask()
    cycles = 0
    while arm.phase() != c.ADMITTANCE:
        arm.run(velocity=(0.0, 0.0, velocity))
        cycles += 1
        assert abs(arm.force()) <= max(0.0, cap - cycles * RATE * DT) + TINY
    assert cycles <= math.ceil(cap / (RATE * DT) + TINY)
    assert arm.force() == 0.0


def test_a_spring_engaged_again_while_it_is_released_goes_on_from_where_it_is():
    arm = Arm()
    arm.ask(engage_z=1.0, target_z=0.02)
    arm.run_for(200)
    arm.ask()
    arm.run_for(5)
    assert arm.phase() == c.RELEASING
    before, cap = arm.reference(), arm.cap()
    arm.ask(engage_z=1.0, target_z=0.02)
    arm.run()
    assert arm.phase() == c.POSITION
    assert abs(arm.reference() - before) <= SPEED_MAX * DT
    assert arm.cap() == pytest.approx(cap + RATE * DT)


# Bumpless

MOTIONS = st.lists(
    st.tuples(
        st.booleans(),  # engage z
        st.booleans(),  # assist
        st.floats(-0.15, 0.15),  # target
        st.floats(-0.5, 0.5),  # its velocity
        st.floats(-15.0, 15.0),  # acceleration of the handle
        st.sampled_from((1.0, 1.0, 1.0, 3.0, 0.4)),  # periods since the cycle before
    ),
    min_size=2,
    max_size=15,
)


def commanded_change(velocity, before, handle, stiffness, damping, dt):
    """The change of a spring's force [N] that its command is to answer for.

    The force K (r - x) + B (v - x') changes by what is commanded and by the handle's own motion. For a handle
    at rest the first is K v dt + B dv; for one that moves at x' it is K (v - x') dt + B dv, as a reference
    that goes with the handle changes nothing. The loop may take any handle between the two.
    """
    at_rest = stiffness * velocity * dt + damping * (velocity - before)
    moving = at_rest - stiffness * handle * dt
    return 0.0 if at_rest * moving <= 0.0 else min(abs(at_rest), abs(moving))


def drive(motions):
    """Run a handle through motions; yields the arm and what a cycle changed, spring by spring."""
    arm, speed = Arm(), 0.0
    for engage, assist, target, target_velocity, acceleration, periods in motions:
        arm.ask(
            engage_x=float(engage), target_x=target, velocity_x=target_velocity,
            engage_z=float(engage), assist=float(assist), target_z=target, velocity_z=target_velocity,
            bias_z=100.0 * target,
        )  # fmt: skip
        for k in range(10):
            dt = DT * (periods if k == 4 else 1.0)
            before = list(arm.s)
            speed = max(-0.25, min(0.25, speed + acceleration * dt - arm.m[2] * dt))
            arm.run(velocity=(0.5 * speed, 0.0, speed), dt=dt)
            yield arm, before, dt


@given(MOTIONS)
@HAND_OVERS
def test_the_command_changes_a_springs_force_no_faster_than_the_rate(motions):
    for arm, before, dt in drive(motions):
        for spring, axis, rate in ((0, 0, RATE), (2, 2, RATE), (c.ASSIST, 2, ASSIST_RATE)):
            at = spring * c.SPRING_STRIDE
            if before[at + c.PHASE] == c.ADMITTANCE or arm.phase(spring) == c.ADMITTANCE:
                continue
            stiffness, damping = P[c.P_SPRING + spring * c.P_STRIDE :][:2]
            change = commanded_change(
                arm.s[at + c.VELOCITY], before[at + c.VELOCITY], arm.m[3 + axis], stiffness, damping, dt
            )
            assert change <= rate * dt + TINY


@given(MOTIONS)
@HAND_OVERS
def test_a_cap_opens_no_faster_than_the_rate_and_bounds_the_force(motions):
    for arm, before, dt in drive(motions):
        for spring in range(c.SPRINGS):
            rate, limit = (ASSIST_RATE, MODES.assist_force_max) if spring == c.ASSIST else (RATE, FORCE_MAX)
            cap_before = before[spring * c.SPRING_STRIDE + c.CAP]
            if before[spring * c.SPRING_STRIDE + c.PHASE] == c.ADMITTANCE:
                cap_before = 0.0
            assert arm.cap(spring) <= min(cap_before + rate * dt, limit) + TINY
            assert abs(arm.force(spring)) <= arm.cap(spring) + TINY


@given(MOTIONS, st.floats(-0.1, 0.1))
@HAND_OVERS
def test_with_the_handle_at_rest_the_commanded_force_itself_keeps_the_rate(motions, position):
    arm = Arm((0.0, 0.0, position))
    for engage, assist, target, target_velocity, _, periods in motions:
        arm.ask(engage_z=float(engage), assist=float(assist), target_z=target, velocity_z=target_velocity)
        for k in range(10):
            dt = DT * (periods if k == 4 else 1.0)
            spring, assistance = arm.force(), arm.force(c.ASSIST)
            assert arm.run(dt=dt) == c.OK
            total = arm.force() + arm.force(c.ASSIST)
            assert abs(arm.force() - spring) <= RATE * dt + TINY
            assert abs(total - spring - assistance) <= LIMITS.force_rate * dt + TINY
            assert abs(arm.force()) <= FORCE_MAX


@given(MOTIONS)
@HAND_OVERS
def test_spring_and_assist_that_take_turns_never_exceed_the_largest_force_together(motions):
    arm, speed = Arm(), 0.0
    for engage, _, target, target_velocity, acceleration, _ in motions:
        arm.ask(engage_z=float(engage), assist=float(not engage), target_z=target, velocity_z=target_velocity)
        for _ in range(40):
            speed = max(-0.2, min(0.2, speed + acceleration * DT - arm.m[2] * DT))
            arm.run(velocity=(0.0, 0.0, speed))
            assert abs(arm.force()) + abs(arm.force(c.ASSIST)) <= FORCE_MAX + TINY


@given(MOTIONS)
@HAND_OVERS
def test_a_reference_never_moves_faster_than_its_limit(motions):
    for arm, before, dt in drive(motions):
        for spring in (0, 2, c.ASSIST):
            at = spring * c.SPRING_STRIDE
            if arm.phase(spring) == c.ADMITTANCE or before[at + c.PHASE] == c.ADMITTANCE:
                continue
            assert abs(arm.reference(spring) - before[at + c.REFERENCE]) <= SPEED_MAX * dt + TINY
            assert abs(arm.s[at + c.VELOCITY]) <= SPEED_MAX


@given(MOTIONS)
@HAND_OVERS
def test_the_bias_force_is_ramped_and_limited(motions):
    for arm, before, dt in drive(motions):
        for axis in range(3):
            bias = arm.s[c.S_BIAS + axis]
            assert abs(bias - before[c.S_BIAS + axis]) <= LIMITS.bias_rate * dt + TINY
            assert abs(bias) <= LIMITS.bias_max


def test_a_cycle_after_missed_periods_moves_by_what_they_allow_and_no_more():
    for periods in (1, 5, 50):
        arm = Arm()
        arm.ask(engage_z=1.0, target_z=0.1, velocity_z=0.3)
        arm.run_for(100)
        before, force = arm.reference(), arm.force()
        arm.run(dt=periods * DT)
        assert abs(arm.reference() - before) <= SPEED_MAX * periods * DT + TINY
        assert abs(arm.force() - force) <= min(RATE * periods * DT, 2.0 * FORCE_MAX) + TINY


# Bias-force PD


@given(MOTIONS)
@HAND_OVERS
def test_the_bias_force_is_what_the_springs_of_the_other_way_would_pull_with(motions):
    springs, ours, speed = Arm(), Arm(), 0.0
    ours.p = list(P_BY_FORCE)
    for engage, assist, target, target_velocity, acceleration, periods in motions:
        for arm in (springs, ours):
            arm.ask(
                engage_z=float(engage), assist=float(assist), target_z=target, velocity_z=target_velocity,
                bias_z=100.0 * target,
            )  # fmt: skip
        for k in range(10):
            dt = DT * (periods if k == 4 else 1.0)
            speed = max(-0.25, min(0.25, speed + acceleration * dt - ours.m[2] * dt))
            for arm in (springs, ours):
                arm.run(velocity=(0.0, 0.0, speed), dt=dt)
            assert ours.s[: c.S_PUSH] == springs.s[: c.S_PUSH]
            assert springs.s[c.S_PUSH :] == springs.s[c.S_BIAS : c.S_BIAS + 3]
            assert ours.s[c.S_PUSH + 2] == ours.s[c.S_BIAS + 2] + ours.force()


def test_the_bias_force_follows_the_pd_law_and_its_largest_force():
    arm = Arm()
    arm.p = list(P_BY_FORCE)
    arm.ask(engage_z=1.0, target_z=0.002)
    arm.run_for(1000)
    kd = MODES.damping(MODES.position_stiffness, MODES.position_damping_ratio)
    arm.run(velocity=(0.0, 0.0, 0.01))
    expected = MODES.position_stiffness * (0.002 - arm.m[2]) - kd * 0.01
    assert arm.s[c.S_PUSH + 2] == pytest.approx(expected, rel=1e-3)
    arm.m[2] = -0.1
    arm.run()
    assert arm.s[c.S_PUSH + 2] == FORCE_MAX


@given(MOTIONS, st.floats(-0.1, 0.1))
@HAND_OVERS
def test_a_bias_force_that_is_switched_with_the_handle_at_rest_keeps_the_rate(motions, position):
    arm = Arm((0.0, 0.0, position))
    arm.p = list(P_BY_FORCE)
    for engage, _, target, target_velocity, _, periods in motions:
        arm.ask(engage_z=float(engage), target_z=target, velocity_z=target_velocity)
        for k in range(10):
            dt = DT * (periods if k == 4 else 1.0)
            before = arm.s[c.S_PUSH + 2]
            arm.run(dt=dt)
            assert abs(arm.s[c.S_PUSH + 2] - before) <= LIMITS.force_rate * dt + TINY


# Assist


def test_the_assist_helps_to_hold_the_hands_own_height():
    arm = Arm()
    arm.ask(assist=1.0)
    arm.run_for(200)
    assert arm.force(c.ASSIST) == 0.0
    arm.run_for(50, velocity=(0.0, 0.0, -0.1))
    assert arm.force(c.ASSIST) > 0.5


def test_the_assist_follows_the_hand_with_its_time_constant():
    arm = Arm()
    arm.ask(assist=1.0)
    arm.run_for(50)
    arm.m[2] = 0.01
    arm.run_for(round(MODES.assist_time / DT))
    assert 0.01 - arm.reference(c.ASSIST) == pytest.approx(0.01 * math.exp(-1.0), rel=0.05)
    arm.run_for(3000)
    assert arm.force(c.ASSIST) == pytest.approx(0.0, abs=0.01)


@given(MOTIONS)
@HAND_OVERS
def test_the_assist_never_depends_on_what_the_task_or_the_skill_wants(motions):
    """The loop is given no stiffness, depth or force of the task; nor does the target reach the assist."""
    arms, speed = (Arm(), Arm()), 0.0
    for engage, assist, target, target_velocity, acceleration, _ in motions:
        arms[0].ask(assist=float(assist))
        arms[1].ask(
            assist=float(assist),
            engage_z=float(engage),
            target_z=target,
            velocity_z=target_velocity,
            bias_z=9.0,
        )
        for _ in range(10):
            speed = max(-0.25, min(0.25, speed + acceleration * DT))
            for arm in arms:
                arm.run(velocity=(0.0, 0.0, speed))
            assert arms[0].force(c.ASSIST) == arms[1].force(c.ASSIST)


# Checks


def at_joints(r=0.0, phi=0.0, z=0.0):
    radius = GEOMETRY.r0 + r
    return radius * math.cos(phi) - GEOMETRY.r0, radius * math.sin(phi), z


@pytest.mark.parametrize(
    ("inside", "outside"),
    [
        (at_joints(r=0.194), at_joints(r=0.196)),
        (at_joints(r=-0.194), at_joints(r=-0.196)),
        (at_joints(phi=0.511), at_joints(phi=0.513)),
        (at_joints(phi=-0.508), at_joints(phi=-0.51)),
        (at_joints(z=0.232), at_joints(z=0.234)),
        (at_joints(z=-0.232), at_joints(z=-0.234)),
    ],
)
def test_a_joint_beyond_its_end_stop_and_the_margin_trips(inside, outside):
    assert Arm(inside).run() == c.OK
    assert Arm(outside).run() == c.TRIP_WORKSPACE


def test_each_joint_has_a_velocity_limit_of_its_own():
    phi = 0.4
    along, around = (math.cos(phi), math.sin(phi)), (-math.sin(phi), math.cos(phi))
    radius = GEOMETRY.r0 + 0.1
    for (x, y), z, limit in (
        (along, 0.0, LIMITS.velocity_r),
        (around, 0.0, LIMITS.velocity_phi * radius),
        ((0.0, 0.0), 1.0, LIMITS.velocity_z),
    ):
        for share, saturated, trip in (
            (0.97, 0.0, c.OK),
            (0.99, 1.0, c.OK),
            (LIMITS.velocity_trip - 0.01, 1.0, c.OK),
            (LIMITS.velocity_trip + 0.01, 0.0, c.TRIP_VELOCITY),
        ):
            arm = Arm(at_joints(r=0.1, phi=phi))
            speed = share * limit
            arm.m[3:6] = [speed * x, speed * y, speed * z]
            assert c.cycle(arm.s, arm.p, arm.u, arm.m, DT) == trip
            assert arm.s[c.S_SATURATED] == saturated


def test_the_hands_force_trips_by_its_magnitude():
    share = LIMITS.force_trip / math.sqrt(3.0)
    assert Arm().run(force=(share * 0.999,) * 3) == c.OK
    assert Arm().run(force=(share * 1.001,) * 3) == c.TRIP_FORCE


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("index", range(c.MEASUREMENT_SIZE))
def test_a_number_that_is_not_finite_trips_and_changes_nothing(bad, index):
    arm = Arm()
    arm.ask(engage_z=1.0, target_z=0.05, assist=1.0)
    arm.run_for(20)
    before = list(arm.s)
    arm.m[index] = bad
    assert c.cycle(arm.s, arm.p, arm.u, arm.m, DT) == c.TRIP_DATA
    assert arm.s == before


def test_a_trip_of_a_limit_still_moves_the_springs_so_that_they_can_be_released():
    arm = Arm()
    arm.ask(engage_z=1.0, target_z=0.05)
    arm.run_for(100)
    arm.ask()
    for _ in range(100):
        assert arm.run(force=(0.0, 0.0, 200.0)) == c.TRIP_FORCE
    assert arm.forces() == [0.0] * c.SPRINGS
    assert arm.phase() == c.ADMITTANCE


# Options


@pytest.mark.parametrize(
    ("options", "name", "value"),
    [
        (ModeOptions, "position_stiffness", 0.0),
        (ModeOptions, "position_force_max", math.inf),
        (ModeOptions, "assist_stiffness", 100_001.0),
        (ModeOptions, "follow_time", math.nan),
        (ModeOptions, "inertia", 1.9),
        (ModeOptions, "inertia", math.nan),
        (ModeOptions, "coulomb_friction", -0.1),
        (LimitOptions, "force_rate", -1.0),
        (LimitOptions, "reference_speed", 0.0),
        (LimitOptions, "velocity_phi", math.nan),
        (LimitOptions, "velocity_trip", 1.0),
        (LimitOptions, "bias_max", -1.0),
        (LimitOptions, "bias_max", math.inf),
        (LimitOptions, "workspace_margin", math.nan),
    ],
)
def test_a_value_out_of_range_names_its_field(options, name, value):
    with pytest.raises(ConfigurationError) as caught:
        options(**{name: value})
    assert caught.value.field == name


@pytest.mark.parametrize(("rate_hz", "stiffness", "ratio"), [(100.0, 5000.0, 1.0), (1000.0, 5000.0, 0.01)])
def test_gains_that_a_rate_cannot_render_by_a_bias_force_are_refused(rate_hz, stiffness, ratio):
    gains = {"position_stiffness": stiffness, "position_damping_ratio": ratio}
    ModeOptions(**gains).check_rate(rate_hz)
    with pytest.raises(ConfigurationError, match=f"{stiffness:g} N/m .* at {rate_hz:g} Hz"):
        ModeOptions(position_control=PositionControl.BIAS_FORCE, **gains).check_rate(rate_hz)


def test_the_springs_of_one_axis_share_the_force_rate():
    assert RATE + ASSIST_RATE == pytest.approx(LIMITS.force_rate)


def test_the_parameters_hold_the_device_s_damping():
    damping = P[c.P_SPRING + 2 * c.P_STRIDE + c.DAMPING]
    assert damping == pytest.approx(2.0 * math.sqrt(MODES.position_stiffness * MODES.inertia))

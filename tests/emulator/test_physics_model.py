"""The virtual mass and its effects against closed forms and scipy's solve_ivp."""

import math

import numpy as np
import pytest
from arm_bench import STEP_S, add_effect, push, quiet_arm, run, throw
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from emulator import layout
from emulator.arm_model import ArmModel
from emulator.effect_table import EffectKind
from emulator.parameters import load_parameters
from hm_driver.geometry import cartesian_to_joint, joint_to_cartesian


def free_oscillation(stiffness, inertia, damping_ratio, steps, start=0.02):
    """z of the virtual mass on a spring, released `start` metres away, in state position."""
    arm = quiet_arm(inertia=inertia, force_sensor=False)
    add_effect(arm, EffectKind.SPRING, stiffness=stiffness, dampfactor=damping_ratio, pos=(0.0, 0.0, start))
    return start - run(arm, steps)[:, 2]


@pytest.mark.parametrize("force", [(4.0, 0.0, 0.0), (0.0, -3.0, 4.0)])
def test_a_constant_force_moves_the_free_mass_by_newtons_law(force):
    arm = quiet_arm(inertia=3.0)
    push(arm, force)
    path = run(arm, 1250)
    time = np.arange(1, 1251) * STEP_S
    expected = 0.5 * np.outer(time * time, force) / 3.0
    late = time > 0.2
    within = arm.parameters.geometry.violation(*expected[-1]) is None
    assert within
    error = np.linalg.norm(path - expected, axis=1) / np.linalg.norm(expected, axis=1)
    assert error[late].max() < 0.01


@pytest.mark.parametrize(("stiffness", "inertia"), [(20.0, 8.0), (300.0, 3.0), (5000.0, 3.0), (20000.0, 2.0)])
def test_a_mass_on_a_spring_oscillates_at_its_natural_frequency(stiffness, inertia):
    omega = math.sqrt(stiffness / inertia)
    steps = min(int(20 * math.pi / omega / STEP_S), 20000)
    z = free_oscillation(stiffness, inertia, 0.0, steps)
    crossings = np.flatnonzero(np.signbit(z[1:]) != np.signbit(z[:-1]))
    times = crossings + z[crossings] / (z[crossings] - z[crossings + 1])
    measured = math.pi * (len(times) - 1) / ((times[-1] - times[0]) * STEP_S)
    assert measured == pytest.approx(omega, rel=0.005)


@pytest.mark.parametrize("damping_ratio", [0.02, 0.1, 0.3])
@pytest.mark.parametrize(("stiffness", "inertia"), [(300.0, 3.0), (20000.0, 2.0)])
def test_the_damp_factor_is_the_damping_ratio_on_the_virtual_mass(stiffness, inertia, damping_ratio):
    z = free_oscillation(stiffness, inertia, damping_ratio, 4000)
    inner = np.flatnonzero((np.abs(z[1:-1]) >= np.abs(z[:-2])) & (np.abs(z[1:-1]) > np.abs(z[2:]))) + 1
    peaks = np.abs(z[inner])
    peaks = peaks[peaks > 1e-5]
    decrement = math.log(peaks[0] / peaks[-1]) / (len(peaks) - 1)
    assert decrement / math.hypot(decrement, math.pi) == pytest.approx(damping_ratio, rel=0.02)


@pytest.mark.parametrize("damping_ratio", [0.2, 1.0, 4.0])
def test_a_spring_with_limit_dead_band_and_bias_follows_an_independent_solution(damping_ratio):
    k, m, band, limit, bias = 800.0, 2.5, 0.004, 9.0, 1.5
    b = 2.0 * damping_ratio * math.sqrt(k * m)

    def law(_, s):
        over = max(abs(s[0] - 0.03) - band, 0.0)
        force = 0.0
        if over > 0.0:
            force = -k * math.copysign(over, s[0] - 0.03) - b * s[1]
        return [s[1], (max(-limit, min(limit, force)) + bias) / m]

    arm = quiet_arm(inertia=m, force_sensor=False)
    add_effect(
        arm, EffectKind.SPRING, stiffness=k, dampfactor=damping_ratio, deadband=band, maxforce=limit,
        direction=(0.0, 0.0, 1.0), pos=(0.0, 0.0, 0.03),
    )  # fmt: skip
    add_effect(arm, EffectKind.BIAS_FORCE, force=(0.0, 0.0, bias))
    z = run(arm, 1500)[:, 2]
    times = np.arange(1, 1501) * STEP_S
    exact = solve_ivp(law, (0.0, times[-1]), [0.0, 0.0], t_eval=times, max_step=1e-4, rtol=1e-8)
    assert np.abs(z - exact.y[0]).max() < 0.01 * np.abs(exact.y[0]).max()


def test_a_damper_slows_each_axis_by_its_own_coefficient():
    arm = quiet_arm(inertia=2.0, force_sensor=False)
    add_effect(arm, EffectKind.DAMPER, dampcoef=(10.0, 40.0, 0.0))
    throw(arm, (0.2, 0.2, 0.2))
    velocity = run(arm, 250, layout.O_MODEL_VELOCITY)
    time = 250 * STEP_S
    assert velocity[-1] == pytest.approx(0.2 * np.exp(-np.array([5.0, 20.0, 0.0]) * time), rel=1e-3)


def test_a_spring_without_direction_pulls_in_all_three_and_with_one_along_it_alone():
    for direction, expected in (((0.0, 0.0, 0.0), (-1.0, -2.0, 3.0)), ((0.0, 1.0, 0.0), (0.0, -2.0, 0.0))):
        arm = quiet_arm(force_sensor=False)
        add_effect(arm, EffectKind.SPRING, stiffness=100.0, pos=(-0.01, -0.02, 0.03), direction=direction)
        arm.step(1)
        assert arm.truth().effect_force == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("everywhere", "expected"), [(0.0, 0.0), (1.0, -2.0 * math.sqrt(300.0) * 0.1)])
def test_damping_acts_within_the_dead_band_only_where_it_is_global(everywhere, expected):
    arm = quiet_arm(force_sensor=False)
    add_effect(arm, EffectKind.SPRING, stiffness=100.0, dampfactor=1.0, deadband=0.05, dampglobal=everywhere)
    throw(arm, (0.0, 0.1, 0.0))
    arm.step(1)
    assert arm.truth().effect_force[1] == pytest.approx(expected, rel=1e-6)


def test_the_velocity_of_a_moving_spring_counts_against_its_damping():
    arm = quiet_arm(force_sensor=False)
    add_effect(arm, EffectKind.SPRING, stiffness=300.0, dampfactor=1.0, vel=(0.0, 0.0, 0.1))
    arm.step(1)
    assert arm.truth().effect_force[2] == pytest.approx(2.0 * math.sqrt(300.0 * 3.0) * 0.1)


def test_the_shaker_keeps_to_its_largest_position_speed_and_acceleration():
    arm = quiet_arm(inertia=2.0, force_sensor=False)
    add_effect(
        arm, EffectKind.SHAKER, stiffness=80000.0, dampfactor=1.0, frequency1=0.5, frequency2=6.0,
        posmax=0.01, velmax=0.1, accmax=1.5, direction=(0.0, 0.0, 1.0),
    )  # fmt: skip
    z = run(arm, 30000)[:, 2]
    assert np.abs(z).max() == pytest.approx(0.01, rel=0.02)
    assert np.abs(np.diff(z)).max() / STEP_S == pytest.approx(0.1, rel=0.05)
    assert np.abs(np.diff(z, 2)).max() / STEP_S**2 == pytest.approx(1.5, rel=0.1)


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.6, 0.0, 0.8)])
def test_dry_friction_holds_below_its_threshold_and_yields_above(direction):
    friction = 2.0
    for share, moves in ((0.99, False), (1.01, True)):
        arm = quiet_arm(friction=friction)
        push(arm, tuple(share * friction * u for u in direction))
        path = run(arm, 1000)
        assert bool(np.linalg.norm(path[-1]) > 1e-6) is moves
        if not moves:
            assert np.all(path == path[0])


def test_dry_friction_brakes_a_sliding_mass_by_its_force_and_then_holds_it_still():
    arm = quiet_arm(inertia=2.0, friction=1.0, force_sensor=False)
    throw(arm, (0.0, 0.0, 0.1))
    velocity = run(arm, 1000, layout.O_MODEL_VELOCITY)[:, 2]
    assert velocity[249] == pytest.approx(0.1 - 0.5 * 0.1, rel=1e-6)
    assert np.all(velocity[501:] == 0.0)


def test_velocity_limits_hold_for_each_joint_and_are_counted():
    arm = quiet_arm(velocity_max=(0.05, 0.1, 0.03))
    push(arm, (30.0, 20.0, 25.0))
    joint_velocity = run(arm, 400, layout.O_MODEL_JOINT_VELOCITY)
    assert np.abs(joint_velocity).max(axis=0) == pytest.approx([0.05, 0.1, 0.03], rel=1e-3)
    assert arm.outputs[layout.O_VELOCITY_LIMITED] == 1.0
    assert arm.outputs[layout.O_LIMITED_STEPS] > 300


def test_the_acceleration_limit_holds():
    arm = quiet_arm(acceleration_max=5.0)
    add_effect(arm, EffectKind.BIAS_FORCE, force=(0.0, 0.0, 60.0))
    arm.step(10)
    assert arm.output(layout.O_MODEL_ACCELERATION)[2] == pytest.approx(5.0)
    assert arm.outputs[layout.O_ACCELERATION_LIMITED] == 1.0


@pytest.mark.parametrize("direction", [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
def test_soft_end_stops_hold_the_arm_inside_its_workspace(direction):
    arm = quiet_arm(inertia=2.0)
    push(arm, tuple(60.0 * u for u in direction))
    path = run(arm, 2500)
    joints = arm.outputs[layout.O_MODEL_JOINT : layout.O_MODEL_JOINT + 3]
    assert np.all(joints >= arm.parameters.joint_min)
    assert np.all(joints <= arm.parameters.joint_max)
    assert arm.outputs[layout.O_AT_END_STOP] == 1.0
    assert np.abs(path[-1] - path[-200]).max() < 2e-3


@settings(max_examples=200, deadline=None)
@given(st.floats(-0.19, 0.19), st.floats(-0.504, 0.507), st.floats(-0.228, 0.228), st.floats(0.3, 1.0))
def test_the_kinematics_lead_there_and_back(r, phi, z, r0):
    place = joint_to_cartesian(r, phi, z, r0)
    again = joint_to_cartesian(*cartesian_to_joint(*place, r0), r0)
    assert again == pytest.approx(place, abs=1e-12)


def test_the_workspace_has_79_litres():
    geometry = load_parameters().geometry
    rng = np.random.default_rng(1)
    low, high = np.array([-0.3, -0.4, -0.3]), np.array([0.3, 0.4, 0.3])
    points = rng.uniform(low, high, (40000, 3))
    share = np.mean([geometry.violation(*point) is None for point in points])
    assert geometry.volume() == pytest.approx(0.079, rel=0.02)
    assert share * np.prod(high - low) == pytest.approx(geometry.volume(), rel=0.02)


def test_the_set_points_of_the_joints_are_consistent_with_the_cartesian_ones():
    arm = quiet_arm(inertia=2.0)
    push(arm, (6.0, 9.0, -5.0))
    arm.step(300)
    joint = run(arm, 3, layout.O_MODEL_JOINT)
    place = joint_to_cartesian(*joint[-1], arm.parameters.r0)
    assert arm.output(layout.O_MODEL_POSITION) == pytest.approx(place, abs=1e-12)
    rate = arm.outputs[layout.O_MODEL_JOINT_VELOCITY : layout.O_MODEL_JOINT_VELOCITY + 3]
    assert rate == pytest.approx((joint[2] - joint[1]) / STEP_S, rel=5e-3)
    acceleration = arm.outputs[layout.O_MODEL_JOINT_ACCELERATION : layout.O_MODEL_JOINT_ACCELERATION + 3]
    assert acceleration == pytest.approx(np.diff(joint, 2, axis=0)[0] / STEP_S**2, rel=0.03)


def busy_arm(seed, *, compiled=True):
    arm = ArmModel(load_parameters(), seed=seed, compiled=compiled)
    arm.set_render(powered=True, effects=True, force_sensor=True)
    for kind in EffectKind:
        add_effect(arm, kind)
        arm.effects.set(0, "stiffness", 400.0)
    for slot in range(9):
        arm.effects.set(slot, "stiffness", 300.0 + 100.0 * slot)
        arm.effects.set(slot, "dampfactor", 0.3)
        arm.effects.set(slot, "friction", 0.2)
    arm.effects.set(3, "frequency1", 3.0)
    arm.effects.set(3, "posmax", 0.01)
    arm.set_hand((0.02, -0.03, 0.05), (0.1, 0.0, 0.0), (500.0,) * 3, (30.0,) * 3, (1.0, 0.0, 0.0))
    return arm


def test_one_seed_gives_the_same_run_to_the_last_bit_and_another_seed_another():
    arms = [busy_arm(seed) for seed in (5, 5, 6)]
    for arm in arms:
        arm.step(700)
        arm.calibrate_force_sensor()
        arm.step(700)
    assert np.array_equal(arms[0].state, arms[1].state)
    assert not np.array_equal(arms[0].state, arms[2].state)


def test_many_steps_in_one_call_equal_single_steps():
    first, second = busy_arm(5), busy_arm(5)
    first.step(300)
    for _ in range(300):
        second.step(1)
    assert np.array_equal(first.state, second.state)
    assert np.array_equal(first.outputs, second.outputs)


def test_plain_python_gives_the_same_numbers_as_the_machine_code():
    compiled, plain = busy_arm(5), busy_arm(5, compiled=False)
    for arm in (compiled, plain):
        arm.step(250)
        arm.release_hand()
        arm.step(100)
    assert np.array_equal(compiled.state, plain.state)
    assert np.array_equal(compiled.outputs, plain.outputs)
    assert np.array_equal(compiled.effects.flat, plain.effects.flat)

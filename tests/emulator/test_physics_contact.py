"""Shapes: static penetration, friction, limits, passivity, Z-width."""

import math

import numpy as np
import pytest
from arm_bench import add_effect, push, quiet_arm, run, speed, throw
from hypothesis import given, settings
from hypothesis import strategies as st

from emulator import layout
from emulator.effect_table import EffectKind

LYING = (math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5))
TURNED = (0.0, 0.0, math.sin(0.2), math.cos(0.2))
SHAPES = {
    "block": (EffectKind.BLOCK, {"pos": (0.0, 0.0, -0.051), "size": (0.2, 0.2, 0.1), "att": TURNED}),
    "sphere": (EffectKind.SPHERE, {"pos": (0.0, 0.0, -0.041), "radius": 0.04}),
    "flat plane": (EffectKind.FLAT_PLANE, {"pos": (0.0, 0.0, -0.001), "normal": (0.0, 0.0, 1.0)}),
    "cylinder's end": (EffectKind.CYLINDER, {"pos": (0.0, 0.0, -0.051), "radius": 0.1, "length": 0.1}),
    "cylinder's side": (
        EffectKind.CYLINDER,
        {"pos": (0.0, 0.0, -0.041), "radius": 0.04, "length": 0.3, "att": LYING},
    ),
    "torus": (
        EffectKind.TORUS,
        {"pos": (0.06, 0.0, -0.021), "ringradius": 0.06, "tuberadius": 0.02},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("stiffness", [500.0, 5000.0, 80000.0])
def test_the_static_penetration_into_a_shape_is_force_over_stiffness(name, stiffness):
    kind, parameters = SHAPES[name]
    arm = quiet_arm(inertia=3.0)
    # Across, a spring keeps the mass on top of round shapes.
    add_effect(arm, EffectKind.DAMPER, dampcoef=(200.0, 200.0, 0.0))
    for direction in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)):
        add_effect(arm, EffectKind.SPRING, stiffness=20000.0, dampfactor=1.0, direction=direction)
    add_effect(arm, kind, stiffness=stiffness, dampfactor=1.0, **parameters)
    push(arm, (0.0, 0.0, -4.0))
    arm.step(5000)
    depth = -0.001 - arm.output(layout.O_MODEL_POSITION)[2]
    assert depth == pytest.approx(4.0 / stiffness, rel=0.01)
    assert arm.truth().contact_force[2] == pytest.approx(4.0, rel=1e-3)


@pytest.mark.parametrize("mu", [0.1, 0.6])
def test_a_frictional_plane_holds_below_mu_times_the_normal_force_and_slides_above(mu):
    for share, slides in ((0.97, False), (1.03, True)):
        arm = quiet_arm(inertia=3.0)
        add_effect(
            arm, EffectKind.FLAT_PLANE, pos=(0.0, 0.0, 0.0), stiffness=5000.0, dampfactor=1.0, friction=mu
        )
        push(arm, (0.0, 0.0, -10.0))
        arm.step(2000)
        push(arm, (0.0, share * mu * 10.0, -10.0))
        y = run(arm, 1000)[:, 1]
        assert bool(abs(y[-1] - y[0]) > 1e-5) is slides


def bounce(kind, parameters, velocity, inertia, *, steps=600, **quantities):
    """Highest and last kinetic energy of a mass that flies into a shape, relative to the first."""
    arm = quiet_arm(inertia=inertia, force_sensor=False)
    add_effect(arm, kind, **parameters, **quantities)
    throw(arm, velocity)
    speeds = []
    for _ in range(steps):
        arm.step(1)
        if arm.outputs[layout.O_AT_END_STOP]:
            break
        speeds.append(speed(arm))
    first = math.hypot(*velocity)
    return (max(speeds) / first) ** 2, (speeds[-1] / first) ** 2


@settings(max_examples=80, deadline=None)
@given(
    name=st.sampled_from(sorted(SHAPES)),
    stiffness=st.floats(100.0, 80000.0),
    inertia=st.floats(2.0, 8.0),
    damping=st.floats(0.0, 2.0),
    inwards=st.floats(0.01, 0.8),
    sideways=st.floats(-0.3, 0.3),
    friction=st.sampled_from([0.0, 0.3]),
    no_pull=st.booleans(),
)
def test_contact_gives_back_no_more_energy_than_it_got(
    name, stiffness, inertia, damping, inwards, sideways, friction, no_pull
):
    kind, parameters = SHAPES[name]
    highest, last = bounce(
        kind, parameters, (0.0, sideways, -inwards), inertia,
        stiffness=stiffness, dampfactor=damping, friction=friction, no_pull=float(no_pull),
    )  # fmt: skip
    allowed = 1.0 + 2.0 * stiffness / inertia / 2500.0**2
    assert highest <= allowed
    assert last <= allowed


@settings(max_examples=40, deadline=None)
@given(stiffness=st.floats(500.0, 80000.0), inertia=st.floats(2.0, 8.0), gap=st.floats(0.0, 4e-4))
def test_an_elastic_bounce_keeps_the_energy_wherever_in_a_step_the_surface_is_met(stiffness, inertia, gap):
    parameters = {"pos": (0.0, 0.0, -0.001 - gap)}
    _, last = bounce(
        EffectKind.FLAT_PLANE, parameters, (0.0, 0.0, -0.5), inertia, stiffness=stiffness, steps=1200
    )
    assert last == pytest.approx(1.0, abs=1e-9 + 2.0 * (stiffness / inertia) / 2500.0**2)


def fast_exit(**limits):
    """Largest outward speed, force and power after the mass was put 2 cm deep into a stiff plane."""
    arm = quiet_arm(inertia=2.0, force_sensor=False)
    add_effect(arm, EffectKind.FLAT_PLANE, pos=(0.0, 0.0, 0.02), stiffness=4000.0, **limits)
    fastest, force, power = 0.0, 0.0, 0.0
    for _ in range(200):
        before = arm.output(layout.O_MODEL_VELOCITY)[2]
        arm.step(1)
        contact = arm.truth().contact_force[2]
        fastest, force = max(fastest, arm.output(layout.O_MODEL_VELOCITY)[2]), max(force, contact)
        power = max(power, contact * before)
    return fastest, force, power


def test_the_guards_of_a_shape_limit_outward_force_power_and_ejection():
    fastest, force, power = fast_exit()
    assert force > 75.0
    assert fastest > 0.8
    assert fast_exit(outward_forcemax=12.0)[1] <= 12.0
    assert fast_exit(powermax=5.0)[2] <= 5.0 < power
    assert fast_exit(ejection_velmax=0.2, ejection_damping=2000.0)[0] < 0.25


def test_the_damping_force_of_a_shape_is_limited():
    for limit, expected in ((math.inf, 2.0 * math.sqrt(4000.0 * 2.0) * 0.5), (3.0, 3.0)):
        arm = quiet_arm(inertia=2.0, force_sensor=False)
        add_effect(
            arm, EffectKind.FLAT_PLANE, pos=(0.0, 0.0, 0.001), stiffness=4000.0, dampfactor=1.0,
            damping_forcemax=limit,
        )  # fmt: skip
        throw(arm, (0.0, 0.0, -0.5))
        arm.step(1)
        elastic = 4000.0 * (0.001 + 0.5 * 0.5 / 2500.0)
        assert arm.truth().contact_force[2] - elastic == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize(("no_pull", "pulls"), [(1.0, False), (0.0, True)])
def test_a_shape_pulls_back_only_where_it_may(no_pull, pulls):
    arm = quiet_arm(inertia=2.0, force_sensor=False)
    add_effect(
        arm, EffectKind.FLAT_PLANE, pos=(0.0, 0.0, 0.003), stiffness=400.0, dampfactor=1.0, no_pull=no_pull
    )
    throw(arm, (0.0, 0.0, 0.4))
    forces = run(arm, 30, layout.O_CONTACT_FORCE)[:, 2]
    assert bool(forces.min() < -0.1) is pulls


def test_tangential_damping_slows_sliding_on_a_plane():
    arm = quiet_arm(inertia=2.0, force_sensor=False)
    add_effect(arm, EffectKind.FLAT_PLANE, pos=(0.0, 0.0, 0.01), stiffness=0.0, tang_damping=20.0)
    throw(arm, (0.0, 0.1, 0.0))
    velocity = run(arm, 250, layout.O_MODEL_VELOCITY)[-1]
    assert velocity[1] == pytest.approx(0.1 * math.exp(-20.0 / 2.0 * 0.1), rel=1e-3)


@pytest.mark.parametrize("hand_stiffness", [0.0, 300.0, 2000.0])
@pytest.mark.parametrize("inertia", [2.0, 3.0, 8.0])
@pytest.mark.parametrize("wall", [500.0, 5000.0, 20000.0])
def test_a_hand_that_rests_on_a_wall_takes_no_energy_out_of_the_arm(wall, inertia, hand_stiffness):
    arm = quiet_arm(inertia=inertia)
    add_effect(arm, EffectKind.FLAT_PLANE, pos=(0.0, 0.0, -0.005), stiffness=wall, dampfactor=0.7)
    zero = (0.0, 0.0, 0.0)
    pressed = (0.0, 0.0, -5.0 if hand_stiffness == 0.0 else 0.0)
    place = (0.0, 0.0, -0.005 - 5.0 / max(hand_stiffness, 1.0))
    arm.set_hand(place, zero, (hand_stiffness,) * 3, (20.0,) * 3, pressed)
    work, lowest = 0.0, 0.0
    for _ in range(2500):
        arm.step(1)
        work += arm.truth().hand_force[2] * arm.truth().tip_velocity[2] / 2500.0
        lowest = min(lowest, work)
    rest = run(arm, 250, layout.O_TIP_VELOCITY)
    # The structure gives back what it stores while the hand loads it: F^2 / 2k, a tenth of a millijoule here.
    assert lowest > -1e-4
    assert np.abs(rest[:, 2]).max() < 0.01


@pytest.mark.parametrize(("inertia", "stable"), [(0.5, False), (2.0, True), (3.0, True)])
def test_a_stiff_hand_shakes_too_small_a_virtual_mass_and_no_allowed_one(inertia, stable):
    arm = quiet_arm(inertia=inertia)
    zero = (0.0, 0.0, 0.0)
    arm.set_hand((0.0, 0.0, -0.002), zero, (40000.0,) * 3, (20.0,) * 3, zero)
    arm.step(5000)
    swing = np.ptp(run(arm, 750, layout.O_TIP_POSITION)[:, 2])
    assert bool(swing < 0.001) is stable

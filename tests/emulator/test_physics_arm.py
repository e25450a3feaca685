"""The real arm: servo, sensors, hand, modes, and how well it follows the virtual mass."""

import dataclasses
import math

import numpy as np
import pytest
from arm_bench import STEP_S, add_effect, push, quiet_arm, run

from emulator import layout
from emulator.arm_model import ArmModel
from emulator.effect_table import CAPACITY, EffectKind
from emulator.parameters import load_parameters
from hm_driver.errors import ConfigurationError

ZERO = (0.0, 0.0, 0.0)


def session_arm(seed=3, *, hand_stiffness=500.0):
    """The arm of the paper's task: 3 kg, held by a hand, a damped spring in z; calibrated and at rest."""
    arm = ArmModel(load_parameters(), seed=seed)
    arm.place_at(0.0, 0.0, 0.0)
    arm.set_render(powered=True, effects=False, force_sensor=False)
    arm.step(2500)
    arm.calibrate_force_sensor()
    arm.set_render(powered=True, effects=True, force_sensor=True)
    add_effect(
        arm, EffectKind.SPRING, stiffness=5000.0, dampfactor=1.0, direction=(0.0, 0.0, 1.0), maxforce=30.0
    )
    arm.set_hand(ZERO, ZERO, (hand_stiffness,) * 3, (60.0,) * 3, ZERO)
    return arm


@pytest.mark.parametrize("hand_stiffness", [300.0, 800.0, 2000.0])
def test_the_arm_follows_the_virtual_mass_closely_in_the_task_of_the_paper(hand_stiffness):
    arm = session_arm(hand_stiffness=hand_stiffness)
    errors, roughness = [], []
    for tick in range(800):
        time = tick * 0.01
        place = [0.15 * math.sin(1.0 * time), 0.15 * math.sin(0.7 * time), 0.0]
        speed = [0.15 * math.cos(1.0 * time), 0.105 * math.cos(0.7 * time), 0.0]
        arm.set_hand(place, speed, (hand_stiffness,) * 3, (60.0,) * 3, ZERO)
        path = run(arm, 25)
        errors.append(
            np.subtract(arm.output(layout.O_MEASURED_POSITION), arm.output(layout.O_MODEL_POSITION))
        )
        roughness.append(np.abs(np.diff(path, 2, axis=0)).max() / STEP_S**2)
    distance = np.linalg.norm(errors[100:], axis=1)
    assert math.sqrt(np.mean(distance**2)) < 2e-4
    assert distance.max() < 4e-4
    assert max(roughness[100:]) < 3.0
    assert arm.outputs[layout.O_LIMITED_STEPS] == 0.0


def test_the_measured_force_is_the_hands_with_the_noise_of_the_sensor():
    arm = session_arm()
    push(arm, (2.0, -1.0, 3.0), damping=60.0)
    add_effect(arm, EffectKind.SPRING, stiffness=2000.0, dampfactor=1.0)
    arm.step(5000)
    measured = run(arm, 2500, layout.O_MEASURED_FORCE)
    # Calibration is as good as its averaging and the drift since.
    assert measured.mean(axis=0) == pytest.approx([2.0, -1.0, 3.0], abs=0.02)
    assert measured.std(axis=0) == pytest.approx([0.015] * 3, rel=0.15)
    steps = measured / 0.01 - (measured / 0.01)[0]
    assert steps == pytest.approx(np.round(steps), abs=1e-6)


def test_calibration_takes_away_the_sensors_offset():
    arm = ArmModel(load_parameters(), seed=4)
    arm.step(2500)
    before = np.abs(arm.output(layout.O_MEASURED_FORCE)).max()
    arm.calibrate_force_sensor()
    arm.step(1)
    assert before > 0.3
    assert np.abs(arm.output(layout.O_MEASURED_FORCE)).max() < 0.1


def test_the_offset_of_the_sensor_drifts_as_a_random_walk():
    parameters = dataclasses.replace(
        load_parameters(), sensor_drift=0.01, sensor_noise=0.0, sensor_offset=0.0
    )
    ends = []
    for seed in range(30):
        arm = ArmModel(parameters, seed=seed)
        arm.step(10000)
        ends.append(arm.state[layout.S_SENSOR_OFFSET : layout.S_SENSOR_OFFSET + 3].copy())
    assert np.std(ends) == pytest.approx(0.01 * math.sqrt(4.0), rel=0.25)


def test_the_noise_of_the_sensor_is_normal():
    arm = ArmModel(dataclasses.replace(load_parameters(), sensor_drift=0.0, sensor_resolution=1e-9), seed=9)
    sample = run(arm, 20000, layout.O_MEASURED_FORCE)
    sample = (sample - sample.mean(axis=0)) / 0.015
    assert sample.std() == pytest.approx(1.0, abs=0.01)
    assert (sample**4).mean() == pytest.approx(3.0, abs=0.15)
    assert abs(np.corrcoef(sample.T)[0, 1]) < 0.03
    assert abs((sample[1:] * sample[:-1]).mean()) < 0.02


def test_a_stuck_or_biased_sensor_and_a_jump_of_the_encoders_are_seen():
    arm = quiet_arm(force_sensor=False)
    arm.set_sensor_fault(bias=(3.0, 0.0, 0.0))
    arm.step(1)
    assert arm.output(layout.O_MEASURED_FORCE)[0] == pytest.approx(3.0)
    arm.set_sensor_fault(stuck=True)
    push(arm, (9.0, 0.0, 0.0))
    arm.step(10)
    assert arm.output(layout.O_MEASURED_FORCE)[0] == pytest.approx(3.0)
    arm.set_sensor_fault()
    arm.set_encoder_offset((0.0, 0.0, 0.002))
    arm.step(1)
    assert arm.output(layout.O_MEASURED_POSITION)[2] == pytest.approx(0.002, abs=1e-4)


def test_the_structure_yields_between_joints_and_handle():
    arm = quiet_arm(force_sensor=False)
    push(arm, (0.0, 0.0, 20.0))
    arm.step(2500)
    bend = arm.output(layout.O_TIP_POSITION)[2] - arm.output(layout.O_MEASURED_POSITION)[2]
    assert bend == pytest.approx(20.0 / arm.parameters.structure_stiffness[2], abs=1e-5)


def test_the_reported_velocity_is_that_of_the_tip():
    arm = session_arm()
    arm.set_hand(ZERO, (0.1, 0.05, 0.0), (500.0,) * 3, (60.0,) * 3, ZERO)
    measured, true = [], []
    for tick in range(100):
        arm.set_hand((0.001 * tick, 0.0005 * tick, 0.0), (0.1, 0.05, 0.0), (500.0,) * 3, (60.0,) * 3, ZERO)
        arm.step(25)
        measured.append(arm.output(layout.O_MEASURED_VELOCITY))
        true.append(arm.output(layout.O_TIP_VELOCITY))
    assert np.abs(np.subtract(measured, true))[50:].max() < 0.005


def test_the_hands_intended_position_moves_on_for_20_ms_and_then_waits():
    arm = quiet_arm(force_sensor=False)
    arm.set_hand(ZERO, (0.0, 0.0, 0.5), (1.0,) * 3, ZERO, ZERO)
    arm.step(50)
    assert arm.state[layout.S_HAND_POSITION + 2] == pytest.approx(0.01)
    arm.step(50)
    assert arm.state[layout.S_HAND_POSITION + 2] == pytest.approx(0.01)


def test_a_released_hand_lets_go_within_50_ms_and_without_a_jump():
    arm = quiet_arm(force_sensor=False)
    push(arm, (0.0, 0.0, 10.0))
    arm.step(200)
    arm.release_hand()
    force = run(arm, 130, layout.O_HAND_FORCE)[:, 2]
    assert np.abs(np.diff(force)).max() < 0.2
    assert force[60] == pytest.approx(5.0, rel=0.05)
    assert np.all(force[126:] == 0.0)


def test_without_power_the_arm_yields_to_the_hand_and_takes_up_no_jump_when_powered_again():
    arm = session_arm()
    arm.set_render(powered=False, effects=False, force_sensor=False)
    arm.set_hand((0.05, 0.0, 0.0), ZERO, (500.0,) * 3, (60.0,) * 3, ZERO)
    arm.step(2500)
    assert arm.output(layout.O_MEASURED_POSITION)[0] > 0.03
    arm.set_render(powered=True, effects=False, force_sensor=False)
    before = arm.output(layout.O_MEASURED_POSITION)
    path = run(arm, 500, layout.O_MEASURED_POSITION)
    assert np.abs(path - before).max() < 5e-4


def test_a_stop_brings_the_moving_arm_to_rest_at_its_deceleration():
    arm = session_arm()
    arm.set_hand((0.1, 0.0, 0.0), ZERO, (500.0,) * 3, (10.0,) * 3, ZERO)
    arm.step(500)
    assert arm.output(layout.O_MODEL_VELOCITY)[0] > 0.1
    arm.set_render(powered=True, effects=False, force_sensor=False)
    path = run(arm, 1000)
    acceleration = np.diff(path[:, 0], 2) / STEP_S**2
    assert np.abs(acceleration).max() <= 10.0 * 1.01
    assert np.all(path[-1] == path[-100])


def test_a_drive_reaches_its_target_within_the_homing_speed_and_the_end_stops():
    arm = ArmModel(load_parameters(), seed=1)
    arm.drive_to(0.5, 0.3, -0.1)
    velocity = run(arm, 12500, layout.O_MODEL_JOINT_VELOCITY)
    assert arm.is_settled()
    assert np.all(np.abs(velocity).max(axis=0) <= np.array(arm.parameters.homing_speed) * 1.001)
    assert arm.output(layout.O_MEASURED_JOINT) == pytest.approx((0.19, 0.3, -0.1), abs=2e-4)


def test_in_position_the_virtual_mass_does_not_answer_to_the_hand():
    arm = session_arm()
    arm.set_render(powered=True, effects=True, force_sensor=False)
    arm.set_hand((0.1, 0.0, 0.0), ZERO, (500.0,) * 3, (60.0,) * 3, ZERO)
    arm.step(2500)
    assert abs(arm.output(layout.O_MODEL_POSITION)[0]) < 1e-3
    assert abs(arm.output(layout.O_MEASURED_POSITION)[0]) < 2e-3


def test_the_table_of_effects_is_full_after_64_and_a_freed_slot_is_new():
    arm = quiet_arm()
    slots = [arm.effects.allocate(EffectKind.SPRING) for _ in range(CAPACITY)]
    with pytest.raises(OverflowError, match="64"):
        arm.effects.allocate(EffectKind.DAMPER)
    arm.effects.set(slots[7], "stiffness", 9.0)
    arm.effects.free(slots[7])
    again = arm.effects.allocate(EffectKind.SPHERE)
    assert again == slots[7]
    assert arm.effects.get(again, "stiffness") == 0.0
    assert arm.effects.kind(again) is EffectKind.SPHERE


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[virtual]\ninertial = 3", ["virtual.inertial", "unknown key", "inertia"]),
        ("[motor]\nx = 3", ["motor", "unknown section", "servo"]),
        ("[virtual]\ninertia = 'heavy'", ["virtual.inertia", "must be a number"]),
        ("[virtual]\ninertia = true", ["virtual.inertia", "must be a number"]),
        ("[virtual]\ninertia = 1e9", ["virtual.inertia", "100 kg"]),
        ("[virtual]\ninertia = nan", ["virtual.inertia", "nan"]),
        ("[virtual]\ninertia = 1", ["virtual.inertia", "inertia_min"]),
        ("[limits]\nvelocity = [1, 2]", ["limits.velocity", "three numbers"]),
        ("[hand]\nfade = { value = 50, unit = 'ms' }", ["hand.fade", "'s'"]),
        ("hand = 3", ["hand", "section"]),
        ("[hand", ["TOML"]),
    ],
)
def test_a_mistake_in_a_file_of_parameters_is_named_with_its_limit(tmp_path, text, words):
    path = tmp_path / "mine.toml"
    path.write_text(text)
    with pytest.raises(ConfigurationError) as caught:
        load_parameters(path)
    assert all(word in str(caught.value) for word in [*words, "mine.toml"])


def test_a_file_may_change_single_parameters(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text("[virtual]\ninertia = 4\n[servo]\nfrequency = { value = 30.0, unit = 'Hz' }\n")
    changed = load_parameters(path)
    assert (changed.inertia, changed.servo_frequency_hz) == (4.0, 30.0)
    assert changed.r0 == load_parameters().r0


def test_the_arrays_have_room_for_all_that_is_kept_in_them():
    for prefix in ("S_", "P_", "O_", "E_"):
        size = prefix + "SIZE"
        starts = [getattr(layout, name) for name in vars(layout) if name.startswith(prefix) and name != size]
        assert len(set(starts)) == len(starts)
        assert max(starts) < getattr(layout, size)

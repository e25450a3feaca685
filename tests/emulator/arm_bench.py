"""What the tests of the physics share: an arm without sensor noise, ready in a mode, and ways to run it."""

import dataclasses
import math

import numpy as np

from emulator import layout
from emulator.arm_model import ArmModel
from emulator.parameters import load_parameters

STEP_S = 1.0 / 2500.0
PARAMETERS = load_parameters()
QUIET = {"sensor_noise": 0.0, "sensor_resolution": 1e-9, "sensor_offset": 0.0, "sensor_drift": 0.0}
OPEN = {"velocity_max": (10.0, 10.0, 10.0), "acceleration_max": 1000.0}


def quiet_arm(*, inertia=3.0, friction=0.0, force_sensor=True, seed=1, **changes):
    """An arm at the origin whose sensor is perfect, rendering effects."""
    parameters = dataclasses.replace(PARAMETERS, **(QUIET | OPEN | changes))
    arm = ArmModel(parameters, seed=seed)
    arm.inertia, arm.coulomb_friction = inertia, friction
    arm.place_at(0.0, 0.0, 0.0)
    arm.set_render(powered=True, effects=True, force_sensor=force_sensor)
    return arm


def add_effect(arm, kind, **parameters):
    """Create and enable an object; returns its slot."""
    slot = arm.effects.allocate(kind)
    for name, value in parameters.items():
        arm.effects.set(slot, name, value)
    arm.effects.set_enabled(slot, enabled=True)
    return slot


def push(arm, force, *, stiffness=0.0, damping=0.0):
    """Let the hand push with a constant force [N]."""
    zero = (0.0, 0.0, 0.0)
    arm.set_hand(arm.output(layout.O_TIP_POSITION), zero, (stiffness,) * 3, (damping,) * 3, force)


def run(arm, steps, start=layout.O_MODEL_POSITION):
    """Outputs after each of a number of steps, shape (steps, 3)."""
    rows = np.empty((steps, 3))
    for i in range(steps):
        arm.step(1)
        rows[i] = arm.outputs[start : start + 3]
    return rows


def speed(arm):
    """Speed of the virtual mass [m/s]."""
    return math.hypot(*arm.output(layout.O_MODEL_VELOCITY))


def throw(arm, velocity):
    """Give the virtual mass a velocity [m/s]."""
    arm.state[layout.S_VELOCITY : layout.S_VELOCITY + 3] = velocity
    arm.state[layout.S_SET_JOINT_VELOCITY] = velocity[0]
    arm.state[layout.S_SET_JOINT_VELOCITY + 1] = velocity[1] / arm.parameters.r0
    arm.state[layout.S_SET_JOINT_VELOCITY + 2] = velocity[2]

"""The whole emulated arm as one function: ``advance`` runs a number of steps on flat arrays."""

import math
from typing import Final

from emulator.compilation import Indices, Numbers, entry_point, kernel
from emulator.inner_loop import inner_step
from emulator.layout import (
    MODE_UNPOWERED,
    O_ACCELERATION_LIMITED,
    O_AT_END_STOP,
    O_CONTACT_FORCE,
    O_DRIVE_LIMITED,
    O_EFFECT_FORCE,
    O_GUARD,
    O_HAND_FORCE,
    O_LIMITED_STEPS,
    O_MEASURED_FORCE,
    O_MEASURED_JOINT,
    O_MEASURED_JOINT_FORCE,
    O_MEASURED_POSITION,
    O_MEASURED_VELOCITY,
    O_MODEL_ACCELERATION,
    O_MODEL_JOINT,
    O_MODEL_JOINT_ACCELERATION,
    O_MODEL_JOINT_VELOCITY,
    O_MODEL_POSITION,
    O_MODEL_VELOCITY,
    O_TIME,
    O_TIP_POSITION,
    O_TIP_VELOCITY,
    O_VELOCITY_LIMITED,
    P_GUARD_FOLLOWING,
    P_GUARD_FORCE,
    P_GUARD_SPEED,
    P_R0,
    P_STEP,
    S_ACCELERATION,
    S_ACCELERATION_LIMITED,
    S_AT_END_STOP,
    S_CONTACT_FORCE,
    S_DRIVE_LIMITED,
    S_EFFECT_FORCE,
    S_ENCODER,
    S_HAND_FORCE,
    S_LIMITED_STEPS,
    S_MODE,
    S_POSITION,
    S_REPORTED_VELOCITY,
    S_SENSOR_FORCE,
    S_SET_JOINT,
    S_SET_JOINT_ACCELERATION,
    S_SET_JOINT_VELOCITY,
    S_STEPS,
    S_TIP,
    S_TIP_VELOCITY,
    S_VELOCITY,
    S_VELOCITY_LIMITED,
)
from emulator.outer_loop import outer_step

GUARD_STEPS: Final = 5
"""The guards look every 2 ms."""


@kernel
def length(x: float, y: float, z: float) -> float:
    """Length of a vector."""
    return math.sqrt(x * x + y * y + z * z)


@kernel
def is_guarded(state: Numbers, params: Numbers, outputs: Numbers) -> bool:
    """Whether the powered arm breaks a limit of its guards, which a number that is none does too."""
    if state[S_MODE] == MODE_UNPOWERED:
        return False
    following_error = length(
        outputs[O_MEASURED_POSITION] - outputs[O_MODEL_POSITION],
        outputs[O_MEASURED_POSITION + 1] - outputs[O_MODEL_POSITION + 1],
        outputs[O_MEASURED_POSITION + 2] - outputs[O_MODEL_POSITION + 2],
    )
    speed = length(
        outputs[O_MEASURED_VELOCITY], outputs[O_MEASURED_VELOCITY + 1], outputs[O_MEASURED_VELOCITY + 2]
    )
    force = length(outputs[O_MEASURED_FORCE], outputs[O_MEASURED_FORCE + 1], outputs[O_MEASURED_FORCE + 2])
    return not (
        following_error <= params[P_GUARD_FOLLOWING]
        and speed <= params[P_GUARD_SPEED]
        and force <= params[P_GUARD_FORCE]
    )


@kernel
def publish(state: Numbers, params: Numbers, outputs: Numbers) -> None:
    """Refresh the outputs from the state."""
    for i in range(3):
        outputs[O_MEASURED_FORCE + i] = state[S_SENSOR_FORCE + i]
        outputs[O_MODEL_POSITION + i] = state[S_POSITION + i]
        outputs[O_MODEL_VELOCITY + i] = state[S_VELOCITY + i]
        outputs[O_MODEL_ACCELERATION + i] = state[S_ACCELERATION + i]
        outputs[O_MEASURED_JOINT + i] = state[S_ENCODER + i]
        outputs[O_MODEL_JOINT + i] = state[S_SET_JOINT + i]
        outputs[O_MODEL_JOINT_VELOCITY + i] = state[S_SET_JOINT_VELOCITY + i]
        outputs[O_MODEL_JOINT_ACCELERATION + i] = state[S_SET_JOINT_ACCELERATION + i]
        outputs[O_TIP_POSITION + i] = state[S_TIP + i]
        outputs[O_TIP_VELOCITY + i] = state[S_TIP_VELOCITY + i]
        outputs[O_HAND_FORCE + i] = state[S_HAND_FORCE + i]
        outputs[O_CONTACT_FORCE + i] = state[S_CONTACT_FORCE + i]
        outputs[O_EFFECT_FORCE + i] = state[S_EFFECT_FORCE + i]
    r0 = params[P_R0]
    radius, phi = r0 + state[S_ENCODER], state[S_ENCODER + 1]
    cosine, sine = math.cos(phi), math.sin(phi)
    outputs[O_MEASURED_POSITION] = radius * cosine - r0
    outputs[O_MEASURED_POSITION + 1] = radius * sine
    outputs[O_MEASURED_POSITION + 2] = state[S_ENCODER + 2]
    along, across = state[S_REPORTED_VELOCITY], state[S_REPORTED_VELOCITY + 1] * radius
    outputs[O_MEASURED_VELOCITY] = cosine * along - sine * across
    outputs[O_MEASURED_VELOCITY + 1] = sine * along + cosine * across
    outputs[O_MEASURED_VELOCITY + 2] = state[S_REPORTED_VELOCITY + 2]
    fx, fy = state[S_SENSOR_FORCE], state[S_SENSOR_FORCE + 1]
    outputs[O_MEASURED_JOINT_FORCE] = cosine * fx + sine * fy
    outputs[O_MEASURED_JOINT_FORCE + 1] = (cosine * fy - sine * fx) * radius
    outputs[O_MEASURED_JOINT_FORCE + 2] = state[S_SENSOR_FORCE + 2]
    outputs[O_TIME] = state[S_STEPS] * params[P_STEP]
    outputs[O_VELOCITY_LIMITED] = state[S_VELOCITY_LIMITED]
    outputs[O_ACCELERATION_LIMITED] = state[S_ACCELERATION_LIMITED]
    outputs[O_AT_END_STOP] = state[S_AT_END_STOP]
    outputs[O_LIMITED_STEPS] = state[S_LIMITED_STEPS]
    outputs[O_DRIVE_LIMITED] = state[S_DRIVE_LIMITED]


@entry_point
def advance(
    state: Numbers,
    params: Numbers,
    effects: Numbers,
    active: Indices,
    n_active: int,
    outputs: Numbers,
    n_steps: int,
) -> int:
    """Run the arm for a number of steps, or until a guard trips.

    Args:
        state: Everything that changes, ``S_SIZE`` numbers (``emulator.layout``).
        params: Constants of the arm, ``P_SIZE`` numbers.
        effects: Rows of ``E_SIZE`` numbers, one after the other.
        active: Index into ``effects`` of the first number of each enabled row.
        n_active: How many entries of ``active`` count.
        outputs: ``O_SIZE`` numbers, refreshed after the last step.
        n_steps: Number of steps of ``params[P_STEP]`` seconds; 0 only refreshes the outputs.

    Returns:
        The number of steps run; after the last one ``outputs[O_GUARD]`` tells whether a guard tripped.
    """
    outputs[O_GUARD] = 0.0
    done = 0
    while True:
        is_look = False
        if done < n_steps:
            outer_step(state, params, effects, active, n_active)
            inner_step(state, params)
            state[S_STEPS] += 1.0
            done += 1
            is_look = int(state[S_STEPS]) % GUARD_STEPS == 0
        if is_look or done >= n_steps:
            publish(state, params, outputs)
            if is_look and is_guarded(state, params, outputs):
                outputs[O_GUARD] = 1.0
                return done
            if done >= n_steps:
                return done

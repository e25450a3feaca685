"""Inner loop and the real arm: servo, drives, joints, structure, encoders, force sensor and hand.

The hand pushes the real arm. The force sensor between them is all the outer loop ever sees of it.
"""

import math

from emulator.compilation import Numbers, kernel
from emulator.layout import (
    MODE_HOLD,
    P_ARM_MASS,
    P_COLUMN_INERTIA,
    P_COULOMB,
    P_DRIVE_GAIN,
    P_DRIVE_LIMIT,
    P_FRICTION_COMPENSATION,
    P_FRICTION_SPEED,
    P_HAND_FADE,
    P_HAND_HOLD,
    P_JOINT_MAX,
    P_JOINT_MIN,
    P_MASS_R,
    P_MASS_Z,
    P_R0,
    P_REPORTED_FILTER,
    P_RESOLUTION,
    P_SENSOR_DRIFT,
    P_SENSOR_MEAN_GAIN,
    P_SENSOR_NOISE,
    P_SENSOR_RANGE,
    P_SENSOR_RESOLUTION,
    P_SERVO_FILTER,
    P_SERVO_INTEGRAL_MAX,
    P_SERVO_KD,
    P_SERVO_KI,
    P_SERVO_KP,
    P_STEP,
    P_STOP_MARGIN,
    P_STRUCTURE,
    P_VISCOUS,
    S_DRIVE,
    S_DRIVE_LIMITED,
    S_ENCODER,
    S_FAULT_BIAS,
    S_FAULT_ENCODER,
    S_FAULT_NOISE,
    S_FAULT_STUCK,
    S_HAND_AGE,
    S_HAND_DAMPING,
    S_HAND_FORCE,
    S_HAND_GAIN,
    S_HAND_POSITION,
    S_HAND_PUSH,
    S_HAND_RELEASED,
    S_HAND_STIFFNESS,
    S_HAND_VELOCITY,
    S_INTEGRAL,
    S_JOINT,
    S_JOINT_VELOCITY,
    S_MODE,
    S_REPORTED_VELOCITY,
    S_SENSOR_FORCE,
    S_SENSOR_MEAN,
    S_SENSOR_OFFSET,
    S_SENSOR_RAW,
    S_SENSOR_TARE,
    S_SERVO_VELOCITY,
    S_SET_JOINT,
    S_SET_JOINT_ACCELERATION,
    S_SET_JOINT_VELOCITY,
    S_STEPS,
    S_TIP,
    S_TIP_VELOCITY,
)
from emulator.noise import normal_pair


@kernel
def moving_mass(params: Numbers, joint: int, radius: float) -> float:
    """Mass [kg] of the joints r and z, or moment of inertia [kg·m²] of phi at a radius [m]."""
    if joint == 0:
        return params[P_MASS_R]
    if joint == 1:
        return params[P_COLUMN_INERTIA] + params[P_ARM_MASS] * radius * radius
    return params[P_MASS_Z]


@kernel
def servo(
    state: Numbers,
    params: Numbers,
    joint: int,
    mass: float,
    coupling: float,
    load: float,
) -> None:
    """One cycle of a joint's servo and drive.

    PID in units of acceleration, feed-forward of the set acceleration, of the Coriolis or centrifugal force
    ``coupling``, of friction and of the measured hand force ``load``; the drive follows with a first-order
    lag.
    """
    if state[S_MODE] < MODE_HOLD:
        state[S_INTEGRAL + joint] = 0.0
        state[S_DRIVE + joint] -= params[P_DRIVE_GAIN] * state[S_DRIVE + joint]
        return
    speed = state[S_SET_JOINT_VELOCITY + joint]
    error = state[S_SET_JOINT + joint] - state[S_ENCODER + joint]
    rate_error = speed - state[S_SERVO_VELOCITY + joint]
    scale = 1.0 / params[P_R0] if joint == 1 else 1.0  # lengths at the centre, as angles
    integral = state[S_INTEGRAL + joint] + params[P_SERVO_KI] * error * params[P_STEP]
    most = params[P_SERVO_INTEGRAL_MAX] * scale
    integral = max(-most, min(most, integral))
    state[S_INTEGRAL + joint] = integral
    acceleration = (
        state[S_SET_JOINT_ACCELERATION + joint]
        + params[P_SERVO_KP] * error
        + params[P_SERVO_KD] * rate_error
        + integral
    )
    smooth = speed / (abs(speed) + params[P_FRICTION_SPEED] * scale)
    friction = params[P_FRICTION_COMPENSATION] * (
        params[P_COULOMB + joint] * smooth + params[P_VISCOUS + joint] * speed
    )
    command = mass * acceleration - coupling + friction - load
    limit = params[P_DRIVE_LIMIT + joint]
    if abs(command) > limit:
        command = math.copysign(limit, command)
        state[S_DRIVE_LIMITED] = 1.0
    state[S_DRIVE + joint] += params[P_DRIVE_GAIN] * (command - state[S_DRIVE + joint])


@kernel
def move_joint(
    state: Numbers,
    params: Numbers,
    joint: int,
    mass: float,
    coupling: float,
    load: float,
    radius: float,
) -> None:
    """Newton's law for one joint with friction, between its mechanical end stops; then its encoder."""
    step = params[P_STEP]
    momentum = mass * state[S_JOINT_VELOCITY + joint] + step * (state[S_DRIVE + joint] + load + coupling)
    grip = step * params[P_COULOMB + joint]
    if abs(momentum) <= grip:
        speed = 0.0
    else:
        speed = (momentum - math.copysign(grip, momentum)) / (mass + step * params[P_VISCOUS + joint])
    place = state[S_JOINT + joint] + step * speed
    margin = params[P_STOP_MARGIN] / radius
    low, high = params[P_JOINT_MIN + joint] - margin, params[P_JOINT_MAX + joint] + margin
    if place < low:
        place, speed = low, max(speed, 0.0)
    elif place > high:
        place, speed = high, min(speed, 0.0)
    state[S_JOINT + joint] = place
    state[S_JOINT_VELOCITY + joint] = speed
    resolution = params[P_RESOLUTION + joint]
    reading = math.floor(place / resolution + 0.5) * resolution + state[S_FAULT_ENCODER + joint]
    difference = (reading - state[S_ENCODER + joint]) / step
    state[S_ENCODER + joint] = reading
    state[S_SERVO_VELOCITY + joint] += params[P_SERVO_FILTER] * (difference - state[S_SERVO_VELOCITY + joint])
    state[S_REPORTED_VELOCITY + joint] += params[P_REPORTED_FILTER] * (
        state[S_SERVO_VELOCITY + joint] - state[S_REPORTED_VELOCITY + joint]
    )


@kernel
def move_hand(
    state: Numbers,
    params: Numbers,
    x: float,
    y: float,
    z: float,
    vx: float,
    vy: float,
    vz: float,
) -> None:
    """Force of the hand on the handle, for the joints' end at x, y, z; the structure yields between them.

    F = K (p_h - p) + B (v_h - v) + F_push with the handle at p = tip + F / k_structure, by backward Euler.
    """
    step = params[P_STEP]
    if state[S_HAND_RELEASED] != 0.0:
        state[S_HAND_GAIN] = max(0.0, state[S_HAND_GAIN] - step / params[P_HAND_FADE])
    moving = 1.0 if state[S_HAND_AGE] < params[P_HAND_HOLD] - 0.5 * step else 0.0
    state[S_HAND_AGE] += step
    gain = state[S_HAND_GAIN]
    for i in range(3):
        end, rate = (x, vx) if i == 0 else ((y, vy) if i == 1 else (z, vz))
        compliance = 1.0 / params[P_STRUCTURE + i]
        force = 0.0
        if gain > 0.0:
            speed = moving * state[S_HAND_VELOCITY + i]
            state[S_HAND_POSITION + i] += step * speed
            k, b = gain * state[S_HAND_STIFFNESS + i], gain * state[S_HAND_DAMPING + i]
            lag = b * compliance / step
            pull = (
                k * (state[S_HAND_POSITION + i] - end)
                + b * (speed - rate)
                + gain * state[S_HAND_PUSH + i]
                + lag * state[S_HAND_FORCE + i]
            )
            force = pull / (1.0 + k * compliance + lag)
        state[S_HAND_FORCE + i] = force
        place = end + force * compliance
        state[S_TIP_VELOCITY + i] = (place - state[S_TIP + i]) / step
        state[S_TIP + i] = place


@kernel
def sense_force(state: Numbers, params: Numbers) -> None:
    """One sample of the force sensor: drift, noise, faults, range, resolution, then the tare."""
    n0, n1 = normal_pair(state)
    n2, walk = normal_pair(state)
    axis = int(state[S_STEPS]) % 3
    state[S_SENSOR_OFFSET + axis] += params[P_SENSOR_DRIFT] * walk
    gain = params[P_SENSOR_NOISE] * state[S_FAULT_NOISE]
    resolution, most = params[P_SENSOR_RESOLUTION], params[P_SENSOR_RANGE]
    for i in range(3):
        if state[S_FAULT_STUCK] == 0.0:
            noise = n0 if i == 0 else (n1 if i == 1 else n2)
            raw = (
                state[S_HAND_FORCE + i] + state[S_SENSOR_OFFSET + i] + gain * noise + state[S_FAULT_BIAS + i]
            )
            raw = max(-most, min(most, raw))
            state[S_SENSOR_RAW + i] = math.floor(raw / resolution + 0.5) * resolution
        raw = state[S_SENSOR_RAW + i]
        state[S_SENSOR_MEAN + i] += params[P_SENSOR_MEAN_GAIN] * (raw - state[S_SENSOR_MEAN + i])
        state[S_SENSOR_FORCE + i] = raw - state[S_SENSOR_TARE + i]


@kernel
def inner_step(state: Numbers, params: Numbers) -> None:
    """One step of servo, arm, hand and sensors, for the set-points of the outer loop."""
    r0 = params[P_R0]
    radius = r0 + state[S_JOINT]
    phi = state[S_JOINT + 1]
    cosine, sine = math.cos(phi), math.sin(phi)
    # What the controller knows: the set-points' speed, the encoders and the calibrated sensor.
    seen = r0 + state[S_ENCODER]
    along, turn = state[S_SET_JOINT_VELOCITY], state[S_SET_JOINT_VELOCITY + 1]
    fx, fy, fz = state[S_SENSOR_FORCE], state[S_SENSOR_FORCE + 1], state[S_SENSOR_FORCE + 2]
    arm = params[P_ARM_MASS]
    state[S_DRIVE_LIMITED] = 0.0
    servo(state, params, 0, moving_mass(params, 0, seen), arm * seen * turn * turn, cosine * fx + sine * fy)
    servo(
        state, params, 1,
        moving_mass(params, 1, seen), -2.0 * arm * seen * along * turn, (cosine * fy - sine * fx) * seen,
    )  # fmt: skip
    servo(state, params, 2, moving_mass(params, 2, seen), 0.0, fz)
    # What happens.
    along, turn = state[S_JOINT_VELOCITY], state[S_JOINT_VELOCITY + 1]
    fx, fy, fz = state[S_HAND_FORCE], state[S_HAND_FORCE + 1], state[S_HAND_FORCE + 2]
    load = cosine * fx + sine * fy
    move_joint(state, params, 0, moving_mass(params, 0, radius), arm * radius * turn * turn, load, 1.0)
    load = (cosine * fy - sine * fx) * radius
    coupling = -2.0 * arm * radius * along * turn
    move_joint(state, params, 1, moving_mass(params, 1, radius), coupling, load, radius)
    move_joint(state, params, 2, moving_mass(params, 2, radius), 0.0, fz, 1.0)
    radius = r0 + state[S_JOINT]
    phi = state[S_JOINT + 1]
    cosine, sine = math.cos(phi), math.sin(phi)
    along, across = state[S_JOINT_VELOCITY], state[S_JOINT_VELOCITY + 1] * radius
    move_hand(
        state, params,
        radius * cosine - r0, radius * sine, state[S_JOINT + 2],
        cosine * along - sine * across, sine * along + cosine * across, state[S_JOINT_VELOCITY + 2],
    )  # fmt: skip
    sense_force(state, params)

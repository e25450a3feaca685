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
    P_PER_RESOLUTION,
    P_R0,
    P_RATE,
    P_REPORTED_FILTER,
    P_RESOLUTION,
    P_SENSOR_DRIFT,
    P_SENSOR_MEAN_GAIN,
    P_SENSOR_NOISE,
    P_SENSOR_PER_RESOLUTION,
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
    S_AXIS,
    S_COSINE,
    S_COUPLING,
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
    S_LOAD,
    S_MASS,
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
    S_SINE,
    S_TIP,
    S_TIP_VELOCITY,
)
from emulator.noise import normal_pair

_TINY = 1e-30


@kernel
def joint_loads(
    state: Numbers,
    params: Numbers,
    radius: float,
    cosine: float,
    sine: float,
    along: float,
    turn: float,
    force: int,
) -> None:
    """Mass, centrifugal or Coriolis force, and share of the force at ``state[force:]``, of each joint."""
    arm = params[P_ARM_MASS]
    fx, fy = state[force], state[force + 1]
    state[S_MASS] = params[P_MASS_R]
    state[S_MASS + 1] = params[P_COLUMN_INERTIA] + arm * radius * radius
    state[S_MASS + 2] = params[P_MASS_Z]
    state[S_COUPLING] = arm * radius * turn * turn
    state[S_COUPLING + 1] = -2.0 * arm * radius * along * turn
    state[S_COUPLING + 2] = 0.0
    state[S_LOAD] = cosine * fx + sine * fy
    state[S_LOAD + 1] = (cosine * fy - sine * fx) * radius
    state[S_LOAD + 2] = state[force + 2]


@kernel
def decay(value: float, gain: float) -> float:
    """Value of a low-pass without input, one step on; 0 before it gets denormal, which would be slow."""
    value -= gain * value
    return value if abs(value) > _TINY else 0.0


@kernel
def servo(
    state: Numbers,
    params: Numbers,
    joint: int,
) -> None:
    """One cycle of a joint's servo and drive.

    PID in units of acceleration, feed-forward of the set acceleration, of the centrifugal or Coriolis
    force, of friction and of the measured hand force; the drive follows with a first-order lag.
    """
    if state[S_MODE] < MODE_HOLD:
        state[S_INTEGRAL + joint] = 0.0
        state[S_DRIVE + joint] = decay(state[S_DRIVE + joint], params[P_DRIVE_GAIN])
        return
    speed = state[S_SET_JOINT_VELOCITY + joint]
    error = state[S_SET_JOINT + joint] - state[S_ENCODER + joint]
    rate_error = speed - state[S_SERVO_VELOCITY + joint]
    integral = state[S_INTEGRAL + joint] + params[P_SERVO_KI] * error * params[P_STEP]
    most = params[P_SERVO_INTEGRAL_MAX + joint]
    integral = max(-most, min(most, integral))
    state[S_INTEGRAL + joint] = integral
    acceleration = (
        state[S_SET_JOINT_ACCELERATION + joint]
        + params[P_SERVO_KP] * error
        + params[P_SERVO_KD] * rate_error
        + integral
    )
    smooth = speed / (abs(speed) + params[P_FRICTION_SPEED + joint])
    friction = params[P_FRICTION_COMPENSATION] * (
        params[P_COULOMB + joint] * smooth + params[P_VISCOUS + joint] * speed
    )
    command = (
        state[S_MASS + joint] * acceleration - state[S_COUPLING + joint] + friction - state[S_LOAD + joint]
    )
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
    lever: float,
) -> None:
    """Newton's law for one joint with friction, between its mechanical end stops; then its encoder."""
    step = params[P_STEP]
    mass = state[S_MASS + joint]
    force = state[S_DRIVE + joint] + state[S_LOAD + joint] + state[S_COUPLING + joint]
    momentum = mass * state[S_JOINT_VELOCITY + joint] + step * force
    grip = step * params[P_COULOMB + joint]
    if abs(momentum) <= grip:
        speed = 0.0
    else:
        speed = (momentum - math.copysign(grip, momentum)) / (mass + step * params[P_VISCOUS + joint])
    place = state[S_JOINT + joint] + step * speed
    margin = params[P_STOP_MARGIN] / lever
    low, high = params[P_JOINT_MIN + joint] - margin, params[P_JOINT_MAX + joint] + margin
    if place < low:
        place, speed = low, max(speed, 0.0)
    elif place > high:
        place, speed = high, min(speed, 0.0)
    state[S_JOINT + joint] = place
    state[S_JOINT_VELOCITY + joint] = speed
    resolution = params[P_RESOLUTION + joint]
    reading = math.floor(place * params[P_PER_RESOLUTION + joint] + 0.5) * resolution
    reading += state[S_FAULT_ENCODER + joint]
    difference = (reading - state[S_ENCODER + joint]) * params[P_RATE]
    state[S_ENCODER + joint] = reading
    speed = difference - decay(difference - state[S_SERVO_VELOCITY + joint], params[P_SERVO_FILTER])
    state[S_SERVO_VELOCITY + joint] = speed
    state[S_REPORTED_VELOCITY + joint] = speed - decay(
        speed - state[S_REPORTED_VELOCITY + joint], params[P_REPORTED_FILTER]
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
    axis = int(state[S_AXIS])
    state[S_AXIS] = 0.0 if axis >= 2 else axis + 1.0
    state[S_SENSOR_OFFSET + axis] += params[P_SENSOR_DRIFT] * walk
    gain = params[P_SENSOR_NOISE] * state[S_FAULT_NOISE]
    most = params[P_SENSOR_RANGE]
    stuck = state[S_FAULT_STUCK] != 0.0
    for i in range(3):
        noise = n0 if i == 0 else (n1 if i == 1 else n2)
        raw = state[S_HAND_FORCE + i] + state[S_SENSOR_OFFSET + i] + state[S_FAULT_BIAS + i] + gain * noise
        raw = max(-most, min(most, raw)) * params[P_SENSOR_PER_RESOLUTION]
        raw = state[S_SENSOR_RAW + i] if stuck else math.floor(raw + 0.5) * params[P_SENSOR_RESOLUTION]
        state[S_SENSOR_RAW + i] = raw
        state[S_SENSOR_MEAN + i] += params[P_SENSOR_MEAN_GAIN] * (raw - state[S_SENSOR_MEAN + i])
        state[S_SENSOR_FORCE + i] = raw - state[S_SENSOR_TARE + i]


@kernel
def inner_step(state: Numbers, params: Numbers) -> None:
    """One step of servo, arm, hand and sensors, for the set-points of the outer loop."""
    r0 = params[P_R0]
    radius = r0 + state[S_JOINT]
    cosine, sine = state[S_COSINE], state[S_SINE]
    # What the controller knows: the set-points' speed, the encoders and the calibrated sensor.
    seen = r0 + state[S_ENCODER]
    along, turn = state[S_SET_JOINT_VELOCITY], state[S_SET_JOINT_VELOCITY + 1]
    joint_loads(state, params, seen, cosine, sine, along, turn, S_SENSOR_FORCE)
    state[S_DRIVE_LIMITED] = 0.0
    for joint in range(3):
        servo(state, params, joint)
    # What happens.
    along, turn = state[S_JOINT_VELOCITY], state[S_JOINT_VELOCITY + 1]
    joint_loads(state, params, radius, cosine, sine, along, turn, S_HAND_FORCE)
    for joint in range(3):
        move_joint(state, params, joint, radius if joint == 1 else 1.0)
    radius = r0 + state[S_JOINT]
    phi = state[S_JOINT + 1]
    cosine, sine = math.cos(phi), math.sin(phi)
    state[S_COSINE], state[S_SINE] = cosine, sine
    along, across = state[S_JOINT_VELOCITY], state[S_JOINT_VELOCITY + 1] * radius
    move_hand(
        state, params,
        radius * cosine - r0, radius * sine, state[S_JOINT + 2],
        cosine * along - sine * across, sine * along + cosine * across, state[S_JOINT_VELOCITY + 2],
    )  # fmt: skip
    sense_force(state, params)

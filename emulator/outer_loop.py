"""Outer loop: from the measured force to set-points, by way of a virtual mass with effects and shapes.

One step is the trapezoidal rule on the forces linearised at the predicted middle of the step::

    (m I + h/2 B + h^2/4 K) dv = h F(x + h/2 v, v)        x' = x + h (v + v')/2

with dry friction as an impulse of bounded size at its end (Karnopp's stick without a threshold of speed).
Linear springs keep their energy exactly, a constant force gives the closed form, friction holds without
creeping.
"""

import math

from emulator.compilation import Indices, Numbers, kernel
from emulator.effects import add_bias_force, add_damper, add_isotropic, add_shaker, add_spring, anchor_offset
from emulator.layout import (
    E_GRIP,
    E_GRIP_NORMAL,
    E_KIND,
    E_VELOCITY,
    KIND_BIAS_FORCE,
    KIND_BLOCK,
    KIND_DAMPER,
    KIND_SHAKER,
    KIND_SPRING,
    MODE_DRIVE,
    MODE_HOLD,
    MODE_RENDER,
    P_ACCELERATION_MAX,
    P_HOMING_ACCELERATION,
    P_HOMING_RATE,
    P_HOMING_SPEED,
    P_JOINT_MAX,
    P_JOINT_MIN,
    P_R0,
    P_RATE,
    P_SHAKER_RAMP,
    P_SHAKER_SWEEP,
    P_STEP,
    P_STOP_DAMPING_RATIO,
    P_STOP_DECELERATION,
    P_STOP_STIFFNESS,
    P_STOP_ZONE,
    P_VELOCITY_MAX,
    ROW_MAX,
    S_ACCELERATION,
    S_ACCELERATION_LIMITED,
    S_AT_END_STOP,
    S_CONTACT_FORCE,
    S_COULOMB_FRICTION,
    S_DRIVE_SPEED,
    S_DRIVE_TARGET,
    S_EFFECT_FORCE,
    S_ENCODER,
    S_FORCE,
    S_INERTIA,
    S_INVERSE,
    S_LIMITED_STEPS,
    S_MATRIX,
    S_MODE,
    S_POSITION,
    S_SENSOR_FORCE,
    S_SET_JOINT,
    S_SET_JOINT_ACCELERATION,
    S_SET_JOINT_VELOCITY,
    S_USE_EFFECTS,
    S_USE_SENSOR,
    S_VELOCITY,
    S_VELOCITY_LIMITED,
)
from emulator.shapes import add_matrix, add_shape, spring_share

_TINY = 1e-12


@kernel
def add_effects(
    state: Numbers,
    params: Numbers,
    effects: Numbers,
    active: Indices,
    n_active: int,
) -> None:
    """Add the forces of all enabled effects at the predicted middle of the step."""
    step = params[P_STEP]
    vx, vy, vz = state[S_VELOCITY], state[S_VELOCITY + 1], state[S_VELOCITY + 2]
    x = state[S_POSITION] + 0.5 * step * vx
    y = state[S_POSITION + 1] + 0.5 * step * vy
    z = state[S_POSITION + 2] + 0.5 * step * vz
    for i in range(n_active):
        row = active[i]
        if row < 0 or row > ROW_MAX:
            continue  # never; but the compiler then knows that an index does not count from the end
        kind = effects[row + E_KIND]
        if kind >= KIND_BLOCK:
            add_shape(state, effects, row, x, y, z, vx, vy, vz, step)
        elif kind == KIND_BIAS_FORCE:
            add_bias_force(state, effects, row)
        else:
            dx, dy, dz, ux, uy, uz = anchor_offset(effects, row, x, y, z, vx, vy, vz)
            if kind == KIND_SPRING:
                add_spring(state, effects, row, dx, dy, dz, ux, uy, uz, step)
            elif kind == KIND_DAMPER:
                add_damper(state, effects, row, ux, uy, uz, step)
            elif kind == KIND_SHAKER:
                sweep, ramp = params[P_SHAKER_SWEEP], params[P_SHAKER_RAMP]
                add_shaker(state, effects, row, dx, dy, dz, ux, uy, uz, step, sweep, ramp)


@kernel
def add_end_stop(
    state: Numbers,
    params: Numbers,
    joint: int,
    cosine: float,
    sine: float,
    distance: float,
) -> None:
    """Add the soft end stops of one joint, at ``distance`` [m] from the column's axis."""
    ux, uy, uz, radius = cosine, sine, 0.0, 1.0
    if joint == 1:
        ux, uy, radius = -sine, cosine, distance
    elif joint == 2:
        ux, uy, uz = 0.0, 0.0, 1.0
    step = params[P_STEP]
    rate = state[S_SET_JOINT_VELOCITY + joint]
    middle = state[S_SET_JOINT + joint] + 0.5 * step * rate
    side = 1.0
    depth = (middle - params[P_JOINT_MAX + joint]) * radius + params[P_STOP_ZONE]
    other = (params[P_JOINT_MIN + joint] - middle) * radius + params[P_STOP_ZONE]
    if other > depth:
        side, depth = -1.0, other
    if depth < -0.001:
        return
    approach = side * rate * radius
    mean_depth, share = spring_share(depth, approach, step)
    if share == 0.0:
        return
    stiffness = params[P_STOP_STIFFNESS]
    b = 2.0 * params[P_STOP_DAMPING_RATIO] * math.sqrt(stiffness * state[S_INERTIA])
    force = stiffness * mean_depth + share * b * approach
    state[S_AT_END_STOP] = 1.0
    if force <= 0.0:
        return
    state[S_FORCE] -= side * force * ux
    state[S_FORCE + 1] -= side * force * uy
    state[S_FORCE + 2] -= side * force * uz
    if share == 1.0:
        add_matrix(state, ux, uy, uz, 0.25 * step * step * stiffness + 0.5 * step * b)


@kernel
def invert_matrix(state: Numbers) -> None:
    """Inverse of the symmetric positive matrix at ``S_MATRIX``, written to ``S_INVERSE``."""
    a, b, c = state[S_MATRIX], state[S_MATRIX + 1], state[S_MATRIX + 2]
    d, e, f = state[S_MATRIX + 3], state[S_MATRIX + 4], state[S_MATRIX + 5]
    co_a, co_b, co_c = d * f - e * e, c * e - b * f, b * e - c * d
    scale = 1.0 / (a * co_a + b * co_b + c * co_c)
    state[S_INVERSE] = scale * co_a
    state[S_INVERSE + 1] = scale * co_b
    state[S_INVERSE + 2] = scale * co_c
    state[S_INVERSE + 3] = scale * (a * f - c * c)
    state[S_INVERSE + 4] = scale * (b * c - a * e)
    state[S_INVERSE + 5] = scale * (a * d - b * b)


@kernel
def times_inverse(state: Numbers, x: float, y: float, z: float) -> tuple[float, float, float]:
    """The inverse at ``S_INVERSE`` times a vector."""
    xy, xz, yz = state[S_INVERSE + 1], state[S_INVERSE + 2], state[S_INVERSE + 4]
    return (
        state[S_INVERSE] * x + xy * y + xz * z,
        xy * x + state[S_INVERSE + 3] * y + yz * z,
        xz * x + yz * y + state[S_INVERSE + 5] * z,
    )


@kernel
def rub(state: Numbers, vx: float, vy: float, vz: float, bound: float) -> tuple[float, float, float]:
    """Change of velocity by dry friction against sliding at v, of an impulse within ``bound`` [N·s]."""
    speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    if speed < _TINY:
        return -vx, -vy, -vz
    ux, uy, uz = vx / speed, vy / speed, vz / speed
    wx, wy, wz = times_inverse(state, ux, uy, uz)
    impulse = speed / (ux * wx + uy * wy + uz * wz)
    if impulse <= bound:
        return -vx, -vy, -vz
    return -bound * wx, -bound * wy, -bound * wz


@kernel
def free_velocity(
    state: Numbers,
    params: Numbers,
    effects: Numbers,
    active: Indices,
    n_active: int,
    cosine: float,
    sine: float,
    radius: float,
) -> tuple[float, float, float]:
    """Velocity [m/s] at the end of the step by Newton's law, before the limits."""
    step = params[P_STEP]
    for i in range(3):
        state[S_FORCE + i] = 0.0
    for i in range(6):
        state[S_MATRIX + i] = 0.0
    add_isotropic(state, state[S_INERTIA])
    if state[S_USE_SENSOR] != 0.0:
        for i in range(3):
            state[S_FORCE + i] += state[S_SENSOR_FORCE + i]
    rubbing = 0
    if state[S_USE_EFFECTS] != 0.0:
        add_effects(state, params, effects, active, n_active)
        rubbing = n_active
    for joint in range(3):
        add_end_stop(state, params, joint, cosine, sine, radius)
    invert_matrix(state)
    dx, dy, dz = times_inverse(
        state, step * state[S_FORCE], step * state[S_FORCE + 1], step * state[S_FORCE + 2]
    )
    vx, vy, vz = state[S_VELOCITY] + dx, state[S_VELOCITY + 1] + dy, state[S_VELOCITY + 2] + dz
    for i in range(rubbing):
        row = active[i]
        if row < 0 or row > ROW_MAX or effects[row + E_KIND] < KIND_BLOCK or effects[row + E_GRIP] <= 0.0:
            continue
        nx, ny, nz = (
            effects[row + E_GRIP_NORMAL],
            effects[row + E_GRIP_NORMAL + 1],
            effects[row + E_GRIP_NORMAL + 2],
        )
        ux = vx - effects[row + E_VELOCITY]
        uy = vy - effects[row + E_VELOCITY + 1]
        uz = vz - effects[row + E_VELOCITY + 2]
        outward = ux * nx + uy * ny + uz * nz
        bound = effects[row + E_GRIP]
        dx, dy, dz = rub(state, ux - outward * nx, uy - outward * ny, uz - outward * nz, bound)
        vx, vy, vz = vx + dx, vy + dy, vz + dz
        mass = state[S_INERTIA] / step
        state[S_CONTACT_FORCE] += mass * dx
        state[S_CONTACT_FORCE + 1] += mass * dy
        state[S_CONTACT_FORCE + 2] += mass * dz
    friction = state[S_COULOMB_FRICTION]
    if friction > 0.0:
        dx, dy, dz = rub(state, vx, vy, vz, friction * step)
        vx, vy, vz = vx + dx, vy + dy, vz + dz
    return vx, vy, vz


@kernel
def braked_velocity(state: Numbers, params: Numbers) -> tuple[float, float, float]:
    """Velocity [m/s] at the end of a step in which the arm comes to rest at a constant deceleration."""
    vx, vy, vz = state[S_VELOCITY], state[S_VELOCITY + 1], state[S_VELOCITY + 2]
    speed = math.sqrt(vx * vx + vy * vy + vz * vz)
    loss = params[P_STOP_DECELERATION] * params[P_STEP]
    if speed <= loss:
        return 0.0, 0.0, 0.0
    keep = 1.0 - loss / speed
    return keep * vx, keep * vy, keep * vz


@kernel
def homing_velocity(
    state: Numbers, params: Numbers, cosine: float, sine: float, radius: float
) -> tuple[float, float, float]:
    """Velocity [m/s] at the end of a step of a drive to ``S_DRIVE_TARGET``, each joint by itself."""
    rates = (0.0, 0.0, 0.0)
    for i in range(3):
        top = params[P_HOMING_SPEED + i] * state[S_DRIVE_SPEED]
        wanted = params[P_HOMING_RATE] * (state[S_DRIVE_TARGET + i] - state[S_SET_JOINT + i])
        wanted = max(-top, min(top, wanted))
        change = params[P_HOMING_ACCELERATION + i] * params[P_STEP]
        old = state[S_SET_JOINT_VELOCITY + i]
        wanted = max(old - change, min(old + change, wanted))
        if i == 0:
            rates = (wanted, rates[1], rates[2])
        elif i == 1:
            rates = (rates[0], wanted, rates[2])
        else:
            rates = (rates[0], rates[1], wanted)
    across = rates[1] * radius
    return cosine * rates[0] - sine * across, sine * rates[0] + cosine * across, rates[2]


@kernel
def limit_velocity(
    state: Numbers,
    params: Numbers,
    vx: float,
    vy: float,
    vz: float,
    cosine: float,
    sine: float,
    radius: float,
) -> tuple[float, float, float]:
    """Velocity within the limits of acceleration (of the tip) and of velocity (of each joint)."""
    dx, dy, dz = vx - state[S_VELOCITY], vy - state[S_VELOCITY + 1], vz - state[S_VELOCITY + 2]
    size = math.sqrt(dx * dx + dy * dy + dz * dz)
    largest = params[P_ACCELERATION_MAX] * params[P_STEP]
    if size > largest:
        scale = largest / size
        vx = state[S_VELOCITY] + scale * dx
        vy = state[S_VELOCITY + 1] + scale * dy
        vz = state[S_VELOCITY + 2] + scale * dz
        state[S_ACCELERATION_LIMITED] = 1.0
    along = cosine * vx + sine * vy
    across = cosine * vy - sine * vx
    top_r, top_phi, top_z = (
        params[P_VELOCITY_MAX],
        params[P_VELOCITY_MAX + 1] * radius,
        params[P_VELOCITY_MAX + 2],
    )
    if abs(along) > top_r or abs(across) > top_phi or abs(vz) > top_z:
        along = max(-top_r, min(top_r, along))
        across = max(-top_phi, min(top_phi, across))
        vz = max(-top_z, min(top_z, vz))
        vx = cosine * along - sine * across
        vy = sine * along + cosine * across
        state[S_VELOCITY_LIMITED] = 1.0
    if state[S_ACCELERATION_LIMITED] + state[S_VELOCITY_LIMITED] > 0.0:
        state[S_LIMITED_STEPS] += 1.0
    return vx, vy, vz


@kernel
def set_points(
    state: Numbers,
    params: Numbers,
    x: float,
    y: float,
    z: float,
    vx: float,
    vy: float,
    vz: float,
) -> None:
    """Store the new position and velocity, held inside the end stops, and their joint set-points."""
    r0 = params[P_R0]
    radius = math.sqrt((r0 + x) * (r0 + x) + y * y)
    r, phi = radius - r0, math.atan2(y, r0 + x)
    cosine, sine = (r0 + x) / radius, y / radius
    low_r, high_r = params[P_JOINT_MIN], params[P_JOINT_MAX]
    low_phi, high_phi = params[P_JOINT_MIN + 1], params[P_JOINT_MAX + 1]
    low_z, high_z = params[P_JOINT_MIN + 2], params[P_JOINT_MAX + 2]
    along, across = cosine * vx + sine * vy, cosine * vy - sine * vx
    if r < low_r or r > high_r or phi < low_phi or phi > high_phi or z < low_z or z > high_z:
        state[S_AT_END_STOP] = 1.0
        along = max(along, 0.0) if r < low_r else (min(along, 0.0) if r > high_r else along)
        across = max(across, 0.0) if phi < low_phi else (min(across, 0.0) if phi > high_phi else across)
        vz = max(vz, 0.0) if z < low_z else (min(vz, 0.0) if z > high_z else vz)
        r = max(low_r, min(high_r, r))
        phi = max(low_phi, min(high_phi, phi))
        z = max(low_z, min(high_z, z))
        radius = r0 + r
        cosine, sine = math.cos(phi), math.sin(phi)
        x, y = radius * cosine - r0, radius * sine
        vx, vy = cosine * along - sine * across, sine * along + cosine * across
    rate = params[P_RATE]
    ax, ay, az = (
        (vx - state[S_VELOCITY]) * rate,
        (vy - state[S_VELOCITY + 1]) * rate,
        (vz - state[S_VELOCITY + 2]) * rate,
    )
    state[S_POSITION], state[S_POSITION + 1], state[S_POSITION + 2] = x, y, z
    state[S_VELOCITY], state[S_VELOCITY + 1], state[S_VELOCITY + 2] = vx, vy, vz
    state[S_ACCELERATION], state[S_ACCELERATION + 1], state[S_ACCELERATION + 2] = ax, ay, az
    turn = across / radius
    state[S_SET_JOINT], state[S_SET_JOINT + 1], state[S_SET_JOINT + 2] = r, phi, z
    state[S_SET_JOINT_VELOCITY] = along
    state[S_SET_JOINT_VELOCITY + 1] = turn
    state[S_SET_JOINT_VELOCITY + 2] = vz
    state[S_SET_JOINT_ACCELERATION] = cosine * ax + sine * ay + radius * turn * turn
    state[S_SET_JOINT_ACCELERATION + 1] = (cosine * ay - sine * ax - 2.0 * along * turn) / radius
    state[S_SET_JOINT_ACCELERATION + 2] = az


@kernel
def follow_arm(state: Numbers, params: Numbers) -> None:
    """Keep the virtual mass at rest where the unpowered arm is measured to be."""
    r0 = params[P_R0]
    radius, phi = r0 + state[S_ENCODER], state[S_ENCODER + 1]
    state[S_POSITION] = radius * math.cos(phi) - r0
    state[S_POSITION + 1] = radius * math.sin(phi)
    state[S_POSITION + 2] = state[S_ENCODER + 2]
    for i in range(3):
        state[S_VELOCITY + i] = 0.0
        state[S_ACCELERATION + i] = 0.0
        state[S_SET_JOINT + i] = state[S_ENCODER + i]
        state[S_SET_JOINT_VELOCITY + i] = 0.0
        state[S_SET_JOINT_ACCELERATION + i] = 0.0


@kernel
def outer_step(
    state: Numbers,
    params: Numbers,
    effects: Numbers,
    active: Indices,
    n_active: int,
) -> None:
    """One step of the virtual mass, in the mode that the state machine has chosen."""
    for i in range(3):
        state[S_EFFECT_FORCE + i] = 0.0
        state[S_CONTACT_FORCE + i] = 0.0
    state[S_VELOCITY_LIMITED] = 0.0
    state[S_ACCELERATION_LIMITED] = 0.0
    state[S_AT_END_STOP] = 0.0
    mode = state[S_MODE]
    if mode < MODE_HOLD:
        follow_arm(state, params)
        return
    step = params[P_STEP]
    r0 = params[P_R0]
    x, y, z = state[S_POSITION], state[S_POSITION + 1], state[S_POSITION + 2]
    radius = r0 + state[S_SET_JOINT]
    cosine, sine = (r0 + x) / radius, y / radius
    if mode == MODE_RENDER:
        vx, vy, vz = free_velocity(state, params, effects, active, n_active, cosine, sine, radius)
        vx, vy, vz = limit_velocity(state, params, vx, vy, vz, cosine, sine, radius)
    elif mode == MODE_DRIVE:
        vx, vy, vz = homing_velocity(state, params, cosine, sine, radius)
    else:
        vx, vy, vz = braked_velocity(state, params)
    half = 0.5 * step
    x += half * (state[S_VELOCITY] + vx)
    y += half * (state[S_VELOCITY + 1] + vy)
    z += half * (state[S_VELOCITY + 2] + vz)
    set_points(state, params, x, y, z, vx, vy, vz)

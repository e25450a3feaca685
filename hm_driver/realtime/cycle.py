"""What the loop does in a cycle: admittance and position mode, their limits, and the checks below them.

Scalar functions of plain Python on flat sequences of floats, without objects, clock or I/O. The loop process
runs them interpreted on lists; a study compiles the very same functions for arrays.

Modes
    Four virtual springs of the device are moved: ``x``, ``y``, ``z`` of position mode and the *assist* in z
    of admittance mode. Each has a reference (position and velocity), a cap (the device's ``maxforce``) and a
    phase. An axis without an engaged spring is in admittance mode.

Bumpless by construction
    Engaging starts at the handle with a cap of nearly zero; releasing lowers the cap, from the force there
    is, until nothing is left. In between, the reference's velocity may change the spring's force by no more
    than the force rate, judged with the handle at rest or moving as it does now, whichever lets the reference
    follow the handle; its speed never exceeds the limit. As the smaller of two values changes no faster than
    the faster of the two, the force of each spring obeys the rate at every hand-over, mode change and update.
"""

import math
from typing import Protocol

# state: four springs of four numbers, then the rest
AXES = 3
ASSIST = 3
SPRINGS = 4
REFERENCE, VELOCITY, CAP, PHASE = 0, 1, 2, 3
SPRING_STRIDE = 4
S_BIAS = 16
S_START = 19
S_TARGET = 22
S_ELAPSED = 25
S_SEQUENCE = 26
S_FORCE = 27
S_SATURATED = 31
S_PUSH = 32
STATE_SIZE = 35

ADMITTANCE, POSITION, RELEASING = 0.0, 1.0, 2.0

# parameters
P_TICK = 0
P_FORCE_RATE = 1
P_ASSIST_RATE = 2
P_SPEED_MAX = 3
P_FOLLOW = 4
P_ASSIST_TIME = 5
P_SPRING = 6
STIFFNESS, DAMPING, FORCE_MAX = 0, 1, 2
P_STRIDE = 3
P_BIAS_MAX = 18
P_BIAS_RATE = 19
P_R0 = 20
P_JOINT = 21
P_JOINT_SPEED = 27
P_SPEED_TRIP = 30
P_FORCE_TRIP = 31
P_BY_FORCE = 32
PARAMETER_SIZE = 33

# set-point, in the order of `setpoint.SetPoint`
U_SEQUENCE, U_ASSIST, U_ENGAGE, U_TARGET, U_VELOCITY, U_BIAS = 0, 1, 2, 5, 8, 11
SETPOINT_SIZE = 14

# measurement: position, velocity, force
M_POSITION, M_VELOCITY, M_FORCE = 0, 3, 6
MEASUREMENT_SIZE = 9

# trips
OK, TRIP_DATA, TRIP_WORKSPACE, TRIP_VELOCITY, TRIP_FORCE = 0, 1, 2, 3, 4


class Floats(Protocol):
    """A flat sequence of floats: a list where the loop runs, an array where a study compiles it."""

    def __getitem__(self, index: int, /) -> float:
        """Read one number."""
        ...

    def __setitem__(self, index: int, value: float, /) -> None:
        """Write one number."""
        ...


def clamp(value: float, low: float, high: float) -> float:
    """The value, or the limit that it exceeds."""
    if value < low:
        return low
    if value > high:
        return high
    return value


def follow(
    gap: float,
    target_velocity: float,
    velocity: float,
    handle_velocity: float,
    stiffness: float,
    damping: float,
    force_step: float,
    speed_max: float,
    follow_time: float,
    dt: float,
) -> float:
    """Next velocity of a reference that follows its target within the force rate.

    Args:
        gap: Target minus reference [m].
        target_velocity: Velocity of the target [m/s].
        velocity: Present velocity of the reference [m/s].
        handle_velocity: Velocity of the handle [m/s].
        stiffness: Of the spring [N/m].
        damping: Of the spring [N*s/m].
        force_step: Largest change of the spring's force in this cycle [N].
        speed_max: Largest speed of the reference [m/s].
        follow_time: Time constant of the approach [s].
        dt: True duration of the cycle [s].

    Returns:
        Velocity [m/s]. The spring's force K (r - x) + B (v - x') changes by K (v - x') dt + B dv, which is
        held within the step. A reference that would keep the rate against a handle at rest may go on as
        before however fast the hand pulls: otherwise the spring would yield to it.
    """
    inertia = stiffness * dt + damping
    brake = math.sqrt(force_step / (inertia * dt) * abs(gap))
    wanted = target_velocity + clamp(gap / follow_time, -brake, brake)
    moving = damping * velocity + stiffness * dt * handle_velocity
    low, high = (moving - force_step) / inertia, (moving + force_step) / inertia
    if stiffness * abs(velocity) * dt <= force_step:
        if velocity < low:
            low = velocity
        if velocity > high:
            high = velocity
    return clamp(clamp(wanted, low, high), -speed_max, speed_max)


def step_spring(
    s: Floats,
    p: Floats,
    spring: int,
    axis: int,
    engage: bool,  # noqa: FBT001  # flat scalars only, for the compiler
    target: float,
    target_velocity: float,
    m: Floats,
    dt: float,
) -> float:
    """Move a spring that is wanted or not yet released by a cycle, and return its commanded force [N].

    Args:
        s: State, changed in place.
        p: Parameters.
        spring: Index of the spring.
        axis: Axis that it acts on.
        engage: Whether the spring is wanted.
        target: Target of the reference [m].
        target_velocity: Velocity of the target [m/s].
        m: Measurement.
        dt: True duration of the cycle [s].
    """
    base = spring * SPRING_STRIDE
    position = m[M_POSITION + axis]
    handle_velocity = m[M_VELOCITY + axis]
    if s[base + PHASE] == ADMITTANCE:
        s[base + REFERENCE] = position
        s[base + VELOCITY] = clamp(handle_velocity, -p[P_SPEED_MAX], p[P_SPEED_MAX])
        s[base + CAP] = 0.0
    kind = P_SPRING + spring * P_STRIDE
    stiffness = p[kind + STIFFNESS]
    damping = p[kind + DAMPING]
    force_step = (p[P_ASSIST_RATE] if spring == ASSIST else p[P_FORCE_RATE]) * dt
    reference = s[base + REFERENCE]
    gap = target - reference if engage else 0.0
    wanted_velocity = target_velocity if engage else 0.0
    velocity = follow(
        gap,
        wanted_velocity,
        s[base + VELOCITY],
        handle_velocity,
        stiffness,
        damping,
        force_step,
        p[P_SPEED_MAX],
        p[P_FOLLOW],
        dt,
    )
    reference += velocity * dt
    s[base + REFERENCE] = reference
    s[base + VELOCITY] = velocity
    raw = stiffness * (reference - position) + damping * (velocity - handle_velocity)
    if engage:
        s[base + PHASE] = POSITION
        cap = s[base + CAP] + force_step
        if cap > p[kind + FORCE_MAX]:
            cap = p[kind + FORCE_MAX]
    else:
        cap = min(s[base + CAP], abs(s[S_FORCE + spring])) - force_step
        s[base + PHASE] = RELEASING
        if cap <= 0.0:
            s[base + PHASE] = ADMITTANCE
            cap = 0.0
    s[base + CAP] = cap
    return clamp(raw, -cap, cap)


def step_assist(s: Floats, p: Floats, engage: bool, m: Floats, dt: float) -> float:  # noqa: FBT001
    """Move the assist, whose reference is the low-passed height of the hand itself, and return its force [N].

    It never learns of the task: neither the stiffness, nor the depth, nor the reference force.
    """
    base = ASSIST * SPRING_STRIDE
    position = m[M_POSITION + 2]
    if s[base + PHASE] == ADMITTANCE:
        s[base + REFERENCE] = position
        if not engage:
            s[base + VELOCITY] = 0.0
            return 0.0
    slip = (position - s[base + REFERENCE]) / p[P_ASSIST_TIME]
    return step_spring(s, p, ASSIST, 2, engage, s[base + REFERENCE], slip, m, dt)


def check(s: Floats, p: Floats, m: Floats) -> int:
    """Check a measurement against the limits below every mode.

    Returns:
        ``OK`` or the trip. Cycles with a joint within 2 % of its velocity limit are counted in the state.
    """
    forward, y, z = m[M_POSITION], m[M_POSITION + 1], m[M_POSITION + 2]
    vx, vy, vz = m[M_VELOCITY], m[M_VELOCITY + 1], m[M_VELOCITY + 2]
    fx, fy, fz = m[M_FORCE], m[M_FORCE + 1], m[M_FORCE + 2]
    total = forward + y + z + vx + vy + vz + fx + fy + fz
    if total - total != 0.0:  # one of them is not finite, or their sum is beyond every number
        for i in range(MEASUREMENT_SIZE):
            if not math.isfinite(m[i]):
                return TRIP_DATA
    x = p[P_R0] + forward
    radius = math.sqrt(x * x + y * y)
    phi = math.atan2(y, x)
    r = radius - p[P_R0]
    if not (
        p[P_JOINT] <= r <= p[P_JOINT + 1]
        and p[P_JOINT + 2] <= phi <= p[P_JOINT + 3]
        and p[P_JOINT + 4] <= z <= p[P_JOINT + 5]
    ):
        return TRIP_WORKSPACE
    cosine, sine = x / radius, y / radius
    share = abs(cosine * vx + sine * vy) / p[P_JOINT_SPEED]
    around = abs(cosine * vy - sine * vx) / (radius * p[P_JOINT_SPEED + 1])
    if around > share:
        share = around
    vertical = abs(vz) / p[P_JOINT_SPEED + 2]
    if vertical > share:
        share = vertical
    if share > p[P_SPEED_TRIP]:
        return TRIP_VELOCITY
    if share >= 0.98:
        s[S_SATURATED] += 1.0
    if fx * fx + fy * fy + fz * fz > p[P_FORCE_TRIP] * p[P_FORCE_TRIP]:
        return TRIP_FORCE
    return OK


def cycle(s: Floats, p: Floats, u: Floats, m: Floats, dt: float) -> int:
    """Run one cycle: interpolate the set-point, move the springs and the bias force, check the limits.

    Args:
        s: State, ``STATE_SIZE`` floats, changed in place.
        p: Parameters, ``PARAMETER_SIZE`` floats.
        u: Set-point, ``SETPOINT_SIZE`` floats in the order of `SetPoint`.
        m: Measurement, ``MEASUREMENT_SIZE`` floats: position [m], velocity [m/s], force [N].
        dt: True duration of the cycle [s]; longer than a period where one was missed.

    Returns:
        ``OK`` or the trip code. After a trip the caller asks for release by a set-point without engagement.
    """
    trip = check(s, p, m)
    if trip == TRIP_DATA:
        return trip
    if u[U_SEQUENCE] != s[S_SEQUENCE]:
        s[S_SEQUENCE] = u[U_SEQUENCE]
        s[S_ELAPSED] = 0.0
        for axis in range(AXES):
            s[S_START + axis] = s[S_TARGET + axis]
    s[S_ELAPSED] += dt
    share = s[S_ELAPSED] / p[P_TICK]
    late = s[S_ELAPSED] > 2.0 * p[P_TICK]
    if share > 1.0:
        share = 1.0
    for axis in range(AXES):
        engage = u[U_ENGAGE + axis] > 0.5
        is_idle = s[axis * SPRING_STRIDE + PHASE] == ADMITTANCE
        position = m[M_POSITION + axis]
        if is_idle:
            s[S_START + axis] = position
        start = s[S_START + axis]
        target = start + share * (u[U_TARGET + axis] - start)
        s[S_TARGET + axis] = target
        if is_idle and not engage:
            s[axis * SPRING_STRIDE + REFERENCE] = position
            s[axis * SPRING_STRIDE + VELOCITY] = 0.0
            s[S_FORCE + axis] = 0.0
        else:
            velocity = 0.0 if late else u[U_VELOCITY + axis]
            s[S_FORCE + axis] = step_spring(s, p, axis, axis, engage, target, velocity, m, dt)
    s[S_FORCE + ASSIST] = step_assist(s, p, u[U_ASSIST] > 0.5, m, dt)
    is_by_force = p[P_BY_FORCE] > 0.5
    for axis in range(AXES):
        bias = s[S_BIAS + axis]
        if u[U_BIAS + axis] != bias:
            step = p[P_BIAS_RATE] * dt
            wanted = clamp(u[U_BIAS + axis], -p[P_BIAS_MAX], p[P_BIAS_MAX])
            bias += clamp(wanted - bias, -step, step)
            s[S_BIAS + axis] = bias
        s[S_PUSH + axis] = bias + s[S_FORCE + axis] if is_by_force else bias
    return trip

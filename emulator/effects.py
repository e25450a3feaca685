"""Effects without a surface: spring, damper, bias force and shaker, as forces on the virtual mass.

Each adds its force at the predicted middle of the step to ``S_FORCE`` and its share of the implicit step,
h/2 B + h^2/4 K, to ``S_MATRIX``: the step is then the trapezoidal rule, which keeps the energy of a linear
spring exactly.
"""

import math

from emulator.compilation import Numbers, kernel
from emulator.layout import (
    E_ACCELERATION_MAX,
    E_BIAS,
    E_DAMPING,
    E_DAMPING_GLOBAL,
    E_DAMPING_RATIO,
    E_DEADBAND,
    E_DIRECTION,
    E_FREQUENCY_1,
    E_FREQUENCY_2,
    E_HAS_DIRECTION,
    E_MAX_FORCE,
    E_PHASE,
    E_POSITION,
    E_POSITION_MAX,
    E_STIFFNESS,
    E_TIME,
    E_VELOCITY,
    E_VELOCITY_MAX,
    S_EFFECT_FORCE,
    S_FORCE,
    S_INERTIA,
    S_MATRIX,
)
from emulator.shapes import add_matrix

_TINY = 1e-12
_TWO_PI = 2.0 * math.pi


@kernel
def add_force(state: Numbers, fx: float, fy: float, fz: float) -> None:
    """Add the force of an effect [N] to the step."""
    state[S_FORCE] += fx
    state[S_FORCE + 1] += fy
    state[S_FORCE + 2] += fz
    state[S_EFFECT_FORCE] += fx
    state[S_EFFECT_FORCE + 1] += fy
    state[S_EFFECT_FORCE + 2] += fz


@kernel
def add_isotropic(state: Numbers, weight: float) -> None:
    """Add weight times the unit matrix to the matrix of the implicit step."""
    state[S_MATRIX] += weight
    state[S_MATRIX + 3] += weight
    state[S_MATRIX + 5] += weight


@kernel
def add_spring(
    state: Numbers,
    effects: Numbers,
    row: int,
    x: float,
    y: float,
    z: float,
    vx: float,
    vy: float,
    vz: float,
    step: float,
) -> None:
    """Add a spring stretched by x, y, z [m], whose end moves by vx, vy, vz [m/s] against its anchor.

    F = -k e - B v with e the stretch beyond the dead band and B = 2 zeta sqrt(k m). With a direction both
    act along it alone, and within the dead band nothing acts; but with ``dampglobal`` the damping acts
    everywhere, in all directions and against the world. The whole force is limited to ``maxforce``.
    """
    k = effects[row + E_STIFFNESS]
    b = 2.0 * effects[row + E_DAMPING_RATIO] * math.sqrt(k * state[S_INERTIA])
    band = effects[row + E_DEADBAND]
    everywhere = effects[row + E_DAMPING_GLOBAL] != 0.0
    fx, fy, fz, isotropic, along = 0.0, 0.0, 0.0, 0.0, 0.0
    if effects[row + E_HAS_DIRECTION] != 0.0:
        ux, uy, uz = (
            effects[row + E_DIRECTION],
            effects[row + E_DIRECTION + 1],
            effects[row + E_DIRECTION + 2],
        )
        stretch = x * ux + y * uy + z * uz
        over = abs(stretch) - band
        if over > 0.0:
            force = -k * math.copysign(over, stretch)
            along = 0.25 * step * step * k
            if not everywhere:
                force -= b * (vx * ux + vy * uy + vz * uz)
                along += 0.5 * step * b
            fx, fy, fz = force * ux, force * uy, force * uz
    else:
        ux, uy, uz = 0.0, 0.0, 1.0
        over = 0.0
        if band <= 0.0:
            fx, fy, fz = -k * x, -k * y, -k * z
            isotropic = 0.25 * step * step * k
            over = 1.0
        else:
            stretch = math.sqrt(x * x + y * y + z * z)
            over = stretch - band
            if over > 0.0:
                ux, uy, uz = x / stretch, y / stretch, z / stretch
                fx, fy, fz = -k * over * ux, -k * over * uy, -k * over * uz
                isotropic = 0.25 * step * step * k * over / stretch
                along = 0.25 * step * step * k - isotropic
        if over > 0.0 and not everywhere:
            fx -= b * vx
            fy -= b * vy
            fz -= b * vz
            isotropic += 0.5 * step * b
    if everywhere:
        fx -= b * (vx + effects[row + E_VELOCITY])
        fy -= b * (vy + effects[row + E_VELOCITY + 1])
        fz -= b * (vz + effects[row + E_VELOCITY + 2])
        isotropic += 0.5 * step * b
    size = math.sqrt(fx * fx + fy * fy + fz * fz)
    limit = effects[row + E_MAX_FORCE]
    if size > limit:
        scale = limit / size
        add_force(state, scale * fx, scale * fy, scale * fz)
        return
    add_force(state, fx, fy, fz)
    if isotropic != 0.0:
        add_isotropic(state, isotropic)
    if along != 0.0:
        add_matrix(state, ux, uy, uz, along)


@kernel
def add_damper(
    state: Numbers,
    effects: Numbers,
    row: int,
    vx: float,
    vy: float,
    vz: float,
    step: float,
) -> None:
    """Add a damper with a coefficient an axis [N·s/m], for the speed against its own ``vel``."""
    bx, by, bz = effects[row + E_DAMPING], effects[row + E_DAMPING + 1], effects[row + E_DAMPING + 2]
    add_force(state, -bx * vx, -by * vy, -bz * vz)
    state[S_MATRIX] += 0.5 * step * bx
    state[S_MATRIX + 3] += 0.5 * step * by
    state[S_MATRIX + 5] += 0.5 * step * bz


@kernel
def add_bias_force(state: Numbers, effects: Numbers, row: int) -> None:
    """Add a constant force [N]."""
    add_force(state, effects[row + E_BIAS], effects[row + E_BIAS + 1], effects[row + E_BIAS + 2])


@kernel
def shaker_motion(effects: Numbers, row: int, step: float, sweep: float, ramp: float) -> tuple[float, float]:
    """Displacement [m] and speed [m/s] of a shaker along its direction; moves its clock on by one step.

    A sine that sweeps from ``frequency1`` to ``frequency2`` and back, each way in ``sweep`` seconds. The
    amplitude is the largest that keeps to ``posmax``, ``velmax`` and ``accmax`` at the present frequency,
    and grows from zero in ``ramp`` seconds.
    """
    time = effects[row + E_TIME]
    turns = time / (2.0 * sweep)
    turns -= math.floor(turns)
    place = 2.0 * turns if turns < 0.5 else 2.0 - 2.0 * turns
    f1, f2 = effects[row + E_FREQUENCY_1], effects[row + E_FREQUENCY_2]
    omega = _TWO_PI * (f1 + (f2 - f1) * place)
    amplitude = effects[row + E_POSITION_MAX]
    if omega > _TINY:
        amplitude = min(amplitude, effects[row + E_VELOCITY_MAX] / omega)
        amplitude = min(amplitude, effects[row + E_ACCELERATION_MAX] / (omega * omega))
    grown = min(1.0, time / ramp)
    amplitude *= grown * grown * (3.0 - 2.0 * grown)
    phase = effects[row + E_PHASE] + omega * step
    if phase > _TWO_PI:
        phase -= _TWO_PI
    effects[row + E_PHASE] = phase
    effects[row + E_TIME] = time + step
    return amplitude * math.sin(phase), amplitude * omega * math.cos(phase)


@kernel
def add_shaker(
    state: Numbers,
    effects: Numbers,
    row: int,
    x: float,
    y: float,
    z: float,
    vx: float,
    vy: float,
    vz: float,
    step: float,
    sweep: float,
    ramp: float,
) -> None:
    """Add a spring whose anchor shakes along the effect's direction."""
    shift, speed = shaker_motion(effects, row, step, sweep, ramp)
    ux, uy, uz = effects[row + E_DIRECTION], effects[row + E_DIRECTION + 1], effects[row + E_DIRECTION + 2]
    add_spring(
        state, effects, row,
        x - shift * ux, y - shift * uy, z - shift * uz,
        vx - speed * ux, vy - speed * uy, vz - speed * uz,
        step,
    )  # fmt: skip


@kernel
def anchor_offset(
    effects: Numbers,
    row: int,
    x: float,
    y: float,
    z: float,
    vx: float,
    vy: float,
    vz: float,
) -> tuple[float, float, float, float, float, float]:
    """Position [m] and velocity [m/s] against an effect's ``pos`` and ``vel``."""
    return (
        x - effects[row + E_POSITION],
        y - effects[row + E_POSITION + 1],
        z - effects[row + E_POSITION + 2],
        vx - effects[row + E_VELOCITY],
        vy - effects[row + E_VELOCITY + 1],
        vz - effects[row + E_VELOCITY + 2],
    )

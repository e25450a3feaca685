"""Shapes: how deep a point is inside a solid, and the force with which the solid answers.

A shape is a solid whose outside is free. The depth is the distance to the nearest point of its surface, and
the normal points from there to the free side, so that the contact spring has a potential and cannot create
energy by a change of face.
"""

import math

from emulator.compilation import Numbers, kernel
from emulator.layout import (
    E_ATTITUDE,
    E_DAMPING_FORCE_MAX,
    E_DAMPING_RATIO,
    E_EJECTION_DAMPING,
    E_EJECTION_VELOCITY_MAX,
    E_FRICTION,
    E_GRIP,
    E_GRIP_NORMAL,
    E_KIND,
    E_LENGTH,
    E_NO_PULL,
    E_NORMAL,
    E_OUTWARD_FORCE_MAX,
    E_POSITION,
    E_POWER_MAX,
    E_RADIUS,
    E_RING_RADIUS,
    E_SIZE_XYZ,
    E_STIFFNESS,
    E_TANGENTIAL_DAMPING,
    E_TUBE_RADIUS,
    E_VELOCITY,
    KIND_BLOCK,
    KIND_CYLINDER,
    KIND_FLAT_PLANE,
    KIND_SPHERE,
    S_CONTACT_FORCE,
    S_FORCE,
    S_INERTIA,
    S_MATRIX,
    S_NORMAL,
)

_TINY = 1e-12


@kernel
def add_matrix(state: Numbers, nx: float, ny: float, nz: float, weight: float) -> None:
    """Add weight * n n^T to the symmetric matrix xx, xy, xz, yy, yz, zz of the implicit step."""
    state[S_MATRIX] += weight * nx * nx
    state[S_MATRIX + 1] += weight * nx * ny
    state[S_MATRIX + 2] += weight * nx * nz
    state[S_MATRIX + 3] += weight * ny * ny
    state[S_MATRIX + 4] += weight * ny * nz
    state[S_MATRIX + 5] += weight * nz * nz


@kernel
def rotate(
    qx: float, qy: float, qz: float, qw: float, x: float, y: float, z: float
) -> tuple[float, float, float]:
    """Vector turned by the unit quaternion [x, y, z, w]; negate x, y, z of it to turn back."""
    tx = 2.0 * (qy * z - qz * y)
    ty = 2.0 * (qz * x - qx * z)
    tz = 2.0 * (qx * y - qy * x)
    return (
        x + qw * tx + (qy * tz - qz * ty),
        y + qw * ty + (qz * tx - qx * tz),
        z + qw * tz + (qx * ty - qy * tx),
    )


@kernel
def shape_depth(effects: Numbers, row: int, x: float, y: float, z: float, normal: Numbers) -> float:
    """Depth [m] of a point in the shape's own frame; the normal goes to ``normal[S_NORMAL:]``."""
    kind = effects[row + E_KIND]
    nx, ny, nz = 0.0, 0.0, 1.0
    if kind == KIND_FLAT_PLANE:
        nx, ny, nz = effects[row + E_NORMAL], effects[row + E_NORMAL + 1], effects[row + E_NORMAL + 2]
        depth = -(x * nx + y * ny + z * nz)
    elif kind == KIND_SPHERE:
        distance = math.sqrt(x * x + y * y + z * z)
        if distance > _TINY:
            nx, ny, nz = x / distance, y / distance, z / distance
        depth = effects[row + E_RADIUS] - distance
    elif kind == KIND_BLOCK:
        depth = 0.5 * effects[row + E_SIZE_XYZ + 2] - abs(z)
        nz = math.copysign(1.0, z)
        depth_x = 0.5 * effects[row + E_SIZE_XYZ] - abs(x)
        depth_y = 0.5 * effects[row + E_SIZE_XYZ + 1] - abs(y)
        if depth_x < depth and depth_x <= depth_y:
            depth, nx, nz = depth_x, math.copysign(1.0, x), 0.0
        elif depth_y < depth:
            depth, ny, nz = depth_y, math.copysign(1.0, y), 0.0
    elif kind == KIND_CYLINDER:
        distance = math.sqrt(x * x + y * y)
        depth = 0.5 * effects[row + E_LENGTH] - abs(z)
        nz = math.copysign(1.0, z)
        if effects[row + E_RADIUS] - distance < depth:
            depth, nz = effects[row + E_RADIUS] - distance, 0.0
            nx, ny = 1.0, 0.0
            if distance > _TINY:
                nx, ny = x / distance, y / distance
    else:
        radius = math.sqrt(x * x + y * y)
        ux, uy = 1.0, 0.0
        if radius > _TINY:
            ux, uy = x / radius, y / radius
        across = radius - effects[row + E_RING_RADIUS]
        distance = math.sqrt(across * across + z * z)
        if distance > _TINY:
            nx, ny, nz = ux * across / distance, uy * across / distance, z / distance
        depth = effects[row + E_TUBE_RADIUS] - distance
    normal[S_NORMAL] = nx
    normal[S_NORMAL + 1] = ny
    normal[S_NORMAL + 2] = nz
    return depth


@kernel
def spring_share(depth: float, approach: float, step: float) -> tuple[float, float]:
    """Mean depth over a step, and the share of the step that is spent inside.

    ``depth`` is that of the predicted middle of the step, ``approach`` its rate [m/s]. Where the surface is
    crossed within the step, the mean depth is the one whose force does exactly the work of the contact's
    potential: entering and leaving neither create nor lose energy.
    """
    half = 0.5 * step * approach
    before, after = depth - half, depth + half
    if before > 0.0 and after > 0.0:
        return depth, 1.0
    if before <= 0.0 and after <= 0.0:
        return 0.0, 0.0
    deepest = max(before, after)
    share = deepest / abs(after - before)
    return 0.5 * deepest * share, share


@kernel
def surplus_work(
    effects: Numbers,
    row: int,
    x: float,
    y: float,
    z: float,
    vx: float,
    vy: float,
    vz: float,
    step: float,
    loss: float,
    scratch: Numbers,
) -> float:
    """Work that a contact of unit stiffness would do in a step beyond the energy that it has [m²].

    ``loss`` is the change of d^2/2 that the force accounts for; it differs from the true one where the
    nearest surface changes within the step, as in the middle of a thin solid or on a diagonal of a block.
    """
    if effects[row + E_KIND] == KIND_FLAT_PLANE:
        return 0.0
    change = 0.0
    for i in range(2):
        half = step * (i - 0.5)
        depth = max(0.0, shape_depth(effects, row, x + half * vx, y + half * vy, z + half * vz, scratch))
        change += half / step * depth * depth
    return change - loss


@kernel
def add_shape(
    state: Numbers,
    effects: Numbers,
    row: int,
    mid_x: float,
    mid_y: float,
    mid_z: float,
    vx: float,
    vy: float,
    vz: float,
    step: float,
) -> None:
    """Add the contact force of one shape to the step of the virtual mass.

    Normal force: k d + 2 zeta sqrt(k m) d', the damping part limited to ``damping_forcemax``;
    ``ejection_damping`` acts on the outward speed above ``ejection_velmax``; ``no_pull`` forbids a force
    into the shape; ``outward_forcemax`` and ``powermax`` limit what pushes outwards. Friction is left to
    the end of the step as a bound (``E_GRIP``).
    """
    effects[row + E_GRIP] = 0.0
    qx, qy, qz = effects[row + E_ATTITUDE], effects[row + E_ATTITUDE + 1], effects[row + E_ATTITUDE + 2]
    qw = effects[row + E_ATTITUDE + 3]
    x, y, z = rotate(
        -qx, -qy, -qz, qw,
        mid_x - effects[row + E_POSITION],
        mid_y - effects[row + E_POSITION + 1],
        mid_z - effects[row + E_POSITION + 2],
    )  # fmt: skip
    depth = shape_depth(effects, row, x, y, z, state)
    rx, ry, rz = (
        vx - effects[row + E_VELOCITY],
        vy - effects[row + E_VELOCITY + 1],
        vz - effects[row + E_VELOCITY + 2],
    )
    if depth <= 0.0 and depth * depth > (rx * rx + ry * ry + rz * rz) * step * step:
        return
    nx, ny, nz = rotate(qx, qy, qz, qw, state[S_NORMAL], state[S_NORMAL + 1], state[S_NORMAL + 2])
    outward = rx * nx + ry * ny + rz * nz
    mean_depth, share = spring_share(depth, -outward, step)
    if share == 0.0:
        return
    lx, ly, lz = rotate(-qx, -qy, -qz, qw, rx, ry, rz)
    gain = surplus_work(effects, row, x, y, z, lx, ly, lz, step, -outward * step * mean_depth, state)
    stiffness = effects[row + E_STIFFNESS]
    b = 2.0 * effects[row + E_DAMPING_RATIO] * math.sqrt(stiffness * state[S_INERTIA])
    elastic = stiffness * mean_depth
    damping = -share * b * outward
    weight = 0.0
    if share == 1.0:
        weight = 0.25 * step * step * stiffness + 0.5 * step * b
    limit = effects[row + E_DAMPING_FORCE_MAX]
    if abs(damping) > limit:
        damping = math.copysign(limit, damping)
        weight = min(weight, 0.25 * step * step * stiffness)
    normal_force = elastic + damping
    excess = outward - effects[row + E_EJECTION_VELOCITY_MAX]
    if excess > 0.0:
        normal_force -= share * effects[row + E_EJECTION_DAMPING] * excess
        weight += 0.5 * step * share * effects[row + E_EJECTION_DAMPING]
    if normal_force < 0.0 and effects[row + E_NO_PULL] != 0.0:
        normal_force, weight = 0.0, 0.0
    limit = effects[row + E_OUTWARD_FORCE_MAX]
    if outward > 0.0:
        limit = min(limit, effects[row + E_POWER_MAX] / outward)
    if normal_force > limit:
        normal_force, weight = limit, 0.0
    drag = share * effects[row + E_TANGENTIAL_DAMPING]
    fx = normal_force * nx - drag * (rx - outward * nx)
    fy = normal_force * ny - drag * (ry - outward * ny)
    fz = normal_force * nz - drag * (rz - outward * nz)
    moved = step * (rx * rx + ry * ry + rz * rz)
    if gain > 0.0 and moved > _TINY:
        brake = stiffness * gain / moved
        fx, fy, fz = fx - brake * rx, fy - brake * ry, fz - brake * rz
    drag *= 0.5 * step
    add_matrix(state, nx, ny, nz, weight - drag)
    state[S_MATRIX] += drag
    state[S_MATRIX + 3] += drag
    state[S_MATRIX + 5] += drag
    state[S_FORCE] += fx
    state[S_FORCE + 1] += fy
    state[S_FORCE + 2] += fz
    state[S_CONTACT_FORCE] += fx
    state[S_CONTACT_FORCE + 1] += fy
    state[S_CONTACT_FORCE + 2] += fz
    effects[row + E_GRIP] = effects[row + E_FRICTION] * max(normal_force, 0.0) * step
    effects[row + E_GRIP_NORMAL] = nx
    effects[row + E_GRIP_NORMAL + 1] = ny
    effects[row + E_GRIP_NORMAL + 2] = nz

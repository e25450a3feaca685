"""Compiled kernels of receptive field weighted regression: recursive least squares in fields that adapt.

A field minimises, by the gradient (Schaal and Atkeson 1998; the formulas are those of Schaal's rfwr.m)::

    J = 1/W sum_i w_i |e_i|^2 / (1 - w_i z_i^T P z_i)^2  +  gamma/d sum_ij D_ij^2

with the errors e_i of its own linear model, of which the quotient is the error with the sample left out.
"""

import math

import numpy as np
from numba import njit

from teaching import kernels, shape_kernels
from teaching.kernels import FloatArray
from teaching.shape_kernels import COUNT, CROSS, FORGETTING, SQUARE, TAU, WEIGHT


def block_size(n_inputs: int, n_outputs: int) -> int:
    """Numbers in a block: what any adaptive field has, H of shape (d + 1, m), the upper triangle of R."""
    n1 = n_inputs + 1
    return int(shape_kernels.shape_end(n_inputs)) + n1 * n_outputs + n1 * (n1 + 1) // 2


@njit(cache=True, nogil=True, error_model="numpy")
def recursive_step(
    table: FloatArray,
    i: int,
    lam: float,
    w: float,
    Y: FloatArray,
    k: int,
    z: FloatArray,
    g: FloatArray,
    e: FloatArray,
) -> tuple[float, float, float]:
    """Recursive least squares of field i with its own lam; leaves P z in g and the new error in e.

    Returns the squared error before, the squared error after, and the leverage h = w z^T P z.
    """
    n1, m = z.shape[0], Y.shape[1]
    d = n1 - 1
    parameters = d + d * n1 // 2
    covariance = parameters + n1 * m
    books = kernels.first_book(d, m)
    for j in range(n1):
        g[j] = 0.0
    row = covariance
    for j in range(n1):
        g[j] += table[row, i] * z[j]
        row += 1
        for c in range(j + 1, n1):
            g[j] += table[row, i] * z[c]
            g[c] += table[row, i] * z[j]
            row += 1
    spread = 0.0
    for j in range(n1):
        spread += z[j] * g[j]
    s = 1.0 / (lam / w + spread)
    remainder = 1.0 - s * spread
    before, after = 0.0, 0.0
    for o in range(m):
        error = Y[k, o]
        for j in range(n1):
            error -= table[parameters + j * m + o, i] * z[j]
        for j in range(n1):
            table[parameters + j * m + o, i] += g[j] * s * error
        e[o] = error * remainder
        before += error * error
        after += e[o] * e[o]
        table[books + kernels.SQUARES + o, i] *= lam
        table[books + kernels.SQUARES + o, i] += w * remainder * error * error
    table[books + kernels.FREEDOM, i] = lam * table[books + kernels.FREEDOM, i] + w * remainder
    row = covariance
    for j in range(n1):
        for c in range(j, n1):
            table[row, i] = (table[row, i] - s * g[j] * g[c]) / lam
            row += 1
    for j in range(n1):
        g[j] *= s / w
    table[books + kernels.SAMPLES, i] += 1.0
    return before, after, s * spread


@njit(cache=True, nogil=True, error_model="numpy")
def cost_slope(
    blocks: FloatArray,
    b: int,
    W: float,
    w: float,
    before: float,
    h: float,
    g: FloatArray,
    e: FloatArray,
) -> tuple[float, float]:
    """First and second derivative of the leave-one-out cost of block b by the weight w of a sample.

    g is P z of the sample, e its error with the new parameters, before its squared error with the old ones.
    """
    n1, m = g.shape[0], e.shape[0]
    H = shape_kernels.shape_end(n1 - 1)
    with_H = 0.0
    for j in range(n1):
        for o in range(m):
            with_H += g[j] * e[o] * blocks[b, H + j * m + o]
    with_R = 0.0
    row = H + n1 * m
    for j in range(n1):
        with_R += g[j] * g[j] * blocks[b, row]
        row += 1
        for c in range(j + 1, n1):
            with_R += 2.0 * g[j] * g[c] * blocks[b, row]
            row += 1
    E = blocks[b, CROSS]
    after = 0.0
    for o in range(m):
        after += e[o] * e[o]
    first = -E / (W * W) + (before - 2.0 * with_H - 2.0 * with_R) / W
    zPz = h / w
    second = (
        -before / (W * W)
        + 2.0 * with_H * (1.0 / W + 2.0 * zPz) / W
        + 2.0 * after * zPz / W
        - (before - 2.0 * with_H) / (W * W)
        + 2.0 * E / (W * W * W)
    )
    return first, second


@njit(cache=True, nogil=True, error_model="numpy")
def gather(
    blocks: FloatArray,
    b: int,
    lam: float,
    held: float,
    w: float,
    before: float,
    after: float,
    h: float,
    z: FloatArray,
    e: FloatArray,
) -> None:
    """Add a sample to the sufficient statistics of block b: E, H and R, after they were used."""
    n1, m = z.shape[0], e.shape[0]
    blocks[b, CROSS] = lam * blocks[b, CROSS] + w * before
    blocks[b, SQUARE] = lam * blocks[b, SQUARE] + w * after
    share = held * w / (1.0 - h)
    row = shape_kernels.shape_end(n1 - 1)
    for j in range(n1):
        for o in range(m):
            blocks[b, row] = lam * blocks[b, row] + share * z[j] * e[o] / (1.0 - h)
            row += 1
    for j in range(n1):
        for c in range(j, n1):
            blocks[b, row] = lam * blocks[b, row] + share * w * before * z[j] * z[c]
            row += 1


@njit(cache=True, nogil=True, error_model="numpy")
def learn(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    blocks: FloatArray,
    i: int,
    w: float,
    Y: FloatArray,
    k: int,
    z: FloatArray,
    g: FloatArray,
    v: FloatArray,
    e: FloatArray,
    inverse: FloatArray,
) -> None:
    """Let field i learn a sample: parameters, then shape, then statistics."""
    d, m = z.shape[0] - 1, Y.shape[1]
    b = int(table[shape_kernels.slot_row(d, m), i])
    books = kernels.first_book(d, m)
    chosen = kernels.D0 + d * (d + 1) // 2
    lam = blocks[b, FORGETTING]
    before, after, h = recursive_step(table, i, lam, w, Y, k, z, g, e)
    if lam < 1.0:
        axis = int(table[books + kernels.SAMPLES, i]) % (d + 1)
        covariance = d + d * (d + 1) // 2 + (d + 1) * m
        kernels.retain(table, covariance, i, d + 1, axis, (1.0 - lam) * (d + 1) / params[kernels.P0], v)
    W = lam * blocks[b, WEIGHT] + w
    blocks[b, WEIGHT] = W
    blocks[b, COUNT] = lam * blocks[b, COUNT] + 1.0
    tau = params[chosen + TAU]
    blocks[b, FORGETTING] = tau * lam + (1.0 - tau) * params[chosen + shape_kernels.LAM_FINAL]
    if table[books + kernels.SAMPLES, i] > 2 * d:
        table[books + kernels.GAIN, i] = 1.0
    if not shape_kernels.is_ready(params, blocks[b, COUNT], lam, d):
        return
    held = shape_kernels.transient(blocks, b)
    first, second = cost_slope(blocks, b, W, w, before, h, g, e)
    shape_kernels.adapt(table, blocks, params, i, b, d, m, W, w, held, first, second, z, v)
    shape_kernels.refresh(table, state, params, blocks, i, b, d, m, inverse)
    gather(blocks, b, lam, held, w, before, after, h, z, e)


@njit(cache=True, nogil=True, error_model="numpy")
def learn_2d(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    blocks: FloatArray,
    i: int,
    w: float,
    x0: float,
    x1: float,
    y: float,
) -> None:
    """As :func:`learn` for two inputs and one output, written out."""
    b = int(table[21, i])
    lam = blocks[b, FORGETTING]
    z0, z1 = x0 - table[0, i], x1 - table[1, i]
    p00, p01, p02 = table[8, i], table[9, i], table[10, i]
    p11, p12, p22 = table[11, i], table[12, i], table[13, i]
    g0 = p00 * z0 + p01 * z1 + p02
    g1 = p01 * z0 + p11 * z1 + p12
    g2 = p02 * z0 + p12 * z1 + p22
    spread = z0 * g0 + z1 * g1 + g2
    s = 1.0 / (lam / w + spread)
    error = y - table[5, i] * z0 - table[6, i] * z1 - table[7, i]
    h = s * spread
    remainder = 1.0 - h
    before = error * error
    table[17, i] = lam * table[17, i] + w * remainder
    table[20, i] = lam * table[20, i] + w * remainder * before
    table[5, i] += g0 * s * error
    table[6, i] += g1 * s * error
    table[7, i] += g2 * s * error
    e = error * remainder
    after = e * e
    scale = 1.0 / lam
    s0, s1, s2 = s * g0, s * g1, s * g2
    table[8, i] = (p00 - s0 * g0) * scale
    table[9, i] = (p01 - s0 * g1) * scale
    table[10, i] = (p02 - s0 * g2) * scale
    table[11, i] = (p11 - s1 * g1) * scale
    table[12, i] = (p12 - s1 * g2) * scale
    table[13, i] = (p22 - s2 * g2) * scale
    table[14, i] += 1.0
    if lam < 1.0:
        axis = int(table[14, i]) % 3
        r0 = table[8 + axis, i]
        r1 = table[9 if axis == 0 else 10 + axis, i]
        r2 = table[10 if axis == 0 else 11 + axis, i]
        information = (1.0 - lam) * 3.0 / params[kernels.P0]
        share = information / (1.0 + information * (r0 if axis == 0 else r1 if axis == 1 else r2))
        table[8, i] -= share * r0 * r0
        table[9, i] -= share * r0 * r1
        table[10, i] -= share * r0 * r2
        table[11, i] -= share * r1 * r1
        table[12, i] -= share * r1 * r2
        table[13, i] -= share * r2 * r2
    W = lam * blocks[b, WEIGHT] + w
    blocks[b, WEIGHT] = W
    blocks[b, COUNT] = lam * blocks[b, COUNT] + 1.0
    chosen = kernels.D0 + 3
    tau = params[chosen + TAU]
    blocks[b, FORGETTING] = tau * lam + (1.0 - tau) * params[chosen + shape_kernels.LAM_FINAL]
    if table[14, i] > 4.0:
        table[18, i] = 1.0
    if not shape_kernels.is_ready(params, blocks[b, COUNT], lam, 2):
        return
    held = shape_kernels.transient(blocks, b)
    g0, g1, g2 = s0 / w, s1 / w, s2 / w
    with_H = e * (g0 * blocks[b, 14] + g1 * blocks[b, 15] + g2 * blocks[b, 16])
    with_R = g0 * (g0 * blocks[b, 17] + 2.0 * (g1 * blocks[b, 18] + g2 * blocks[b, 19]))
    with_R += g1 * (g1 * blocks[b, 20] + 2.0 * g2 * blocks[b, 21]) + g2 * g2 * blocks[b, 22]
    E, over = blocks[b, CROSS], 1.0 / W
    first = ((before - 2.0 * with_H - 2.0 * with_R) - E * over) * over
    zPz = h / w
    second = 2.0 * over * (2.0 * with_H * (over + zPz) + after * zPz - before * over + E * over * over)
    u00, u01, u11 = blocks[b, 5], blocks[b, 6], blocks[b, 7]
    D00, D01, D11 = table[2, i], table[3, i], table[4, i]
    share = 2.0 * w * over * (params[chosen + shape_kernels.PENALTY] / 2.0)
    v0, v1 = u00 * z0 + u01 * z1, u11 * z1
    largest = max(abs(u00), abs(u01), abs(u11))
    is_full = params[chosen + shape_kernels.IS_DIAGONAL] == 0.0
    for element in range(5, 8):
        v = v1 if element == 7 else v0
        z = z0 if element == 5 else z1
        if element == 5:
            product, bend = u00 * D00 + u01 * D01, 2.0 * D00 + 4.0 * u00 * u00
        elif element == 6:
            product, bend = u00 * D01 + u01 * D11, 2.0 * D11 + 4.0 * u01 * u01
        else:
            product, bend = u11 * D11, 2.0 * D11 + 4.0 * u11 * u11
        if is_full or element != 6:
            slope = -w * v * z
            gradient = slope * first + 2.0 * share * product
            curvature = (slope * slope / w - w * z * z) * first + slope * slope * second + share * bend
            shape_kernels.step(blocks, params, b, element, chosen, 3, largest, held, gradient, curvature)
    u00, u01, u11 = blocks[b, 5], blocks[b, 6], blocks[b, 7]
    table[2, i] = u00 * u00
    table[3, i] = u00 * u01
    table[4, i] = u01 * u01 + u11 * u11
    wide, high = 1.0 / u00, 1.0 / u11
    across = -u01 * wide * high
    reach = wide * wide + across * across
    table[16, i] = reach + high * high
    state[kernels.REACH] = max(state[kernels.REACH], math.sqrt(reach))
    blocks[b, CROSS] = lam * E + w * before
    blocks[b, SQUARE] = lam * blocks[b, SQUARE] + w * after
    share = held * w / remainder
    with_e, with_R = share * e / remainder, share * w * before
    blocks[b, 14] = lam * blocks[b, 14] + with_e * z0
    blocks[b, 15] = lam * blocks[b, 15] + with_e * z1
    blocks[b, 16] = lam * blocks[b, 16] + with_e
    blocks[b, 17] = lam * blocks[b, 17] + with_R * z0 * z0
    blocks[b, 18] = lam * blocks[b, 18] + with_R * z0 * z1
    blocks[b, 19] = lam * blocks[b, 19] + with_R * z0
    blocks[b, 20] = lam * blocks[b, 20] + with_R * z1 * z1
    blocks[b, 21] = lam * blocks[b, 21] + with_R * z1
    blocks[b, 22] = lam * blocks[b, 22] + with_R


@njit(cache=True, nogil=True, error_model="numpy")
def update(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    blocks: FloatArray,
    X: FloatArray,
    Y: FloatArray,
    start: int,
    scratch: FloatArray | None,
) -> int:
    """As :func:`teaching.kernels.update`, with fields that adapt."""
    n: int = X.shape[0]
    d, m = X.shape[1], Y.shape[1]
    z, g, v, e, inverse = np.empty(d + 1), np.empty(d + 1), np.empty(d + 1), np.empty(m), np.empty((d, d))
    Q = np.empty(table.shape[1])
    z[d] = 1.0
    q_cut = state[kernels.Q_CUT]
    for k in range(start, n):
        if state[kernels.N_MODELS] >= table.shape[1]:
            return k
        if not (kernels.is_finite(X, k) and kernels.is_finite(Y, k)):
            return -1 - k
        extent = math.sqrt(q_cut) * state[kernels.REACH]
        low, high = kernels.window(table, int(state[kernels.N_MODELS]), X[k, 0], extent)
        kernels.exponents(table, d, low, high, X, k, Q)
        q1, q2 = math.inf, math.inf
        first, second = -1, -1
        for i in range(low, high):
            q = Q[i - low]
            if q >= q_cut:
                continue
            if q < q1:
                q2, second = q1, first
                q1, first = q, i
            elif q < q2:
                q2, second = q, i
            w = math.exp(-0.5 * q)
            if scratch is None:
                learn_2d(table, state, params, blocks, i, w, X[k, 0], X[k, 1], Y[k, 0])
            else:
                for j in range(d):
                    z[j] = X[k, j] - table[j, i]
                learn(table, state, params, blocks, i, w, Y, k, z, g, v, e, inverse)
        if math.exp(-0.5 * q1) <= params[kernels.W_GEN]:
            place, _ = shape_kernels.admit(table, state, params, blocks, X, k, m, first, q1, inverse)
            if scratch is None:
                learn_2d(table, state, params, blocks, place, 1.0, X[k, 0], X[k, 1], Y[k, 0])
            else:
                z[:d] = 0.0
                learn(table, state, params, blocks, place, 1.0, Y, k, z, g, v, e, inverse)
        else:
            shape_kernels.prune(table, state, params, blocks, d, m, first, second, q2)
        state[kernels.N_SAMPLES] += 1.0
    return n

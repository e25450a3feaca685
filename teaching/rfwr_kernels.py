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
def update(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    blocks: FloatArray,
    X: FloatArray,
    Y: FloatArray,
    start: int,
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
            for j in range(d):
                z[j] = X[k, j] - table[j, i]
            learn(table, state, params, blocks, i, math.exp(-0.5 * q), Y, k, z, g, v, e, inverse)
        if math.exp(-0.5 * q1) <= params[kernels.W_GEN]:
            place, _ = shape_kernels.admit(table, state, params, blocks, X, k, m, first, q1, inverse)
            for j in range(d):
                z[j] = 0.0
            learn(table, state, params, blocks, place, 1.0, Y, k, z, g, v, e, inverse)
        else:
            shape_kernels.prune(table, state, params, blocks, d, m, first, second, q2)
        state[kernels.N_SAMPLES] += 1.0
    return n

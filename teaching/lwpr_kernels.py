"""Compiled kernels of locally weighted projection regression: a few directions in each field.

A field regresses along R directions u_r that partial least squares finds one after the other, so that what
a sample costs grows with R d and not with d^2, and inputs that carry nothing cost no accuracy
(Vijayakumar, D'Souza and Schaal 2005; the formulas are those of LWPR 1.2.6)::

    s_r = u_r^T x_r;   x_(r+1) = x_r - s_r p_r;   res_(r+1) = res_r - beta_r s_r

with x and y about their weighted means. Here they are taken about the means before the sample, with the
weight that makes the sums exact (Welford), so that one input is weighted least squares to the last digit.
All outputs share the fields; each has its own directions.

The projections together are one linear model, kept in the table's M: predicting costs what it costs in
:mod:`teaching.kernels`.
"""

import math
from typing import Final

import numpy as np
from numba import njit

from teaching import kernels, shape_kernels
from teaching.kernels import FloatArray
from teaching.shape_kernels import COUNT, FORGETTING, TAU, WEIGHT

# parameter vector, behind that of any adaptive field
ADD_BELOW: Final = shape_kernels.PARAMETERS
PROJECTIONS: Final = shape_kernels.PARAMETERS + 1

# a block, behind what any adaptive field has: the number of directions, samples of the comparison of the
# last two, means of x; then for each direction its count; then for each output the numbers below
DIRECTIONS: Final = 0
COMPARED: Final = 1
MEAN: Final = 2

# of an output: mean of y, the sum of squared errors, and of the last two directions; then its directions
MEAN_Y: Final = 0
SQUARE: Final = 1
LAST: Final = 2
BUT_ONE: Final = 3
OUTPUT: Final = 4

# of a direction: sums of s^2 and s res, cross-validation error, the statistics H and R; then u, SXY, SSX
SS: Final = 0
SY: Final = 1
CROSS: Final = 2
H: Final = 3
R: Final = 4
DIRECTION: Final = 5


@njit(cache=True, nogil=True, error_model="numpy")
def output_at(d: int, n_most: int, o: int) -> int:
    """First number in a block of output o, with room for n_most directions."""
    return shape_kernels.shape_end(d) + MEAN + d + n_most + o * (OUTPUT + n_most * (DIRECTION + 3 * d))


def block_size(n_inputs: int, n_outputs: int, n_most: int) -> int:
    """Numbers in a block with room for n_most directions."""
    return int(output_at(n_inputs, n_most, n_outputs))


@njit(cache=True, nogil=True, error_model="numpy")
def project(
    blocks: FloatArray, b: int, at: int, d: int, n: int, x: FloatArray, s: FloatArray, Xr: FloatArray
) -> None:
    """Fill s, shape (n,), and the residual inputs Xr, shape (n, d), of x along the directions from at on."""
    for j in range(d):
        Xr[0, j] = x[j]
    for r in range(n):
        u = at + r * (DIRECTION + 3 * d) + DIRECTION
        total = 0.0
        for j in range(d):
            total += blocks[b, u + j] * Xr[r, j]
        s[r] = total
        if r + 1 < n:
            share = total / blocks[b, u - DIRECTION + SS]
            for j in range(d):
                Xr[r + 1, j] = Xr[r, j] - share * blocks[b, u + 2 * d + j]


@njit(cache=True, nogil=True, error_model="numpy")
def regress(
    blocks: FloatArray,
    b: int,
    at: int,
    d: int,
    n: int,
    lam: float,
    weight: float,
    prior: float,
    residual: float,
    e_cv: FloatArray,
    s: FloatArray,
    Xr: FloatArray,
) -> None:
    """Learn along the n directions from at on; leaves the error of the first r + 1 of them in e_cv[r]."""
    slow = 0.9 + 0.1 * lam
    kept = (1.0 - lam) * prior
    for r in range(n):
        a = at + r * (DIRECTION + 3 * d)
        u, SXY, SSX = a + DIRECTION, a + DIRECTION + d, a + DIRECTION + 2 * d
        target = residual
        residual -= blocks[b, a + SY] / blocks[b, a + SS] * s[r]
        e_cv[r] = residual
        norm, along = 0.0, 0.0
        for j in range(d):
            blocks[b, SXY + j] = slow * blocks[b, SXY + j] + weight * target * Xr[r, j]
            norm += blocks[b, SXY + j] ** 2
            along += blocks[b, SXY + j] * blocks[b, u + j]
        if norm > 1e-200:
            # the only direction of one input must not turn round against the sums that were taken along it
            norm = (math.copysign(1.0, along) if d == 1 else 1.0) / math.sqrt(norm)
            for j in range(d):
                blocks[b, u + j] = norm * blocks[b, SXY + j]
        ws = weight * s[r]
        blocks[b, a + SS] = lam * blocks[b, a + SS] + ws * s[r] + kept
        blocks[b, a + SY] = lam * blocks[b, a + SY] + ws * target
        for j in range(d):
            blocks[b, SSX + j] = lam * blocks[b, SSX + j] + ws * Xr[r, j]


@njit(cache=True, nogil=True, error_model="numpy")
def combine(
    table: FloatArray,
    blocks: FloatArray,
    i: int,
    b: int,
    o: int,
    at: int,
    d: int,
    m: int,
    n: int,
    t: FloatArray,
) -> None:
    """Put the linear model of output o along its first n directions into M of field i; t is scratch."""
    mean = shape_kernels.shape_end(d) + MEAN
    for j in range(d):
        t[j] = 0.0
    for r in range(n - 1, -1, -1):
        a = at + OUTPUT + r * (DIRECTION + 3 * d)
        u, SSX = a + DIRECTION, a + DIRECTION + 2 * d
        along = 0.0
        for j in range(d):
            along += blocks[b, SSX + j] * t[j]
        share = (blocks[b, a + SY] - along) / blocks[b, a + SS]
        for j in range(d):
            t[j] += share * blocks[b, u + j]
    row = d + d * (d + 1) // 2
    constant = blocks[b, at + MEAN_Y]
    for j in range(d):
        table[row + j * m + o, i] = t[j]
        constant += t[j] * (table[j, i] - blocks[b, mean + j])
    table[row + d * m + o, i] = constant


@njit(cache=True, nogil=True, error_model="numpy")
def open_direction(blocks: FloatArray, b: int, d: int, m: int, n_most: int, r: int, prior: float) -> None:
    """Begin direction r of every output of block b along input r."""
    for o in range(m):
        a = output_at(d, n_most, o) + OUTPUT + r * (DIRECTION + 3 * d)
        blocks[b, a + SS] = prior
        blocks[b, a + DIRECTION + r] = 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def trusted(blocks: FloatArray, b: int, d: int) -> int:
    """Number of directions that block b predicts with: the last one waits for 2 d samples of its own."""
    own = shape_kernels.shape_end(d)
    n = int(blocks[b, own + DIRECTIONS])
    return n - 1 if n > 1 and blocks[b, own + MEAN + d + n - 1] <= 2.0 * d else n


@njit(cache=True, nogil=True, error_model="numpy")
def compare(
    blocks: FloatArray,
    params: FloatArray,
    b: int,
    d: int,
    m: int,
    lam: float,
    prior: float,
) -> None:
    """Add a direction to block b where the last one has lowered the error enough.

    The errors with and without it are compared over the same samples, since it came.
    """
    own = shape_kernels.shape_end(d)
    chosen = kernels.D0 + d * (d + 1) // 2
    n, n_most = int(blocks[b, own + DIRECTIONS]), int(params[chosen + PROJECTIONS])
    compared = blocks[b, own + COMPARED]
    if n >= n_most or not (compared * (1.0 - lam) > 0.5 or compared >= 20.0 * d):
        return
    is_worth_it = False
    for o in range(m):
        at = output_at(d, n_most, o)
        if blocks[b, at + LAST] + 1e-300 < params[chosen + ADD_BELOW] * blocks[b, at + BUT_ONE]:
            is_worth_it = True
    if not is_worth_it:
        return
    open_direction(blocks, b, d, m, n_most, n, prior)
    blocks[b, own + DIRECTIONS] = n + 1
    blocks[b, own + COMPARED] = 0.0
    for o in range(m):
        at = output_at(d, n_most, o)
        blocks[b, at + LAST] = 0.0
        blocks[b, at + BUT_ONE] = 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def learn(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    blocks: FloatArray,
    i: int,
    w: float,
    X: FloatArray,
    Y: FloatArray,
    k: int,
    z: FloatArray,
    s: FloatArray,
    e_cv: FloatArray,
    Xr: FloatArray,
    inverse: FloatArray,
) -> None:
    """Let field i learn sample k: its means, its directions, its shape.

    Scratch: z, shape (d,), s and e_cv, (n_most,), Xr, (n_most + 1, d), and inverse, (d, d).
    """
    d, m = X.shape[1], Y.shape[1]
    b = int(table[shape_kernels.slot_row(d, m), i])
    books = kernels.first_book(d, m)
    chosen = kernels.D0 + d * (d + 1) // 2
    n_most = int(params[chosen + PROJECTIONS])
    own = shape_kernels.shape_end(d)
    mean, counts = own + MEAN, own + MEAN + d
    n, n_used = int(blocks[b, own + DIRECTIONS]), trusted(blocks, b, d)
    lam, prior = blocks[b, FORGETTING], 1.0 / params[kernels.P0]
    before = lam * blocks[b, WEIGHT]
    W = before + w
    gain, weight = w / W, w * before / W
    is_ready = shape_kernels.is_ready(params, blocks[b, COUNT], lam, d)
    held, ratio_above, ratio_below = 0.0, 0.0, 0.0
    if is_ready:
        for o in range(m):
            at = output_at(d, n_most, o)
            ratio_above += blocks[b, at + SQUARE]
            ratio_below += blocks[b, at + OUTPUT + (n_used - 1) * (DIRECTION + 3 * d) + CROSS]
        ratio = ratio_above / (ratio_below + 1e-10)
        held = min(1.0, ratio * ratio * ratio * ratio)
    for j in range(d):
        z[j] = X[k, j] - blocks[b, mean + j]
    first, second, leverage = 0.0, 0.0, 0.0
    for o in range(m):
        at = output_at(d, n_most, o)
        directions = at + OUTPUT
        dy = Y[k, o] - blocks[b, at + MEAN_Y]
        project(blocks, b, directions, d, n, z, s, Xr)
        regress(blocks, b, directions, d, n, lam, weight, prior, dy, e_cv, s, Xr)
        blocks[b, at + MEAN_Y] += gain * dy
        if o == m - 1:
            for j in range(d):
                blocks[b, mean + j] += gain * z[j]
        for j in range(d):
            Xr[n_most, j] = (1.0 - gain) * z[j]
        project(blocks, b, directions, d, n, Xr[n_most], s, Xr)
        e, h = (1.0 - gain) * dy, 0.0
        for r in range(n_used):
            a = directions + r * (DIRECTION + 3 * d)
            e -= blocks[b, a + SY] / blocks[b, a + SS] * s[r]
            h += w * s[r] * s[r] / blocks[b, a + SS]
        error = e_cv[n_used - 1]
        fresh = w * max(prior, 1.0 - h - gain)
        if n_used == n:
            blocks[b, at + LAST] = lam * blocks[b, at + LAST] + w * e_cv[n - 1] ** 2
            blocks[b, at + BUT_ONE] = lam * blocks[b, at + BUT_ONE] + w * e_cv[max(0, n - 2)] ** 2
        table[books + kernels.SQUARES + o, i] *= lam
        table[books + kernels.SQUARES + o, i] += fresh * error * error
        leverage += fresh / m
        if is_ready:
            h = min(h, 0.99)
            E = blocks[b, directions + (n_used - 1) * (DIRECTION + 3 * d) + CROSS]
            slope = error * error - E / W
            bend = 2.0 * (e * e * h / w - error * error / W) + 2.0 * E / (W * W)
            for r in range(n_used):
                a = directions + r * (DIRECTION + 3 * d)
                Ps = s[r] / blocks[b, a + SS]
                slope -= 2.0 * Ps * e * blocks[b, a + H] + 2.0 * Ps * Ps * blocks[b, a + R]
                bend += 4.0 * Ps * e * (1.0 / W + h / w) * blocks[b, a + H]
            first += slope / W
            second += bend / W
            blocks[b, at + SQUARE] = lam * blocks[b, at + SQUARE] + w * e * e
            share = held * w / (1.0 - h)
            for r in range(n):
                a = directions + r * (DIRECTION + 3 * d)
                blocks[b, a + CROSS] = lam * blocks[b, a + CROSS] + w * e_cv[r] ** 2
                blocks[b, a + H] = lam * blocks[b, a + H] + share * s[r] * error
                blocks[b, a + R] = lam * blocks[b, a + R] + share * w * error * error * s[r] * s[r]
    table[books + kernels.FREEDOM, i] = lam * table[books + kernels.FREEDOM, i] + leverage
    table[books + kernels.SAMPLES, i] += 1.0
    blocks[b, WEIGHT] = W
    blocks[b, own + COMPARED] = lam * blocks[b, own + COMPARED] + 1.0
    blocks[b, COUNT] = lam * blocks[b, COUNT] + 1.0
    for r in range(n):
        blocks[b, counts + r] = lam * blocks[b, counts + r] + 1.0
    tau = params[chosen + TAU]
    blocks[b, FORGETTING] = tau * lam + (1.0 - tau) * params[chosen + shape_kernels.LAM_FINAL]
    if table[books + kernels.SAMPLES, i] > 2 * d:
        table[books + kernels.GAIN, i] = 1.0
    n_used = trusted(blocks, b, d)
    for o in range(m):
        combine(table, blocks, i, b, o, output_at(d, n_most, o), d, m, n_used, z)
    if is_ready:
        for j in range(d):
            z[j] = X[k, j] - table[j, i]
        shape_kernels.adapt(table, blocks, params, i, b, d, m, W, w, held, first, second, z, Xr[0])
        shape_kernels.refresh(table, state, params, blocks, i, b, d, m, inverse)
    compare(blocks, params, b, d, m, lam, prior)


@njit(cache=True, nogil=True, error_model="numpy")
def begin(
    table: FloatArray,
    blocks: FloatArray,
    params: FloatArray,
    i: int,
    d: int,
    m: int,
    template: int,
) -> None:
    """Give the new field i its directions: as many as the block template has, or two."""
    b = int(table[shape_kernels.slot_row(d, m), i])
    own = shape_kernels.shape_end(d)
    n_most = int(params[kernels.D0 + d * (d + 1) // 2 + PROJECTIONS])
    n = min(2, n_most) if template < 0 else int(blocks[template, own + DIRECTIONS])
    blocks[b, own + DIRECTIONS] = n
    for r in range(n):
        open_direction(blocks, b, d, m, n_most, r, 1.0 / params[kernels.P0])


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
    """As :func:`teaching.kernels.update`, with projections and fields that adapt."""
    n: int = X.shape[0]
    d, m = X.shape[1], Y.shape[1]
    n_most = int(params[kernels.D0 + d * (d + 1) // 2 + PROJECTIONS])
    z, s, e_cv, Xr = np.empty(d), np.empty(n_most), np.empty(n_most), np.empty((n_most + 1, d))
    inverse, Q = np.empty((d, d)), np.empty(table.shape[1])
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
            learn(table, state, params, blocks, i, math.exp(-0.5 * q), X, Y, k, z, s, e_cv, Xr, inverse)
        if math.exp(-0.5 * q1) <= params[kernels.W_GEN]:
            i, template = shape_kernels.admit(table, state, params, blocks, X, k, m, first, q1, inverse)
            begin(table, blocks, params, i, d, m, template)
            learn(table, state, params, blocks, i, 1.0, X, Y, k, z, s, e_cv, Xr, inverse)
        else:
            shape_kernels.prune(table, state, params, blocks, d, m, first, second, q2)
        state[kernels.N_SAMPLES] += 1.0
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def deviation(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    blocks: FloatArray,
    X: FloatArray,
    Y: FloatArray,
    V: FloatArray,
) -> None:
    """Fill V, shape (n, m), with the variance of LWPR's confidence at X for its predictions Y.

    With the noise and the uncertainty of each field k::

        sigma_k^2 = sum_e_cv2 / freedom (1 + w_k sum_r s_r^2 / SS_r)
        V = sum_k w_k (sigma_k^2 + (y_k - y)^2) / (sum_k w_k)^2

    which grows beyond all bounds, and is infinite, where no field is active.
    """
    d, m = X.shape[1], Y.shape[1]
    n_most = int(params[kernels.D0 + d * (d + 1) // 2 + PROJECTIONS])
    row, books = d + d * (d + 1) // 2, kernels.first_book(d, m)
    mean, slot = shape_kernels.shape_end(d) + MEAN, shape_kernels.slot_row(d, m)
    Q, z = np.empty(int(state[kernels.N_MODELS])), np.empty(d)
    s, Xr = np.empty(n_most), np.empty((n_most, d))
    for k in range(X.shape[0]):
        q_min, low, high = kernels.nearest(table, state, d, X, k, Q)
        is_unknown = q_min > state[kernels.Q_CUT] or q_min == math.inf
        for o in range(m):
            V[k, o] = math.inf if is_unknown else 0.0
        if is_unknown:
            continue
        weights = 0.0
        for i in range(low, high):
            if Q[i - low] > q_min + state[kernels.Q_CUT]:
                continue
            w = math.exp(-0.5 * Q[i - low])
            say = w * table[books + kernels.GAIN, i]
            weights += say
            b = int(table[slot, i])
            n_used = trusted(blocks, b, d)
            for o in range(m):
                directions = output_at(d, n_most, o) + OUTPUT
                y = table[row + d * m + o, i]
                for j in range(d):
                    y += table[row + j * m + o, i] * (X[k, j] - table[j, i])
                    z[j] = X[k, j] - blocks[b, mean + j]
                project(blocks, b, directions, d, n_used, z, s, Xr)
                uncertain = 1.0
                for r in range(n_used):
                    uncertain += w * s[r] * s[r] / blocks[b, directions + r * (DIRECTION + 3 * d) + SS]
                noise = table[books + kernels.SQUARES + o, i] / table[books + kernels.FREEDOM, i]
                V[k, o] += say * (uncertain * noise + (y - Y[k, o]) ** 2)
        for o in range(m):
            V[k, o] = V[k, o] / (weights * weights) if weights > 0.0 else math.inf

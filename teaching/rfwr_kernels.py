"""Compiled kernels of receptive field weighted regression: fields that adapt their own size and shape.

A field's metric is D = U^T U with an upper triangular U, which stays positive definite. Each sample moves U
down the gradient of the leave-one-out error of the field plus a penalty on small fields (Schaal and
Atkeson 1998; the formulas are those of Schaal's rfwr.m and of LWPR 1.2.6)::

    J = 1/W sum_i w_i |e_i|^2 / (1 - w_i z_i^T P z_i)^2  +  gamma/d sum_ij D_ij^2

The table is that of :mod:`teaching.kernels`, with more rows behind its books.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from teaching import kernels
from teaching.kernels import FloatArray

# parameter vector, behind the upper triangle of the initial D
PENALTY: Final = 0
RATE: Final = 1
META_RATE: Final = 2
LAM_FINAL: Final = 3
TAU: Final = 4
IS_DIAGONAL: Final = 5
PARAMETERS: Final = 6

# rows of one number, behind the books; the triangles and the statistics H and R follow
FORGETTING: Final = 0
COUNT: Final = 1
WEIGHT: Final = 2
CROSS: Final = 3
SQUARE: Final = 4
SINGLES: Final = 5

UNTRUSTED: Final = 1e-9
"""Say in predictions of a field that has seen too few samples to be trusted, by that of one that has."""


@dataclass(frozen=True, slots=True)
class AdaptiveLayout:
    """Rows of the table behind those of :class:`teaching.kernels.Layout`."""

    base: kernels.Layout

    @property
    def rows(self) -> int:
        """Number of rows of the table."""
        return statistics_row(self.base.n_inputs, self.base.n_outputs) + statistics_rows(
            self.base.n_inputs, self.base.n_outputs
        )

    @property
    def factor(self) -> int:
        """First row of the upper triangle of U."""
        return first_row(self.base.n_inputs, self.base.n_outputs) + SINGLES


def statistics_rows(d: int, m: int) -> int:
    """Number of rows of H, shape (d + 1, m), and of the upper triangle of R."""
    return (d + 1) * m + (d + 1) * (d + 2) // 2


@njit(cache=True, nogil=True, error_model="numpy")
def first_row(d: int, m: int) -> int:
    """First row behind the books."""
    return kernels.first_book(d, m) + kernels.SQUARES + m


@njit(cache=True, nogil=True, error_model="numpy")
def statistics_row(d: int, m: int) -> int:
    """First row of H, behind U, the logarithms of its rates and their memory."""
    return first_row(d, m) + SINGLES + 3 * (d * (d + 1) // 2)


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
    table: FloatArray,
    i: int,
    d: int,
    m: int,
    W: float,
    w: float,
    before: float,
    h: float,
    g: FloatArray,
    e: FloatArray,
) -> tuple[float, float]:
    """First and second derivative of the leave-one-out cost of field i by the weight w of a sample.

    g is P z of the sample, e its error with the new parameters, before its squared error with the old ones.
    """
    n1 = d + 1
    H = statistics_row(d, m)
    R = H + n1 * m
    with_H = 0.0
    for j in range(n1):
        for o in range(m):
            with_H += g[j] * e[o] * table[H + j * m + o, i]
    with_R = 0.0
    row = R
    for j in range(n1):
        with_R += g[j] * g[j] * table[row, i]
        row += 1
        for c in range(j + 1, n1):
            with_R += 2.0 * g[j] * g[c] * table[row, i]
            row += 1
    E = table[first_row(d, m) + CROSS, i]
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
def adapt(
    table: FloatArray,
    params: FloatArray,
    i: int,
    d: int,
    m: int,
    W: float,
    w: float,
    transient: float,
    first: float,
    second: float,
    z: FloatArray,
    v: FloatArray,
) -> None:
    """Move U of field i against the gradient of its cost; v is scratch of shape (d + 1,)."""
    triangle = d * (d + 1) // 2
    chosen = kernels.D0 + triangle
    penalty = params[chosen + PENALTY] / d
    meta_rate = params[chosen + META_RATE]
    is_diagonal = params[chosen + IS_DIAGONAL] != 0.0
    U = first_row(d, m) + SINGLES
    largest = 0.0
    row = U
    for r in range(d):
        v[r] = 0.0
        for c in range(r, d):
            v[r] += table[row, i] * z[c]
            largest = max(largest, abs(table[row, i]))
            row += 1
    row = U
    for r in range(d):
        for c in range(r, d):
            if is_diagonal and r != c:
                row += 1
                continue
            slope = -w * v[r] * z[c]
            product = 0.0
            for j in range(r, d):
                a, b = min(j, c), max(j, c)
                product += (
                    table[U + r * d - r * (r - 1) // 2 + j - r, i]
                    * table[d + a * d - a * (a - 1) // 2 + b - a, i]
                )
            gradient = slope * first / m + (w / W) * 4.0 * penalty * product
            rate = row + triangle
            alpha = 0.0 if meta_rate > 0.0 else math.exp(table[rate, i])
            if meta_rate > 0.0:
                memory = rate + triangle
                diagonal = d + c * d - c * (c - 1) // 2
                curvature = (slope * slope / w - w * z[c] * z[c]) * first / m + slope * slope * second / m
                curvature += (w / W) * 2.0 * penalty * (2.0 * table[diagonal, i] + 4.0 * table[row, i] ** 2)
                change = meta_rate * transient * gradient * table[memory, i]
                table[rate, i] -= min(0.1, max(-0.1, change))
                table[rate, i] = min(10.0, max(-10.0, table[rate, i]))
                alpha = math.exp(table[rate, i])
                keep = max(0.0, 1.0 - alpha * transient * curvature)
                table[memory, i] = table[memory, i] * keep - alpha * transient * gradient
            step = alpha * transient * gradient
            if abs(step) > 0.1 * largest:
                table[rate, i] -= math.log(2.0)
            else:
                table[row, i] -= step
            row += 1


@njit(cache=True, nogil=True, error_model="numpy")
def refresh(table: FloatArray, state: FloatArray, i: int, d: int, m: int, inverse: FloatArray) -> None:
    """Put D = U^T U and the size of field i in place; inverse is scratch of shape (d, d)."""
    U = first_row(d, m) + SINGLES
    row = d
    for a in range(d):
        for b in range(a, d):
            s = 0.0
            for r in range(a + 1):
                s += (
                    table[U + r * d - r * (r - 1) // 2 + a - r, i]
                    * table[U + r * d - r * (r - 1) // 2 + b - r, i]
                )
            table[row, i] = s
            row += 1
    trace, reach = 0.0, 0.0
    for c in range(d):
        for r in range(c, -1, -1):
            s = 1.0 if r == c else 0.0
            for j in range(r + 1, c + 1):
                s -= table[U + r * d - r * (r - 1) // 2 + j - r, i] * inverse[j, c]
            inverse[r, c] = s / table[U + r * d - r * (r - 1) // 2, i]
            trace += inverse[r, c] ** 2
            if r == 0:
                reach += inverse[r, c] ** 2
    table[kernels.first_book(d, m) + kernels.SIZE, i] = trace
    state[kernels.REACH] = max(state[kernels.REACH], math.sqrt(reach))


@njit(cache=True, nogil=True, error_model="numpy")
def gather(
    table: FloatArray,
    i: int,
    d: int,
    m: int,
    lam: float,
    transient: float,
    w: float,
    before: float,
    after: float,
    h: float,
    z: FloatArray,
    e: FloatArray,
) -> None:
    """Add a sample to the sufficient statistics of field i: E, H and R, after they were used."""
    n1 = d + 1
    singles = first_row(d, m)
    H = statistics_row(d, m)
    table[singles + CROSS, i] = lam * table[singles + CROSS, i] + w * before
    table[singles + SQUARE, i] = lam * table[singles + SQUARE, i] + w * after
    share = transient * w / (1.0 - h)
    row = H
    for j in range(n1):
        for o in range(m):
            table[row, i] = lam * table[row, i] + share * z[j] * e[o] / (1.0 - h)
            row += 1
    for j in range(n1):
        for c in range(j, n1):
            table[row, i] = lam * table[row, i] + share * w * before * z[j] * z[c]
            row += 1


@njit(cache=True, nogil=True, error_model="numpy")
def begin(table: FloatArray, params: FloatArray, i: int, d: int, m: int, template: int) -> None:
    """Give the new field i the shape and rates of a template, or the initial ones where that is negative."""
    singles = first_row(d, m)
    triangle = d * (d + 1) // 2
    U = singles + SINGLES
    table[singles + FORGETTING, i] = params[kernels.LAM]
    table[kernels.first_book(d, m) + kernels.GAIN, i] = UNTRUSTED
    if template >= 0:
        for j in range(2 * triangle):
            table[U + j, i] = table[U + j, template]
        return
    for r in range(d):
        for c in range(r, d):
            s = params[kernels.D0 + r * d - r * (r - 1) // 2 + c - r]
            for j in range(r):
                base = U + j * d - j * (j - 1) // 2 - j
                s -= table[base + r, i] * table[base + c, i]
            base = U + r * d - r * (r - 1) // 2 - r
            table[base + c, i] = math.sqrt(s) if r == c else s / table[base + r, i]
            table[base + c + triangle, i] = math.log(params[kernels.D0 + triangle + RATE] + 1e-10)


@njit(cache=True, nogil=True, error_model="numpy")
def learn(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
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
    singles = first_row(d, m)
    books = kernels.first_book(d, m)
    chosen = kernels.D0 + d * (d + 1) // 2
    lam = table[singles + FORGETTING, i]
    before, after, h = recursive_step(table, i, lam, w, Y, k, z, g, e)
    if lam < 1.0:
        axis = int(table[books + kernels.SAMPLES, i]) % (d + 1)
        covariance = d + d * (d + 1) // 2 + (d + 1) * m
        kernels.retain(table, covariance, i, d + 1, axis, (1.0 - lam) * (d + 1) / params[kernels.P0], v)
    W = lam * table[singles + WEIGHT, i] + w
    table[singles + WEIGHT, i] = W
    table[singles + COUNT, i] = lam * table[singles + COUNT, i] + 1.0
    tau = params[chosen + TAU]
    table[singles + FORGETTING, i] = tau * lam + (1.0 - tau) * params[chosen + LAM_FINAL]
    if table[books + kernels.SAMPLES, i] > 2 * d:
        table[books + kernels.GAIN, i] = 1.0
    if table[singles + COUNT, i] * (1.0 - lam) <= 0.1 and table[singles + COUNT, i] < 20 * d:
        return
    ratio = table[singles + SQUARE, i] / (table[singles + CROSS, i] + 1e-10)
    transient = min(1.0, ratio * ratio * ratio * ratio)
    first, second = cost_slope(table, i, d, m, W, w, before, h, g, e)
    adapt(table, params, i, d, m, W, w, transient, first, second, z, v)
    refresh(table, state, i, d, m, inverse)
    gather(table, i, d, m, lam, transient, w, before, after, h, z, e)


@njit(cache=True, nogil=True, error_model="numpy")
def update(
    table: FloatArray, state: FloatArray, params: FloatArray, X: FloatArray, Y: FloatArray, start: int
) -> int:
    """As :func:`teaching.kernels.update`, with fields that adapt."""
    n: int = X.shape[0]
    d, m = X.shape[1], Y.shape[1]
    z, g, v, e, inverse = np.empty(d + 1), np.empty(d + 1), np.empty(d + 1), np.empty(m), np.empty((d, d))
    z[d] = 1.0
    q_cut = state[kernels.Q_CUT]
    for k in range(start, n):
        if state[kernels.N_MODELS] >= table.shape[1]:
            return k
        if not (kernels.is_finite(X, k) and kernels.is_finite(Y, k)):
            return -1 - k
        extent = math.sqrt(q_cut) * state[kernels.REACH]
        low, high = kernels.window(table, int(state[kernels.N_MODELS]), X[k, 0], extent)
        q1, q2 = math.inf, math.inf
        first, second = -1, -1
        for i in range(low, high):
            q = kernels.exponent(table, d, i, X, k)
            if q >= q_cut:
                continue
            if q < q1:
                q2, second = q1, first
                q1, first = q, i
            elif q < q2:
                q2, second = q, i
            for j in range(d):
                z[j] = X[k, j] - table[j, i]
            learn(table, state, params, i, math.exp(-0.5 * q), Y, k, z, g, v, e, inverse)
        if math.exp(-0.5 * q1) <= params[kernels.W_GEN]:
            trusted = first >= 0 and table[kernels.first_book(d, m) + kernels.GAIN, first] == 1.0
            near = math.exp(-0.5 * q1) > 0.1 * params[kernels.W_GEN]
            place = kernels.insert(table, state, params, X, k, m, 0)
            template = first + (1 if place <= first else 0)
            begin(table, params, place, d, m, template if trusted and near else -1)
            refresh(table, state, place, d, m, inverse)
            for j in range(d):
                z[j] = 0.0
            learn(table, state, params, place, 1.0, Y, k, z, g, v, e, inverse)
        elif params[kernels.PRUNE] != kernels.PRUNE_NEVER:
            q_prune = -2.0 * math.log(params[kernels.W_PRUNE])
            if q2 < q_prune and (
                params[kernels.PRUNE] == kernels.PRUNE_PAPER
                or kernels.separation(table, d, first, second) < q_prune
                or kernels.separation(table, d, second, first) < q_prune
            ):
                kernels.remove(table, state, kernels.superfluous(table, d, m, first, second))
                state[kernels.N_PRUNED] += 1.0
        state[kernels.N_SAMPLES] += 1.0
    return n

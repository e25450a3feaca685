"""Compiled kernels of the local learners: activation, prediction and recursive update.

All models of a learner live in one table of shape (rows, capacity), a structure of arrays: row by row
the components of the centres, the upper triangles of D, the parameters M, the upper triangles of P and
the books (see :class:`Layout`). The columns are kept sorted by the first component of the centre, so that
the models near a point are a window found by bisection, and cost grows with the models in the window.
A weight below the cut-off is recognised by its exponent before any exponential is taken.

The kernels hold no state of their own, release the global interpreter lock and use strict IEEE
arithmetic: the same input gives the same bits. They may be called from other compiled code.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

# state vector: what changes with learning, and the two numbers that a query needs
N_MODELS: Final = 0
N_ADDED: Final = 1
N_PRUNED: Final = 2
N_SAMPLES: Final = 3
REACH: Final = 4
Q_CUT: Final = 5
STATE_SIZE: Final = 6

# parameter vector: what a user chooses; the upper triangle of the initial D follows
W_GEN: Final = 0
W_PRUNE: Final = 1
LAM: Final = 2
P0: Final = 3
PRUNE: Final = 4
TOLERANCE: Final = 5
RATIO: Final = 6
LEVELS: Final = 7
SIZE0: Final = 8
D0: Final = 9

PRUNE_NEVER: Final = 0
PRUNE_OVERLAP: Final = 1
PRUNE_PAPER: Final = 2

# books, counted from the first row behind P
SAMPLES: Final = 0
BORN: Final = 1
SIZE: Final = 2
FREEDOM: Final = 3
GAIN: Final = 4
LEVEL: Final = 5
SQUARES: Final = 6


@dataclass(frozen=True, slots=True)
class Layout:
    """Rows of the table for n_inputs inputs and n_outputs outputs."""

    n_inputs: int
    n_outputs: int

    @property
    def metric(self) -> int:
        """First row of the upper triangle of D."""
        return self.n_inputs

    @property
    def parameters(self) -> int:
        """First row of M, shape (n_inputs + 1, n_outputs), the constant last."""
        return self.metric + self.n_inputs * (self.n_inputs + 1) // 2

    @property
    def covariance(self) -> int:
        """First row of the upper triangle of P."""
        return self.parameters + (self.n_inputs + 1) * self.n_outputs

    @property
    def books(self) -> int:
        """First row of the books, in the order of the constants SAMPLES to SQUARES."""
        return self.covariance + (self.n_inputs + 1) * (self.n_inputs + 2) // 2

    @property
    def rows(self) -> int:
        """Number of rows of the table."""
        return self.books + SQUARES + self.n_outputs


@njit(cache=True, nogil=True, error_model="numpy")
def window(table: FloatArray, n: int, centre: float, extent: float) -> tuple[int, int]:
    """Columns [low, high) whose first centre component is within extent of centre."""
    low, high = 0, n
    value = centre - extent
    while low < high:
        middle = (low + high) >> 1
        if table[0, middle] < value:
            low = middle + 1
        else:
            high = middle
    first = low
    high = n
    value = centre + extent
    while low < high:
        middle = (low + high) >> 1
        if table[0, middle] <= value:
            low = middle + 1
        else:
            high = middle
    return first, low


@njit(cache=True, nogil=True, error_model="numpy")
def first_book(d: int, m: int) -> int:
    """First row of the books, as :attr:`Layout.books`."""
    return d + d * (d + 1) // 2 + (d + 1) * m + (d + 1) * (d + 2) // 2


@njit(cache=True, nogil=True, error_model="numpy")
def exponent(table: FloatArray, d: int, i: int, X: FloatArray, k: int) -> float:
    """Twice the negative exponent of eq. (2) for model i and row k of X, shape (n, d)."""
    q = 0.0
    row = d
    for j in range(d):
        dj = X[k, j] - table[j, i]
        s = table[row, i] * dj
        row += 1
        for l in range(j + 1, d):  # noqa: E741 - the letter that follows k
            s += 2.0 * table[row, i] * (X[k, l] - table[l, i])
            row += 1
        q += s * dj
    return q


@njit(cache=True, nogil=True, error_model="numpy")
def exponents_2d(table: FloatArray, low: int, high: int, x0: float, x1: float, Q: FloatArray) -> None:
    """Fill Q, shape (high - low,) or longer, with the exponents of the models low to high at (x0, x1)."""
    c0, c1 = table[0, low:high], table[1, low:high]
    D00, D01, D11 = table[2, low:high], table[3, low:high], table[4, low:high]
    for i in range(c0.shape[0]):
        a, b = x0 - c0[i], x1 - c1[i]
        Q[i] = a * (D00[i] * a + 2.0 * D01[i] * b) + D11[i] * b * b


@njit(cache=True, nogil=True, error_model="numpy")
def exponents(table: FloatArray, d: int, low: int, high: int, X: FloatArray, k: int, Q: FloatArray) -> None:
    """Fill Q as :func:`exponents_2d` for row k of X, shape (n, d): what :func:`exponent` says, bit for bit.

    The innermost loops run over the models, so that the processor takes several of them at a time.
    """
    if d == 2:
        exponents_2d(table, low, high, X[k, 0], X[k, 1], Q)
        return
    n = high - low
    s = np.empty(n)
    for i in range(n):
        Q[i] = 0.0
    row = d
    for j in range(d):
        x, centre, metric = X[k, j], table[j, low:high], table[row, low:high]
        for i in range(s.shape[0]):
            s[i] = metric[i] * (x - centre[i])
        row += 1
        for l in range(j + 1, d):  # noqa: E741 - the letter that follows k
            x, other, metric = X[k, l], table[l, low:high], table[row, low:high]
            for i in range(s.shape[0]):
                s[i] += 2.0 * metric[i] * (x - other[i])
            row += 1
        x = X[k, j]
        for i in range(s.shape[0]):
            Q[i] += s[i] * (x - centre[i])


@njit(cache=True, nogil=True, error_model="numpy")
def smallest(Q: FloatArray, n: int) -> float:
    """Smallest of the first n numbers; infinity where there is none. Eight at a time, for speed."""
    q = Q[:n]
    a = b = c = d = e = f = g = h = math.inf
    for i in range(q.shape[0] // 8):
        j = 8 * i
        a = min(a, q[j])
        b = min(b, q[j + 1])
        c = min(c, q[j + 2])
        d = min(d, q[j + 3])
        e = min(e, q[j + 4])
        f = min(f, q[j + 5])
        g = min(g, q[j + 6])
        h = min(h, q[j + 7])
    for i in range(8 * (q.shape[0] // 8), q.shape[0]):
        a = min(a, q[i])
    return min(a, b, c, d, e, f, g, h)


@njit(cache=True, nogil=True, error_model="numpy")
def nearest(
    table: FloatArray, state: FloatArray, d: int, X: FloatArray, k: int, Q: FloatArray
) -> tuple[float, int, int]:
    """Smallest exponent q and the window of the models that may count for a prediction at X[k].

    A model counts where its weight is at least the cut-off times the largest weight, so that a
    prediction exists however far the point is from every model. Q, shape (N,), is left with the exponents
    in the window, from its first number on.
    """
    n = int(state[N_MODELS])
    q_cut = state[Q_CUT]
    low, high = window(table, n, X[k, 0], math.sqrt(2.0 * q_cut) * state[REACH])
    exponents(table, d, low, high, X, k, Q)
    q_min = smallest(Q, high - low)
    if q_min <= q_cut:
        return q_min, low, high
    exponents(table, d, 0, n, X, k, Q)
    return smallest(Q, n), 0, n


@njit(cache=True, nogil=True, error_model="numpy")
def query_in(
    table: FloatArray, state: FloatArray, x0: float, x1: float, Q: FloatArray, active: NDArray[np.int64]
) -> tuple[float, float]:
    """As :func:`query_2d`, with scratch Q and active of shape (N,)."""
    n = int(state[N_MODELS])
    q_cut = state[Q_CUT]
    low, high = window(table, n, x0, math.sqrt(2.0 * q_cut) * state[REACH])
    exponents_2d(table, low, high, x0, x1, Q)
    q_min = smallest(Q, high - low)
    if not q_min <= q_cut:
        low, high = 0, n
        exponents_2d(table, low, high, x0, x1, Q)
        q_min = smallest(Q, n)
        if q_min == math.inf:
            return 0.0, 0.0
    limit = q_min + q_cut
    n_active = 0
    for j in range(high - low):
        active[n_active] = j
        n_active += Q[j] <= limit
    total = 0.0
    weights = 0.0
    for k in range(n_active):
        j = active[k]
        i = low + j
        w = math.exp(0.5 * (q_min - Q[j])) * table[18, i]
        weights += w
        a, b = x0 - table[0, i], x1 - table[1, i]
        total += w * (table[5, i] * a + table[6, i] * b + table[7, i])
    return total / weights, math.exp(-0.5 * q_min)


@njit(cache=True, nogil=True, error_model="numpy")
def query_2d(table: FloatArray, state: FloatArray, x0: float, x1: float) -> tuple[float, float]:
    """Prediction of eq. (1) and w_max at (x0, x1), for two inputs and one output."""
    n = int(state[N_MODELS])
    return query_in(table, state, x0, x1, np.empty(n), np.empty(n, np.int64))


@njit(cache=True, nogil=True, error_model="numpy")
def predict(
    table: FloatArray,
    state: FloatArray,
    X: FloatArray,
    Y: FloatArray,
    w_max: FloatArray,
    scratch: FloatArray | None,
) -> None:
    """Fill Y, shape (n, m), with eq. (1) and w_max, shape (n,), for X, shape (n, d)."""
    d, m = X.shape[1], Y.shape[1]
    Q = np.empty(int(state[N_MODELS]))
    if scratch is None:
        active = np.empty(Q.shape[0], np.int64)
        for k in range(X.shape[0]):
            Y[k, 0], w_max[k] = query_in(table, state, X[k, 0], X[k, 1], Q, active)
        return
    parameters = d + d * (d + 1) // 2
    gain = first_book(d, m) + GAIN
    for k in range(X.shape[0]):
        q_min, low, high = nearest(table, state, d, X, k, Q)
        for o in range(m):
            Y[k, o] = 0.0
        w_max[k] = math.exp(-0.5 * q_min)
        if q_min == math.inf:
            continue
        limit = q_min + state[Q_CUT]
        weights = 0.0
        for i in range(low, high):
            q = Q[i - low]
            if q <= limit:
                w = math.exp(0.5 * (q_min - q)) * table[gain, i]
                weights += w
                for o in range(m):
                    y = table[parameters + d * m + o, i]
                    for j in range(d):
                        y += table[parameters + j * m + o, i] * (X[k, j] - table[j, i])
                    Y[k, o] += w * y
        for o in range(m):
            Y[k, o] /= weights


@njit(cache=True, nogil=True, error_model="numpy")
def deviation(
    table: FloatArray, state: FloatArray, X: FloatArray, Y: FloatArray, R: FloatArray, S: FloatArray
) -> None:
    """Fill R and S, shapes (n, m), with variances at X for its predictions Y, shape (n, m).

    R is the weighted mean of the models' own variances (noise and uncertainty of their parameters), S that
    of the squared differences between the models and the prediction. Where no model is active above the
    cut-off R is infinite: the prediction there is no more than a continuation.
    """
    d, m = X.shape[1], Y.shape[1]
    parameters = d + d * (d + 1) // 2
    covariance = parameters + (d + 1) * m
    books = first_book(d, m)
    z, Q = np.empty(d + 1), np.empty(int(state[N_MODELS]))
    z[d] = 1.0
    for k in range(X.shape[0]):
        q_min, low, high = nearest(table, state, d, X, k, Q)
        is_unknown = q_min > state[Q_CUT] or q_min == math.inf
        for o in range(m):
            R[k, o] = math.inf if is_unknown else 0.0
            S[k, o] = 0.0
        if is_unknown:
            continue
        weights = 0.0
        for i in range(low, high):
            q = Q[i - low]
            if q > q_min + state[Q_CUT]:
                continue
            w = math.exp(0.5 * (q_min - q)) * table[books + GAIN, i]
            weights += w
            for j in range(d):
                z[j] = X[k, j] - table[j, i]
            uncertain = 1.0
            row = covariance
            for j in range(d + 1):
                uncertain += table[row, i] * z[j] * z[j]
                row += 1
                for c in range(j + 1, d + 1):
                    uncertain += 2.0 * table[row, i] * z[j] * z[c]
                    row += 1
            for o in range(m):
                y = 0.0
                for j in range(d + 1):
                    y += table[parameters + j * m + o, i] * z[j]
                S[k, o] += w * (y - Y[k, o]) ** 2
                R[k, o] += w * uncertain * table[books + SQUARES + o, i] / table[books + FREEDOM, i]
        for o in range(m):
            R[k, o] /= weights
            S[k, o] /= weights


@njit(cache=True, nogil=True, error_model="numpy")
def query_std_2d(table: FloatArray, state: FloatArray, x0: float, x1: float) -> tuple[float, float, float]:
    """As :func:`query_2d`, with the standard deviation that :func:`deviation` gives as the third."""
    X, Y = np.empty((1, 2)), np.empty((1, 1))
    R, S = np.empty((1, 1)), np.empty((1, 1))
    Y[0, 0], w_max = query_2d(table, state, x0, x1)
    X[0, 0] = x0
    X[0, 1] = x1
    deviation(table, state, X, Y, R, S)
    return Y[0, 0], w_max, math.sqrt(R[0, 0] + S[0, 0])


@njit(cache=True, nogil=True, error_model="numpy")
def activations(table: FloatArray, state: FloatArray, X: FloatArray, W: FloatArray) -> None:
    """Fill W, shape (n, N), with eq. (2) for X, shape (n, d); no cut-off."""
    for k in range(X.shape[0]):
        for i in range(int(state[N_MODELS])):
            W[k, i] = math.exp(-0.5 * exponent(table, X.shape[1], i, X, k))


@njit(cache=True, nogil=True, error_model="numpy")
def count_active(table: FloatArray, state: FloatArray, X: FloatArray, q_limit: float) -> int:
    """Number of rows of X, shape (n, d), where some model's exponent is at most q_limit.

    Rows that follow each other are mostly neighbours: the model that was found last is asked first.
    """
    extent = math.sqrt(q_limit) * state[REACH]
    count, last = 0, -1
    for k in range(X.shape[0]):
        low, high = window(table, int(state[N_MODELS]), X[k, 0], extent)
        if low <= last < high and exponent(table, X.shape[1], last, X, k) <= q_limit:
            count += 1
            continue
        for i in range(low, high):
            if exponent(table, X.shape[1], i, X, k) <= q_limit:
                count += 1
                last = i
                break
    return count


@njit(cache=True, nogil=True, error_model="numpy")
def insert(
    table: FloatArray, state: FloatArray, params: FloatArray, X: FloatArray, k: int, m: int, level: int
) -> int:
    """Put a new model with centre X[k], M = 0 and P = P0 I into its sorted place; the table has room.

    At level n its D is ratio^n times the initial one, and its say in predictions is det(D) / det(D0).
    """
    d = X.shape[1]
    n = int(state[N_MODELS])
    scale = params[RATIO] ** level
    _, place = window(table, n, X[k, 0], 0.0)
    for row in range(table.shape[0]):
        for i in range(n, place, -1):
            table[row, i] = table[row, i - 1]
        table[row, place] = 0.0
    for j in range(d):
        table[j, place] = X[k, j]
    row = d
    for j in range(d * (d + 1) // 2):
        table[row, place] = params[D0 + j] * scale
        row += 1
    row += (d + 1) * m
    for j in range(d + 1):
        table[row, place] = params[P0]
        row += d + 1 - j
    table[row + BORN, place] = state[N_SAMPLES]
    table[row + SIZE, place] = params[SIZE0] / scale
    table[row + GAIN, place] = scale**d
    table[row + LEVEL, place] = level
    state[N_MODELS] += 1.0
    state[N_ADDED] += 1.0
    return place


@njit(cache=True, nogil=True, error_model="numpy")
def remove(table: FloatArray, state: FloatArray, i: int) -> None:
    """Take model i out of the table; the others keep their order."""
    n = int(state[N_MODELS])
    for row in range(table.shape[0]):
        for c in range(i, n - 1):
            table[row, c] = table[row, c + 1]
    state[N_MODELS] -= 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def learn(
    table: FloatArray,
    params: FloatArray,
    i: int,
    w: float,
    Y: FloatArray,
    k: int,
    z: FloatArray,
    g: FloatArray,
) -> None:
    """Recursive least squares of model i, eqs. (5) to (7), for the sample z = [x - c, 1], Y[k].

    Beside them the weighted squared residuals and the degrees of freedom are kept by their own exact
    recursions, so that their quotient is the local variance of the noise.

    With lam < 1 the prior's information I / P0 leaks back in at the rate at which it is forgotten, one
    axis a sample: P stays below about P0 for ever, and M is not pulled anywhere.
    """
    n1, m = z.shape[0], Y.shape[1]
    d = n1 - 1
    lam = params[LAM]
    parameters = d + d * n1 // 2
    covariance = parameters + n1 * m
    books = covariance + n1 * (n1 + 1) // 2
    for j in range(n1):
        g[j] = 0.0
    row = covariance
    for j in range(n1):
        g[j] += table[row, i] * z[j]
        row += 1
        for c in range(j + 1, n1):
            p = table[row, i]
            g[j] += p * z[c]
            g[c] += p * z[j]
            row += 1
    spread = 0.0
    for j in range(n1):
        spread += z[j] * g[j]
    s = 1.0 / (lam / w + spread)
    fresh = w * (1.0 - s * spread)
    for o in range(m):
        e = Y[k, o]
        for j in range(n1):
            e -= table[parameters + j * m + o, i] * z[j]
        table[books + SQUARES + o, i] = lam * table[books + SQUARES + o, i] + fresh * e * e
        e *= s
        for j in range(n1):
            table[parameters + j * m + o, i] += g[j] * e
    table[books + FREEDOM, i] = lam * table[books + FREEDOM, i] + fresh
    row = covariance
    scale = 1.0 / lam
    for j in range(n1):
        sg = s * g[j]
        for c in range(j, n1):
            table[row, i] = (table[row, i] - sg * g[c]) * scale
            row += 1
    if lam < 1.0:
        retain(
            table, covariance, i, n1, int(table[books + SAMPLES, i]) % n1, (1.0 - lam) * n1 / params[P0], g
        )
    table[books + SAMPLES, i] += 1.0


@njit(cache=True, nogil=True, error_model="numpy")
def retain(
    table: FloatArray, covariance: int, i: int, n1: int, axis: int, information: float, g: FloatArray
) -> None:
    """Add information along one axis to P^-1 of model i; g is scratch of shape (n1,)."""
    row = covariance
    for j in range(n1):
        for c in range(j, n1):
            if j == axis:
                g[c] = table[row, i]
            elif c == axis:
                g[j] = table[row, i]
            row += 1
    s = information / (1.0 + information * g[axis])
    row = covariance
    for j in range(n1):
        for c in range(j, n1):
            table[row, i] -= s * g[j] * g[c]
            row += 1


@njit(cache=True, nogil=True, error_model="numpy")
def separation(table: FloatArray, d: int, i: int, centre: int) -> float:
    """Exponent q of model i at the centre of another model."""
    q = 0.0
    row = d
    for j in range(d):
        dj = table[j, centre] - table[j, i]
        s = table[row, i] * dj
        row += 1
        for c in range(j + 1, d):
            s += 2.0 * table[row, i] * (table[c, centre] - table[c, i])
            row += 1
        q += s * dj
    return q


@njit(cache=True, nogil=True, error_model="numpy")
def superfluous(table: FloatArray, d: int, m: int, i: int, j: int) -> int:
    """Which of two models goes: the larger trace of D^-1, then of P, then the newer."""
    covariance = d + d * (d + 1) // 2 + (d + 1) * m
    books = first_book(d, m)
    difference = table[books + SIZE, i] - table[books + SIZE, j]
    if difference == 0.0:
        row = covariance
        for c in range(d + 1):
            difference += table[row, i] - table[row, j]
            row += d + 1 - c
    if difference == 0.0:
        difference = table[books + BORN, i] - table[books + BORN, j]
    return i if difference > 0.0 else j


@njit(cache=True, nogil=True, error_model="numpy")
def sweep_any(
    table: FloatArray,
    params: FloatArray,
    q_cut: float,
    low: int,
    high: int,
    X: FloatArray,
    Y: FloatArray,
    k: int,
    scratch: FloatArray,
    Q: FloatArray,
) -> tuple[float, int, float, int]:
    """Let the models low to high learn sample k; returns the two most active: q and column of each."""
    d = X.shape[1]
    exponents(table, d, low, high, X, k, Q)
    z, g = scratch[0], scratch[1]
    z[d] = 1.0
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
        learn(table, params, i, math.exp(-0.5 * q), Y, k, z, g)
    return q1, first, q2, second


@njit(cache=True, nogil=True, error_model="numpy")
def sweep_2d(
    table: FloatArray,
    params: FloatArray,
    q_cut: float,
    low: int,
    high: int,
    x0: float,
    x1: float,
    y: float,
    Q: FloatArray,
) -> tuple[float, int, float, int]:
    """As :func:`sweep_any` for two inputs and one output, written out: the same arithmetic."""
    exponents_2d(table, low, high, x0, x1, Q)
    lam = params[LAM]
    scale = 1.0 / lam
    information = (1.0 - lam) * 3.0 / params[P0]
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
        a, b = x0 - table[0, i], x1 - table[1, i]
        p00, p01, p02 = table[8, i], table[9, i], table[10, i]
        p11, p12, p22 = table[11, i], table[12, i], table[13, i]
        g0 = p00 * a + p01 * b + p02
        g1 = p01 * a + p11 * b + p12
        g2 = p02 * a + p12 * b + p22
        spread = a * g0 + b * g1 + g2
        s = 1.0 / (lam / w + spread)
        e = y - table[5, i] * a - table[6, i] * b - table[7, i]
        fresh = w * (1.0 - s * spread)
        table[17, i] = lam * table[17, i] + fresh
        table[20, i] = lam * table[20, i] + fresh * e * e
        e *= s
        table[5, i] += g0 * e
        table[6, i] += g1 * e
        table[7, i] += g2 * e
        s0, s1 = s * g0, s * g1
        table[8, i] = (p00 - s0 * g0) * scale
        table[9, i] = (p01 - s0 * g1) * scale
        table[10, i] = (p02 - s0 * g2) * scale
        table[11, i] = (p11 - s1 * g1) * scale
        table[12, i] = (p12 - s1 * g2) * scale
        table[13, i] = (p22 - s * g2 * g2) * scale
        if lam < 1.0:
            axis = int(table[14, i]) % 3
            r0 = 8 + axis
            r1 = 9 if axis == 0 else 10 + axis
            r2 = 10 if axis == 0 else 11 + axis
            g0, g1, g2 = table[r0, i], table[r1, i], table[r2, i]
            s = information / (1.0 + information * (g0 if axis == 0 else g1 if axis == 1 else g2))
            s0, s1 = s * g0, s * g1
            table[8, i] -= s0 * g0
            table[9, i] -= s0 * g1
            table[10, i] -= s0 * g2
            table[11, i] -= s1 * g1
            table[12, i] -= s1 * g2
            table[13, i] -= s * g2 * g2
        table[14, i] += 1.0
    return q1, first, q2, second


@njit(cache=True, nogil=True, error_model="numpy")
def sweep(
    table: FloatArray,
    params: FloatArray,
    q_cut: float,
    low: int,
    high: int,
    X: FloatArray,
    Y: FloatArray,
    k: int,
    scratch: FloatArray | None,
    Q: FloatArray,
) -> tuple[float, int, float, int]:
    """Let the models low to high learn sample k; returns the two most active: q and column of each."""
    if scratch is None:
        return sweep_2d(table, params, q_cut, low, high, X[k, 0], X[k, 1], Y[k, 0], Q)
    return sweep_any(table, params, q_cut, low, high, X, Y, k, scratch, Q)


@njit(cache=True, nogil=True, error_model="numpy")
def absorb(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    X: FloatArray,
    Y: FloatArray,
    k: int,
    scratch: FloatArray | None,
    Q: FloatArray,
) -> bool:
    """Learn sample k, then generate a model or prune one; the table has room. Says whether it generated."""
    d, m = X.shape[1], Y.shape[1]
    q_cut = state[Q_CUT]
    low, high = window(table, int(state[N_MODELS]), X[k, 0], math.sqrt(q_cut) * state[REACH])
    q1, first, q2, second = sweep(table, params, q_cut, low, high, X, Y, k, scratch, Q)
    generates: bool = math.exp(-0.5 * q1) <= params[W_GEN]
    if generates:
        place = insert(table, state, params, X, k, m, 0)
        sweep(table, params, q_cut, place, place + 1, X, Y, k, scratch, Q)
    elif params[PRUNE] != PRUNE_NEVER:
        q_prune = -2.0 * math.log(params[W_PRUNE])
        level = first_book(d, m) + LEVEL
        if (
            q2 < q_prune
            and table[level, first] == table[level, second]
            and (
                params[PRUNE] == PRUNE_PAPER
                or separation(table, d, first, second) < q_prune
                or separation(table, d, second, first) < q_prune
            )
        ):
            remove(table, state, superfluous(table, d, m, first, second))
            state[N_PRUNED] += 1.0
    state[N_SAMPLES] += 1.0
    return generates


@njit(cache=True, nogil=True, error_model="numpy")
def is_finite(X: FloatArray, k: int) -> bool:
    """Whether row k of X is finite."""
    total = 0.0
    for j in range(X.shape[1]):
        total += 0.0 * X[k, j]
    return total == 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def update(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    X: FloatArray,
    Y: FloatArray,
    start: int,
    scratch: FloatArray | None,
) -> int:
    """Learn the samples X[start:], Y[start:] one after the other, shapes (n, d) and (n, m).

    Returns the number of samples learned of all, less than n where the table is full (make room and call
    again), and -1 - k where sample k is not finite; it and what follows are not learned.
    """
    n: int = X.shape[0]
    Q = np.empty(table.shape[1])
    for k in range(start, n):
        if state[N_MODELS] >= table.shape[1]:
            return k
        if not (is_finite(X, k) and is_finite(Y, k)):
            return -1 - k
        absorb(table, state, params, X, Y, k, scratch, Q)
    return n


@njit(cache=True, nogil=True, error_model="numpy")
def missing_level(
    table: FloatArray, state: FloatArray, params: FloatArray, X: FloatArray, k: int, m: int
) -> int:
    """Coarsest level, above 0, of which no model is activated above w_gen by X[k]; -1 if there is none."""
    d = X.shape[1]
    level = first_book(d, m) + LEVEL
    q_gen = -2.0 * math.log(params[W_GEN])
    low, high = window(table, int(state[N_MODELS]), X[k, 0], math.sqrt(q_gen) * state[REACH])
    for candidate in range(1, int(params[LEVELS])):
        is_there = False
        for i in range(low, high):
            if table[level, i] == candidate and exponent(table, d, i, X, k) < q_gen:
                is_there = True
                break
        if not is_there:
            return candidate
    return -1


@njit(cache=True, nogil=True, error_model="numpy")
def update_refining(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    X: FloatArray,
    Y: FloatArray,
    start: int,
    scratch: FloatArray | None,
) -> int:
    """As :func:`update`, and a sample that the prediction misses asks for a model of the next finer level."""
    n: int = X.shape[0]
    y, w_max, Q = np.empty((1, Y.shape[1])), np.empty(1), np.empty(table.shape[1])
    for k in range(start, n):
        if state[N_MODELS] >= table.shape[1]:
            return k
        if not (is_finite(X, k) and is_finite(Y, k)):
            return -1 - k
        predict(table, state, X[k : k + 1], y, w_max, scratch)
        error, size = 0.0, 0.0
        for o in range(Y.shape[1]):
            error += (Y[k, o] - y[0, o]) ** 2
            size += Y[k, o] ** 2
        if absorb(table, state, params, X, Y, k, scratch, Q) or error <= params[TOLERANCE] ** 2 * size:
            continue
        level = missing_level(table, state, params, X, k, Y.shape[1])
        if level > 0:
            place = insert(table, state, params, X, k, Y.shape[1], level)
            table[first_book(X.shape[1], Y.shape[1]) + BORN, place] -= 1.0
            sweep(table, params, state[Q_CUT], place, place + 1, X, Y, k, scratch, Q)
    return n


def scratch_for(n_inputs: int, n_outputs: int) -> FloatArray | None:
    """Scratch that the kernels want; None selects, at compile time, what is written out for the plane."""
    return None if (n_inputs, n_outputs) == (2, 1) else np.zeros((2, n_inputs + 1))


def warm_up(n_inputs: int = 2, n_outputs: int = 1) -> None:
    """Compile what a session needs, or load it from the cache: before a loop starts, never inside it."""
    layout, scratch = Layout(n_inputs, n_outputs), scratch_for(n_inputs, n_outputs)
    table, state = np.zeros((layout.rows, 8)), np.zeros(STATE_SIZE)
    state[REACH], state[Q_CUT] = 0.05, 13.8
    D = np.full(layout.parameters - layout.metric, 400.0)
    params = np.array([0.8, 0.9, 0.99, 1e6, PRUNE_PAPER, 0.1, 4.0, 2.0, 0.005, *D])
    X, Y = np.zeros((2, n_inputs)), np.zeros((2, n_outputs))
    update(table, state, params, X, Y, 0, scratch)
    predict(table, state, X, Y, np.zeros(2), scratch)
    count_active(table, state, X, 1.0)
    query_2d(table, state, 0.0, 0.0)

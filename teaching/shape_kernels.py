"""Compiled kernels of what adaptive fields share: their shape, how it is born, moves and goes.

A field's metric is D = U^T U with an upper triangular U, which stays positive definite. Each sample moves U
against the gradient of the field's leave-one-out cost plus a penalty on small fields, with learning rates
that learn themselves (Schaal and Atkeson 1998; the formulas are those of Schaal's rfwr.m and of LWPR 1.2.6).

The table is that of :mod:`teaching.kernels` with one row more: the number of the field's block. What only
learning needs stands in the blocks, a row of an array of shape (capacity, width) for each field, so that
the table which every query walks through stays small, and what a field learns from lies together.
"""

import math
from typing import Final

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

# numbers at the beginning of a block; the triangles of U, of its log rates and of their memory follow
FORGETTING: Final = 0
COUNT: Final = 1
WEIGHT: Final = 2
CROSS: Final = 3
SQUARE: Final = 4
SINGLES: Final = 5

UNTRUSTED: Final = 1e-9
"""Say in predictions of a field that has seen too few samples to be trusted, by that of one that has."""
LARGEST_STEP: Final = 0.1
"""Largest step of U by the largest element of U; a larger one is dropped and its rate halved."""


@njit(cache=True, nogil=True, error_model="numpy")
def slot_row(d: int, m: int) -> int:
    """Row of the table that holds the number of a field's block."""
    return kernels.first_book(d, m) + kernels.SQUARES + m


@njit(cache=True, nogil=True, error_model="numpy")
def shape_end(d: int) -> int:
    """First number of a block behind what any adaptive field has."""
    return SINGLES + 3 * (d * (d + 1) // 2)


@njit(cache=True, nogil=True, error_model="numpy")
def is_ready(params: FloatArray, count: float, lam: float, d: int) -> bool:
    """Whether fields adapt at all and one has seen enough: n (1 - lam) > 0.1, or 20 d samples."""
    adapts: bool = params[kernels.D0 + d * (d + 1) // 2 + RATE] > 0.0
    return adapts and (count * (1.0 - lam) > 0.1 or count >= 20.0 * d)


@njit(cache=True, nogil=True, error_model="numpy")
def transient(blocks: FloatArray, b: int) -> float:
    """What holds the shape back while the parameters of the field are still moving, from 0 to 1."""
    ratio: float = blocks[b, SQUARE] / (blocks[b, CROSS] + 1e-10)
    return min(1.0, ratio * ratio * ratio * ratio)


@njit(cache=True, nogil=True, error_model="numpy")
def step(
    blocks: FloatArray,
    params: FloatArray,
    b: int,
    element: int,
    chosen: int,
    triangle: int,
    largest: float,
    held: float,
    gradient: float,
    curvature: float,
) -> None:
    """Move one element of U in block b, and its learning rate where that learns (IDBD of Sutton 1992)."""
    rate = element + triangle
    meta_rate = params[chosen + META_RATE]
    if meta_rate == 0.0:
        alpha = math.exp(blocks[b, rate])
    else:
        memory = rate + triangle
        change = meta_rate * held * gradient * blocks[b, memory]
        blocks[b, rate] -= min(0.1, max(-0.1, change))
        blocks[b, rate] = min(10.0, max(-10.0, blocks[b, rate]))
        alpha = math.exp(blocks[b, rate])
        keep = max(0.0, 1.0 - alpha * held * curvature)
        blocks[b, memory] = blocks[b, memory] * keep - alpha * held * gradient
    move = alpha * held * gradient
    if abs(move) > LARGEST_STEP * largest:
        blocks[b, rate] -= math.log(2.0)
    else:
        blocks[b, element] -= move


@njit(cache=True, nogil=True, error_model="numpy")
def adapt(
    table: FloatArray,
    blocks: FloatArray,
    params: FloatArray,
    i: int,
    b: int,
    d: int,
    m: int,
    W: float,
    w: float,
    held: float,
    first: float,
    second: float,
    z: FloatArray,
    v: FloatArray,
) -> None:
    """Move U of field i against the gradient of its cost.

    Args:
        table: The table of the learner.
        blocks: Its blocks.
        params: Its parameter vector.
        i: Column of the field.
        b: Its block.
        d: Number of inputs.
        m: Number of outputs.
        W: Sum of the weights that the field has seen.
        w: Weight of the sample.
        held: What :func:`transient` says.
        first: First derivative of the leave-one-out cost by w, summed over the outputs.
        second: Its second derivative.
        z: x - c of the sample, shape (d,) or more.
        v: Scratch of the same shape.
    """
    triangle = d * (d + 1) // 2
    chosen = kernels.D0 + triangle
    penalty = params[chosen + PENALTY] / d
    share = w / W
    first /= m
    second /= m
    if params[chosen + IS_DIAGONAL] != 0.0:
        largest = 0.0
        element = SINGLES
        for r in range(d):
            largest = max(largest, abs(blocks[b, element]))
            element += d - r
        element = SINGLES
        for r in range(d):
            u = blocks[b, element]
            slope = -w * u * z[r] * z[r]
            gradient = slope * first + share * 4.0 * penalty * u * u * u
            curvature = (slope * slope / w - w * z[r] * z[r]) * first + slope * slope * second
            curvature += share * 12.0 * penalty * u * u
            step(blocks, params, b, element, chosen, triangle, largest, held, gradient, curvature)
            element += d - r
        return
    largest = 0.0
    element = SINGLES
    for r in range(d):
        v[r] = 0.0
        for c in range(r, d):
            v[r] += blocks[b, element] * z[c]
            largest = max(largest, abs(blocks[b, element]))
            element += 1
    element = SINGLES
    for r in range(d):
        U_r = element
        for c in range(r, d):
            slope = -w * v[r] * z[c]
            product = 0.0
            D_rc = d + r * d - r * (r - 1) // 2 + c - r
            for j in range(r, c):
                product += blocks[b, U_r + j - r] * table[D_rc, i]
                D_rc += d - j - 1
            for j in range(c, d):
                product += blocks[b, U_r + j - r] * table[D_rc + j - c, i]
            u = blocks[b, element]
            gradient = slope * first + share * 4.0 * penalty * product
            curvature = (slope * slope / w - w * z[c] * z[c]) * first + slope * slope * second
            D_cc = d + c * d - c * (c - 1) // 2
            curvature += share * 2.0 * penalty * (2.0 * table[D_cc, i] + 4.0 * u * u)
            step(blocks, params, b, element, chosen, triangle, largest, held, gradient, curvature)
            element += 1


@njit(cache=True, nogil=True, error_model="numpy")
def refresh(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    blocks: FloatArray,
    i: int,
    b: int,
    d: int,
    m: int,
    inverse: FloatArray,
) -> None:
    """Put D = U^T U and the size of field i in place; inverse is scratch of shape (d, d)."""
    size = kernels.first_book(d, m) + kernels.SIZE
    U = SINGLES
    if params[kernels.D0 + d * (d + 1) // 2 + IS_DIAGONAL] != 0.0:
        row = 0
        trace = 0.0
        for r in range(d):
            square = blocks[b, U + row] ** 2
            table[d + row, i] = square
            trace += 1.0 / square
            row += d - r
        table[size, i] = trace
        state[kernels.REACH] = max(state[kernels.REACH], 1.0 / abs(blocks[b, U]))
        return
    row = d
    for a in range(d):
        for c in range(a, d):
            s = 0.0
            for r in range(a + 1):
                base = U + r * d - r * (r - 1) // 2 - r
                s += blocks[b, base + a] * blocks[b, base + c]
            table[row, i] = s
            row += 1
    trace, reach = 0.0, 0.0
    for c in range(d):
        for r in range(c, -1, -1):
            base = U + r * d - r * (r - 1) // 2 - r
            s = 1.0 if r == c else 0.0
            for j in range(r + 1, c + 1):
                s -= blocks[b, base + j] * inverse[j, c]
            inverse[r, c] = s / blocks[b, base + r]
            trace += inverse[r, c] ** 2
            if r == 0:
                reach += inverse[r, c] ** 2
    table[size, i] = trace
    state[kernels.REACH] = max(state[kernels.REACH], math.sqrt(reach))


@njit(cache=True, nogil=True, error_model="numpy")
def admit(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    blocks: FloatArray,
    X: FloatArray,
    k: int,
    m: int,
    first: int,
    q1: float,
    inverse: FloatArray,
) -> tuple[int, int]:
    """Make a field with its centre at X[k]; the table has room.

    It takes shape and rates from the most active field, first, where that is trusted and active above
    0.1 w_gen, and else begins with the initial ones. Returns its column, and the block of the field whose
    shape it took, or -1.
    """
    d = X.shape[1]
    slot, gain = slot_row(d, m), kernels.first_book(d, m) + kernels.GAIN
    triangle = d * (d + 1) // 2
    template = -1
    if first >= 0 and table[gain, first] == 1.0 and math.exp(-0.5 * q1) > 0.1 * params[kernels.W_GEN]:
        template = int(table[slot, first])
    b = int(state[kernels.N_MODELS])
    i = kernels.insert(table, state, params, X, k, m, 0)
    table[slot, i] = b
    table[gain, i] = UNTRUSTED
    for j in range(blocks.shape[1]):
        blocks[b, j] = 0.0
    blocks[b, FORGETTING] = params[kernels.LAM]
    if template >= 0:
        for j in range(SINGLES, SINGLES + 2 * triangle):
            blocks[b, j] = blocks[template, j]
    else:
        rate = math.log(params[kernels.D0 + triangle + RATE] + 1e-10)
        for r in range(d):
            base = SINGLES + r * d - r * (r - 1) // 2 - r
            for c in range(r, d):
                s = params[kernels.D0 + r * d - r * (r - 1) // 2 + c - r]
                for j in range(r):
                    above = SINGLES + j * d - j * (j - 1) // 2 - j
                    s -= blocks[b, above + r] * blocks[b, above + c]
                blocks[b, base + c] = math.sqrt(s) if r == c else s / blocks[b, base + r]
                blocks[b, base + c + triangle] = rate
    refresh(table, state, params, blocks, i, b, d, m, inverse)
    return i, template


@njit(cache=True, nogil=True, error_model="numpy")
def dismiss(table: FloatArray, state: FloatArray, blocks: FloatArray, d: int, m: int, i: int) -> None:
    """Take field i out of the table; the last block moves into the place of its own."""
    slot = slot_row(d, m)
    b, last = int(table[slot, i]), int(state[kernels.N_MODELS]) - 1
    kernels.remove(table, state, i)
    if b == last:
        return
    for j in range(blocks.shape[1]):
        blocks[b, j] = blocks[last, j]
    for c in range(last):
        if int(table[slot, c]) == last:
            table[slot, c] = b
            return


@njit(cache=True, nogil=True, error_model="numpy")
def prune(
    table: FloatArray,
    state: FloatArray,
    params: FloatArray,
    blocks: FloatArray,
    d: int,
    m: int,
    first: int,
    second: int,
    q2: float,
) -> None:
    """Remove one of the two most active fields, if the rule says that there is one too many."""
    if params[kernels.PRUNE] == kernels.PRUNE_NEVER:
        return
    q_prune = -2.0 * math.log(params[kernels.W_PRUNE])
    if q2 < q_prune and (
        params[kernels.PRUNE] == kernels.PRUNE_PAPER
        or kernels.separation(table, d, first, second) < q_prune
        or kernels.separation(table, d, second, first) < q_prune
    ):
        dismiss(table, state, blocks, d, m, kernels.superfluous(table, d, m, first, second))
        state[kernels.N_PRUNED] += 1.0

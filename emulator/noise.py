"""Normally distributed random numbers inside the kernels.

L'Ecuyer's MRG32k3a (Operations Research 47, 1999) is exact in double arithmetic and needs no integers, so
that compiled and plain Python agree to the last bit. Its six numbers live in the state; ``seed_random``
fills them.
"""

import math
import random

from emulator.compilation import Numbers, kernel
from emulator.layout import S_RANDOM

_M1 = 4294967087.0
_M2 = 4294944443.0
_TWO_PI = 2.0 * math.pi


def seed_random(state: Numbers, seed: int) -> None:
    """Start the generator in ``state`` for a seed."""
    source = random.Random(seed)
    for i in range(6):
        state[S_RANDOM + i] = float(source.randrange(1, int(_M2)))


@kernel
def uniform(state: Numbers) -> float:
    """The next number, evenly distributed in (0, 1)."""
    p1 = 1403580.0 * state[S_RANDOM + 1] - 810728.0 * state[S_RANDOM]
    p1 -= math.floor(p1 / _M1) * _M1
    state[S_RANDOM] = state[S_RANDOM + 1]
    state[S_RANDOM + 1] = state[S_RANDOM + 2]
    state[S_RANDOM + 2] = p1
    p2 = 527612.0 * state[S_RANDOM + 5] - 1370589.0 * state[S_RANDOM + 3]
    p2 -= math.floor(p2 / _M2) * _M2
    state[S_RANDOM + 3] = state[S_RANDOM + 4]
    state[S_RANDOM + 4] = state[S_RANDOM + 5]
    state[S_RANDOM + 5] = p2
    difference = p1 - p2
    if difference <= 0.0:
        difference += _M1
    return difference / 4294967088.0


@kernel
def normal_pair(state: Numbers) -> tuple[float, float]:
    """Two independent numbers of mean 0 and variance 1 (Box and Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(uniform(state)))
    angle = _TWO_PI * uniform(state)
    return radius * math.cos(angle), radius * math.sin(angle)

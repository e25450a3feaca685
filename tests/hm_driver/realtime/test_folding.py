import math
import random
import struct
import types

import pytest

from hm_driver.realtime import cycle
from hm_driver.realtime.core import folded_cycle
from hm_driver.realtime.folding import fold
from hm_driver.realtime.options import LoopOptions

UNUSUAL = [math.nan, math.inf, -math.inf, 1e308, 0.5, -0.5, 100.0]


def set_point(rng, sequence):
    wants = [float(rng.random() < 0.4) for _ in range(4)]
    targets = [rng.uniform(-0.1, 0.1) for _ in range(3)]
    velocities = [rng.uniform(-0.3, 0.3) for _ in range(3)]
    bias = [rng.choice([0.0, rng.uniform(-15.0, 15.0)]) for _ in range(3)]
    return [float(sequence), *wants, *targets, *velocities, *bias]


def measurement(rng):
    m = [rng.uniform(-0.1, 0.1) for _ in range(3)]
    m += [rng.uniform(-0.2, 0.2) for _ in range(3)]
    m += [rng.uniform(-30.0, 30.0) for _ in range(3)]
    if rng.random() < 0.01:
        m[rng.randrange(9)] = rng.choice(UNUSUAL)
    return m


@pytest.mark.parametrize("is_by_force", [0.0, 1.0])
def test_the_folded_cycle_computes_the_same_bit_for_bit(is_by_force):
    rng = random.Random(4)
    plain, folded = [0.0] * cycle.STATE_SIZE, [0.0] * cycle.STATE_SIZE
    p = LoopOptions(url="tcp://127.0.0.1").parameters()
    p[cycle.P_BY_FORCE] = is_by_force
    u, step, codes = set_point(rng, 0), folded_cycle(), set()
    for number in range(10_000):
        if rng.random() < 0.03:
            u = set_point(rng, number)
        m, dt = measurement(rng), rng.choice([0.001, 0.001, 0.0004, 0.01, 0.03])
        codes.add(code := cycle.cycle(plain, p, u, m, dt))
        assert step(folded, p, u, m, dt) == code
        assert struct.pack(f"{len(plain)}d", *plain) == struct.pack(f"{len(folded)}d", *folded)
    assert codes == {0, 1, 2, 3, 4}


def test_the_folded_cycle_looks_up_no_number_and_runs_no_loop():
    code = folded_cycle().__code__
    assert not [name for name in code.co_names if name.isupper()]
    assert "range" not in code.co_names
    assert "clamp" not in code.co_names


def test_functions_without_a_source_are_taken_as_they_are():
    module = types.ModuleType("nowhere")
    module.double = lambda x: 2 * x
    assert fold(module)["double"](3) == 6

"""Runs of the jitter suite that were not measured, for the tests of what reads them."""

import random

import pytest

from tools.jitter.options import JitterOptions, Limits, parse_scenario
from tools.jitter.pairing import CoursePoint, Event
from tools.jitter.result import CyclictestResult, Run, ScenarioResult
from tools.jitter.spread import Spread, new_histogram
from tools.jitter.suite import option_values
from tools.jitter.verdict import judge


def spread(median_us, *, seed=1, samples=2000, tail_us=0.0):
    rng, histogram = random.Random(seed), new_histogram()
    for _ in range(samples):
        histogram.record(int(1e3 * median_us * rng.lognormvariate(0.0, 0.3)))
    if tail_us:
        histogram.record(int(1e3 * tail_us))
    return Spread.of(histogram)


def scenario(name="none", **changes):
    values = {
        "name": name, "rate_hz": 1000.0, "duration_s": 2.0, "cycles": 2499, "missed": 1, "grid_length": 2500,
        "window_cycles": 2000, "window_missed": 0, "own_missed": 0, "canary_missed": 0,
        "device_canary_missed": 0, "drift_us_per_s": 0.2, "drift_resolution_us_per_s": 0.5,
        "lateness": spread(35.0), "canary": spread(15.0), "excess": spread(18.0), "response": spread(240.0),
        "execution": spread(200.0), "exchange": spread(150.0), "rung": "fifo", "scheduling": "fifo 80, cpu 1",
        "canary_rung": "fifo", "requests_per_cycle": 1.0, "dialect": "text", "is_combined": True,
        "cpu_us_per_cycle": 140.0, "spun_share": 0.05, "heartbeats": 200, "longest_silence_ms": 12.0,
        "loads": (), "problem": "", "own_misses_s": (),
        "course": tuple(CoursePoint(0.1 * i, 30.0, 90.0, 40.0, 60.0, 20.0, 300.0, 0, 0) for i in range(20)),
        "worst": (Event(0.5, 512, 90.0, 60.0, 30.0, 300.0),),
    }  # fmt: skip
    return ScenarioResult(**(values | changes))


@pytest.fixture
def make_scenario():
    return scenario


@pytest.fixture
def make_run():
    """A run of scenarios that were not measured."""

    def make(*scenarios, cyclictest=False, limits=None):
        results = scenarios or (scenario(),)
        limits = limits or Limits()
        options = JitterOptions(scenarios=tuple(parse_scenario(r.name) for r in results), limits=limits)
        sliced = CyclictestResult(
            slices=2, slice_s=1.0, command="cyclictest -q", cyclictest=spread(12.0), spin=spread(0.3),
            no_spin=spread(17.0),
        )  # fmt: skip
        return Run(
            started="2026-01-01T00:00:00+00:00",
            version="0.1.0",
            host={"name": "lab", "cpus": "2"},
            options=option_values(options),
            scenarios=tuple(results),
            cyclictest=sliced if cyclictest else None,
            checks=tuple(check.as_dict() for result in results for check in judge(result, limits)),
        )

    return make


@pytest.fixture
def make_spread():
    return spread

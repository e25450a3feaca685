"""The cross benchmark: two ridges and a bump under noise, learned in one pass.

``y = max{exp(-10 x1^2), exp(-50 x2^2), 1.25 exp(-5 |x|^2)} + N(0, 0.1^2)`` with x uniform on [-1, 1]^2,
one sample after the other. The error is the mean squared error of the prediction on a noiseless grid of
41 x 41 points by the variance of the noisy outputs, as Schaal and Atkeson normalise it.
"""

import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from teaching.learner import FloatArray
from teaching.local_models import LocalModels
from teaching.lwpr import LWPR
from teaching.lwr import LWR
from teaching.rfwr import RFWR

NOISE = 0.1
"""Standard deviation of the noise."""
SIZES = (1000, 5000, 10_000, 20_000, 100_000)
"""Samples after which the error is taken."""
LEARNERS: dict[str, Callable[[], LocalModels]] = {
    "LWR, D = 400": lambda: LWR(D=400.0, w_gen=0.2),
    "LWR, D = 600, w_gen = 0.6": lambda: LWR(D=600.0, w_gen=0.6),
    "LWR, D = 1000, w_gen = 0.6": lambda: LWR(D=1000.0, w_gen=0.6),
    "RFWR": lambda: RFWR(prune="never"),
    "RFWR, wide overlap": lambda: RFWR(
        D=127.0, w_gen=0.05, meta_rate=1000.0, tau=0.999, lam_final=1.0, prune="never"
    ),
    "LWPR, full D": lambda: LWPR(diagonal=False, prune="never"),
    "LWPR, diagonal D": lambda: LWPR(prune="never"),
}
"""The learners of the table."""


class CrossRow(NamedTuple):
    """One learner on the benchmark, means over the seeds."""

    learner: str
    errors: tuple[float, ...]
    """Normalised mean squared error after each size."""
    models: float
    """Models at the end."""
    updates_per_s: float
    """Samples learned by second, in batches."""


def crossed_ridges(X: FloatArray) -> FloatArray:
    """The function, shape (n,), at X, shape (n, 2)."""
    a, b = X[:, 0] ** 2, X[:, 1] ** 2
    values: FloatArray = np.maximum(
        np.maximum(np.exp(-10.0 * a), np.exp(-50.0 * b)), 1.25 * np.exp(-5.0 * (a + b))
    )
    return values


def cross_samples(n: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Noisy samples, shapes (n, 2) and (n,)."""
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1.0, 1.0, (n, 2))
    return X, crossed_ridges(X) + rng.normal(0.0, NOISE, n)


def cross_error(skill: LocalModels, outputs: FloatArray) -> float:
    """Normalised mean squared error of a learner; outputs are the noisy ones that it learned from."""
    axis = np.linspace(-1.0, 1.0, 41)
    grid = np.stack([side.ravel() for side in np.meshgrid(axis, axis)], axis=1)
    return float(np.mean((skill.predict(grid)[:, 0] - crossed_ridges(grid)) ** 2) / np.var(outputs))


def measure_cross(name: str, *, sizes: Sequence[int] = SIZES, seeds: Sequence[int] = (0, 1, 2)) -> CrossRow:
    """Run one learner of :data:`LEARNERS` over the benchmark.

    Args:
        name: Its name.
        sizes: Samples after which the error is taken, ascending.
        seeds: Seeds of the samples.
    """
    errors, models, seconds = np.zeros((len(seeds), len(sizes))), 0.0, 0.0
    for row, seed in enumerate(seeds):
        X, y = cross_samples(sizes[-1], seed)
        skill = LEARNERS[name]()
        skill.warm_up()
        done = 0
        for column, size in enumerate(sizes):
            start = time.thread_time()
            skill.partial_fit(X[done:size], y[done:size])
            seconds += time.thread_time() - start
            done = size
            errors[row, column] = cross_error(skill, y[:size])
        models += skill.n_models / len(seeds)
    mean = tuple(float(error) for error in errors.mean(axis=0))
    return CrossRow(name, mean, models, len(seeds) * sizes[-1] / max(seconds, 1e-9))

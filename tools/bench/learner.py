"""What the learners cost and how well they learn: ``python -m tools.bench.learner``, two minutes.

Calls of one point from Python are compared with plain numpy (einsum) that does the same; the two take turns
in short blocks, and each row tells the median time of both and the median ratio, so that a busy machine
disturbs little. Then batches, in points a second, many dimensions, and the cross benchmark.
"""

import time
from collections.abc import Callable
from statistics import median
from typing import NamedTuple

import numpy as np
from cyclopts import App

from teaching.learner import FloatArray
from teaching.local_models import LocalModels
from teaching.lwpr import LWPR
from teaching.lwr import LWR
from teaching.rfwr import RFWR
from tools.bench.learner_cross import LEARNERS, SIZES, CrossRow, cross_samples, measure_cross
from tools.cli.console import tell, write, write_json

CALLS: dict[str, tuple[str, int, float, float]] = {
    "predict, 100 models, all active": ("predict", 100, 40.0, 0.15),
    "predict, 1000 models, 280 active": ("predict", 1000, 950.0, 0.07),
    "predict, 1000 models, 20 active": ("predict", 1000, 13_500.0, 0.07),
    "predict, 5000 models, 20 active": ("predict", 5000, 67_700.0, 0.012),
    "update, 100 models, all active": ("update", 100, 40.0, 0.14),
    "update, 1000 models, 280 active": ("update", 1000, 950.0, 0.14),
}
"""Operation, models, D of their fields, and the goal: the largest ratio to plain numpy."""
BATCHES: dict[str, float] = {
    "predict, 60 models": 1e6,
    "update, adapting": 300e3,
}
"""Goals in points a second."""


class CallRow(NamedTuple):
    """One operation, a point a call."""

    what: str
    numpy_us: float
    """Median time of plain numpy [µs]."""
    ours_us: float
    """Median time of ours [µs]."""
    ratio: float
    """Median of the ratios of neighbouring blocks."""
    goal: float
    """Largest ratio that was asked for."""


class BatchRow(NamedTuple):
    """One operation, many points a call."""

    what: str
    models: int
    points_per_s: float
    """Best of the rounds, in processor time."""
    goal: float


class ManyRow(NamedTuple):
    """A learner of many inputs of which two matter."""

    learner: str
    inputs: int
    models: int
    error: float
    """Normalised mean squared error on fresh points without noise."""
    updates_per_s: float


def measure_call(name: str, *, rounds: int = 30, calls: int = 100) -> CallRow:
    """Measure one operation of :data:`CALLS`.

    Args:
        name: Its name.
        rounds: How often numpy and we take turns.
        calls: Calls of ours in a turn; numpy makes a fifth of them.
    """
    operation, n, D, goal = CALLS[name]
    rng = np.random.default_rng(0)
    skill = LWR(D=D, w_gen=1.0 - 1e-12, prune="never", capacity=n)
    X = rng.uniform(-0.2, 0.2, (n, 2))
    skill.partial_fit(X, X[:, 0])
    points = rng.uniform(-0.2, 0.2, (calls, 2))
    plain = PlainNumpy(skill)
    ours: Callable[[list[float]], object] = lambda x: skill.query(x[0], x[1])  # noqa: E731 - one of two
    theirs: Callable[[FloatArray], object] = plain.predict
    if operation == "update":
        # a point that is a centre makes no new model
        points = X[rng.integers(0, n, calls)]
        ours, theirs = (lambda x: skill.update(x, 0.1)), (lambda x: plain.update(x, 0.1))
    lists, arrays = points.tolist(), list(points[: max(1, calls // 5)])
    times: list[tuple[float, float]] = []
    for _ in range(rounds + 1):
        start = time.perf_counter()
        for x in arrays:
            theirs(x)
        between = time.perf_counter()
        for point in lists:
            ours(point)
        end = time.perf_counter()
        times.append(((between - start) / len(arrays), (end - between) / len(lists)))
    times = times[1:]
    return CallRow(
        name,
        1e6 * median(t for t, _ in times),
        1e6 * median(t for _, t in times),
        median(t / plain_t for plain_t, t in times),
        goal,
    )


class PlainNumpy:
    """Models of a learner for two inputs and one output, in plain numpy with einsum."""

    def __init__(self, skill: LWR) -> None:
        models = skill.models
        self.centres, self.D = models.centres, models.D
        self.M, self.P = models.M[:, :, 0].copy(), models.P.copy()

    def predict(self, x: FloatArray) -> tuple[float, float]:
        """Prediction of eq. (1) and largest activation."""
        offset = x - self.centres
        w = np.exp(-0.5 * np.einsum("ni,nij,nj->n", offset, self.D, offset))
        y = np.einsum("ni,ni->n", offset, self.M[:, :2]) + self.M[:, 2]
        return float(np.sum(w * y) / np.sum(w)), float(w.max())

    def update(self, x: FloatArray, y: float) -> None:
        """Recursive least squares of the active models, eqs. (5) to (7)."""
        offset = x - self.centres
        w = np.exp(-0.5 * np.einsum("ni,nij,nj->n", offset, self.D, offset))
        active = np.flatnonzero(w > 0.001)
        z = np.column_stack((offset[active], np.ones(len(active))))
        P = self.P[active]
        Pz = np.einsum("nij,nj->ni", P, z)
        gain = Pz / (1.0 / w[active] + np.einsum("ni,ni->n", z, Pz))[:, None]
        error = y - np.einsum("ni,ni->n", z, self.M[active])
        self.P[active] = P - np.einsum("ni,nj->nij", gain, Pz)
        self.M[active] += gain * error[:, None]


def measure_batches(*, rounds: int = 5, n: int = 100_000) -> list[BatchRow]:
    """Measure the operations of :data:`BATCHES` on the data of the cross benchmark.

    Args:
        rounds: How often; the best round counts.
        n: Points in a batch.
    """
    X, y = cross_samples(n, 0)
    fixed, adapting = LWR(D=60.0, w_gen=0.2), RFWR(prune="never")
    fixed.partial_fit(X, y)
    adapting.warm_up()

    def learn() -> LocalModels:
        return adapting.copy().partial_fit(X, y)

    n_adapted = learn().n_models
    runs: list[tuple[str, int, Callable[[], object]]] = [
        ("predict, 60 models", fixed.n_models, lambda: fixed.predict(X)),
        ("update, adapting", n_adapted, learn),
    ]
    rows = []
    for what, models, run in runs:
        seconds = []
        for _ in range(rounds):
            start = time.thread_time()
            run()
            seconds.append(time.thread_time() - start)
        rows.append(BatchRow(what, models, n / min(seconds), BATCHES[what]))
    return rows


def measure_many(n_inputs: int, *, n: int = 20_000) -> list[ManyRow]:
    """Learn sin(2 x1) + x2^2 from many inputs of which only these two matter, with noise of 0.1.

    Args:
        n_inputs: Number of inputs, uniform on [-1, 1].
        n: Samples.
    """
    rng = np.random.default_rng(0)
    X, points = rng.uniform(-1.0, 1.0, (n, n_inputs)), rng.uniform(-1.0, 1.0, (2000, n_inputs))

    def truth(X: FloatArray) -> FloatArray:
        return np.asarray(np.sin(2.0 * X[:, 0]) + X[:, 1] ** 2)

    y = truth(X) + rng.normal(0.0, 0.1, n)
    rows = []
    for name, skill in (
        ("LWPR", LWPR(n_inputs, D=1.0 / n_inputs)),
        ("RFWR, diagonal D", RFWR(n_inputs, D=1.0 / n_inputs, diagonal=True)),
        ("LWR", LWR(n_inputs, D=1.0 / n_inputs, w_gen=0.1)),
    ):
        skill.warm_up()
        start = time.thread_time()
        skill.partial_fit(X, y)
        seconds = time.thread_time() - start
        error = np.mean((skill.predict(points)[:, 0] - truth(points)) ** 2) / np.var(y)
        rows.append(ManyRow(name, n_inputs, skill.n_models, float(error), n / max(seconds, 1e-9)))
    return rows


def verdict(is_met: bool) -> str:  # noqa: FBT001 - a word for it
    """A word for whether a goal is met."""
    return "met" if is_met else "MISSED"


def tables(
    calls: list[CallRow], batches: list[BatchRow], many: list[ManyRow], cross: list[CrossRow]
) -> list[str]:
    """The results as lines of Markdown tables."""
    lines = [
        "| One point a call, 2 inputs | numpy [µs] | ours [µs] | ratio | goal | |",
        "|---|---|---|---|---|---|",
    ]
    lines += [
        f"| {c.what} | {c.numpy_us:.1f} | {c.ours_us:.2f} | {c.ratio:.4f} | {c.goal:g} "
        f"| {verdict(c.ratio <= c.goal)} |"
        for c in calls
    ]
    lines += ["", "| Many points a call, 2 inputs | models | points/s | goal | |", "|---|---|---|---|---|"]
    lines += [
        f"| {b.what} | {b.models} | {b.points_per_s:,.0f} | {b.goal:,.0f} "
        f"| {verdict(b.points_per_s >= b.goal)} |"
        for b in batches
    ]
    lines += [
        "",
        "| Two of many inputs matter | inputs | models | nMSE | updates/s |",
        "|---|---|---|---|---|",
    ]
    lines += [
        f"| {r.learner} | {r.inputs} | {r.models} | {r.error:.4f} | {r.updates_per_s:,.0f} |" for r in many
    ]
    sizes = " | ".join(f"{size // 1000}k" for size in SIZES)
    lines += [
        "",
        f"| Cross benchmark, nMSE after | {sizes} | models | updates/s |",
        "|---" * (len(SIZES) + 3) + "|",
    ]
    for row in cross:
        errors = " | ".join(f"{error:.4f}" for error in row.errors)
        lines.append(f"| {row.learner} | {errors} | {row.models:.0f} | {row.updates_per_s:,.0f} |")
    return lines


app = App(name="learner", help="Measure what the learners cost and how well they learn.")


@app.default
def main(*, json: bool = False, rounds: int = 30) -> None:
    """Measure and print the tables.

    Args:
        json: Print one JSON object instead.
        rounds: Turns of each comparison with numpy.
    """
    tell("one point a call ...")
    calls = [measure_call(name, rounds=rounds) for name in CALLS]
    tell("many points a call ...")
    batches = measure_batches()
    tell("many inputs ...")
    many = [row for n_inputs in (10, 20) for row in measure_many(n_inputs)]
    tell("cross benchmark ...")
    cross = [measure_cross(name) for name in LEARNERS]
    if not json:
        for line in tables(calls, batches, many, cross):
            write(line)
        return
    write_json(
        {
            "calls": [row._asdict() for row in calls],
            "batches": [row._asdict() for row in batches],
            "many_inputs": [row._asdict() for row in many],
            "cross": [row._asdict() for row in cross],
            "cross_sizes": list(SIZES),
        }
    )


if __name__ == "__main__":
    app()

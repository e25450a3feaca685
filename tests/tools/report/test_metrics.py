import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from teaching.evaluation import coverage, force_error
from teaching.lwpr import LWPR
from teaching.lwr import LWR
from teaching.rehearsal import RehearsingLWR
from teaching.rfwr import RFWR
from teaching.task_file import load_task
from tools.report import metrics
from tools.report.session_data import Skill


def skill_of(learner):
    models = learner.models
    return Skill(
        time_s=0.0,
        update=1,
        samples=learner.n_samples,
        added=learner.n_added,
        pruned=learner.n_pruned,
        coverage=0.0,
        centres=models.centres,
        D=models.D,
        M=models.M[:, :, 0],
        say=learner.say,
        **({} if learner.variances is None else {"P": models.P, "variances": learner.variances[:, 0]}),
    )


@pytest.fixture(scope="module")
def taught():
    task = load_task("paper")
    rng = np.random.default_rng(3)
    X = rng.uniform(-0.2, 0.2, (3000, 2))
    Y = task.reference_force / task.stiffness_at(X) + rng.normal(0.0, 1e-3, 3000)
    return task, LWR(D=400.0, w_gen=0.8).partial_fit(X, Y[:, None])


def test_the_report_evaluates_a_logged_skill_as_the_learner_does(taught):
    task, learner = taught
    points = task.grid(metrics.GRID)
    found = metrics.evaluate(skill_of(learner), points)
    np.testing.assert_allclose(found.y, learner.predict(points)[:, 0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.w_max, learner.w_max(points), rtol=1e-9)


@pytest.mark.parametrize(
    "make",
    [
        lambda: LWR(D=400.0, w_gen=0.8, levels=3),
        lambda: RehearsingLWR(D=400.0),
        lambda: RFWR(D=400.0, w_gen=0.5, input_scale=0.1, output_scale=0.05),
        lambda: LWPR(D=400.0, w_gen=0.5, input_scale=0.1, output_scale=0.05),
    ],
    ids=["multi", "rehearsing", "rfwr", "lwpr"],
)
def test_the_report_evaluates_every_learner_by_the_say_of_its_models(make):
    task, rng = load_task("paper"), np.random.default_rng(3)
    X = rng.uniform(-0.2, 0.2, (1500, 2))
    learner = make().partial_fit(X, (task.reference_force / task.stiffness_at(X))[:, None])
    points = task.grid(20)
    found = metrics.evaluate(skill_of(learner), points, with_std=True)
    y, std = learner.predict(points, return_std=True)
    np.testing.assert_allclose(found.y, y[:, 0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found.w_max, learner.w_max(points), rtol=1e-9)
    if learner.variances is None:
        assert found.std is None
    else:
        np.testing.assert_allclose(found.std, std[:, 0], rtol=1e-9)


def test_coverage_and_grid_error_are_those_of_the_learner(taught):
    task, learner = taught
    points = task.grid(metrics.GRID)
    found = metrics.evaluate(skill_of(learner), points)
    assert metrics.coverage(found, 0.5) == pytest.approx(coverage(learner, task, 0.5))
    errors = np.abs(task.stiffness_at(points) * found.y - task.reference_force)
    mine = metrics.by_border(errors, task.border_distances(points))
    np.testing.assert_allclose(np.array(mine), np.array(force_error(learner, task)), atol=1e-6)


def test_far_away_the_nearest_model_goes_on_and_the_result_is_finite(taught):
    _, learner = taught
    found = metrics.evaluate(skill_of(learner), np.array([[50.0, -50.0]]))
    assert np.isfinite(found.y).all()
    assert found.w_max[0] == 0.0
    assert np.isinf(metrics.evaluate(skill_of(learner), np.array([[50.0, -50.0]]), with_std=True).std).all()


def test_a_skill_without_models_predicts_nothing():
    empty = Skill(
        time_s=0.0,
        update=1,
        samples=0,
        added=0,
        pruned=0,
        coverage=0.0,
        centres=np.empty((0, 2)),
        D=np.empty((0, 2, 2)),
        M=np.empty((0, 3)),
    )
    found = metrics.evaluate(empty, np.zeros((4, 2)))
    assert (found.y == 0.0).all()
    assert metrics.coverage(found, 0.5) == 0.0


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 5000), st.integers(1, 300), st.randoms(use_true_random=False))
def test_decimation_keeps_every_peak(n, bins, random):
    values = np.array([random.gauss(0.0, 1.0) for _ in range(n)])
    times, kept = metrics.decimate(np.arange(n, dtype=float), values, bins)
    assert len(times) == len(kept) <= max(n, 2 * bins)
    if n:
        assert (kept.min(), kept.max()) == (values.min(), values.max())


def test_decimation_keeps_gaps():
    values = np.full(1000, np.nan)
    values[:100] = 1.0
    _, kept = metrics.decimate(np.arange(1000.0), values, 50)
    assert np.isnan(kept[-2:]).all()
    assert (kept[:10] == 1.0).all()


def test_a_profile_has_the_mean_of_each_bin_and_leaves_out_what_is_not_there():
    errors = np.array([1.0, 3.0, 5.0, np.nan, 7.0])
    distances = np.array([0.001, 0.004, 0.012, 0.013, np.inf])
    found = metrics.profile(errors, distances, width=0.005)
    np.testing.assert_allclose(found.distance, [0.0025, 0.0075, 0.0125])
    np.testing.assert_allclose(found.mean, [2.0, np.nan, 5.0])


def test_lateness_without_cycles_is_unknown():
    assert np.isnan(metrics.lateness(np.empty(0)).max)
    assert metrics.lateness(np.arange(1001.0)) == (500.0, 990.0, 999.0, 1000.0)

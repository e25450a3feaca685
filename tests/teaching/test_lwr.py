import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hm_driver.errors import ConfigurationError
from teaching.lwr import LWR


def crossed_ridges(X):
    a, b = X[:, 0], X[:, 1]
    ridges = np.maximum(np.exp(-10 * a**2), np.exp(-50 * b**2))
    return np.maximum(ridges, 1.25 * np.exp(-5 * (a**2 + b**2)))


def weighted_least_squares(X, Y, centre, D, *, ridge):
    """Batch solution of what one model has learned."""
    Z = np.column_stack((X - centre, np.ones(len(X))))
    w = np.exp(-0.5 * np.einsum("ni,ij,nj->n", X - centre, D, X - centre))
    return np.linalg.solve(Z.T @ (w[:, None] * Z) + ridge * np.eye(Z.shape[1]), Z.T @ (w[:, None] * Y))


@settings(max_examples=100, deadline=None)
@given(st.integers(1, 4), st.integers(1, 3), st.integers(0, 10_000), st.floats(1e2, 1e6))
def test_recursive_least_squares_equals_batch_weighted_least_squares(d, m, seed, P0):
    rng = np.random.default_rng(seed)
    X = rng.uniform(-1.0, 1.0, (60, d))
    Y = rng.normal(size=(60, m))
    root = rng.normal(size=(d, d))
    D = root @ root.T + np.eye(d)
    skill = LWR(d, m, D=D, w_gen=1e-300, w_cutoff=0.0, P0=P0).partial_fit(X, Y)
    models = skill.models
    assert skill.n_models == 1
    assert models.samples[0] == 60
    expected = weighted_least_squares(X, Y, X[0], D, ridge=1.0 / P0)
    np.testing.assert_allclose(models.M[0], expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(models.P[0], models.P[0].T, rtol=0, atol=0)


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1.0, 0.99]))
def test_the_written_out_plane_kernel_equals_the_general_one(seed, lam):
    rng = np.random.default_rng(seed)
    X, y = rng.uniform(-0.2, 0.2, (300, 2)), rng.normal(size=300)
    options = {"D": [[400.0, 90.0], [90.0, 300.0]], "lam": lam}
    one = LWR(2, 1, **options).partial_fit(X, y)
    two = LWR(2, 2, **options).partial_fit(X, np.column_stack((y, -y)))
    np.testing.assert_array_equal(one.models.centres, two.models.centres)
    np.testing.assert_allclose(one.models.M[:, :, 0], two.models.M[:, :, 0], rtol=1e-8, atol=1e-8)
    np.testing.assert_allclose(one.models.P, two.models.P, rtol=1e-8, atol=1e-9)
    points = rng.uniform(-0.4, 0.4, (50, 2))
    np.testing.assert_allclose(one.predict(points)[:, 0], two.predict(points)[:, 0], rtol=1e-7, atol=1e-7)
    np.testing.assert_allclose(one.w_max(points), two.w_max(points), rtol=1e-12)


def test_a_fixed_field_reaches_the_cross_benchmark():
    rng = np.random.default_rng(0)
    X = rng.uniform(-1.0, 1.0, (20_000, 2))
    y = crossed_ridges(X) + rng.normal(0.0, 0.1, len(X))
    skill = LWR(D=400.0, w_gen=0.2).partial_fit(X, y)
    axis = np.linspace(-1.0, 1.0, 41)
    grid = np.stack([g.ravel() for g in np.meshgrid(axis, axis)], axis=1)
    error = np.mean((skill.predict(grid)[:, 0] - crossed_ridges(grid)) ** 2) / np.var(y)
    assert error <= 0.0025


def test_the_papers_plane_is_covered_by_about_a_hundred_models(paper, rng):
    X = rng.uniform(-0.2, 0.2, (20_000, 2))
    skill = LWR().partial_fit(X, paper.reference_force / paper.stiffness_at(X))
    assert 90 <= skill.n_models <= 120
    assert (skill.n_added, skill.n_pruned) == (skill.n_models, 0)
    assert skill.share_active(paper.grid(), 0.5) == 1.0


def test_a_new_model_stands_where_a_sample_activates_none_above_w_gen(rng):
    skill = LWR(w_gen=0.5)
    for x in rng.uniform(-0.2, 0.2, (500, 2)):
        before, activation = skill.n_models, skill.w_max([x])[0]
        skill.update(x, 1.0)
        assert (skill.n_models > before) == (activation <= 0.5)
    assert np.max(np.triu(skill.activations(skill.models.centres), 1)) <= 0.5


def test_overlap_pruning_never_prunes_fields_of_one_size(rng):
    X = rng.uniform(-0.2, 0.2, (5000, 2))
    assert LWR(prune="overlap").partial_fit(X, X[:, 0]).n_pruned == 0


def test_literal_pruning_undoes_what_generation_does(rng):
    X = rng.uniform(-0.2, 0.2, (5000, 2))
    skill = LWR(prune="paper").partial_fit(X, X[:, 0])
    assert skill.n_pruned > 50
    assert skill.n_added - skill.n_pruned == skill.n_models
    assert "w_prune^4" in skill.check_parameters()[0]
    assert LWR(prune="paper", w_gen=0.65).check_parameters() == []


def test_the_less_certain_of_two_equal_fields_is_pruned():
    skill = LWR(D=1.0, w_gen=0.8, w_prune=0.9, prune="paper")
    skill.partial_fit([[0.0, 0.0], [0.1, 0.0], [0.7, 0.0]], [1.0, 1.0, 2.0])
    assert skill.models.centres.tolist() == [[0.0, 0.0], [0.7, 0.0]]
    skill.update((0.34, 0.0), 1.0)
    assert skill.models.centres.tolist() == [[0.0, 0.0]]


def test_pruning_of_overlapping_models_says_so_when_generation_is_too_dense():
    skill = LWR(w_gen=0.95, w_prune=0.9)
    assert "as soon as it is made" in skill.check_parameters()[0]
    skill.partial_fit(np.random.default_rng(0).uniform(-0.1, 0.1, (2000, 2)), np.zeros(2000))
    assert skill.n_pruned > 0


def test_a_query_equals_a_prediction(rng):
    X = rng.uniform(-0.2, 0.2, (1000, 2))
    skill = LWR().partial_fit(X, np.sin(10 * X[:, 0]))
    for x0, x1 in rng.uniform(-0.5, 0.5, (50, 2)).tolist():
        y, w_max = skill.query(x0, x1)
        assert y == skill.predict([[x0, x1]])[0, 0]
        assert w_max == pytest.approx(skill.activations([[x0, x1]]).max(), rel=1e-12)


def test_prediction_is_the_weighted_mean_of_equation_1(rng):
    X = rng.uniform(-0.2, 0.2, (500, 3))
    skill = LWR(3, 2, w_cutoff=0.0, D=[100.0, 200.0, 300.0]).partial_fit(X, X[:, :2] ** 2)
    points = rng.uniform(-0.2, 0.2, (20, 3))
    W = skill.activations(points)
    Z = np.concatenate((points[:, None] - skill.models.centres, np.ones((20, skill.n_models, 1))), axis=2)
    outputs = np.einsum("nkj,kjo->nko", Z, skill.models.M)
    expected = np.einsum("nk,nko->no", W, outputs) / W.sum(axis=1)[:, None]
    np.testing.assert_allclose(skill.predict(points), expected, rtol=1e-10)


def test_far_from_every_model_the_nearest_one_predicts():
    skill = LWR().partial_fit([[0.0, 0.0], [0.2, 0.0]], [0.1, 0.3])
    y, w_max = skill.query(50.0, 0.0)
    assert y == pytest.approx(0.3, rel=1e-4)
    assert w_max == 0.0
    assert skill.predict([[1e3, 1e3]])[0, 0] == pytest.approx(0.3, rel=1e-4)
    assert math.isfinite(skill.query(1e200, -1e200)[0])


def test_without_models_prediction_and_activation_are_zero():
    assert LWR().query(0.1, 0.1) == (0.0, 0.0)
    assert LWR(3, 2).predict([[1.0, 2.0, 3.0]]).tolist() == [[0.0, 0.0]]
    assert LWR().w_max(np.empty((0, 2))).shape == (0,)


@pytest.mark.parametrize("jitter", [0.0, 0.001])
def test_forgetting_stays_finite_while_the_hand_rests(jitter):
    rng = np.random.default_rng(1)
    skill = LWR(lam=0.99)
    X = np.array([0.03, 0.01]) + rng.normal(0.0, 1.0, (200_000, 2)) * jitter
    skill.partial_fit([[0.0, 0.0]], [0.1]).partial_fit(X, np.full(len(X), 0.05))
    P = skill.models.P
    assert np.isfinite(P).all()
    assert np.linalg.eigvalsh(P).min() > 0.0
    assert np.linalg.eigvalsh(P).max() < 2e6
    assert skill.query(0.03, 0.01)[0] == pytest.approx(0.05, abs=1e-6)


def test_forgetting_follows_a_change_that_remembering_does_not(rng):
    X = rng.uniform(-0.05, 0.05, (4000, 2))
    y = np.where(np.arange(4000) < 2000, 0.1, 0.02)
    forgetful, faithful = LWR(lam=0.99).partial_fit(X, y), LWR().partial_fit(X, y)
    assert forgetful.query(0.0, 0.0)[0] == pytest.approx(0.02, abs=1e-4)
    assert faithful.query(0.0, 0.0)[0] == pytest.approx(0.06, abs=0.01)


def test_one_sample_at_a_time_equals_a_batch_and_grows_beyond_its_first_room(rng):
    X, y = rng.uniform(-1.0, 1.0, (400, 2)), rng.normal(size=400)
    batch = LWR(capacity=4).partial_fit(X, y)
    single = LWR(capacity=2)
    for x, value in zip(X, y, strict=True):
        single.update(tuple(x), value)
    assert batch.n_models > 100
    for a, b in zip(batch.models, single.models, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_copy_shares_nothing(rng):
    skill = LWR().partial_fit(rng.uniform(-0.2, 0.2, (100, 2)), np.ones(100))
    before = skill.models
    other = skill.copy().partial_fit(rng.uniform(-0.4, 0.4, (500, 2)), np.zeros(500))
    assert other.n_models > skill.n_models
    for a, b in zip(before, skill.models, strict=True):
        np.testing.assert_array_equal(a, b)


def test_models_are_removed_by_index_by_region_and_by_age(rng):
    X = rng.uniform(-0.2, 0.2, (2000, 2))
    skill = LWR().partial_fit(X, X[:, 0])
    n, centres = skill.n_models, skill.models.centres
    assert skill.remove([0, -1]) == 2
    np.testing.assert_array_equal(skill.models.centres, centres[1:-1])
    assert skill.remove([]) == 0
    assert skill.remove_near((0.1, 0.1), 0.5) > 0
    assert skill.w_max([[0.1, 0.1]])[0] <= 0.5
    assert skill.remove_box((-0.2, -0.2), (0.0, 0.0)) > 0
    assert not np.any(np.all(skill.models.centres < 0.0, axis=1))
    assert skill.remove_older(n_samples=50) > 0
    assert skill.models.born.min() >= 50
    assert skill.n_models < n
    y, w_max = skill.query(0.1, -0.1)
    assert math.isfinite(y)
    assert 0.0 < w_max <= 1.0
    with pytest.raises(IndexError):
        skill.remove([10_000])


def test_a_saved_learner_goes_on_as_if_nothing_had_happened(tmp_path, rng):
    X, y = rng.uniform(-0.2, 0.2, (600, 2)), rng.normal(size=600)
    skill = LWR(lam=0.999, prune="paper", D=[300.0, 500.0]).partial_fit(X[:300], y[:300])
    skill.save(tmp_path / "skill.npz")
    loaded = LWR.load(tmp_path / "skill.npz")
    assert loaded.parameters["prune"] == "paper"
    for a, b in zip(skill.partial_fit(X, y).models, loaded.partial_fit(X, y).models, strict=True):
        np.testing.assert_array_equal(a, b)


def test_a_file_that_is_no_learner_is_refused(tmp_path):
    (tmp_path / "text.npz").write_text("not a learner")
    with pytest.raises(ConfigurationError, match=r"text\.npz"):
        LWR.load(tmp_path / "text.npz")
    np.savez(tmp_path / "other.npz", format=99, kind="LWR")
    with pytest.raises(ConfigurationError, match="format"):
        LWR.load(tmp_path / "other.npz")


def test_samples_that_are_not_finite_are_refused_whole():
    skill = LWR().partial_fit([[0.0, 0.0]], [1.0])
    for X, Y in (([[0.0, 0.1], [np.nan, 0.0]], [1.0, 1.0]), ([[0.0, 0.1], [0.0, 0.0]], [1.0, np.inf])):
        with pytest.raises(ValueError, match="not finite"):
            skill.partial_fit(X, Y)
    with pytest.raises(ValueError, match="not finite"):
        skill.update((0.0, math.nan), 1.0)
    assert skill.n_samples == 1


@pytest.mark.parametrize(
    ("X", "Y"),
    [([[0.0]], [1.0]), ([0.0, 0.0], [1.0]), ([[0.0, 0.0]], [[1.0, 2.0]]), ([[0.0, 0.0]], [1.0, 2.0])],
)
def test_wrong_shapes_are_refused(X, Y):
    with pytest.raises(ValueError, match=r"shape|as many"):
        LWR().partial_fit(X, Y)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"D": -1.0}, "D"),
        ({"D": [[1.0, 2.0], [2.0, 1.0]]}, "D"),
        ({"D": [[1.0, 0.5], [0.0, 1.0]]}, "D"),
        ({"D": [1.0, 2.0, 3.0]}, "D"),
        ({"D": math.nan}, "D"),
        ({"n_inputs": 0}, "n_inputs"),
        ({"n_outputs": 0}, "n_outputs"),
        ({"w_gen": 1.0}, "w_gen"),
        ({"w_gen": 0.0}, "w_gen"),
        ({"w_prune": 1.5}, "w_prune"),
        ({"lam": 0.0}, "lam"),
        ({"lam": 1.1}, "lam"),
        ({"lam": math.nan}, "lam"),
        ({"P0": 0.0}, "P0"),
        ({"w_cutoff": 0.9}, "w_cutoff"),
        ({"prune": "sometimes"}, "prune"),
        ({"capacity": 0}, "capacity"),
    ],
)
def test_parameters_out_of_range_are_refused_by_name(arguments, field):
    with pytest.raises(ConfigurationError) as caught:
        LWR(**arguments)
    assert caught.value.field == field


def test_repeated_points_and_a_constant_output_are_learned():
    skill = LWR().partial_fit(np.zeros((1000, 2)), np.full(1000, 0.07))
    assert skill.n_models == 1
    assert skill.query(0.0, 0.0)[0] == pytest.approx(0.07, rel=1e-8)


def test_a_query_needs_two_inputs_and_one_output():
    with pytest.raises(TypeError, match="3 and 1"):
        LWR(3).query(0.0, 0.0)


def test_read_only_samples_are_learned():
    X = np.zeros((2, 2))
    X.setflags(write=False)
    assert LWR().partial_fit(X, [0.0, 0.0]).n_samples == 2


def test_the_standard_deviation_is_that_of_the_noise(rng):
    X = rng.uniform(-0.2, 0.2, (20_000, 2))
    skill = LWR().partial_fit(X, 0.1 + 0.2 * X[:, 1] + rng.normal(0.0, 0.03, len(X)))
    points = rng.uniform(-0.15, 0.15, (20, 2))
    Y, std = skill.predict(points, return_std=True)
    assert Y.shape == std.shape == (20, 1)
    np.testing.assert_allclose(std[:, 0], 0.03, rtol=0.1)
    assert skill.query_std(*points[3]) == pytest.approx((Y[3, 0], skill.w_max(points)[3], std[3, 0]))


@pytest.mark.parametrize(("n_inputs", "n_outputs"), [(2, 1), (3, 2)])
def test_residuals_and_degrees_of_freedom_are_those_of_batch_least_squares(n_inputs, n_outputs, rng):
    X, Y = rng.uniform(-1.0, 1.0, (80, n_inputs)), rng.normal(size=(80, n_outputs))
    skill = LWR(n_inputs, n_outputs, D=1.0, w_gen=1e-300, w_cutoff=0.0, P0=1e9).partial_fit(X, Y)
    Z = np.column_stack((X - X[0], np.ones(80)))
    w = np.exp(-0.5 * np.sum((X - X[0]) ** 2, axis=1))
    M = weighted_least_squares(X, Y, X[0], np.eye(n_inputs), ridge=1e-9)
    variance = (w @ (Y - Z @ M) ** 2) / np.sum(w * (1.0 - np.array(list(running_leverage(Z, w)))))
    point = np.zeros((1, n_inputs))
    z = np.append(point[0] - X[0], 1.0)
    P = np.linalg.inv(Z.T @ (w[:, None] * Z) + 1e-9 * np.eye(n_inputs + 1))
    _, std = skill.predict(point, return_std=True)
    np.testing.assert_allclose(std[0], np.sqrt(variance * (1.0 + z @ P @ z)), rtol=1e-6)


def running_leverage(Z, w):
    """Leverage of each sample when it came."""
    information = 1e-9 * np.eye(Z.shape[1])
    for z, weight in zip(Z, w, strict=True):
        information = information + weight * np.outer(z, z)
        yield weight * z @ np.linalg.solve(information, z)


def test_a_learner_of_nothing_is_not_certain_of_anything():
    Y, std = LWR().predict([[0.0, 0.0]], return_std=True)
    assert (Y[0, 0], std[0, 0]) == (0.0, math.inf)
    assert LWR().query_std(0.0, 0.0) == (0.0, 0.0, math.inf)
    one = LWR().partial_fit([[0.0, 0.0]], [0.1])
    assert one.query_std(0.0, 0.0)[2] >= 0.1


def test_the_deviation_knows_where_the_skill_is_wrong_and_the_activation_does_not(paper, rng):
    X = rng.uniform(-0.2, 0.2, (8000, 2))
    skill = LWR().partial_fit(X, paper.reference_force / paper.stiffness_at(X))
    grid = paper.grid()
    Y, std = skill.predict(grid, return_std=True)
    wrong = np.abs(paper.stiffness_at(grid) * Y[:, 0] - paper.reference_force) > 2.0
    assert area_under_curve(std[:, 0], wrong) > 0.75
    assert area_under_curve(-skill.w_max(grid), wrong) < 0.6


def area_under_curve(score, label):
    rank = np.argsort(np.argsort(score)) + 1.0
    positive = label.sum()
    return (rank[label].sum() - positive * (positive + 1) / 2) / (positive * (len(label) - positive))


def test_refinement_learns_the_border_of_two_objects(paper, rng):
    X = rng.uniform(-0.2, 0.2, (8000, 2))
    y = paper.reference_force / paper.stiffness_at(X)
    coarse, fine = LWR().partial_fit(X, y), LWR(levels=3, w_gen=0.5).partial_fit(X, y)
    grid = paper.grid()
    near = paper.border_distances(grid) <= 0.02

    def error(skill):
        return np.abs(paper.stiffness_at(grid) * skill.predict(grid)[:, 0] - paper.reference_force)[
            near
        ].mean()

    assert error(fine) < 0.25 * error(coarse)
    assert np.unique(fine.models.D[:, 0, 0]).tolist() == [400.0, 6400.0, 102_400.0]
    assert fine.n_models < 1000


def test_refinement_makes_nothing_where_the_prediction_is_right(rng):
    X = rng.uniform(-0.2, 0.2, (3000, 2))
    y = 0.1 + X[:, 0] * 0.1
    assert LWR(levels=3).partial_fit(X, y).n_models <= 1.2 * LWR().partial_fit(X, y).n_models


def test_refinement_has_more_inputs_and_outputs_too(rng):
    X = rng.uniform(-0.2, 0.2, (3000, 3))
    Y = np.sign(X[:, :2]) + 2.0
    coarse, fine = LWR(3, 2).partial_fit(X, Y), LWR(3, 2, levels=2).partial_fit(X, Y)
    assert np.mean((fine.predict(X) - Y) ** 2) < 0.5 * np.mean((coarse.predict(X) - Y) ** 2)

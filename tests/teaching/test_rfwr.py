import numpy as np
import pytest

from hm_driver.errors import ConfigurationError
from teaching import rfwr_kernels, shape_kernels
from teaching.kernels import D0
from teaching.rfwr import RFWR

GAMMA = 1e-3


def crossed_ridges(X):
    a, b = X[:, 0], X[:, 1]
    ridges = np.maximum(np.exp(-10 * a**2), np.exp(-50 * b**2))
    return np.maximum(ridges, 1.25 * np.exp(-5 * (a**2 + b**2)))


def field(U, X, Y, centre):
    """Weights, errors, leverages, and P of a field fitted to all samples at once."""
    offset = X - centre
    w = np.exp(-0.5 * np.sum((offset @ U.T) ** 2, axis=1))
    Z = np.column_stack((offset, np.ones(len(X))))
    P = np.linalg.inv(Z.T @ (w[:, None] * Z))
    e = Y - Z @ (P @ Z.T @ (w[:, None] * Y))
    return w, e, w * np.einsum("ni,ij,nj->n", Z, P, Z), P, Z


def leave_one_out_cost(U, X, Y, centre):
    w, e, h, _, _ = field(U, X, Y, centre)
    D = U.T @ U
    left_out = w * np.sum(e**2, axis=1) / (1.0 - h) ** 2
    return left_out.sum() / w.sum() / Y.shape[1] + GAMMA / len(centre) * np.sum(D**2)


@pytest.mark.parametrize(("d", "m"), [(1, 1), (2, 1), (3, 2)])
def test_the_fields_shape_follows_the_gradient_of_the_leave_one_out_cost(d, m, rng):
    X, Y, centre = rng.uniform(-1.0, 1.0, (40, d)), rng.normal(size=(40, m)), np.full(d, 0.1)
    U = np.triu(rng.normal(size=(d, d))) + 2.0 * np.eye(d)
    upper = np.triu_indices(d)
    expected = np.zeros(len(upper[0]))
    for j, (r, c) in enumerate(zip(*upper, strict=True)):
        step = np.zeros((d, d))
        step[r, c] = 1e-6
        costs = [leave_one_out_cost(U + s * step, X, Y, centre) for s in (1, -1)]
        expected[j] = (costs[0] - costs[1]) / 2e-6
    np.testing.assert_allclose(sum_of_steps(U, X, Y, centre), expected, rtol=1e-5, atol=1e-8)


def sum_of_steps(U, X, Y, centre):
    """What the kernels make of the same data, sample by sample, with the statistics of all others."""
    d, m = X.shape[1], Y.shape[1]
    w, e, h, P, Z = field(U, X, Y, centre)
    before = np.sum(e**2, axis=1) / (1.0 - h) ** 2
    n_triangle = d * (d + 1) // 2
    H, size = shape_kernels.shape_end(d), rfwr_kernels.block_size(d, m)
    upper, rate = np.triu_indices(d), 1e-6
    params = np.concatenate((np.zeros(D0 + n_triangle), [GAMMA, rate, 0.0, 1.0, 1.0, 0.0]))
    total = np.zeros(n_triangle)
    for k in range(len(X)):
        others = np.arange(len(X)) != k
        table, blocks = np.zeros((d + n_triangle, 1)), np.zeros((1, size))
        table[:d, 0], table[d:, 0] = centre, (U.T @ U)[upper]
        blocks[0, shape_kernels.CROSS] = np.sum(w * before)
        row = shape_kernels.SINGLES
        blocks[0, row : row + n_triangle] = U[upper]
        blocks[0, row + n_triangle : row + 2 * n_triangle] = np.log(rate)
        share = (w / (1.0 - h))[others, None] * Z[others]
        blocks[0, H : H + (d + 1) * m] = (share.T @ (e / (1.0 - h)[:, None])[others]).ravel()
        R = (share * (w * before)[others, None]).T @ Z[others]
        blocks[0, H + (d + 1) * m :] = R[np.triu_indices(d + 1)]
        g, W = P @ Z[k], w.sum()
        slopes = rfwr_kernels.cost_slope(blocks, 0, W, w[k], before[k], h[k], g, e[k].copy())
        v = np.empty(d + 1)
        shape_kernels.adapt(table, blocks, params, 0, 0, d, m, W, w[k], 1.0, *slopes, Z[k].copy(), v)
        total += (U[upper] - blocks[0, row : row + n_triangle]) / rate
    return total


def test_adapted_fields_reach_the_cross_benchmark():
    rng = np.random.default_rng(0)
    X = rng.uniform(-1.0, 1.0, (100_000, 2))
    y = crossed_ridges(X) + rng.normal(0.0, 0.1, len(X))
    axis = np.linspace(-1.0, 1.0, 41)
    grid = np.stack([g.ravel() for g in np.meshgrid(axis, axis)], axis=1)
    skill = RFWR(prune="never")
    errors = []
    for part in (slice(0, 20_000), slice(20_000, None)):
        skill.partial_fit(X[part], y[part])
        errors.append(np.mean((skill.predict(grid)[:, 0] - crossed_ridges(grid)) ** 2) / np.var(y))
    assert errors[0] <= 0.010
    assert errors[1] <= 0.003
    assert skill.n_models <= 100


def test_fields_become_narrow_across_a_ridge_and_stay_wide_along_it(rng):
    X = rng.uniform(-1.0, 1.0, (20_000, 2))
    skill = RFWR(D=20.0).partial_fit(X, np.exp(-50.0 * X[:, 1] ** 2) + rng.normal(0.0, 0.05, len(X)))
    on_the_ridge = np.abs(skill.models.centres[:, 1]) < 0.2
    D = skill.models.D[on_the_ridge]
    assert np.median(D[:, 1, 1]) > 5.0 * np.median(D[:, 0, 0])
    assert np.linalg.eigvalsh(skill.models.D).min() > 0.0


def test_a_diagonal_metric_stays_diagonal(rng):
    X = rng.uniform(-1.0, 1.0, (3000, 2))
    skill = RFWR(diagonal=True).partial_fit(X, crossed_ridges(X))
    assert np.all(skill.models.D[:, 0, 1] == 0.0)


def test_an_adaptive_learner_copies_saves_and_loads(tmp_path, rng):
    X = rng.uniform(-1.0, 1.0, (3000, 2))
    skill = RFWR().partial_fit(X, crossed_ridges(X))
    skill.save(tmp_path / "rfwr.npz")
    loaded, copied = RFWR.load(tmp_path / "rfwr.npz"), skill.copy()
    for other in (loaded, copied):
        other.partial_fit(X, crossed_ridges(X))
    skill.partial_fit(X, crossed_ridges(X))
    for a, b, c in zip(skill.models, loaded.models, copied.models, strict=True):
        np.testing.assert_array_equal(a, b)
        np.testing.assert_array_equal(a, c)


def test_more_outputs_share_the_fields(rng):
    X = rng.uniform(-1.0, 1.0, (4000, 3))
    Y = np.column_stack((np.sin(3 * X[:, 0]), X[:, 1] * X[:, 2]))
    skill = RFWR(3, 2, D=5.0).partial_fit(X, Y)
    assert np.mean((skill.predict(X) - Y) ** 2) < 0.01
    assert skill.models.M.shape[1:] == (4, 2)


def test_an_adaptive_learner_stays_finite_on_degenerate_data():
    same = RFWR().partial_fit(np.zeros((20_000, 2)), np.ones(20_000))
    assert same.query(0.0, 0.0)[0] == pytest.approx(1.0)
    assert np.isfinite(same.models.P).all()
    assert np.isfinite(same.models.D).all()


@pytest.mark.parametrize(
    ("arguments", "field_name"),
    [
        ({"tau": 0.0}, "tau"),
        ({"lam_final": 1.1}, "lam_final"),
        ({"penalty": -1.0}, "penalty"),
        ({"rate": -1.0}, "rate"),
    ],
)
def test_rates_out_of_range_are_refused_by_name(arguments, field_name):
    with pytest.raises(ConfigurationError) as caught:
        RFWR(**arguments)
    assert caught.value.field == field_name


@pytest.mark.parametrize(
    "options", [{}, {"diagonal": True}, {"meta_rate": 0.0}, {"lam": 1.0, "lam_final": 1.0}]
)
def test_the_written_out_plane_kernel_equals_the_general_one(options, rng):
    X = rng.uniform(-1.0, 1.0, (3000, 2))
    y = crossed_ridges(X) + rng.normal(0.0, 0.1, len(X))
    plane, general = RFWR(**options), RFWR(**options)
    general._scratch = np.zeros((2, 3))
    for one, other in zip(plane.partial_fit(X, y).models, general.partial_fit(X, y).models, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-4)


def test_scales_let_an_adaptive_learner_work_in_any_units(rng):
    X = rng.uniform(-1.0, 1.0, (3000, 2))
    y = crossed_ridges(X) + rng.normal(0.0, 0.1, len(X))
    size = np.array([0.2, 50.0])
    plain = RFWR(D=50.0).partial_fit(X, y)
    scaled = RFWR(D=50.0 / size**2, input_scale=size, output_scale=1e-3).partial_fit(X * size, y * 1e-3)
    points = rng.uniform(-1.0, 1.0, (100, 2))
    expected, expected_std = plain.predict(points, return_std=True)
    found, found_std = scaled.predict(points * size, return_std=True)
    np.testing.assert_allclose(found * 1e3, expected, rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(found_std * 1e3, expected_std, rtol=1e-5)
    np.testing.assert_allclose(scaled.models.centres, plain.models.centres * size, rtol=1e-12)
    np.testing.assert_allclose(scaled.models.D, plain.models.D / np.outer(size, size), rtol=1e-6)
    Z = np.append(points[0] * size - scaled.models.centres[0], 1.0)
    z = np.append(points[0] - plain.models.centres[0], 1.0)
    np.testing.assert_allclose(Z @ scaled.models.M[0] * 1e3, z @ plain.models.M[0], rtol=1e-6, atol=1e-8)


def test_a_rate_of_zero_keeps_the_metric_as_it_is(rng):
    X = rng.uniform(-1.0, 1.0, (3000, 2))
    skill = RFWR(D=[50.0, 80.0], rate=0.0).partial_fit(X, crossed_ridges(X))
    np.testing.assert_allclose(skill.models.D, np.broadcast_to(np.diag([50.0, 80.0]), skill.models.D.shape))

"""What every learner owes to those who use it."""

import math

import numpy as np
import pytest

from teaching.lwpr import LWPR
from teaching.lwr import LWR
from teaching.rfwr import RFWR

LEARNERS = {
    "lwr": lambda d=2, m=1: LWR(d, m),
    "literal": lambda d=2, m=1: LWR(d, m, prune="paper"),
    "forgetful": lambda d=2, m=1: LWR(d, m, lam=0.995),
    "refining": lambda d=2, m=1: LWR(d, m, levels=3),
    "rfwr": lambda d=2, m=1: RFWR(d, m, D=400.0),
    "scaled": lambda d=2, m=1: RFWR(d, m, D=400.0, input_scale=0.2, output_scale=0.05),
    "lwpr": lambda d=2, m=1: LWPR(d, m, D=400.0),
}


@pytest.fixture(params=sorted(LEARNERS))
def make(request):
    return LEARNERS[request.param]


@pytest.fixture
def data(rng):
    X = rng.uniform(-0.2, 0.2, (3000, 2))
    return X, 0.05 + 0.3 * X[:, 0] * X[:, 1] + 0.02 * np.sign(X[:, 0])


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a.models, b.models, strict=True))


def test_a_smooth_function_is_learned(make, rng):
    X = rng.uniform(-0.2, 0.2, (5000, 2))
    y = 0.05 + 0.3 * X[:, 0] * X[:, 1]
    assert np.abs(make().partial_fit(X, y).predict(X)[:, 0] - y).max() < 0.005


def test_the_same_samples_give_the_same_bits(make, data):
    assert same(make().partial_fit(*data), make().partial_fit(*data))


def test_one_by_one_is_the_same_as_a_batch(make, data):
    single = make()
    for x, y in zip(data[0], data[1], strict=True):
        single.update(x, y)
    assert same(single, make().partial_fit(*data))


def test_batches_of_any_size_give_the_same_learner(make, data):
    parts = make().partial_fit(data[0][:1], data[1][:1]).partial_fit(data[0][1:777], data[1][1:777])
    assert same(parts.partial_fit(data[0][777:], data[1][777:]), make().partial_fit(*data))


def test_a_copy_learns_on_without_the_original(make, data):
    skill = make().partial_fit(data[0][:1000], data[1][:1000])
    before = skill.models
    copied = skill.copy().partial_fit(data[0][1000:], data[1][1000:])
    assert all(np.array_equal(x, y) for x, y in zip(before, skill.models, strict=True))
    assert same(copied, make().partial_fit(*data))


def test_a_query_is_a_prediction_and_the_largest_activation(make, data, rng):
    skill = make().partial_fit(*data)
    for x0, x1 in rng.uniform(-0.4, 0.4, (20, 2)).tolist():
        y, w_max = skill.query(x0, x1)
        assert y == skill.predict([[x0, x1]])[0, 0]
        assert w_max == skill.w_max([[x0, x1]])[0]
        assert 0.0 <= w_max <= 1.0
        assert w_max == pytest.approx(skill.activations([[x0, x1]]).max(), rel=1e-12)


def test_prediction_is_finite_everywhere(make, data):
    skill = make().partial_fit(*data)
    assert np.isfinite(skill.predict([[0.0, 0.0], [1.0, -1.0], [1e6, 1e6]])).all()
    assert make().query(0.0, 0.0) == (0.0, 0.0)


def test_the_share_of_active_points_agrees_with_w_max(make, data, paper):
    skill = make().partial_fit(data[0][:200] * 0.5, data[1][:200])
    grid = paper.grid(40)
    assert skill.share_active(grid, 0.5) == np.mean(skill.w_max(grid) >= 0.5)


def test_models_are_counted(make, data):
    skill = make().partial_fit(*data)
    assert skill.n_samples == 3000
    assert skill.n_models == len(skill.models.centres) == skill.n_added - skill.n_pruned
    assert np.all(np.diff(skill.models.born) > 0)
    assert skill.remove([0]) == 1
    assert len(skill.models.centres) == skill.n_models


def test_metrics_and_covariances_are_positive_definite(make, data):
    models = make().partial_fit(*data).models
    assert np.linalg.eigvalsh(models.D).min() > 0.0
    assert np.linalg.eigvalsh(models.P).min() > 0.0


def test_many_inputs_and_outputs_are_learned(make, rng):
    X = rng.uniform(-0.05, 0.05, (500, 4))
    Y = X @ rng.normal(size=(4, 3))
    skill = make(4, 3).partial_fit(X, Y)
    assert np.abs(skill.predict(X) - Y).max() < 0.02
    assert skill.predict(X, return_std=True)[1].shape == (500, 3)


def test_what_is_not_finite_is_refused_whole(make, data):
    skill = make().partial_fit(*data)
    before = skill.models
    with pytest.raises(ValueError, match="finite"):
        skill.partial_fit([[0.0, 0.0], [math.inf, 0.0]], [0.0, 0.0])
    with pytest.raises(ValueError, match="finite"):
        skill.update((0.0, 0.0), math.nan)
    assert all(np.array_equal(x, y) for x, y in zip(before, skill.models, strict=True))


@pytest.mark.parametrize("n", [0, 1, 2])
def test_few_samples_are_enough(make, n):
    skill = make().partial_fit(np.zeros((n, 2)), np.full(n, 0.07))
    assert skill.predict([[0.0, 0.0]])[0, 0] == pytest.approx(0.07 if n else 0.0, rel=1e-5)


def test_a_saved_learner_is_read_back(make, data, tmp_path):
    skill = make().partial_fit(*data)
    skill.save(tmp_path / "skill.npz")
    assert same(type(skill).load(tmp_path / "skill.npz"), skill)

"""What every learner owes to those who use it."""

import math

import numpy as np
import pytest

from hm_driver.errors import ConfigurationError
from teaching.lwpr import LWPR
from teaching.lwr import LWR
from teaching.rehearsal import SLICE, RehearsingLWR
from teaching.rfwr import RFWR

LEARNERS = {
    "lwr": lambda d=2, m=1, **o: LWR(d, m, **o),
    "literal": lambda d=2, m=1, **o: LWR(d, m, **{"prune": "paper", **o}),
    "forgetful": lambda d=2, m=1, **o: LWR(d, m, **{"lam": 0.995, **o}),
    "refining": lambda d=2, m=1, **o: LWR(d, m, levels=3, **o),
    "rfwr": lambda d=2, m=1, **o: RFWR(d, m, **{"D": 400.0, **o}),
    "scaled": lambda d=2, m=1, **o: RFWR(d, m, **{"D": 400.0, "input_scale": 0.2, "output_scale": 0.05, **o}),
    "lwpr": lambda d=2, m=1, **o: LWPR(d, m, **{"D": 400.0, **o}),
    "rehearsing": lambda d=2, m=1, **o: RehearsingLWR(d, m, **o),
}


@pytest.fixture(params=sorted(LEARNERS))
def make(request):
    return LEARNERS[request.param]


@pytest.fixture
def data(rng):
    X = rng.uniform(-0.2, 0.2, (3000, 2))
    return X, 0.05 + 0.3 * X[:, 0] * X[:, 1] + 0.02 * np.sign(X[:, 0])


@pytest.fixture
def grain(make):
    """Samples that the learner takes at a time: to the bit the same in calls of its multiples."""
    return SLICE if isinstance(make(), RehearsingLWR) else 1


def same(a, b):
    return all(np.array_equal(x, y) for x, y in zip(a.models, b.models, strict=True))


def test_a_smooth_function_is_learned(make, rng):
    X = rng.uniform(-0.2, 0.2, (5000, 2))
    y = 0.05 + 0.3 * X[:, 0] * X[:, 1]
    assert np.abs(make().partial_fit(X, y).predict(X)[:, 0] - y).max() < 0.005


def test_the_same_samples_give_the_same_bits(make, data):
    assert same(make().partial_fit(*data), make().partial_fit(*data))


def test_one_by_one_is_the_same_as_a_batch(make, data, grain):
    single = make()
    for x, y in zip(data[0], data[1], strict=True):
        single.update(x, y)
    batch = make().partial_fit(*data)
    assert single.n_samples == batch.n_samples == 3000
    if grain == 1:
        assert same(single, batch)
    else:
        errors = [np.abs(one.predict(data[0])[:, 0] - data[1]).mean() for one in (single, batch)]
        assert errors[0] < 1.5 * errors[1]


def test_batches_of_any_size_give_the_same_learner(make, data, grain):
    first, second = grain, 777 * grain % 3000
    parts = make().partial_fit(data[0][:first], data[1][:first])
    parts = parts.partial_fit(data[0][first:second], data[1][first:second])
    assert same(parts.partial_fit(data[0][second:], data[1][second:]), make().partial_fit(*data))


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


def test_the_share_of_active_points_agrees_with_w_max(make, data, paper, rng):
    skill = make().partial_fit(data[0][:200] * 0.5, data[1][:200])
    for points in (paper.grid(40), rng.permutation(paper.grid(40))):
        for w in (0.2, 0.5, 0.9):
            assert skill.share_active(points, w) == np.mean(skill.w_max(points) >= w)


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


def test_forgetting_stays_finite_while_the_same_sample_repeats(make):
    skill = make(lam=0.99)
    if "lam_final" in skill.parameters:
        skill = make(lam=0.99, lam_final=0.99)
    n = 1_000_000 if type(skill) is LWR else 75_000  # 0.99^-75000 is above every double
    n //= 3 if type(skill) is RehearsingLWR else 1  # it learns each sample three times
    skill.partial_fit([[0.0, 0.0]], [0.1]).partial_fit(np.full((n, 2), 0.01), np.full(n, 0.05))
    assert all(np.isfinite(part).all() for part in skill.models)
    assert skill.predict([[0.01, 0.01]])[0, 0] == pytest.approx(0.05, abs=1e-6)
    skill.partial_fit([[0.02, 0.01]], [0.06])
    assert all(np.isfinite(part).all() for part in skill.models)


def test_far_from_every_model_the_prediction_is_finite_and_says_that_it_knows_nothing(make, data):
    skill = make().partial_fit(*data)
    far = np.array([[3.0, 3.0], [-1e4, 2.0]])
    Y, std = skill.predict(far, return_std=True)
    assert np.isfinite(Y).all()
    assert np.isinf(std).all()
    assert np.all(skill.w_max(far) < 1e-3)
    assert skill.query_std(3.0, 3.0)[2] == math.inf


def test_the_deviation_is_near_that_of_the_noise_where_the_skill_is_known(make, rng):
    X = rng.uniform(-0.2, 0.2, (4_000, 2))
    skill = make().partial_fit(X, 0.1 + 0.2 * X[:, 1] + rng.normal(0.0, 0.03, len(X)))
    _, std = skill.predict(rng.uniform(-0.15, 0.15, (50, 2)), return_std=True)
    assert 0.01 < np.median(std) < 0.2


def test_models_go_by_region_by_index_and_by_age(make, data):
    skill = make().partial_fit(*data)
    n, centres = skill.n_models, skill.models.centres
    inside = np.sum((centres - [0.1, 0.1]) ** 2, axis=1) <= 0.1**2
    assert skill.remove_ellipse((0.1, 0.1), 0.1) == inside.sum() > 0
    turned = skill.copy()
    assert turned.remove_ellipse((-0.1, -0.1), (0.2, 0.05), angle=math.pi / 4) > 0
    offset = turned.models.centres + 0.1
    along, across = offset.sum(axis=1) / math.sqrt(2), np.diff(offset, axis=1)[:, 0] / math.sqrt(2)
    assert np.all((along / 0.2) ** 2 + (across / 0.05) ** 2 > 1.0)
    assert skill.remove_box((-0.2, -0.2), (-0.05, -0.05)) > 0
    assert skill.remove_near((0.15, -0.15), 0.5) > 0
    assert skill.w_max([[0.15, -0.15]])[0] <= 0.5
    assert skill.remove([0]) == 1
    assert skill.remove_older(int(skill.models.born[1])) == 1
    assert 0 < skill.n_models < n
    again = skill.partial_fit(*data)
    assert np.all(np.isfinite(again.predict(data[0])))
    assert np.abs(again.predict(data[0])[:, 0] - data[1]).mean() < 0.01


def test_a_region_that_is_none_is_refused(make, data):
    skill = make().partial_fit(*data)
    for axes in (0.0, -1.0, (0.1, math.nan)):
        with pytest.raises(ValueError, match="semi_axes"):
            skill.remove_ellipse((0.0, 0.0), axes)
    with pytest.raises(ValueError, match="two inputs"):
        make(3, 1).remove_ellipse((0.0, 0.0, 0.0), 0.1, angle=0.5)
    with pytest.raises(IndexError):
        skill.remove([10_000])


@pytest.mark.parametrize("damage", ["cut", "bit", "text", "newer", "kind", "pickle", "rows", "parameter"])
def test_a_damaged_or_newer_file_is_refused(make, data, tmp_path, damage):
    skill, path = make().partial_fit(data[0][:300], data[1][:300]), tmp_path / "skill.npz"
    skill.save(path)
    content = bytearray(path.read_bytes())
    with np.load(path) as file:
        stored = dict(file)
    if damage == "cut":
        path.write_bytes(content[: len(content) // 2])
    elif damage == "bit":
        content[content.find(b"table.npy") + 400] ^= 16
        path.write_bytes(content)
    elif damage == "text":
        path.write_text("x1,x2,y\n")
    else:
        change = {
            "newer": {"format": 99},
            "kind": {"kind": "GP"},
            "pickle": {"table": np.array([{"a": 1}], dtype=object)},
            "rows": {"table": stored["table"][:-1]},
            "parameter": {"parameters": '{"n_inputs": 2, "w_gen": 7.0, "D": [[1.0, 0.0], [0.0, 1.0]]}'},
        }[damage]
        np.savez(path, **{**stored, **change})
    with pytest.raises(ConfigurationError, match=r"skill\.npz") as caught:
        type(skill).load(path)
    if damage == "newer":
        assert "update this software" in str(caught.value)


def test_a_file_is_replaced_whole_or_not_at_all(make, data, tmp_path, monkeypatch):
    skill, path = make().partial_fit(*data), tmp_path / "skill.npz"
    skill.save(path)
    before = path.read_bytes()

    def fail(*_, **__):
        raise OSError("no space left")

    monkeypatch.setattr("teaching.storage.np.savez", fail)
    with pytest.raises(OSError, match="no space"):
        skill.save(path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_what_was_loaded_goes_on_as_if_nothing_had_happened(make, data, tmp_path):
    skill = make().partial_fit(*data)
    skill.remove([0, 3])
    skill.save(tmp_path / "skill.npz")
    loaded = type(skill).load(tmp_path / "skill.npz")
    assert same(skill.partial_fit(*data), loaded.partial_fit(*data))


@pytest.mark.parametrize("arguments", [(0, 1), (2, 0), (-1, 1), (1.5, 1), (True, 1)])
def test_numbers_of_inputs_and_outputs_are_whole_and_above_0(make, arguments):
    with pytest.raises(ConfigurationError, match=r"n_inputs|n_outputs"):
        make(*arguments)


@pytest.mark.parametrize(
    "D", [0.0, -4.0, math.inf, [1.0, -1.0], [[1.0, 2.0], [2.0, 1.0]], [[1.0]], "wide", [[1.0], [1.0, 2.0]]]
)
def test_a_metric_that_is_not_positive_definite_is_refused(make, D):
    with pytest.raises(ConfigurationError, match="D"):
        make(D=D)


@pytest.mark.parametrize(
    ("x", "y"),
    [
        ((0.1,), 0.1),
        (0.1, 0.1),
        ((0.1, 0.1, 0.1), 0.1),
        ((0.1, 0.1), (0.1, 0.1)),
        ((), 0.1),
        ((0.1, 0.1), ()),
    ],
)
def test_one_sample_of_a_wrong_shape_is_refused(make, x, y):
    skill = make()
    with pytest.raises(ValueError, match=r"shapes \(2,\) and \(1,\)"):
        skill.update(x, y)
    assert skill.n_samples == skill.n_models == 0


@pytest.mark.parametrize(
    ("X", "Y"),
    [([[0.0]], [1.0]), ([0.0, 0.0], [1.0]), ([[0.0, 0.0]], [[1.0, 2.0]]), ([[0.0, 0.0]], [1.0, 2.0])],
)
def test_wrong_shapes_are_refused(make, X, Y):
    with pytest.raises(ValueError, match=r"shape|as many"):
        make().partial_fit(X, Y)


def test_repeated_points_and_a_constant_output_are_learned(make):
    skill = make().partial_fit(np.zeros((500, 2)), np.full(500, 0.07))
    assert skill.n_models == 1
    assert skill.query(0.0, 0.0)[0] == pytest.approx(0.07, rel=1e-6)
    assert math.isfinite(skill.query_std(0.0, 0.0)[2])


def test_thresholds_that_contradict_each_other_are_said_with_the_consequence(make):
    said = make(w_gen=0.8, w_prune=0.9, prune="paper").check_parameters()
    assert len(said) == 1
    assert "prune each other" in said[0]
    assert "as soon as it is made" in make(w_gen=0.95, w_prune=0.9, prune="overlap").check_parameters()[0]
    assert make(w_gen=0.5, w_prune=0.9, prune="paper").check_parameters() == []


def test_warming_up_learns_nothing(make):
    skill = make()
    skill.warm_up()
    assert (skill.n_samples, skill.n_models) == (0, 0)

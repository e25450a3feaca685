"""The learner that remembers."""

import numpy as np
import pytest

from hm_driver.errors import ConfigurationError
from teaching.lwr import LWR
from teaching.rehearsal import RehearsingLWR

HALVES = {"levels": 3, "ratio": 8.0, "w_gen": 0.5}


def step(X):
    return np.where(X[:, 0] < 0.0, 0.1, 0.03)


def halves(rng, n=1500):
    """First the left half of a step, then the right one, as a demonstrator teaches two objects."""
    X = rng.uniform(-0.15, 0.15, (n, 2))
    X = X[np.argsort(X[:, 0] >= 0.0, kind="stable")]
    return X, step(X)


def test_what_was_taught_first_survives_what_is_taught_next_to_it(rng):
    X, Y = halves(rng)
    places = rng.uniform(-0.05, -0.01, (500, 2))
    errors = {}
    for make in (LWR, RehearsingLWR):
        skill = make(**HALVES)
        for k in range(0, len(X), 50):
            skill.partial_fit(X[k : k + 50], Y[k : k + 50])
        errors[make] = np.mean(np.abs(skill.predict(places)[:, 0] - 0.1))
    assert errors[RehearsingLWR] < 0.5 * errors[LWR]


def test_the_same_samples_give_the_same_bits(rng):
    X, Y = halves(rng, 400)
    one, other = (RehearsingLWR().partial_fit(X, Y) for _ in range(2))
    assert np.array_equal(one.predict(X), other.predict(X))


def test_samples_are_counted_once_however_often_they_are_rehearsed(rng):
    X, Y = halves(rng, 300)
    skill = RehearsingLWR(rehearse=5).partial_fit(X, Y)
    assert skill.n_samples == skill.n_remembered == 300


def test_the_memory_is_bounded_and_the_oldest_sample_goes_first():
    skill = RehearsingLWR(memory=10)
    X = np.linspace(0.0, 1.0, 25).reshape(-1, 1) @ np.ones((1, 2))
    for x in X:
        skill.update(x, 0.1)
    assert skill.n_remembered == 10
    assert skill.n_samples == 25
    skill.remove_box([X[-1, 0] - 1e-9] * 2, [1.0, 1.0])
    assert skill.n_remembered < 10


def test_a_copy_shares_nothing(rng):
    X, Y = halves(rng, 300)
    skill = RehearsingLWR().partial_fit(X, Y)
    before = skill.predict(X)
    skill.copy().partial_fit(X, Y + 0.05)
    assert np.array_equal(skill.predict(X), before)
    assert skill.n_remembered == 300


def test_what_is_forgotten_is_not_rehearsed(rng):
    X = rng.uniform(-0.1, 0.1, (600, 2))
    skill = RehearsingLWR().partial_fit(X, np.full(600, 0.02))
    skill.remove_box([-np.inf, -np.inf], [np.inf, np.inf])
    assert (skill.n_models, skill.n_remembered) == (0, 0)
    skill.partial_fit(X, np.full(600, 0.08))
    assert skill.predict(X) == pytest.approx(np.full((600, 1), 0.08))


def test_removing_models_forgets_what_they_held(rng):
    X = rng.uniform(-0.2, 0.2, (2000, 2))
    skill = RehearsingLWR().partial_fit(X, np.full(2000, 0.05))
    assert skill.remove_near((0.0, 0.0), 0.5) > 0
    assert 0 < skill.n_remembered < 2000
    assert skill.w_max([[0.0, 0.0]])[0] <= 0.5


def test_the_samples_that_go_with_a_model_are_those_that_it_held(rng):
    X = rng.uniform(-0.2, 0.2, (1500, 2))
    skill = RehearsingLWR(w_gen=0.4).partial_fit(X, step(X))
    chosen = rng.permutation(skill.n_models)[: skill.n_models // 3]
    held = np.any(skill.activations(X)[:, chosen] > 0.4, axis=1)
    skill.remove(chosen)
    assert 0 < skill.n_remembered == 1500 - held.sum()


def test_a_saved_learner_goes_on_as_if_nothing_had_happened(rng, tmp_path):
    X, Y = halves(rng, 600)
    skill = RehearsingLWR().partial_fit(X[:400], Y[:400])
    skill.save(tmp_path / "skill.npz")
    again = RehearsingLWR.load(tmp_path / "skill.npz")
    for one in (skill, again):
        one.partial_fit(X[400:], Y[400:])
    assert again.n_samples == skill.n_samples == 600
    assert np.array_equal(again.predict(X), skill.predict(X))


def test_a_bad_sample_is_refused_and_nothing_is_learned():
    skill = RehearsingLWR()
    with pytest.raises(ValueError, match="not finite"):
        skill.partial_fit([[0.0, 0.0], [np.nan, 0.0]], [0.1, 0.1])
    with pytest.raises(ValueError, match="as many"):
        skill.partial_fit([[0.0, 0.0]], [0.1, 0.1])
    assert (skill.n_samples, skill.n_remembered, skill.n_models) == (0, 0, 0)


@pytest.mark.parametrize(("name", "value"), [("rehearse", 0), ("memory", 0), ("levels", 99)])
def test_a_parameter_out_of_range_is_refused_by_its_name(name, value):
    with pytest.raises(ConfigurationError) as caught:
        RehearsingLWR(**{name: value})
    assert caught.value.field == name


def test_one_input_and_two_outputs_are_learned_as_well(rng):
    X = rng.uniform(0.0, 1.0, (300, 1))
    Y = np.column_stack((X[:, 0] + 1.0, 2.0 - X[:, 0]))
    skill = RehearsingLWR(1, 2, D=100.0).partial_fit(X, Y)
    assert skill.predict([[0.5]])[0] == pytest.approx([1.5, 1.5], abs=1e-3)

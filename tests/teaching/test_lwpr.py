import math

import numpy as np
import pytest

from hm_driver.errors import ConfigurationError
from teaching.lwpr import LWPR
from teaching.lwr import LWR

ONE_FIELD = {"w_gen": 1e-300, "w_cutoff": 0.0, "P0": 1e10}
FIXED = {"rate": 0.0, "lam": 1.0, "lam_final": 1.0, **ONE_FIELD}


def test_one_input_is_weighted_least_squares_to_the_last_digits(rng):
    X = rng.uniform(-1.0, 1.0, (300, 1))
    Y = np.column_stack((np.sin(3.0 * X[:, 0]), X[:, 0] ** 2)) + rng.normal(0.0, 0.1, (300, 2))
    projected, direct = LWPR(1, 2, D=2.0, **FIXED), LWR(1, 2, D=2.0, **ONE_FIELD)
    for one, other in zip(projected.partial_fit(X, Y).models, direct.partial_fit(X, Y).models, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-7, atol=1e-8)


@pytest.mark.parametrize(("d", "tolerance"), [(2, 0.05), (4, 0.05), (6, 0.1)])
def test_as_many_directions_as_inputs_agree_with_least_squares(d, tolerance, rng):
    X, A = rng.normal(size=(8000, d)), rng.normal(size=(d, 2))
    Y = X @ A + 0.7 + 0.3 * rng.normal(size=(8000, 2))
    projected = LWPR(d, 2, D=0.5, projections=d, add_below=1e3, **FIXED).partial_fit(X, Y)
    direct = LWR(d, 2, D=0.5, **ONE_FIELD).partial_fit(X, Y)
    assert projected.projections.tolist() == [d]
    points = X[:200]
    difference = projected.predict(points) - direct.predict(points)
    assert np.sqrt(np.mean(difference**2)) < tolerance * np.std(Y)


def test_directions_are_added_only_while_they_lower_the_error(rng):
    X = rng.normal(size=(4000, 6))
    y = X[:, 0] + 0.05 * rng.normal(size=4000)
    simple = LWPR(6, D=1e-3, **FIXED).partial_fit(X, y)
    assert simple.projections.tolist() == [2]
    scale = np.array([1.0, 2.0, 4.0, 8.0, 16.0, 32.0])
    steep = LWPR(6, D=1e-6, add_below=0.95, **FIXED).partial_fit(X * scale, (X * scale[::-1]).sum(axis=1))
    assert steep.projections[0] > 2
    assert LWPR(6, D=1e-6, projections=2, **FIXED).partial_fit(X * scale, y).projections.tolist() == [2]


@pytest.mark.parametrize("d", [10, 20])
def test_many_inputs_of_which_two_matter_are_learned(d, rng):
    def truth(X):
        return np.sin(2.0 * X[:, 0]) + X[:, 1] ** 2

    X, points = rng.uniform(-1.0, 1.0, (20_000, d)), rng.uniform(-1.0, 1.0, (1000, d))
    y = truth(X) + rng.normal(0.0, 0.1, len(X))
    skill = LWPR(d, D=1.0 / d).partial_fit(X, y)
    Y, std = skill.predict(points, return_std=True)
    assert np.mean((Y[:, 0] - truth(points)) ** 2) < 0.12 * np.var(y)
    assert np.isfinite(std).all()
    D = np.median(np.diagonal(skill.models.D, axis1=1, axis2=2), axis=0)
    assert D[1] > 2.0 * max(np.delete(D, [0, 1]))


def test_inputs_that_depend_on_each_other_do_no_harm(rng):
    hidden = rng.normal(size=(5000, 2))
    X = hidden @ rng.normal(size=(2, 12))
    skill = LWPR(12, D=1e-3, **FIXED).partial_fit(X, hidden[:, 0])
    assert np.mean((skill.predict(X)[:, 0] - hidden[:, 0]) ** 2) < 0.01
    assert np.isfinite(skill.models.P).all()


def test_the_confidence_grows_to_infinity_away_from_the_data(rng):
    X = rng.uniform(-0.2, 0.2, (5000, 2))
    skill = LWPR(D=400.0, rate=0.0).partial_fit(X, 0.1 + rng.normal(0.0, 0.03, len(X)))
    inside, edge, far = (skill.query_std(x, 0.0)[2] for x in (0.0, 0.3, 1.0))
    assert 0.01 < inside < 0.05 < edge < far == math.inf


def test_every_output_has_its_own_directions_in_shared_fields(rng):
    X = rng.normal(size=(3000, 4))
    Y = X[:, :3] * [1.0, -2.0, 3.0]
    both = LWPR(4, 3, D=0.01, projections=2, **FIXED).partial_fit(X, Y)
    for o in range(3):
        alone = LWPR(4, 1, D=0.01, projections=2, **FIXED).partial_fit(X, Y[:, o])
        np.testing.assert_allclose(both.models.M[:, :, o], alone.models.M[:, :, 0], rtol=1e-9, atol=1e-12)


def test_its_covariance_is_that_of_the_regression(rng):
    X = rng.normal(size=(2000, 3))
    skill = LWPR(3, D=0.1, projections=3, add_below=1e3, **FIXED).partial_fit(X, X.sum(axis=1))
    models = skill.models
    w = np.exp(-0.5 * np.einsum("ni,ij,nj->n", X - X[0], models.D[0], X - X[0]))
    Z = np.column_stack((X - X[0], np.ones(len(X))))
    expected = np.linalg.inv(Z.T @ (w[:, None] * Z))
    np.testing.assert_allclose(np.diag(models.P[0]), np.diag(expected), rtol=0.25)


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"projections": 0}, "projections"),
        ({"projections": 3}, "projections"),
        ({"add_below": 0.0}, "add_below"),
        ({"diagonal": 1}, "diagonal"),
        ({"D": [[2.0, 1.0], [1.0, 2.0]]}, "D"),
        ({"input_scale": [1.0, 0.0]}, "input_scale"),
        ({"output_scale": [1.0, 1.0]}, "output_scale"),
    ],
)
def test_parameters_out_of_range_are_refused_by_name(arguments, field):
    with pytest.raises(ConfigurationError) as caught:
        LWPR(**arguments)
    assert caught.value.field == field

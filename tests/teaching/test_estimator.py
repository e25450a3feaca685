import pickle
import subprocess
import sys

import numpy as np
import pytest

from hm_driver.errors import ConfigurationError
from teaching.estimator import LEARNERS, LocalRegressor

WITHOUT_SCIKIT_LEARN = """
import sys

class Blocker:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("sklearn", "scipy", "pandas"):
            raise ImportError(name)

sys.meta_path.insert(0, Blocker())
import numpy as np
from teaching.estimator import LocalRegressor
X = np.linspace(0.0, 1.0, 50)[:, None]
model = LocalRegressor("lwr")
try:
    model.predict(X)
except ValueError as error:
    print(error)
model.fit(X, X[:, 0]).partial_fit(X, X[:, 0])
print(model.score(X, X[:, 0]) > 0.99, model.set_params(lam=0.5).get_params()["lam"], model)
"""


def expectation():
    estimator_checks = pytest.importorskip("sklearn.utils.estimator_checks")
    return estimator_checks.check_estimator


@pytest.mark.parametrize("learner", sorted(LEARNERS))
@pytest.mark.filterwarnings("ignore:Estimator LocalRegressor does not inherit")
@pytest.mark.filterwarnings("ignore:Skipping check")
def test_an_estimator_keeps_all_of_scikit_learns_conventions(learner):
    results = expectation()(LocalRegressor(learner), on_fail=None)
    failed = {r["check_name"]: r["exception"] for r in results if r["status"] == "failed"}
    assert failed == {}
    assert len(results) > 40


def test_an_estimator_runs_where_scikit_learn_is_not_installed():
    run = subprocess.run(
        [sys.executable, "-c", WITHOUT_SCIKIT_LEARN], capture_output=True, text=True, check=False, timeout=100
    )
    assert run.stderr == ""
    assert run.stdout.splitlines() == [
        "This LocalRegressor instance is not fitted yet; call fit first",
        "True 0.5 LocalRegressor(learner='lwr', lam=0.5)",
    ]


def test_an_estimator_stands_in_a_pipeline_and_a_search():
    model_selection = pytest.importorskip("sklearn.model_selection")
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    rng = np.random.default_rng(0)
    X = rng.uniform(0.0, 100.0, (600, 2))
    y = np.sin(X[:, 0] / 10.0)
    search = model_selection.GridSearchCV(
        make_pipeline(StandardScaler(), LocalRegressor("lwr")), {"localregressor__D": [1.0, 30.0]}, cv=3
    )
    assert search.fit(X, y).best_params_ == {"localregressor__D": 30.0}
    assert search.score(X, y) > 0.9


def test_outputs_come_back_in_the_shape_they_were_given():
    X = np.linspace(0.0, 1.0, 40)[:, None]
    flat = LocalRegressor("lwr").fit(X, X[:, 0])
    assert flat.predict(X).shape == (40,)
    several = LocalRegressor("lwr").fit(X, np.column_stack((X, 2.0 * X)))
    mean, std = several.predict(X, return_std=True)
    assert mean.shape == std.shape == (40, 2)


def test_partial_fit_of_all_samples_is_fit(rng):
    X, y = rng.normal(size=(300, 3)), rng.normal(size=300)
    at_once = LocalRegressor("rfwr", D=0.5).fit(X, y)
    parts = LocalRegressor("rfwr", D=0.5).partial_fit(X[:100], y[:100]).partial_fit(X[100:], y[100:])
    np.testing.assert_array_equal(at_once.predict(X), parts.predict(X))
    assert at_once.fit(X, y).learner_.n_samples == 300


def test_an_estimator_is_pickled_with_what_it_learned(rng):
    X, y = rng.normal(size=(100, 2)), rng.normal(size=100)
    model = LocalRegressor("lwpr").fit(X, y)
    np.testing.assert_array_equal(pickle.loads(pickle.dumps(model)).predict(X), model.predict(X))  # noqa: S301 - our own


@pytest.mark.parametrize(
    ("arguments", "field"),
    [
        ({"learner": "knn"}, "learner"),
        ({"D": "auto"}, "D"),
        ({"n_passes": 0}, "n_passes"),
        ({"lam": 2.0}, "lam"),
    ],
)
def test_parameters_are_checked_when_they_are_used(arguments, field):
    with pytest.raises(ConfigurationError) as caught:
        LocalRegressor(**arguments).fit([[0.0], [1.0]], [0.0, 1.0])
    assert caught.value.field == field
    with pytest.raises(ValueError, match="Invalid parameter 'depth'"):
        LocalRegressor().set_params(depth=3)


def test_a_constant_output_is_explained_or_not(rng):
    X = rng.normal(size=(50, 1))
    model = LocalRegressor("lwr").fit(X, np.zeros(50))
    assert model.score(X, np.zeros(50)) == 1.0
    assert model.score(X, np.ones(50)) == 0.0

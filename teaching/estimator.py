"""The learners behind scikit-learn's conventions, without scikit-learn being needed.

Example:
    >>> import numpy as np
    >>> from teaching.estimator import LocalRegressor
    >>> X = np.random.default_rng(0).uniform(0.0, 1.0, (400, 1))
    >>> y = np.sin(4.0 * X[:, 0])
    >>> model = LocalRegressor("lwr").fit(X, y)
    >>> model.score(X, y) > 0.99
    True
    >>> y, std = model.predict([[0.5]], return_std=True)
    >>> y.shape, std.shape
    ((1,), (1,))
"""

import inspect
import sys
from collections.abc import Callable
from typing import Any, Final, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike

from hm_driver.errors import ConfigurationError
from teaching.kernels import FloatArray
from teaching.local_models import LocalModels
from teaching.lwpr import LWPR
from teaching.lwr import LWR
from teaching.rfwr import RFWR

Kind = Literal["lwr", "multiresolution", "rfwr", "lwpr"]
LEARNERS: Final[dict[str, Callable[..., LocalModels]]] = {
    "lwr": LWR,
    "multiresolution": lambda *sizes, **options: LWR(*sizes, **{"levels": 3, "w_gen": 0.5, **options}),
    "rfwr": RFWR,
    "lwpr": LWPR,
}
"""What makes each learner from its numbers of inputs and outputs and its options."""


class LocalRegressor:
    """An incremental regression by local models, as scikit-learn's pipelines and searches expect one.

    Args:
        learner: ``"lwr"`` (fields of one fixed size), ``"multiresolution"`` (finer ones where the prediction
            misses), ``"rfwr"`` (fields that adapt) or ``"lwpr"`` (the same along a few directions, for many
            inputs).
        D: Metric of the fields, as the learner takes it [1 / input unit^2]; ``"scale"`` is
            10 / (d^2 variance) of each input of the first samples.
        w_gen: Activation at or below which a sample makes a new field; None is the learner's own.
        lam: Forgetting factor; None is the learner's own.
        options: Further arguments of the learner by name.
        n_passes: How often :meth:`fit` goes through the samples.

    Attributes:
        learner_: The learner itself, once there are samples: models, activations, removal, files.
        n_features_in_: Number of inputs.
    """

    def __init__(
        self,
        learner: Kind = "lwpr",
        *,
        D: ArrayLike | Literal["scale"] = "scale",
        w_gen: float | None = None,
        lam: float | None = None,
        options: dict[str, Any] | None = None,
        n_passes: int = 1,
    ) -> None:
        self.learner = learner
        self.D = D
        self.w_gen = w_gen
        self.lam = lam
        self.options = options
        self.n_passes = n_passes

    def get_params(self, deep: bool = True) -> dict[str, Any]:  # noqa: ARG002, FBT001, FBT002 - its signature
        """Parameters by name."""
        return {name: getattr(self, name) for name in _names()}

    def set_params(self, **params: Any) -> Self:  # noqa: ANN401 - whatever the constructor takes
        """Set parameters by name.

        Raises:
            ValueError: There is no such parameter.
        """
        for name, value in params.items():
            if name not in _names():
                raise ValueError(f"Invalid parameter {name!r} for {self!r}; there are {', '.join(_names())}")
            setattr(self, name, value)
        return self

    def __repr__(self) -> str:
        defaults = inspect.signature(type(self)).parameters
        changed = (
            f"{name}={value!r}"
            for name, value in self.get_params().items()
            if repr(value) != repr(defaults[name].default)
        )
        return f"{type(self).__name__}({', '.join(changed)})"

    def fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Learn samples from the beginning.

        Args:
            X: Inputs, shape (n, d).
            y: Outputs, shape (n,) or (n, m).

        Raises:
            ValueError: Shapes are wrong, a value is not finite, or there is no sample.
            ConfigurationError: A parameter is out of range.
        """
        if isinstance(self.n_passes, bool) or not isinstance(self.n_passes, int) or self.n_passes < 1:
            raise ConfigurationError("n_passes", f"{self.n_passes!r} must be a whole number from 1 on")
        inputs, outputs = self._samples(X, y)
        self._begin(inputs, outputs)
        for _ in range(self.n_passes):
            self.learner_.partial_fit(inputs, outputs.reshape(len(outputs), -1))
        return self

    def partial_fit(self, X: ArrayLike, y: ArrayLike) -> Self:
        """Learn more samples; the first ones decide about ``D="scale"``.

        Args:
            X: Inputs, shape (n, d).
            y: Outputs, shape (n,) or (n, m), as before.

        Raises:
            ValueError: Shapes are wrong, a value is not finite, or there is no sample.
            ConfigurationError: A parameter is out of range.
        """
        inputs, outputs = self._samples(X, y)
        if not hasattr(self, "learner_"):
            self._begin(inputs, outputs)
        self._check_width(inputs)
        self.learner_.partial_fit(inputs, outputs.reshape(len(outputs), -1))
        return self

    @overload
    def predict(self, X: ArrayLike, *, return_std: Literal[False] = False) -> FloatArray: ...

    @overload
    def predict(self, X: ArrayLike, *, return_std: Literal[True]) -> tuple[FloatArray, FloatArray]: ...

    def predict(
        self, X: ArrayLike, *, return_std: bool = False
    ) -> FloatArray | tuple[FloatArray, FloatArray]:
        """Outputs at X, of the shape that y had, and with return_std their standard deviation.

        Raises:
            ValueError: The shape is wrong, a value is not finite, or nothing was learned yet.
        """
        if not hasattr(self, "learner_"):
            raise _not_fitted()(f"This {type(self).__name__} instance is not fitted yet; call fit first")
        inputs = _matrix("X", X)
        self._check_width(inputs)
        if return_std:
            Y, std = self.learner_.predict(inputs, return_std=True)
            return self._shaped(Y), self._shaped(std)
        return self._shaped(self.learner_.predict(inputs))

    def score(self, X: ArrayLike, y: ArrayLike) -> float:
        """Coefficient of determination R^2, the mean over the outputs; 1 is perfect.

        Raises:
            ValueError: As :meth:`predict`, or y has another shape than the predictions.
        """
        Y = self.predict(X)
        truth = np.asarray(y, dtype=float).reshape(Y.shape)
        missed = np.atleast_1d(np.sum((truth - Y) ** 2, axis=0))
        spread = np.atleast_1d(np.sum((truth - truth.mean(axis=0)) ** 2, axis=0))
        constant = spread == 0.0
        explained = 1.0 - missed / np.where(constant, 1.0, spread)
        return float(np.mean(np.where(constant, (missed == 0.0).astype(float), explained)))

    def __sklearn_tags__(self) -> Any:  # noqa: ANN401 - a class of scikit-learn, which alone calls this
        """What scikit-learn asks an estimator about itself."""
        from sklearn.utils import InputTags, RegressorTags, Tags, TargetTags

        return Tags(
            estimator_type="regressor",
            target_tags=TargetTags(required=True, multi_output=True),
            regressor_tags=RegressorTags(),
            input_tags=InputTags(),
        )

    def _begin(self, X: FloatArray, Y: FloatArray) -> None:
        if self.learner not in LEARNERS:
            raise ConfigurationError("learner", f"{self.learner!r} is none of {', '.join(LEARNERS)}")
        options = dict(self.options or {})
        if self.w_gen is not None:
            options["w_gen"] = self.w_gen
        if self.lam is not None:
            options["lam"] = self.lam
        options["D"] = self.D
        if isinstance(self.D, str):
            if self.D != "scale":
                raise ConfigurationError("D", f"{self.D!r} must be 'scale', a number, a list or a matrix")
            variance = X.var(axis=0)
            options["D"] = 10.0 / (X.shape[1] ** 2 * np.where(variance > 1e-300, variance, 1.0))
        n_outputs = 1 if Y.ndim == 1 else Y.shape[1]
        self.learner_ = LEARNERS[self.learner](X.shape[1], n_outputs, **options)
        self.n_features_in_ = X.shape[1]
        self._is_flat = Y.ndim == 1

    def _samples(self, X: ArrayLike, y: ArrayLike) -> tuple[FloatArray, FloatArray]:
        if y is None:
            raise ValueError(f"{type(self).__name__} requires y to be passed, but the target y is None")
        inputs, outputs = _matrix("X", X), _array("y", y)
        if outputs.ndim not in (1, 2) or len(outputs) != len(inputs):
            raise ValueError(f"y has the shape {outputs.shape}; it must have {len(inputs)} rows, as X")
        return inputs, outputs

    def _check_width(self, X: FloatArray) -> None:
        if X.shape[1] != self.n_features_in_:
            raise ValueError(
                f"X has {X.shape[1]} features, but {type(self).__name__} "
                f"is expecting {self.n_features_in_} features as input"
            )

    def _shaped(self, Y: FloatArray) -> FloatArray:
        return Y[:, 0] if self._is_flat else Y


def _names() -> list[str]:
    return list(inspect.signature(LocalRegressor).parameters)


def _not_fitted() -> type[Exception]:
    """The error of scikit-learn where that is loaded, so that its users catch theirs."""
    exceptions = sys.modules.get("sklearn.exceptions")
    found: type[Exception] = getattr(exceptions, "NotFittedError", ValueError)
    return found


def _array(name: str, values: ArrayLike) -> FloatArray:
    if hasattr(values, "toarray"):
        raise TypeError(f"{name} is a sparse matrix; dense data is required: use {name}.toarray()")
    array = np.asarray(values)
    if array.dtype.kind == "c":
        raise ValueError(f"Complex data not supported: {name} is of type {array.dtype}")
    converted = np.asarray(array, dtype=np.float64)
    if not np.isfinite(converted).all():
        raise ValueError(f"{name} contains NaN or infinity")
    return converted


def _matrix(name: str, values: ArrayLike) -> FloatArray:
    array = _array(name, values)
    if array.ndim != 2:
        raise ValueError(
            f"{name} has the shape {array.shape}, but 2 dimensions are expected: "
            "Reshape your data with array.reshape(-1, 1) if it has one feature"
        )
    if array.shape[0] < 1:
        raise ValueError(f"0 sample(s) (shape={array.shape}) while a minimum of 1 is required.")
    if array.shape[1] < 1:
        raise ValueError(f"0 feature(s) (shape={array.shape}) while a minimum of 1 is required.")
    return array

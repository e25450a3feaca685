"""What learners of local models share: their table, and all that does not depend on how they learn."""

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Final, Literal, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

from hm_driver.errors import ConfigurationError
from teaching import kernels, storage
from teaching.kernels import FloatArray, Layout
from teaching.learner import ModelSet

Prune = Literal["overlap", "paper", "never"]
PRUNE_MODES: Final[dict[str, int]] = {
    "never": kernels.PRUNE_NEVER,
    "overlap": kernels.PRUNE_OVERLAP,
    "paper": kernels.PRUNE_PAPER,
}


class LocalModels(ABC):
    """Linear models with receptive fields in one table; a subclass chooses parameters and teaches them.

    Args:
        parameters: The arguments of the subclass by name, to be saved; D as a matrix.
        refinement: Numbers of the kernels' parameter vector from TOLERANCE to LEVELS.
        extra: Numbers behind the initial D in the kernels' parameter vector.
        block: Numbers that a model has beside the table.
        capacity: Number of models that there is room for at first.
        scales: One input and one output in the learner's own units; None where these are the user's.
    """

    _shares_deviation: ClassVar[bool] = True
    """Whether the standard deviation is that of :func:`teaching.kernels.deviation`."""

    def __init__(
        self,
        parameters: dict[str, Any],
        *,
        refinement: tuple[float, float, float] = (0.0, 1.0, 1.0),
        extra: tuple[float, ...] = (),
        block: int = 0,
        capacity: int,
        scales: tuple[FloatArray, FloatArray] | None = None,
    ) -> None:
        p = self._parameters = parameters
        check_common(p)
        require_count("capacity", capacity, 10_000_000)
        n_inputs, n_outputs, D = p["n_inputs"], p["n_outputs"], p["D"]
        self._layout = Layout(n_inputs, n_outputs)
        self._scales = scales
        if scales is not None:
            D = D * np.outer(scales[0], scales[0])
        inverse = np.linalg.inv(D)
        chosen = [p["w_gen"], p["w_prune"], p["lam"], p["P0"], PRUNE_MODES[p["prune"]], *refinement]
        triangle = D[np.triu_indices(n_inputs)]
        self._params = np.array([*chosen, np.trace(inverse), *triangle, *extra], dtype=float)
        self._state = np.zeros(kernels.STATE_SIZE)
        self._state[kernels.REACH] = math.sqrt(inverse[0, 0])
        self._state[kernels.Q_CUT] = -2.0 * math.log(p["w_cutoff"]) if p["w_cutoff"] > 0.0 else math.inf
        columns = columns_for(capacity)
        self._table = np.zeros((self._layout.rows + (block > 0), columns))
        self._blocks = np.zeros((columns if block else 0, block))
        self._x, self._y = np.zeros((1, n_inputs)), np.zeros((1, n_outputs))
        self._scratch = kernels.scratch_for(n_inputs, n_outputs)

    @abstractmethod
    def _learn(self, X: FloatArray, Y: FloatArray, start: int) -> int:
        """Learn from sample start on; returns how many of all are learned, as :func:`kernels.update`."""

    @property
    def n_inputs(self) -> int:
        """Number of inputs d."""
        return self._layout.n_inputs

    @property
    def n_outputs(self) -> int:
        """Number of outputs m."""
        return self._layout.n_outputs

    @property
    def n_models(self) -> int:
        """Number of local models N that there are now."""
        return int(self._state[kernels.N_MODELS])

    @property
    def n_added(self) -> int:
        """Number of models ever made."""
        return int(self._state[kernels.N_ADDED])

    @property
    def n_pruned(self) -> int:
        """Number of models that pruning has removed."""
        return int(self._state[kernels.N_PRUNED])

    @property
    def n_samples(self) -> int:
        """Number of samples learned."""
        return int(self._state[kernels.N_SAMPLES])

    @property
    def parameters(self) -> dict[str, Any]:
        """The arguments that the learner was made with, D as a matrix."""
        return {**self._parameters, "D": self._parameters["D"].copy()}

    @property
    def models(self) -> ModelSet:
        """The local models, oldest first."""
        layout, d, m = self._layout, self.n_inputs, self.n_outputs
        order = self._by_age()
        t = self._table[:, order]
        centres, D = t[:d].T.copy(), symmetric(t[layout.metric : layout.parameters], d)
        M, P = t[layout.parameters : layout.covariance].T.reshape(-1, d + 1, m), self._covariances(order)
        if self._scales is not None:
            x, y = self._scales
            x1 = np.append(x, 1.0)
            centres, D = centres * x, D / np.outer(x, x)
            M, P = M / x1[:, None] * y, P / np.outer(x1, x1)
        samples, born = t[layout.books + kernels.SAMPLES], t[layout.books + kernels.BORN]
        return ModelSet(centres, D, M, P, samples.astype(np.int64), born.astype(np.int64))

    @property
    def say(self) -> FloatArray:
        """Factor of each model's weight in eq. (1), shape (N,), oldest first."""
        gain: FloatArray = self._table[self._layout.books + kernels.GAIN, self._by_age()].copy()
        return gain

    @property
    def variances(self) -> FloatArray | None:
        """Variance of each model's residuals [squared output units], shape (N, m), oldest first.

        With :attr:`models` and :attr:`say` they give the standard deviation of :meth:`predict`; None where
        that follows from more than these, as with projections.
        """
        if not self._shares_deviation:
            return None
        t, books = self._table[:, self._by_age()], self._layout.books
        squares = t[books + kernels.SQUARES : books + kernels.SQUARES + self.n_outputs]
        variances: FloatArray = (squares / t[books + kernels.FREEDOM]).T.copy()
        return variances if self._scales is None else variances * self._scales[1] ** 2

    def check_parameters(self) -> list[str]:
        """Say which parameters contradict each other, and the consequence."""
        p = self._parameters
        said = []
        if p["prune"] == "paper" and p["w_gen"] >= p["w_prune"] ** 4:
            said.append(
                f"w_gen = {p['w_gen']:g} is not below w_prune^4 = {p['w_prune'] ** 4:.3g}: a sample "
                f"midway between two new models activates both by up to {p['w_gen'] ** 0.25:.3g}, so that "
                "they prune each other and models come and go without end; choose prune = 'overlap', "
                "a lower w_gen or a higher w_prune"
            )
        if p["prune"] != "never" and p["w_gen"] >= p["w_prune"]:
            said.append(
                f"w_gen = {p['w_gen']:g} is not below w_prune = {p['w_prune']:g}: a model is pruned "
                "as soon as it is made; choose w_gen < w_prune or prune = 'never'"
            )
        return said

    def update(self, x: ArrayLike, y: ArrayLike) -> None:
        """Learn one sample.

        Args:
            x: Input, shape (d,).
            y: Output, shape (m,), or a number where m is 1.

        Raises:
            ValueError: The shape is wrong or a value is not finite; nothing is learned.
        """
        self._take(x, y)
        if self._scales is not None:
            self._x /= self._scales[0]
            self._y /= self._scales[1]
        if self._learn(self._x, self._y, 0) != 1:
            if not (np.isfinite(self._x).all() and np.isfinite(self._y).all()):
                raise ValueError(f"the sample x = {x!r}, y = {y!r} is not finite; it was not learned")
            self._grow()
            self._learn(self._x, self._y, 0)

    def partial_fit(self, X: ArrayLike, Y: ArrayLike) -> Self:
        """Learn samples in the order given.

        Args:
            X: Inputs, shape (n, d), or (n,) where d is 1.
            Y: Outputs, shape (n, m), or (n,) where m is 1.

        Raises:
            ValueError: Shapes are wrong or a value is not finite; nothing is learned.
        """
        inputs, outputs = self._inputs(X), checked("Y", Y, self.n_outputs)
        if self._scales is not None:
            outputs = outputs / self._scales[1]
        if len(inputs) != len(outputs):
            raise ValueError(f"X has {len(inputs)} samples and Y {len(outputs)}; they must be as many")
        done = 0
        while done < len(inputs):
            done = self._learn(inputs, outputs, done)
            if done < len(inputs):
                self._grow()
        return self

    @overload
    def predict(self, X: ArrayLike, *, return_std: Literal[False] = False) -> FloatArray: ...

    @overload
    def predict(self, X: ArrayLike, *, return_std: Literal[True]) -> tuple[FloatArray, FloatArray]: ...

    def predict(
        self, X: ArrayLike, *, return_std: bool = False
    ) -> FloatArray | tuple[FloatArray, FloatArray]:
        """Outputs of eq. (1), shape (n, m), at inputs of shape (n, d).

        Args:
            X: Inputs, shape (n, d).
            return_std: Also return the standard deviation of a sample about its prediction, shape (n, m): the
                noise that the models have seen, the uncertainty of their parameters, and their disagreement
                (in the spirit of the confidence of LWPR); infinite where there is no model.
        """
        Y = self._evaluate(X)[0]
        return (Y, self._deviation(X, Y)) if return_std else Y

    def w_max(self, X: ArrayLike) -> FloatArray:
        """Largest activation, shape (n,), at inputs of shape (n, d); 0 without models."""
        return self._evaluate(X)[1]

    def share_active(self, X: ArrayLike, w: float) -> float:
        """Share of inputs of shape (n, d) with an activation of at least w."""
        inputs = self._inputs(X)
        require_between("w", w, 0.0, 1.0, closed=True)
        active: int = kernels.count_active(self._table, self._state, inputs, -2.0 * math.log(w))
        return active / len(inputs)

    def activations(self, X: ArrayLike) -> FloatArray:
        """Activation of eq. (2) of every model, oldest first, shape (n, N), at inputs of shape (n, d)."""
        inputs = self._inputs(X)
        W = np.empty((len(inputs), self.n_models))
        kernels.activations(self._table, self._state, inputs, W)
        return W[:, self._by_age()]

    def query(self, x0: float, x1: float) -> tuple[float, float]:
        """Prediction and largest activation at one point: the fast path of a control loop.

        Raises:
            TypeError: The learner has not two inputs and one output.
        """
        if self._layout.n_inputs != 2 or self._layout.n_outputs != 1:
            raise TypeError(
                f"query() is for two inputs and one output, not {self.n_inputs} and {self.n_outputs}"
            )
        result: tuple[float, float]
        if self._scales is None:
            result = kernels.query_2d(self._table, self._state, float(x0), float(x1))
            return result
        x, y = self._scales
        result = kernels.query_2d(self._table, self._state, float(x0) / x[0], float(x1) / x[1])
        return result[0] * float(y[0]), result[1]

    def query_std(self, x0: float, x1: float) -> tuple[float, float, float]:
        """As :meth:`query`, with the standard deviation of :meth:`predict` as the third."""
        if self._is_plain and math.isfinite(x0 + x1):
            result: tuple[float, float, float]
            result = kernels.query_std_2d(self._table, self._state, float(x0), float(x1))
            return result
        y, w_max = self.query(x0, x1)
        point = np.array([[x0, x1]], dtype=float)
        return y, w_max, float(self._deviation(point, np.array([[y]]))[0, 0])

    @property
    def _is_plain(self) -> bool:
        """Whether one call of a kernel has the prediction at a point of a plane, and its deviation."""
        return self._scales is None and self._scratch is None and self._shares_deviation

    def remove(self, which: ArrayLike) -> int:
        """Remove models, named by indices into :attr:`models` or by a mask of shape (N,).

        Returns:
            How many were removed.

        Raises:
            IndexError: There is no such model.
        """
        keep = np.ones(self.n_models, dtype=bool)
        chosen = np.asarray(which)
        keep[self._by_age()[chosen if chosen.size else []]] = False
        n = int(keep.sum())
        removed = self.n_models - n
        kept = self._table[:, : self.n_models][:, keep]
        if len(self._blocks) and removed:
            self._blocks[:n] = self._blocks[kept[-1].astype(np.int64)]
            kept[-1] = np.arange(n)
        self._table[:, :n] = kept
        self._state[kernels.N_MODELS] = n
        return removed

    def remove_near(self, x: ArrayLike, w: float) -> int:
        """Remove the models that the input x, shape (d,), activates above w; returns how many."""
        return self.remove(self.activations(np.reshape(np.asarray(x, dtype=float), (1, -1)))[0] > w)

    def remove_box(self, lower: ArrayLike, upper: ArrayLike) -> int:
        """Remove the models with their centre between two corners, shapes (d,); returns how many."""
        centres = self.models.centres
        low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
        return self.remove(np.all((centres >= low) & (centres <= high), axis=1))

    def remove_ellipse(self, centre: ArrayLike, semi_axes: ArrayLike, *, angle: float = 0.0) -> int:
        """Remove the models with their centre in an ellipse, a circle or their like of more dimensions.

        Args:
            centre: Its centre, shape (d,).
            semi_axes: Its semi-axes [input units], shape (d,), or a number: a circle's radius.
            angle: By which the first axis is turned towards the second [rad]; for two inputs.

        Returns:
            How many were removed.

        Raises:
            ValueError: A semi-axis is not above 0, or an angle was given for other than two inputs.
        """
        axes = np.broadcast_to(np.asarray(semi_axes, dtype=float), (self.n_inputs,))
        if not np.all(axes > 0.0):
            raise ValueError(f"semi_axes = {semi_axes!r} must be above 0")
        offset = self.models.centres - np.asarray(centre, dtype=float)
        if angle != 0.0:
            if self.n_inputs != 2:
                raise ValueError(f"an angle turns an ellipse of two inputs, not of {self.n_inputs}")
            c, s = math.cos(angle), math.sin(angle)
            offset = offset @ np.array([[c, -s], [s, c]])
        return self.remove(np.sum((offset / axes) ** 2, axis=1) <= 1.0)

    def remove_older(self, n_samples: int) -> int:
        """Remove the models made before the learner had seen n_samples samples; returns how many."""
        return self.remove(self.models.born < n_samples)

    def copy(self) -> Self:
        """A learner of the same state that shares nothing with this one."""
        other = object.__new__(type(self))
        other.__dict__.update(self.__dict__)
        for name in ("_params", "_state", "_table", "_blocks", "_x", "_y"):
            setattr(other, name, getattr(self, name).copy())
        other._scratch = kernels.scratch_for(self.n_inputs, self.n_outputs)
        return other

    def save(self, path: str | Path) -> None:
        """Write parameters and models to a file (numpy's npz with the parameters as JSON, no pickle).

        It is written aside and moved into place, so that a file there was before survives a failure.

        Raises:
            OSError: The file cannot be written.
        """
        n = self.n_models
        arrays = {"state": self._state, "table": self._table[:, :n], "blocks": self._blocks[:n]}
        storage.write(path, type(self).__name__, self._parameters, arrays)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a learner that :meth:`save` wrote; it goes on as if nothing had happened.

        Raises:
            ConfigurationError: The file is no saved learner of this kind, damaged, or of another format.
            OSError: The file cannot be read.
        """
        parameters, arrays = storage.read(path, cls.__name__)
        state, table, blocks = (arrays[name] for name in ("state", "table", "blocks"))
        n = table.shape[1] if table.ndim == 2 else 0
        make: Callable[..., Self] = cls
        try:
            self = make(**parameters, capacity=max(256, n))
        except (TypeError, ConfigurationError) as error:
            raise storage.damaged(path, f"its parameters are refused: {error}") from error
        if (
            state.shape != self._state.shape
            or table.shape != (self._table.shape[0], n)
            or blocks.shape != (n if len(self._blocks) else 0, self._blocks.shape[1])
            or state[kernels.N_MODELS] != n
            or not all(np.isfinite(array).all() for array in (state[: kernels.Q_CUT], table, blocks))
            or np.any(np.diff(table[0]) < 0.0)
            or (len(blocks) and not np.array_equal(np.sort(table[-1]), np.arange(n)))
        ):
            raise storage.damaged(path, "its arrays do not fit together")
        self._table[:, :n], self._blocks[: len(blocks)], self._state[:] = table, blocks, state
        return self

    def warm_up(self) -> None:
        """Compile what this learner runs, or load it from the cache: before a loop starts, never in it."""
        other = self.copy()
        X, Y = np.zeros((2, self.n_inputs)), np.zeros((2, self.n_outputs))
        other.partial_fit(X, Y).predict(X, return_std=True)
        other.share_active(X, 0.5)
        other.activations(X)
        other.update(X[0], Y[0])
        if (self.n_inputs, self.n_outputs) == (2, 1):
            other.query_std(0.0, 0.0)

    def _take(self, x: ArrayLike, y: ArrayLike) -> None:
        """Keep one sample, to be learned."""
        d, m = self._layout.n_inputs, self._layout.n_outputs
        try:
            fits = (d == 1 or len(x) == d) and (m == 1 or len(y) == m)  # type: ignore[arg-type]  # numbers fail
            if fits:
                self._x[0] = x
                self._y[0] = y
        except (TypeError, ValueError):
            fits = False
        if not fits:
            raise ValueError(
                f"the sample x = {x!r}, y = {y!r} has not the shapes ({d},) and ({m},); it was not learned"
            )

    def _covariances(self, order: NDArray[np.int64]) -> FloatArray:
        """P of the models in the columns order, shape (N, d + 1, d + 1), in the learner's own units."""
        rows = self._table[self._layout.covariance : self._layout.books, order]
        return symmetric(rows, self.n_inputs + 1)

    def _by_age(self) -> NDArray[np.int64]:
        order: NDArray[np.int64] = np.argsort(
            self._table[self._layout.books + kernels.BORN, : self.n_models], kind="stable"
        )
        return order

    def _grow(self) -> None:
        table = np.zeros((self._table.shape[0], columns_for(2 * self._table.shape[1])))
        table[:, : self._table.shape[1]] = self._table
        if len(self._blocks):
            blocks = np.zeros((table.shape[1], self._blocks.shape[1]))
            blocks[: len(self._blocks)] = self._blocks
            self._blocks = blocks
        self._table = table

    def _evaluate(self, X: ArrayLike) -> tuple[FloatArray, FloatArray]:
        inputs = self._inputs(X)
        Y, w_max = np.empty((len(inputs), self.n_outputs)), np.empty(len(inputs))
        kernels.predict(self._table, self._state, inputs, Y, w_max, self._scratch)
        if self._scales is not None:
            Y *= self._scales[1]
        return Y, w_max

    def _deviation(self, X: ArrayLike, Y: FloatArray) -> FloatArray:
        inputs, V = self._inputs(X), np.empty_like(Y)
        if self._scales is None:
            self._variance(inputs, Y, V)
        else:
            self._variance(inputs, Y / self._scales[1], V)
            V *= self._scales[1] ** 2
        deviation: FloatArray = np.sqrt(V)
        return deviation

    def _variance(self, X: FloatArray, Y: FloatArray, V: FloatArray) -> None:
        """Fill V with the variances at X for its predictions Y, in the learner's own units."""
        between = np.empty_like(V)
        kernels.deviation(self._table, self._state, X, Y, V, between)
        V += between

    def _inputs(self, X: ArrayLike) -> FloatArray:
        inputs = checked("X", X, self.n_inputs)
        return inputs if self._scales is None else inputs / self._scales[0]


def checked(name: str, values: ArrayLike, width: int) -> FloatArray:
    """Values as an array of shape (n, width).

    Raises:
        ValueError: The shape is wrong or a value is not finite.
    """
    array = np.require(values, dtype=np.float64, requirements=["C", "W"])
    if array.ndim == 1 and width == 1:
        array = array.reshape(-1, 1)
    if array.ndim != 2 or array.shape[1] != width:
        raise ValueError(f"{name} has the shape {np.shape(values)}; it must be (n, {width})")
    if not np.isfinite(array).all():
        bad = int(np.flatnonzero(~np.isfinite(array).all(axis=1))[0])
        raise ValueError(f"{name}[{bad}] = {array[bad]} is not finite; nothing was done")
    return array


def scale_vector(name: str, scale: ArrayLike | None, width: int) -> FloatArray:
    """A positive scale for each input or output, shape (width,), from a number, a list or None for 1.

    Raises:
        ConfigurationError: The shape is wrong or a scale is not above 0.
    """
    given = np.asarray(1.0 if scale is None else scale, dtype=float)
    if given.shape not in ((), (width,)):
        raise ConfigurationError(name, f"has the shape {given.shape}; it must be a number or ({width},)")
    if not (np.isfinite(given).all() and np.all(given > 0.0)):
        raise ConfigurationError(name, f"{given.tolist()} must be finite and above 0")
    vector: FloatArray = np.broadcast_to(given, (width,)).copy()
    return vector


def check_common(p: dict[str, Any]) -> None:
    """Refuse arguments that every learner of local models has.

    Raises:
        ConfigurationError: An argument is out of range.
    """
    require_between("w_gen", p["w_gen"], 0.0, 1.0)
    require_between("w_prune", p["w_prune"], 0.0, 1.0)
    require_between("lam", p["lam"], 0.0, 1.0, closed=True)
    require_between("P0", p["P0"], 0.0, 1e15, closed=True)
    require_between("w_cutoff", p["w_cutoff"], -math.ulp(0.0), min(p["w_gen"], 0.1), closed=True)
    if p["prune"] not in PRUNE_MODES:
        raise ConfigurationError("prune", f"{p['prune']!r} is none of {', '.join(sorted(PRUNE_MODES))}")


def require_count(name: str, value: int, high: int) -> None:
    """Refuse what is not a whole number from 1 to high.

    Raises:
        ConfigurationError: The value is out of range or no whole number.
    """
    if isinstance(value, bool) or not isinstance(value, int) or not 1 <= value <= high:
        raise ConfigurationError(name, f"{value!r} must be a whole number from 1 to {high}")


def require_between(name: str, value: float, low: float, high: float, *, closed: bool = False) -> None:
    """Refuse a value that is not above low and below high, or at high where closed.

    Raises:
        ConfigurationError: The value is out of range or no number.
    """
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ConfigurationError(name, f"{value!r} must be a number")
    if not (low < value < high or (closed and value == high)):
        limit = "at most" if closed else "below"
        raise ConfigurationError(name, f"{value:g} must be above {max(low, 0.0):g} and {limit} {high:g}")


def metric_matrix(D: ArrayLike, n_inputs: int) -> FloatArray:
    """D as a symmetric positive definite matrix, shape (d, d), from a number, a diagonal or a matrix.

    Raises:
        ConfigurationError: The shape is wrong, or D is not symmetric positive definite.
    """
    try:
        given = np.asarray(D, dtype=float)
    except (TypeError, ValueError) as error:
        raise ConfigurationError("D", f"{D!r} must be a number, a diagonal or a square matrix") from error
    if given.ndim == 0:
        given = np.full(n_inputs, float(given))
    matrix = np.diag(given) if given.ndim == 1 else given
    if matrix.shape != (n_inputs, n_inputs):
        raise ConfigurationError(
            "D", f"has the shape {np.shape(D)}; it must be a number, ({n_inputs},) or square"
        )
    if not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T, rtol=1e-12, atol=0.0):
        raise ConfigurationError("D", f"{matrix.tolist()} must be finite and symmetric")
    smallest = float(np.linalg.eigvalsh(matrix)[0])
    if smallest <= 0.0:
        raise ConfigurationError("D", f"must be positive definite; its smallest eigenvalue is {smallest:g}")
    result: FloatArray = (matrix + matrix.T) / 2.0
    return result


def columns_for(capacity: int) -> int:
    """Columns of a table for so many models: an odd number of cache lines a row.

    A power of two would put all rows of a column into the same few sets of the cache.
    """
    return 8 * (-(-capacity // 8) | 1)


def symmetric(rows: FloatArray, size: int) -> FloatArray:
    """Matrices of shape (N, size, size) from the rows of their upper triangles, shape (-1, N)."""
    matrices = np.empty((rows.shape[1], size, size))
    upper, right = np.triu_indices(size)
    matrices[:, upper, right] = rows.T
    matrices[:, right, upper] = rows.T
    return matrices

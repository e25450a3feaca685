"""Multi-resolution regression that remembers: ours, not the paper's.

A recursive learner of local models forgets nothing and yet loses what it knew, where a wide field learns
first one side of a border and then the other: its straight line goes wrong on the side that was taught
first, where no sample comes any more to ask for a finer model. So this one keeps its samples and rehearses:
among the new samples it learns old ones again, a new model begins with all that is remembered of its
field, and each model has a say in the prediction by how precise it has been.

Example:
    >>> from teaching.rehearsal import RehearsingLWR
    >>> skill = RehearsingLWR(levels=4, ratio=8.0, w_gen=0.5)
    >>> skill = skill.partial_fit([[0.0, 0.0], [0.1, 0.0]], [0.10, 0.02])
    >>> skill.n_remembered
    2
"""

import math
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from teaching import kernels, storage
from teaching.kernels import FloatArray
from teaching.local_models import checked, require_count
from teaching.lwr import LWR

BoolArray = NDArray[np.bool_]

GOLDEN: Final = 0.5 * (math.sqrt(5.0) - 1.0)
"""Multiples of it, modulo 1, visit the memory evenly whatever its size."""
SLICE: Final = 5
"""New samples after which models that have just been made are taught what is remembered."""
Q_FIELD: Final = 9.0
"""Exponent, three standard deviations, up to which a remembered sample belongs to a field."""
PRIOR: Final = 0.5
"""Samples for which the tolerance counts in a model's variance, until it has more of its own."""
FLOOR: Final = 0.02
"""Relative deviation below which a model's precision counts no further."""


@njit(cache=True, nogil=True, error_model="numpy")
def teach_model(
    table: FloatArray,
    params: FloatArray,
    place: int,
    X: FloatArray,
    Y: FloatArray,
    scratch: FloatArray | None,
    Q: FloatArray,
) -> None:
    """Let the model in one column learn samples X, Y of shapes (n, d) and (n, m), within its field."""
    for k in range(X.shape[0]):
        kernels.sweep(table, params, Q_FIELD, place, place + 1, X, Y, k, scratch, Q)


@njit(cache=True, nogil=True, error_model="numpy")
def mark_held(
    X: FloatArray, centres: FloatArray, D: FloatArray, reach: FloatArray, q_limit: float, held: BoolArray
) -> None:
    """Set held, shape (n,), for the rows of X, shape (n, d), whose exponent in some field is below q_limit.

    No field goes farther along the first input than its reach.
    """
    d, n = X.shape[1], centres.shape[0]
    for k in range(X.shape[0]):
        for i in range(n):
            if abs(X[k, 0] - centres[i, 0]) > reach[i]:
                continue
            q = 0.0
            for j in range(d):
                for c in range(d):
                    q += (X[k, j] - centres[i, j]) * D[i, j, c] * (X[k, c] - centres[i, c])
            if q < q_limit:
                held[k] = True
                break


class RehearsingLWR(LWR):
    """Locally weighted regression of several field sizes that rehearses what it was taught.

    * *Rehearsal.* After each new sample, ``rehearse`` remembered ones are learned again, in an order that
      visits the memory evenly; one that the prediction now misses asks for a finer model as a new one does.
    * *Beginning.* A model that is made later begins with the remembered samples of its field.
    * *Say.* The weight of a model in eq. (1) is multiplied by (det(D) / det(D0))^(1/4) / v^2, with v the
      local variance of its residuals by the square of its value: of two fields the more precise one counts,
      and of two that are as precise the wide one, which has averaged over more samples, is not drowned.

    Cost per sample is constant, and what is remembered is bounded: the oldest samples go first. Samples are
    taken five at a time, and weights are set after each five: calls whose sizes are multiples of five learn
    the same to the bit. Other sizes rehearse in another order and decide otherwise at times, so that there
    are other models, of about the same error.

    Args:
        n_inputs: Number of inputs d.
        n_outputs: Number of outputs m.
        rehearse: Remembered samples that are learned again for each new one.
        memory: Samples that are remembered.
        options: Those of :class:`teaching.lwr.LWR`.

    Raises:
        ConfigurationError: An argument is out of range.
    """

    def __init__(
        self,
        n_inputs: int = 2,
        n_outputs: int = 1,
        *,
        rehearse: int = 2,
        memory: int = 50_000,
        **options: Any,  # noqa: ANN401 - those of LWR, which checks them
    ) -> None:
        require_count("rehearse", rehearse, 100)
        require_count("memory", memory, 10_000_000)
        super().__init__(n_inputs, n_outputs, **{"levels": 4, "ratio": 8.0, "w_gen": 0.5, **options})
        self._parameters |= {"rehearse": rehearse, "memory": memory}
        self._kept_X, self._kept_Y = np.empty((0, n_inputs)), np.empty((0, n_outputs))
        self._n_kept = self._oldest = self._turn = self._n_new = 0

    @property
    def n_samples(self) -> int:
        """Number of samples learned; each counts once, however often it was rehearsed."""
        return self._n_new

    @property
    def n_remembered(self) -> int:
        """Number of samples remembered."""
        return self._n_kept

    def update(self, x: ArrayLike, y: ArrayLike) -> None:
        """Learn one sample, shapes (d,) and (m,).

        Raises:
            ValueError: The shape is wrong or a value is not finite; nothing is learned.
        """
        self._take(x, y)
        self.partial_fit(self._x.copy(), self._y.copy())

    def partial_fit(self, X: ArrayLike, Y: ArrayLike) -> Self:
        """Learn samples in the order given, with remembered ones between them.

        Args:
            X: Inputs, shape (n, d), or (n,) where d is 1.
            Y: Outputs, shape (n, m), or (n,) where m is 1.

        Raises:
            ValueError: Shapes are wrong or a value is not finite; nothing is learned.
        """
        inputs, outputs = checked("X", X, self.n_inputs), checked("Y", Y, self.n_outputs)
        if len(inputs) != len(outputs):
            raise ValueError(f"X has {len(inputs)} samples and Y {len(outputs)}; they must be as many")
        for k in range(0, len(inputs), SLICE):
            new_X, new_Y = inputs[k : k + SLICE], outputs[k : k + SLICE]
            chosen = self._recall(len(new_X))
            self._learn_slice(
                np.concatenate((new_X, self._kept_X[chosen])), np.concatenate((new_Y, self._kept_Y[chosen]))
            )
            self._keep(new_X, new_Y)
            self._weigh()
        self._n_new += len(inputs)
        return self

    def remove(self, which: ArrayLike) -> int:
        """Remove models as :meth:`LocalModels.remove` does, and the samples that they held."""
        models = self.models
        chosen = np.zeros(self.n_models, dtype=bool)
        indices = np.asarray(which)
        chosen[indices if indices.size else []] = True
        held = np.zeros(self._n_kept, dtype=bool)
        q_held = -2.0 * math.log(self._parameters["w_gen"])
        centres, D = models.centres[chosen], models.D[chosen]
        reach = 1.001 * np.sqrt(q_held * np.linalg.inv(D)[:, 0, 0])
        mark_held(self._kept_X[: self._n_kept], centres, D, reach, q_held, held)
        self._forget(held)
        return super().remove(which)

    def remove_box(self, lower: ArrayLike, upper: ArrayLike) -> int:
        """Remove the models with their centre between two corners, shapes (d,), and all samples there."""
        low, high = np.asarray(lower, dtype=float), np.asarray(upper, dtype=float)
        X = self._kept_X[: self._n_kept]
        self._forget(np.all((low <= X) & (high >= X), axis=1))
        return super().remove_box(lower, upper)

    def warm_up(self) -> None:
        """As :meth:`LocalModels.warm_up`, with what a later model begins with."""
        super().warm_up()
        other = self.copy()
        for x in (0.0, 1e3):
            other.partial_fit(np.full((1, self.n_inputs), x), np.zeros((1, self.n_outputs)))
        other.remove([0])

    def copy(self) -> Self:
        """A learner of the same state that shares nothing with this one."""
        other = super().copy()
        for name in ("_kept_X", "_kept_Y"):
            setattr(other, name, getattr(self, name).copy())
        return other

    def save(self, path: str | Path) -> None:
        """Write parameters, models and memory to a file, as :meth:`LocalModels.save`."""
        n, kept = self.n_models, self._n_kept
        arrays = {
            "state": self._state,
            "table": self._table[:, :n],
            "blocks": self._blocks[:n],
            "kept_X": self._kept_X[:kept],
            "kept_Y": self._kept_Y[:kept],
            "order": np.array([self._oldest, self._turn, self._n_new], dtype=float),
        }
        storage.write(path, type(self).__name__, self._parameters, arrays)

    @classmethod
    def load(cls, path: str | Path) -> Self:
        """Read a learner that :meth:`save` wrote, as :meth:`LocalModels.load`."""
        self = super().load(path)
        _, arrays = storage.read(path, cls.__name__)
        try:
            X, Y, order = (np.asarray(arrays[name], dtype=float) for name in ("kept_X", "kept_Y", "order"))
        except KeyError as error:
            raise storage.damaged(path, "it has no memory") from error
        if X.shape != (len(X), self.n_inputs) or Y.shape != (len(X), self.n_outputs) or order.shape != (3,):
            raise storage.damaged(path, "its memory does not fit together")
        self._kept_X, self._kept_Y, self._n_kept = X.copy(), Y.copy(), len(X)
        self._oldest, self._turn, self._n_new = (int(value) for value in order)
        return self

    def _recall(self, n: int) -> NDArray[np.int64]:
        """Which remembered samples are rehearsed for n new ones."""
        if not self._n_kept:
            return np.empty(0, dtype=np.int64)
        n *= self._parameters["rehearse"]
        turns = self._turn + np.arange(n)
        self._turn += n
        chosen: NDArray[np.int64] = (np.modf(turns * GOLDEN)[0] * self._n_kept).astype(np.int64)
        return chosen

    def _learn_slice(self, X: FloatArray, Y: FloatArray) -> None:
        before, seen = self.n_added, self._state[kernels.N_SAMPLES]
        super().partial_fit(X, Y)
        if self.n_added == before or not self._n_kept:
            return
        layout, n = self._layout, self.n_models
        kept_X, kept_Y = self._kept_X[: self._n_kept], self._kept_Y[: self._n_kept]
        Q = np.empty(self._table.shape[1])
        for place in np.flatnonzero(self._table[layout.books + kernels.BORN, :n] >= seen).tolist():
            near = np.flatnonzero(np.abs(kept_X[:, 0] - self._table[0, place]) <= self._reach(place))
            teach_model(self._table, self._params, place, kept_X[near], kept_Y[near], self._scratch, Q)

    def _reach(self, place: int) -> float:
        """How far the field of a model goes along the first input [input units]."""
        level = self._table[self._layout.books + kernels.LEVEL, place]
        reach: float = self._state[kernels.REACH] * self._params[kernels.RATIO] ** (-0.5 * level)
        return math.sqrt(Q_FIELD) * reach

    def _keep(self, X: FloatArray, Y: FloatArray) -> None:
        """Remember samples; the oldest go where there is no more room."""
        limit = self._parameters["memory"]
        room = min(limit, max(256, 2 * (self._n_kept + len(X))))
        if self._n_kept + len(X) > len(self._kept_X) and len(self._kept_X) < room:
            for name in ("_kept_X", "_kept_Y"):
                old = getattr(self, name)
                grown = np.empty((room, old.shape[1]))
                grown[: self._n_kept] = old[: self._n_kept]
                setattr(self, name, grown)
        for x, y in zip(X, Y, strict=True):
            if self._n_kept < limit:
                place = self._n_kept
                self._n_kept += 1
            else:
                place = self._oldest
                self._oldest = (self._oldest + 1) % limit
            self._kept_X[place], self._kept_Y[place] = x, y

    def _forget(self, unwanted: BoolArray) -> None:
        keep = ~unwanted
        self._kept_X, self._kept_Y = self._kept_X[: self._n_kept][keep], self._kept_Y[: self._n_kept][keep]
        self._n_kept, self._oldest = int(keep.sum()), 0

    def _weigh(self) -> None:
        """Set each model's say in predictions by its precision so far."""
        layout, n, d, m = self._layout, self.n_models, self.n_inputs, self.n_outputs
        books, t = layout.books, self._table[:, :n]
        values = t[layout.parameters + d * m : layout.covariance]
        size = np.maximum(np.sum(values**2, axis=0), 1e-12)
        squares = t[books + kernels.SQUARES : books + kernels.SQUARES + m].sum(axis=0)
        tolerance = self._parameters["tolerance"]
        v = (squares / size + PRIOR * tolerance**2) / (t[books + kernels.FREEDOM] + PRIOR)
        sharpness = self._parameters["ratio"] ** (0.25 * d * t[books + kernels.LEVEL])
        t[books + kernels.GAIN] = sharpness * (FLOOR**2 / (v + FLOOR**2)) ** 2

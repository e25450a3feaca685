"""Locally weighted projection regression: fields that find the few directions that matter.

Example:
    >>> import numpy as np
    >>> from teaching.lwpr import LWPR
    >>> X = np.random.default_rng(0).uniform(-1.0, 1.0, (2000, 10))
    >>> skill = LWPR(n_inputs=10, D=0.05).partial_fit(X, np.sin(2.0 * X[:, 0]))
    >>> y, std = skill.predict(np.zeros((1, 10)), return_std=True)
    >>> bool(abs(y[0, 0]) < 0.1)
    True
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from teaching import lwpr_kernels, shape_kernels
from teaching.kernels import FloatArray
from teaching.local_models import LocalModels, Prune, require_between, require_count
from teaching.rfwr import adaptive_vector, check_adaptive


class LWPR(LocalModels):
    """Local regression along a few directions, for many inputs of which few matter.

    After Vijayakumar, D'Souza and Schaal (2005), with the formulas of LWPR 1.2.6 and these differences:
    means are subtracted as they were before a sample, which makes one input weighted least squares to the
    last digit; the errors with and without a direction are compared over the same samples; all outputs
    share the fields, each with its own directions; and what forgetting takes from the sums of squares' prior
    is put back, so that everything stays finite for ever.

    The directions depend on the units of the inputs, as those of partial least squares always do: scale
    inputs of unlike size with ``input_scale``. The standard deviation is LWPR's confidence: that of
    the prediction itself, from local noise, uncertain parameters and the fields' disagreement, which grows
    as the activation goes to 0 and is infinite where no field is active above ``w_cutoff``.
    Generation, pruning, trust and the adaptation of D are those of :class:`teaching.rfwr.RFWR`.

    Args:
        n_inputs: Number of inputs d.
        n_outputs: Number of outputs m.
        D: Metric that a field begins with.
        projections: Largest number of directions in a field; None is d, at most 10.
        add_below: A direction is added while the last one lowers the squared error below this share.
        w_gen: A sample that activates no field above this makes a new one.
        w_prune: Activation above which two fields are taken as one too many.
        lam: Forgetting factor that a field begins with.
        lam_final: Forgetting factor that it tends to.
        tau: How slowly: lam moves by 1 - tau of the difference with each sample.
        penalty: Weight gamma of the penalty on small fields.
        rate: Learning rate of the gradient descent at the beginning; 0 keeps D as it is.
        meta_rate: Learning rate of the learning rates; 0 leaves them alone.
        diagonal: Whether D stays diagonal.
        P0: Inverse of the sum of squares that a direction begins with.
        w_cutoff: Weight below which a field neither learns nor counts.
        prune: Which rule prunes.
        input_scale: Size of each input [input units], shape (d,), or a number; None is 1.
        output_scale: Size of each output [output units], shape (m,), or a number; None is 1.
        capacity: Number of fields that there is room for at first.

    Raises:
        ConfigurationError: An argument is out of range or D is not symmetric positive definite.
    """

    _shares_deviation = False

    def __init__(
        self,
        n_inputs: int = 2,
        n_outputs: int = 1,
        *,
        D: ArrayLike = 50.0,
        projections: int | None = None,
        add_below: float = 0.5,
        w_gen: float = 0.1,
        w_prune: float = 0.9,
        lam: float = 0.999,
        lam_final: float = 0.99999,
        tau: float = 0.9999,
        penalty: float = 1e-8,
        rate: float = 250.0,
        meta_rate: float = 250.0,
        diagonal: bool = True,
        P0: float = 1e10,
        w_cutoff: float = 0.001,
        prune: Prune = "overlap",
        input_scale: ArrayLike | None = None,
        output_scale: ArrayLike | None = None,
        capacity: int = 256,
    ) -> None:
        parameters: dict[str, Any] = {
            "n_inputs": n_inputs,
            "n_outputs": n_outputs,
            "D": D,
            "projections": projections,
            "add_below": add_below,
            "w_gen": w_gen,
            "w_prune": w_prune,
            "lam": lam,
            "lam_final": lam_final,
            "tau": tau,
            "penalty": penalty,
            "rate": rate,
            "meta_rate": meta_rate,
            "diagonal": diagonal,
            "P0": P0,
            "w_cutoff": w_cutoff,
            "prune": prune,
            "input_scale": input_scale,
            "output_scale": output_scale,
        }
        scales = check_adaptive(parameters)
        require_between("add_below", add_below, 0.0, 1e6)
        if projections is not None:
            require_count("projections", projections, n_inputs)
        self._most = min(n_inputs, 10) if projections is None else projections
        super().__init__(
            parameters,
            extra=(*adaptive_vector(parameters), add_below, self._most),
            block=lwpr_kernels.block_size(n_inputs, n_outputs, self._most),
            capacity=capacity,
            scales=scales,
        )

    @property
    def projections(self) -> NDArray[np.int64]:
        """Number of directions of each field, oldest first, shape (N,)."""
        at = int(shape_kernels.shape_end(self.n_inputs)) + lwpr_kernels.DIRECTIONS
        count: NDArray[np.int64] = self._blocks[self._slots(self._by_age()), at].astype(np.int64)
        return count

    def _learn(self, X: FloatArray, Y: FloatArray, start: int) -> int:
        done: int = lwpr_kernels.update(self._table, self._state, self._params, self._blocks, X, Y, start)
        return done

    def _variance(self, X: FloatArray, Y: FloatArray, V: FloatArray) -> None:
        lwpr_kernels.deviation(self._table, self._state, self._params, self._blocks, X, Y, V)

    def _slots(self, order: NDArray[np.int64]) -> NDArray[np.int64]:
        slots: NDArray[np.int64] = self._table[-1, order].astype(np.int64)
        return slots

    def _covariances(self, order: NDArray[np.int64]) -> FloatArray:
        """P of the first output's directions and the mean: of the rank of what was regressed."""
        d = self.n_inputs
        own = int(shape_kernels.shape_end(d))
        P = np.zeros((len(order), d + 1, d + 1))
        for k, (column, b) in enumerate(zip(order, self._slots(order), strict=True)):
            block = self._blocks[b]
            at = int(lwpr_kernels.output_at(d, self._most, 0)) + lwpr_kernels.OUTPUT
            shift = np.eye(d + 1)
            shift[:d, d] = self._table[:d, column] - block[own + 2 : own + 2 + d]
            deflate = np.eye(d)
            inner = np.zeros((d + 1, d + 1))
            inner[d, d] = 1.0 / block[shape_kernels.WEIGHT]
            for _ in range(int(block[own + lwpr_kernels.DIRECTIONS])):
                u, SSX = block[at + 5 : at + 5 + d], block[at + 5 + 2 * d : at + 5 + 3 * d]
                v = deflate @ u
                inner[:d, :d] += np.outer(v, v) / block[at]
                deflate = deflate - np.outer(v, SSX) / block[at]
                at += lwpr_kernels.DIRECTION + 3 * d
            P[k] = shift.T @ inner @ shift
        return P

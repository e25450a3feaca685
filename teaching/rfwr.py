"""Receptive field weighted regression: fields that adapt their size and shape to the function.

Example:
    >>> from teaching.rfwr import RFWR
    >>> skill = RFWR(n_inputs=1, D=50.0)
    >>> skill = skill.partial_fit([0.0, 0.5, 1.0], [0.0, 0.25, 1.0])
    >>> skill.n_samples
    3
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from hm_driver.errors import ConfigurationError
from teaching import rfwr_kernels
from teaching.kernels import FloatArray
from teaching.local_models import (
    LocalModels,
    Prune,
    metric_matrix,
    require_between,
    require_count,
    scale_vector,
)


class RFWR(LocalModels):
    """Locally weighted regression whose fields follow the gradient of their leave-one-out error.

    After Schaal and Atkeson (1998), with the formulas of Schaal's and Klanke's programs. The penalty and
    the rates are absolute, as theirs are: they suit inputs and outputs of the order of 1. ``input_scale``
    and ``output_scale`` divide what is of another order; everything that goes in or comes out, D too, stays
    in the user's units. A field has its say once it has learned more than 2 d samples, and adapts after
    20 d, or n (1 - lam) > 0.1. Pruning, forgetting and prediction are those of :class:`teaching.lwr.LWR`.

    Args:
        n_inputs: Number of inputs d.
        n_outputs: Number of outputs m.
        D: Metric that a field begins with.
        w_gen: A sample that activates no field above this makes a new one.
        w_prune: Activation above which two fields are taken as one too many.
        lam: Forgetting factor that a field begins with.
        lam_final: Forgetting factor that it tends to.
        tau: How slowly: lam moves by 1 - tau of the difference with each sample.
        penalty: Weight gamma of the penalty on small fields.
        rate: Learning rate of the gradient descent at the beginning; 0 keeps D as it is.
        meta_rate: Learning rate of the learning rates; 0 leaves them alone.
        diagonal: Whether D stays diagonal.
        P0: Initial covariance.
        w_cutoff: Weight below which a field neither learns nor counts.
        prune: Which rule prunes.
        input_scale: Size of each input [input units], shape (d,), or a number; None is 1.
        output_scale: Size of each output [output units], shape (m,), or a number; None is 1.
        capacity: Number of fields that there is room for at first.

    Raises:
        ConfigurationError: An argument is out of range or D is not symmetric positive definite.
    """

    def __init__(
        self,
        n_inputs: int = 2,
        n_outputs: int = 1,
        *,
        D: ArrayLike = 50.0,
        w_gen: float = 0.1,
        w_prune: float = 0.9,
        lam: float = 0.999,
        lam_final: float = 0.99999,
        tau: float = 0.9999,
        penalty: float = 1e-9,
        rate: float = 1000.0,
        meta_rate: float = 250.0,
        diagonal: bool = False,
        P0: float = 1e6,
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
        super().__init__(
            parameters,
            extra=adaptive_vector(parameters),
            block=rfwr_kernels.block_size(n_inputs, n_outputs),
            capacity=capacity,
            scales=scales,
        )

    def _learn(self, X: FloatArray, Y: FloatArray, start: int) -> int:
        done: int = rfwr_kernels.update(
            self._table, self._state, self._params, self._blocks, X, Y, start, self._scratch
        )
        return done


def check_adaptive(p: dict[str, Any]) -> tuple[FloatArray, FloatArray] | None:
    """Refuse arguments of an adaptive learner that are out of range, and make D a matrix.

    Returns:
        The scales of inputs and outputs; None where they are 1.

    Raises:
        ConfigurationError: An argument is out of range or D is not symmetric positive definite.
    """
    require_count("n_inputs", p["n_inputs"], 1000)
    require_count("n_outputs", p["n_outputs"], 1000)
    require_between("lam_final", p["lam_final"], 0.0, 1.0, closed=True)
    require_between("tau", p["tau"], 0.0, 1.0, closed=True)
    require_between("penalty", p["penalty"], -1e-300, 1e6)
    require_between("rate", p["rate"], -1e-300, 1e6)
    require_between("meta_rate", p["meta_rate"], -1e-300, 1e6)
    if not isinstance(p["diagonal"], bool):
        raise ConfigurationError("diagonal", f"{p['diagonal']!r} must be true or false")
    p["D"] = metric_matrix(p["D"], p["n_inputs"])
    if p["diagonal"] and np.any(p["D"] != np.diag(np.diag(p["D"]))):
        raise ConfigurationError("D", "must be diagonal where diagonal is true")
    if p["input_scale"] is None and p["output_scale"] is None:
        return None
    x = p["input_scale"] = scale_vector("input_scale", p["input_scale"], p["n_inputs"])
    y = p["output_scale"] = scale_vector("output_scale", p["output_scale"], p["n_outputs"])
    return x, y


def adaptive_vector(p: dict[str, Any]) -> tuple[float, ...]:
    """Numbers of the kernels' parameter vector from PENALTY to IS_DIAGONAL."""
    names = ("penalty", "rate", "meta_rate", "lam_final", "tau", "diagonal")
    return tuple(float(p[name]) for name in names)

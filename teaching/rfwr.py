"""Receptive field weighted regression: fields that adapt their size and shape to the function.

Example:
    >>> from teaching.rfwr import RFWR
    >>> skill = RFWR(n_inputs=1, D=50.0)
    >>> skill = skill.partial_fit([0.0, 0.5, 1.0], [0.0, 0.25, 1.0])
    >>> skill.n_samples
    3
"""

from typing import Any

from numpy.typing import ArrayLike

from teaching import rfwr_kernels
from teaching.kernels import FloatArray, Layout
from teaching.local_models import LocalModels, Prune, metric_matrix, require_between, require_count


class RFWR(LocalModels):
    """Locally weighted regression whose fields follow the gradient of their leave-one-out error.

    After Schaal and Atkeson (1998), with the formulas of Schaal's and Klanke's programs. Inputs and outputs
    should be of the order of 1: the penalty and the rates are absolute, as theirs are. A field has its say
    once it has learned more than 2 d samples, and adapts after 20 d, or n (1 - lam) > 0.1. Pruning,
    forgetting and prediction are those of :class:`teaching.lwr.LWR`.

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
        rate: Learning rate of the gradient descent at the beginning.
        meta_rate: Learning rate of the learning rates; 0 leaves them alone.
        diagonal: Whether D stays diagonal.
        P0: Initial covariance.
        w_cutoff: Weight below which a field neither learns nor counts.
        prune: Which rule prunes.
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
        capacity: int = 256,
    ) -> None:
        require_count("n_inputs", n_inputs, 1000)
        require_count("n_outputs", n_outputs, 1000)
        require_count("capacity", capacity, 10_000_000)
        require_between("lam_final", lam_final, 0.0, 1.0, closed=True)
        require_between("tau", tau, 0.0, 1.0, closed=True)
        require_between("penalty", penalty, -1e-300, 1e6)
        require_between("rate", rate, 0.0, 1e6)
        require_between("meta_rate", meta_rate, -1e-300, 1e6)
        parameters: dict[str, Any] = {
            "n_inputs": n_inputs,
            "n_outputs": n_outputs,
            "D": metric_matrix(D, n_inputs),
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
        }
        super().__init__(
            parameters,
            refinement=(0.0, 1.0, 1.0),
            extra=(penalty, rate, meta_rate, lam_final, tau, float(diagonal)),
            rows=rfwr_kernels.AdaptiveLayout(Layout(n_inputs, n_outputs)).rows,
            capacity=capacity,
        )

    def _learn(self, X: FloatArray, Y: FloatArray, start: int) -> int:
        done: int = rfwr_kernels.update(self._table, self._state, self._params, X, Y, start)
        return done

"""Locally weighted regression with fixed receptive fields: eqs. (1) to (7) of the paper.

Example:
    >>> from teaching.lwr import LWR
    >>> skill = LWR(n_inputs=2, n_outputs=1, D=400.0)
    >>> skill = skill.partial_fit([[0.0, 0.0], [0.1, 0.0]], [0.10, 0.02])
    >>> skill.n_models
    2
    >>> y, w_max = skill.query(0.1, 0.0)
    >>> round(w_max, 3)
    1.0
"""

from typing import Any

from numpy.typing import ArrayLike

from teaching import kernels
from teaching.kernels import FloatArray
from teaching.local_models import LocalModels, Prune, metric_matrix, require_between, require_count


class LWR(LocalModels):
    """Receptive fields of one fixed size with recursive least squares in each.

    Where the paper is silent or contradicts itself:

    * *Pruning.* Two centres at the generation distance activate their midpoint by w_gen^(1/4), 0.946 for 0.8,
      above w_prune = 0.9: literally read, models that generation has just made prune each other for ever.
      ``prune="overlap"`` therefore also asks that one of the two centres activates the other above
      w_prune; ``"paper"`` is the literal rule. Docs: ``docs/decisions/0002-pruning.md``.
    * *"The model with the larger covariance matrix"* is the one with the larger trace of D^-1, the
      wider field; of equal ones that with the larger trace of P, the less certain; then the newer.
    * *Prediction* counts the models whose weight is at least ``w_cutoff`` times the largest weight at
      that point. The exponents are shifted by the largest, so that it is finite however far away; there it
      is the nearest model's straight continuation, which only w_max tells. Without models it is 0.
    * *Update* reaches the models with a weight above ``w_cutoff``. With 0 every model counts in both.
    * *Forgetting.* With lam < 1 and a hand that rests, P of eq. (7) grows without bound. What is
      forgotten of the prior's information I / P0 is therefore put back: P stays below about P0 for ever.
    * *Beginning.* M(0) = 0 and P(0) = P0 I; the sample that makes a model is also the first it learns.

    *Refinement* is not in the paper. With ``levels`` above 1 (3 serve well), a sample that the prediction
    misses by more than ``tolerance`` times its own size makes a model of the next finer level there, with
    ``ratio`` times the D; and a model's weight in eq. (1) is multiplied by its det(D) / det(D0), so that the
    finest has the say. Steps, as at the border of two objects, are then learned as sharply as they are
    taught. The activation w_max is that of all models. Pruning looks at models of one level only.

    Args:
        n_inputs: Number of inputs d.
        n_outputs: Number of outputs m.
        D: Distance metric of every field [1 / input unit^2]: a number, its diagonal, or a matrix (d, d).
        w_gen: A sample that activates no model above this makes a new one.
        w_prune: Activation above which two models are taken as one too many.
        lam: Forgetting factor; 1 forgets nothing.
        P0: Initial covariance; 1 / P0 is the ridge, in squared input units for the slopes.
        w_cutoff: Weight below which a model neither learns nor counts.
        prune: Which rule prunes.
        levels: Number of field sizes; 1 is the paper's.
        ratio: D of a level by that of the next coarser one.
        tolerance: Share of the output that a prediction may miss before a finer model is made.
        capacity: Number of models that there is room for at first; the room grows.

    Raises:
        ConfigurationError: An argument is out of range or D is not symmetric positive definite.
    """

    def __init__(
        self,
        n_inputs: int = 2,
        n_outputs: int = 1,
        *,
        D: ArrayLike = 400.0,
        w_gen: float = 0.8,
        w_prune: float = 0.9,
        lam: float = 1.0,
        P0: float = 1e6,
        w_cutoff: float = 0.001,
        prune: Prune = "overlap",
        levels: int = 1,
        ratio: float = 16.0,
        tolerance: float = 0.1,
        capacity: int = 256,
    ) -> None:
        require_count("n_inputs", n_inputs, 1000)
        require_count("n_outputs", n_outputs, 1000)
        require_count("levels", levels, 8)
        require_between("ratio", ratio, 1.0, 1000.0, closed=True)
        require_between("tolerance", tolerance, 0.0, 10.0, closed=True)
        parameters: dict[str, Any] = {
            "n_inputs": n_inputs,
            "n_outputs": n_outputs,
            "D": metric_matrix(D, n_inputs),
            "w_gen": w_gen,
            "w_prune": w_prune,
            "lam": lam,
            "P0": P0,
            "w_cutoff": w_cutoff,
            "prune": prune,
            "levels": levels,
            "ratio": ratio,
            "tolerance": tolerance,
        }
        super().__init__(
            parameters,
            refinement=(tolerance, ratio, levels),
            capacity=capacity,
        )

    def _learn(self, X: FloatArray, Y: FloatArray, start: int) -> int:
        learn = kernels.update if self._parameters["levels"] == 1 else kernels.update_refining
        done: int = learn(self._table, self._state, self._params, X, Y, start, self._scratch)
        return done

"""What a local learner is: the contract that a session, an arbitration and a report rely on."""

from pathlib import Path
from typing import Literal, NamedTuple, Protocol, Self, overload

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]


class ModelSet(NamedTuple):
    """The local models of a learner, oldest first; copies, which nobody else changes."""

    centres: FloatArray
    """Centres c, shape (N, d)."""
    D: FloatArray
    """Distance metrics, shape (N, d, d)."""
    M: FloatArray
    """Parameters of the linear models, the constant last, shape (N, d + 1, m)."""
    P: FloatArray
    """Covariances of the recursive least squares, shape (N, d + 1, d + 1)."""
    samples: NDArray[np.int64]
    """Number of samples that each model has learned, shape (N,)."""
    born: NDArray[np.int64]
    """Number of samples that the learner had seen before it made the model, shape (N,)."""


class Learner(Protocol):
    """An incremental regression made of local models.

    An implementer has no clock, file, thread or random state: the same samples in the same order give the
    same bits. A sample that is not finite is refused before anything is learned from it. One learner
    is used from one thread at a time.
    """

    @property
    def n_inputs(self) -> int:
        """Number of inputs d."""
        ...

    @property
    def n_outputs(self) -> int:
        """Number of outputs m."""
        ...

    @property
    def n_models(self) -> int:
        """Number of local models N that there are now."""
        ...

    @property
    def n_added(self) -> int:
        """Number of models ever made."""
        ...

    @property
    def n_pruned(self) -> int:
        """Number of models that pruning has removed."""
        ...

    @property
    def n_samples(self) -> int:
        """Number of samples learned."""
        ...

    @property
    def models(self) -> ModelSet:
        """The local models, oldest first."""
        ...

    def update(self, x: ArrayLike, y: ArrayLike) -> None:
        """Learn one sample, shapes (d,) and (m,); numbers where d or m is 1."""
        ...

    def partial_fit(self, X: ArrayLike, Y: ArrayLike) -> Self:
        """Learn samples in the order given, shapes (n, d) and (n, m); all of them or, if refused, none."""
        ...

    @overload
    def predict(self, X: ArrayLike, *, return_std: Literal[False] = False) -> FloatArray: ...

    @overload
    def predict(self, X: ArrayLike, *, return_std: Literal[True]) -> tuple[FloatArray, FloatArray]: ...

    def predict(
        self, X: ArrayLike, *, return_std: bool = False
    ) -> FloatArray | tuple[FloatArray, FloatArray]:
        """Outputs, shape (n, m), at inputs of shape (n, d), and with return_std their standard deviation.

        Always finite. Where no model is active it is the straight continuation of the nearest, and 0 where
        there is no model at all: the standard deviation is infinite there, and w_max next to 0 or 0.
        """
        ...

    def w_max(self, X: ArrayLike) -> FloatArray:
        """Largest activation, shape (n,), at inputs of shape (n, d); 0 where there is no model at all."""
        ...

    def activations(self, X: ArrayLike) -> FloatArray:
        """Activation of every model, oldest first, shape (n, N), at inputs of shape (n, d)."""
        ...

    def share_active(self, X: ArrayLike, w: float) -> float:
        """Share of inputs of shape (n, d) with an activation of at least w; cheaper than :meth:`w_max`."""
        ...

    def query(self, x0: float, x1: float) -> tuple[float, float]:
        """Prediction and largest activation at one point, for two inputs and one output."""
        ...

    def query_std(self, x0: float, x1: float) -> tuple[float, float, float]:
        """As :meth:`query`, with the standard deviation as the third."""
        ...

    def remove(self, which: ArrayLike) -> int:
        """Remove models by indices into :attr:`models` or a mask of shape (N,); returns how many."""
        ...

    def remove_near(self, x: ArrayLike, w: float) -> int:
        """Remove the models that the input x, shape (d,), activates above w; returns how many."""
        ...

    def remove_box(self, lower: ArrayLike, upper: ArrayLike) -> int:
        """Remove the models with their centre between two corners, shapes (d,); returns how many."""
        ...

    def remove_ellipse(self, centre: ArrayLike, semi_axes: ArrayLike, *, angle: float = 0.0) -> int:
        """Remove the models with their centre in an ellipse, or in a circle; returns how many."""
        ...

    def remove_older(self, n_samples: int) -> int:
        """Remove the models made before the learner had seen n_samples samples; returns how many."""
        ...

    @property
    def say(self) -> FloatArray:
        """Factor of each model's weight in eq. (1), shape (N,), oldest first; 1 where all have one say."""
        ...

    @property
    def variances(self) -> FloatArray | None:
        """Variance of each model's residuals [squared output units], shape (N, m), oldest first.

        With :attr:`models` and :attr:`say` they give the standard deviation of :meth:`predict`; None where
        more than these decides it.
        """
        ...

    def check_parameters(self) -> list[str]:
        """Say which parameters contradict each other, and the consequence."""
        ...

    def warm_up(self) -> None:
        """Compile what the learner runs, so that no later call does."""
        ...

    def copy(self) -> Self:
        """A learner of the same state that shares nothing with this one."""
        ...

    def save(self, path: str | Path) -> None:
        """Write the learner to a file, which its class's ``load`` reads."""
        ...

"""What an arbitration is: who is in control, and how much."""

import copy
from typing import NamedTuple, Protocol, Self


class Query(NamedTuple):
    """What is known at the manipulator's present position."""

    y_robot: float
    """Prediction of eq. (1)."""
    w_max: float
    """Largest activation."""
    std: float = 0.0
    """Standard deviation of the prediction; only what an arbitration that `needs_std` is given."""
    x: float = 0.0
    """Manipulator's position on the plane [m]."""
    y: float = 0.0


class Observation(NamedTuple):
    """What came of a tick, for an arbitration that learns from it."""

    x: float
    """Manipulator's position on the plane [m]."""
    y: float
    y_demo: float
    """The human's command, or the estimate of it."""
    y_robot: float
    """The skill's."""
    C: float
    """Control factor that was applied."""
    force: float
    """Interaction force as the screen shows it [N]."""
    is_demonstrating: bool
    """Whether the human's command was fit to be learned: on the plane, in contact, not in a transient."""
    is_pressed: bool
    """Whether the human's button is down."""
    has_skill: bool
    """Whether there is any model."""
    dt: float
    """Time that it stands for [s]."""


class Arbitration(Protocol):
    """Decides the share of the human.

    An implementer has no clock and no random state. The factor is finite and between 0 and 1 for any input.
    Where it is exactly 1 the human alone is in control. `factor` changes nothing; what an arbitration
    learns, it learns by `observe`, in the order of the ticks and while teaching alone.
    """

    @property
    def w_th(self) -> float:
        """Activation from which a spot counts as covered by a model."""
        ...

    @property
    def w_free(self) -> float:
        """Activation from which on a model may cost the human control: forgetting goes down to it."""
        return self.w_th

    @property
    def needs_std(self) -> bool:
        """Whether `Query.std` must be given."""
        return False

    @property
    def is_stateful(self) -> bool:
        """Whether it must be told by `observe` what came of each tick."""
        return False

    @property
    def is_gradual(self) -> bool:
        """Whether both act at once for long, so that samples with 0 < C < 1 are learned as well."""
        return False

    def factor(self, query: Query) -> float:
        """Control factor C: 1 gives the human control, 0 the learned skill."""
        ...

    def observe(self, observation: Observation) -> None:  # noqa: ARG002  # for those who learn
        """Learn from a tick."""
        return

    def forget(self, x: float, y: float, radius: float) -> None:  # noqa: ARG002  # for those who learn
        """Think no better of the skill within a radius [m] of a place than at the beginning."""
        return

    def reset(self) -> None:
        """Be as at the beginning."""
        return

    def copy(self) -> Self:
        """An arbitration of the same state that shares none of it."""
        return copy.deepcopy(self)


def blend(C: float, y_demo: float, y_robot: float) -> float:
    """Command y_cmd of eq. (8)."""
    return C * y_demo + (1.0 - C) * y_robot

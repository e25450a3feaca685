"""Arbitration by the human himself, with a button."""

from teaching.arbitration.contract import Arbitration, Observation, Query
from teaching.arbitration.existence import ExistenceArbitration


class ButtonArbitration(Arbitration):
    """The human takes control by a button and gives it back by it: in the spirit of HG-DAgger.

    Kelly et al. (2019): an expert watches the skill and takes over where he judges it unsafe; what he does
    then is learned. The doubt threshold that they learn from an ensemble's covariance is not part of this.
    As long as there is no model at all the human is in control, which stands for the first demonstration that
    HG-DAgger begins with. Afterwards the place does not matter: with the button up the skill acts, even
    where it has no model.

    Args:
        w_th: Activation from which a spot counts as covered; it decides nothing here but when teaching ends.
    """

    def __init__(self, *, w_th: float = 0.5) -> None:
        ExistenceArbitration(w_th, 0.0)
        self._w_th = w_th
        self._is_pressed = False
        self._has_skill = False

    @property
    def w_th(self) -> float:
        """Activation from which a spot counts as covered by a model."""
        return self._w_th

    @property
    def is_stateful(self) -> bool:
        """It is: it knows the button."""
        return True

    def factor(self, query: Query) -> float:  # noqa: ARG002  # the same everywhere
        """1 while the button is down or there is no skill, else 0."""
        return 1.0 if self._is_pressed or not self._has_skill else 0.0

    def observe(self, observation: Observation) -> None:
        """See the button, and whether there is a skill."""
        self._is_pressed, self._has_skill = observation.is_pressed, observation.has_skill

    def reset(self) -> None:
        """Let go of the button."""
        self._is_pressed = self._has_skill = False

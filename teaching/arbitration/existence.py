"""The paper's arbitration by the existence of models, eq. (9), and ours by existence and confidence."""

import math
from dataclasses import dataclass

from hm_driver.errors import ConfigurationError
from teaching.arbitration.contract import Arbitration, Query


@dataclass(frozen=True, slots=True)
class ExistenceArbitration(Arbitration):
    """Control goes to the skill wherever a local model exists: eq. (9) of the paper, to the letter.

    Raises:
        ConfigurationError: The blend zone does not lie between 0 and 1.
    """

    w_th: float = 0.5
    """Activation in the middle of the switch."""
    d: float = 0.05
    """Width of the switch in activation."""

    def __post_init__(self) -> None:
        if not 0.0 < self.w_th < 1.0:
            raise ConfigurationError("w_th", f"{self.w_th:g} must be above 0 and below 1")
        if not 0.0 <= self.d < 2.0 * min(self.w_th, 1.0 - self.w_th):
            limit = 2.0 * min(self.w_th, 1.0 - self.w_th)
            raise ConfigurationError(
                "d",
                f"{self.d:g} must be at least 0 and below {limit:g}: w_th -+ d/2 must lie within 0 to 1",
            )

    @property
    def w_free(self) -> float:
        """Activation below which eq. (9) is 1."""
        return self.w_th - 0.5 * self.d

    def factor(self, query: Query) -> float:
        """Control factor C of eq. (9)."""
        return control_factor(query.w_max, w_th=self.w_th, d=self.d)


@dataclass(frozen=True, slots=True)
class ConfidenceArbitration(Arbitration):
    """Control goes to the skill where a model exists **and** is confident: ours, not the paper's.

    A model exists on both sides of a border long before both are learned, so that existence alone gives the
    skill control where it is wrong. The standard deviation by the size of the prediction tells such spots.

    Raises:
        ConfigurationError: A zone of blending does not lie within its range.
    """

    w_th: float = 0.5
    """Activation in the middle of the switch of eq. (9)."""
    d: float = 0.05
    """Width of that switch in activation."""
    doubt: float = 0.2
    """Standard deviation by the prediction in the middle of the switch to the human."""
    doubt_width: float = 0.1
    """Width of that switch."""

    def __post_init__(self) -> None:
        ExistenceArbitration(self.w_th, self.d)
        if not 0.0 < self.doubt <= 10.0:
            raise ConfigurationError("doubt", f"{self.doubt:g} must be above 0 and at most 10")
        if not 0.0 <= self.doubt_width <= 2.0 * self.doubt:
            limit = 2.0 * self.doubt
            raise ConfigurationError(
                "doubt_width", f"{self.doubt_width:g} must be at least 0 and at most {limit:g}"
            )

    @property
    def w_free(self) -> float:
        """Activation below which eq. (9) is 1."""
        return self.w_th - 0.5 * self.d

    @property
    def needs_std(self) -> bool:
        """It does: doubt is judged by it."""
        return True

    def factor(self, query: Query) -> float:
        """The larger of eq. (9) and its mirror image in the relative standard deviation."""
        existence = control_factor(query.w_max, w_th=self.w_th, d=self.d)
        relative = query.std / max(abs(query.y_robot), 1e-9)
        confidence = control_factor(-relative, w_th=-self.doubt, d=self.doubt_width)
        return max(existence, confidence)


def control_factor(w_max: float, *, w_th: float, d: float) -> float:
    """Control factor C of eq. (9): exactly 1 below w_th - d/2, exactly 0 from w_th + d/2, a cosine between.

    For d = 0 it is the switch that eq. (9) tends to: 1 below w_th and 0 from there. What is no number counts
    as no activation.
    """
    low = w_th - 0.5 * d
    if not w_max >= low:
        return 1.0
    if w_max >= w_th + 0.5 * d:
        return 0.0
    return 0.5 * (1.0 + math.cos(math.pi * (w_max - low) / d))


def check_thresholds(*, w_th: float, d: float, w_gen: float) -> list[str]:
    """Say which thresholds of arbitration and learner contradict each other, and the consequence."""
    said = []
    if w_th > w_gen:
        said.append(
            f"w_th = {w_th:g} is above w_gen = {w_gen:g}: where the activation is between them the human "
            "keeps control, but no model is made there, so that teaching on does not hand over; "
            "choose w_th <= w_gen"
        )
    elif w_th + 0.5 * d > w_gen:
        said.append(
            f"w_th + d/2 = {w_th + 0.5 * d:g} is above w_gen = {w_gen:g}: where models are as far apart "
            "as generation allows, control is never the robot's alone; choose w_th + d/2 <= w_gen"
        )
    return said

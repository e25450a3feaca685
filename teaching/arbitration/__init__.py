"""Who is in control: eqs. (8) and (9) of the paper, and four other answers behind the same contract.

Example:
    >>> from teaching.arbitration import ExistenceArbitration, Query
    >>> ExistenceArbitration(w_th=0.5, d=0.05).factor(Query(y_robot=0.03, w_max=0.2))
    1.0
"""

from teaching.arbitration.button import ButtonArbitration
from teaching.arbitration.contract import Arbitration, Observation, Query, blend
from teaching.arbitration.existence import (
    ConfidenceArbitration,
    ExistenceArbitration,
    check_thresholds,
    control_factor,
)
from teaching.arbitration.gradual import ErrorArbitration, Success, SuccessArbitration, force_success

__all__ = [
    "Arbitration",
    "ButtonArbitration",
    "ConfidenceArbitration",
    "ErrorArbitration",
    "ExistenceArbitration",
    "Observation",
    "Query",
    "Success",
    "SuccessArbitration",
    "blend",
    "check_thresholds",
    "control_factor",
    "force_success",
]

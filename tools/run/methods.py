"""Whole methods of teaching by one name: which learner, which arbitration, and the numbers that go with them.

A method is a set of defaults. What a configuration file or ``--set`` gives stands above it, key by key.
"""

from collections.abc import Mapping
from enum import Enum
from typing import Final


class Method(Enum):
    """The methods."""

    PAPER = "paper"
    """The paper's: control by the existence of models."""
    CONFIDENT = "confident"
    """Ours: models of several sizes, and control by their existence and their confidence."""
    ERROR = "error"
    """Gradual, by the average error of prediction: ours, in the spirit of the paper's [7]."""
    SUCCESS = "success"
    """Gradual, by the local success: ours, in the spirit of the paper's [24]."""
    BUTTON = "button"
    """The human decides, with a button: in the spirit of HG-DAgger."""


PRESETS: Final[Mapping[str, Mapping[str, object]]] = {
    Method.PAPER.value: {},
    Method.CONFIDENT.value: {
        "learner.kind": "multi",
        "learner.D": 400.0,
        "learner.w_gen": 0.5,
        "learner.multi.levels": 4,
        "learner.multi.ratio": 8.0,
        "learner.multi.tolerance": 0.1,
        "learner.multi.rehearse": 2,
        "arbitration.kind": "confidence",
        "arbitration.w_th": 0.475,
        "arbitration.doubt": 0.065,
        "arbitration.doubt_width": 0.0325,
        "session.flush": 30,
        "session.samples_per_tick": 10,
        "session.settling": 0.0,
        "session.hindsight": 0.3,
        "session.transient_speed": 1.0,
        "session.transient_rate": 1.5,
        "session.autonomy_coverage": 0.95,
        "session.give_up": 119.0,
        "correction.insist_force": 8.0,
    },
    Method.ERROR.value: {
        "arbitration.kind": "error",
        "session.coupling": "uncoupled",
    },
    Method.SUCCESS.value: {
        "arbitration.kind": "success",
        "session.coupling": "uncoupled",
    },
    Method.BUTTON.value: {
        "arbitration.kind": "button",
        "session.flush": 30,
    },
}
"""What differs from the defaults, by dotted key of the configuration. The defaults are the paper's."""

"""What teaching logs: its messages and channels, beside the driver's own."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from hm_driver.recording.schemas import (
    FIRST_FREE_CHANNEL,
    Channel,
    Field,
    FixedMessage,
    Kind,
    VariableMessage,
)
from teaching.learner import FloatArray, Learner, ModelSet

STAGES: Final = ("practice", "teaching", "autonomous", "done")
"""The stages of a session, in the order of their numbers."""

_TIME = Field("time_ns", Kind.SFIXED64, "Time of the session's clock, since the Unix epoch", "ns")

ARBITRATION: Final = FixedMessage(
    "Arbitration",
    "Who was in control in a tick, and what each of the two wanted; lengths are the manipulator's.",
    (
        _TIME,
        Field("stage", Kind.FIXED32, "0 practice, 1 teaching, 2 autonomous, 3 done"),
        Field("C", Kind.DOUBLE, "Control factor of eq. (8): 1 human, 0 skill"),
        Field("w_max", Kind.DOUBLE, "Largest activation at the manipulator's position"),
        Field("x", Kind.DOUBLE, "Position of the manipulator in the plane", "m"),
        Field("y", Kind.DOUBLE, "Position of the manipulator in the plane", "m"),
        Field("depth", Kind.DOUBLE, "Depth of the commanded position z_r below the surface", "m"),
        Field("y_demo", Kind.DOUBLE, "Displacement that the human wants", "m"),
        Field("y_robot", Kind.DOUBLE, "Displacement that the skill predicts", "m"),
        Field("y_cmd", Kind.DOUBLE, "Blended command of eq. (8)", "m"),
        Field("y_handle", Kind.DOUBLE, "Displacement at which the handle is, at least 0", "m"),
        Field("force", Kind.DOUBLE, "Interaction force of eq. (12)", "N"),
        Field("reference_force", Kind.DOUBLE, "Force that is to be produced", "N"),
        Field("stiffness", Kind.DOUBLE, "Stiffness of the object under the manipulator", "N/m"),
        Field("accumulated", Kind.FIXED64, "Samples in the accumulation buffer"),
        Field("recorded", Kind.BOOL, "Whether this tick's sample was put into the buffer"),
        Field("pending", Kind.BOOL, "Whether an update is being learned aside"),
        Field("std", Kind.DOUBLE, "Standard deviation of y_robot; 0 where no arbitration asks for it", "m"),
    ),
)

LEARNER_STATE: Final = VariableMessage(
    "LearnerState",
    "The learner after a change; arrays flattened row by row, the oldest model first.",
    (
        _TIME,
        Field("update", Kind.FIXED64, "Number of the update, from 1; 0 before the first"),
        Field("samples", Kind.FIXED64, "Samples learned so far"),
        Field("added", Kind.FIXED64, "Models made so far"),
        Field("pruned", Kind.FIXED64, "Models pruned so far"),
        Field("coverage", Kind.DOUBLE, "Share of the plane where w_max is at least w_th"),
        Field("n_inputs", Kind.FIXED32, "Number of inputs d"),
        Field("n_outputs", Kind.FIXED32, "Number of outputs m"),
        Field("centres", Kind.DOUBLES, "Centres, shape (N, d)"),
        Field("D", Kind.DOUBLES, "Distance metrics, shape (N, d, d)"),
        Field("M", Kind.DOUBLES, "Parameters of the linear models, the constant last, shape (N, d + 1, m)"),
        Field("P", Kind.DOUBLES, "Covariances, shape (N, d + 1, d + 1)"),
        Field("model_samples", Kind.DOUBLES, "Samples learned by each model, shape (N,)"),
        Field("model_born", Kind.DOUBLES, "Samples the learner had seen when it made each model, shape (N,)"),
        Field("say", Kind.DOUBLES, "Factor of each model's weight in eq. (1), shape (N,)"),
        Field("cause", Kind.FIXED32, "0 a batch was learned, 1 models were forgotten, 2 a change was undone"),
        Field(
            "variances",
            Kind.DOUBLES,
            "Variance of each model's residuals, shape (N, m); none with projections, where more decides std",
            "m^2",
        ),
    ),
)

HAND_STATE: Final = FixedMessage(
    "HandState",
    "What a simulated hand intended and felt; only a simulation can know it. Frame of the device.",
    (
        _TIME,
        Field("intended_position", Kind.VECTOR3, "Where the hand wants to be", "m"),
        Field("intended_velocity", Kind.VECTOR3, "How the hand wants to move", "m/s"),
        Field("stiffness", Kind.VECTOR3, "Stiffness of the hand", "N/m"),
        Field("hand_force", Kind.VECTOR3, "True force of the hand on the end effector", "N"),
        Field("contact_force", Kind.VECTOR3, "True force of rendered objects on the end effector", "N"),
        Field("damping", Kind.VECTOR3, "Damping of the hand", "N*s/m"),
        Field("extra_force", Kind.VECTOR3, "Force that the hand adds to its impedance", "N"),
    ),
)

ARBITRATION_CHANNEL: Final = Channel(FIRST_FREE_CHANNEL, "/teaching/arbitration", ARBITRATION)
LEARNER_STATE_CHANNEL: Final = Channel(FIRST_FREE_CHANNEL + 1, "/teaching/learner", LEARNER_STATE)
HAND_STATE_CHANNEL: Final = Channel(FIRST_FREE_CHANNEL + 2, "/teaching/hand", HAND_STATE)

CHANNELS: Final = (ARBITRATION_CHANNEL, LEARNER_STATE_CHANNEL, HAND_STATE_CHANNEL)
"""Everything that teaching logs."""


def pack_learner_state(
    time_ns: int, update: int, coverage: float, learner: Learner, *, cause: int = 0
) -> bytes:
    """Wire form of a LearnerState message."""
    models, variances = learner.models, learner.variances
    return LEARNER_STATE.pack(
        time_ns,
        update,
        learner.n_samples,
        learner.n_added,
        learner.n_pruned,
        coverage,
        learner.n_inputs,
        learner.n_outputs,
        models.centres.ravel().tolist(),
        models.D.ravel().tolist(),
        models.M.ravel().tolist(),
        models.P.ravel().tolist(),
        models.samples.tolist(),
        models.born.tolist(),
        learner.say.tolist(),
        cause,
        [] if variances is None else variances.ravel().tolist(),
    )


def unpack_models(
    n_inputs: int,
    n_outputs: int,
    centres: Sequence[float] | FloatArray,
    D: Sequence[float] | FloatArray,
    M: Sequence[float] | FloatArray,
    P: Sequence[float] | FloatArray,
    samples: Sequence[float] | FloatArray,
    born: Sequence[float] | FloatArray,
) -> ModelSet:
    """The models of a LearnerState message, from its flattened arrays."""
    d, m = n_inputs, n_outputs
    return ModelSet(
        centres=np.asarray(centres, dtype=float).reshape(-1, d),
        D=np.asarray(D, dtype=float).reshape(-1, d, d),
        M=np.asarray(M, dtype=float).reshape(-1, d + 1, m),
        P=np.asarray(P, dtype=float).reshape(-1, d + 1, d + 1),
        samples=np.asarray(samples).astype(np.int64),
        born=np.asarray(born).astype(np.int64),
    )

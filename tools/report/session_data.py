"""What the report reads from a log: every topic, column and key of the configuration is named here alone."""

import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hm_driver.errors import ConfigurationError, RecordingError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime.modes import ModeOptions
from hm_driver.recording.reader import Recording, RecordingWarning
from teaching.task import Task
from teaching.task_file import load_task, task_from_dict

FloatArray = NDArray[np.float64]

ARBITRATION_TOPIC = "/teaching/arbitration"
LEARNER_TOPIC = "/teaching/learner"
STATE_TOPIC = "/device/state"
COMMAND_TOPIC = "/device/command"
TIMING_TOPIC = "/loop/timing"
EVENTS_TOPIC = "/events"
CONFIG_FILE = "config.json"
TASK_FILE = "task.json"
SESSION_METADATA = "session"
RECORDING_METADATA = "recording"

WANTED: dict[str, tuple[str, ...]] = {
    ARBITRATION_TOPIC: (
        *("time_ns", "stage", "C", "x", "y", "depth", "y_robot"),
        *("force", "stiffness", "recorded"),
    ),
    LEARNER_TOPIC: (
        *("time_ns", "update", "samples", "added", "pruned", "coverage"),
        *("centres", "D", "M"),
    ),
    STATE_TOPIC: (
        *("time_ns", "sequence", "measured_position.x", "measured_position.y", "measured_position.z"),
        "model_velocity.z",
    ),
    COMMAND_TOPIC: (
        *("sequence", "reference.z", "reference_velocity.z", "phase.z", "assist_reference"),
        *("spring_force.z", "assist_force"),
    ),
    TIMING_TOPIC: ("sequence", "lateness_ns", "exchange_ns", "missed_periods", "saturated_cycles", "dt_s"),
    EVENTS_TOPIC: ("time_ns", "level", "name", "text"),
}
"""Every topic and column that the report reads."""
LATER: dict[str, tuple[str, ...]] = {LEARNER_TOPIC: ("cause", "say", "P", "variances")}
"""Columns that the report reads where a log has them: they came after the first release."""

PRACTICE, TEACHING, AUTONOMOUS = 0, 1, 2
STAGE_NAMES = {PRACTICE: "practice", TEACHING: "teaching", AUTONOMOUS: "autonomous"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Ticks:
    """The session's ticks; every array has shape (n,)."""

    time_s: FloatArray
    """Time since the first tick [s]."""
    stage: NDArray[np.int64]
    """0 practice, 1 teaching, 2 autonomous, 3 done."""
    C: FloatArray
    """Control factor of eq. (9)."""
    x: FloatArray
    """Position of the manipulator [m]."""
    y: FloatArray
    depth: FloatArray
    """Displacement at which the handle is [m]."""
    y_robot: FloatArray
    """Displacement that the skill predicts [m]."""
    force: FloatArray
    """Interaction force [N]."""
    stiffness: FloatArray
    """True stiffness under the manipulator [N/m]."""
    recorded: NDArray[np.bool_]
    """Whether the tick's sample was accumulated."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Skill:
    """The learner after an update."""

    time_s: float
    """Time of the update [s]."""
    update: int
    """Number of the update, from 1."""
    samples: int
    """Samples learned so far."""
    added: int
    """Models made so far."""
    pruned: int
    """Models pruned so far."""
    coverage: float
    """Share of the plane that is covered, as the session found it."""
    centres: FloatArray
    """Shape (N, 2) [m]."""
    D: FloatArray
    """Distance metrics, shape (N, 2, 2) [1/m^2]."""
    M: FloatArray
    """Linear models, the constant last, shape (N, 3)."""
    say: FloatArray | None = None
    """Factor of each model's weight, shape (N,); None for 1."""
    P: FloatArray | None = None
    """Covariances of the linear models, shape (N, 3, 3); None where the log lacks what a deviation needs."""
    variances: FloatArray | None = None
    """Variance of each model's residuals, shape (N,) [m^2]; None as P."""
    cause: int = 0
    """0 a batch was learned, 1 models were forgotten, 2 a change was undone."""

    @property
    def title(self) -> str:
        """What this skill is, in two words."""
        return ("Update {}", "Forgotten after {}", "Undone after {}")[self.cause].format(self.update)


@dataclass(frozen=True, slots=True, kw_only=True)
class Cycles:
    """The loop's cycles; arrays of shape (n,)."""

    time_s: FloatArray
    """Time since the first tick [s]."""
    dt_s: FloatArray
    """True time step of the cycle [s]."""
    x: FloatArray
    """Position of the handle, frame of the device [m]."""
    y: FloatArray
    z: FloatArray
    velocity_z: FloatArray
    """Velocity of the handle in z [m/s]."""
    reference_z: FloatArray
    """Reference of the position spring in z [m]."""
    reference_velocity_z: FloatArray
    """Velocity of that reference [m/s]."""
    phase_z: FloatArray
    """0 admittance, 1 position, 2 releasing."""
    assist_reference: FloatArray
    """Rest height of the assist spring [m]."""
    spring_force_z: FloatArray
    """Commanded force of the position spring in z [N]."""
    assist_force: FloatArray
    """Commanded force of the assist spring [N]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """How punctual the loop was; arrays of shape (n,)."""

    lateness_us: FloatArray
    """Wake-up behind the grid [us]."""
    exchange_us: FloatArray
    """Exchange with the device [us]."""
    missed_periods: int
    """Periods skipped in all."""
    saturated_cycles: int
    """Cycles with a joint at its velocity limit."""


@dataclass(frozen=True, slots=True)
class Event:
    """Something that happened once."""

    time_s: float
    level: int
    name: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionData:
    """Everything that the report needs, read from one log."""

    path: Path
    """The log."""
    damage: str
    """Why the log is not whole; empty where it is."""
    config: Mapping[str, Any]
    """The merged configuration."""
    metadata: Mapping[str, Mapping[str, str]]
    """What the session and the recorder noted."""
    task: Task
    """The plane, its objects and the mapping."""
    geometry: ArmGeometry
    """Reach of the arm."""
    modes: ModeOptions
    """Springs of the loop."""
    w_th: float
    """Activation threshold of the arbitration."""
    ticks: Ticks
    skills: tuple[Skill, ...]
    """The learner after each update."""
    cycles: Cycles
    timing: Timing
    events: tuple[Event, ...]

    @property
    def lost_messages(self) -> int:
        """Messages that did not get into the log, as far as the recorder could say."""
        return int(self.metadata.get(RECORDING_METADATA, {}).get("lost", "0"))

    @property
    def is_virtual(self) -> bool:
        """Whether the session ran on a virtual clock, where lateness means nothing."""
        return self.metadata.get(SESSION_METADATA, {}).get("clock", "") == "virtual"


def load_session(path: str | Path) -> SessionData:
    """Read a session's log.

    Raises:
        RecordingError: if it cannot be read or holds no teaching session.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)  # the report says it
        with Recording(path) as log:
            return _load(log)


def _load(log: Recording) -> SessionData:
    if ARBITRATION_TOPIC not in log.topics:
        there = ", ".join(log.topics) or "none"
        raise RecordingError(
            f"{log.path} holds no teaching session: no {ARBITRATION_TOPIC}; there are: {there}"
        )
    attachments = log.attachments
    config = _json(log, attachments, CONFIG_FILE)
    tables = log.tables({topic: _columns(log, topic) for topic in WANTED if topic in log.topics})
    arbitration = tables[ARBITRATION_TOPIC]
    if not len(arbitration["time_ns"]):
        raise RecordingError(f"{log.path} holds no tick of a teaching session")
    start_ns = int(arbitration["time_ns"][0])
    return SessionData(
        path=log.path,
        damage=log.damage,
        config=config,
        metadata=log.metadata,
        task=_task(log, config, attachments),
        geometry=_geometry(config),
        modes=_modes(config),
        w_th=float(config.get("arbitration", {}).get("w_th", 0.5)),
        ticks=_ticks(arbitration, start_ns),
        skills=_skills(_table(tables, LEARNER_TOPIC), start_ns),
        cycles=_cycles(
            _table(tables, STATE_TOPIC), _table(tables, COMMAND_TOPIC), _table(tables, TIMING_TOPIC), start_ns
        ),
        timing=_timing(_table(tables, TIMING_TOPIC)),
        events=_events(_table(tables, EVENTS_TOPIC), start_ns),
    )


def _columns(log: Recording, topic: str) -> tuple[str, ...]:
    there = log.describe(topic).columns if topic in LATER else ()
    return (*WANTED[topic], *(name for name in LATER.get(topic, ()) if name in there))


def _json(log: Recording, attachments: Mapping[str, bytes], name: str) -> dict[str, Any]:
    data = attachments.get(name)
    if data is None:
        return {}
    try:
        parsed = json.loads(data)
    except ValueError as error:
        raise RecordingError(f"{log.path}: its attachment {name} is no JSON: {error}") from error
    return parsed if isinstance(parsed, dict) else {}


def _task(log: Recording, config: Mapping[str, Any], attachments: Mapping[str, bytes]) -> Task:
    """The task as attached; else as the configuration holds or names it."""
    described = _json(log, attachments, TASK_FILE) or config.get("task", "paper")
    try:
        if isinstance(described, dict):
            return task_from_dict(described, source=f"{log.path}: {TASK_FILE}")
        return load_task(str(described))
    except ConfigurationError as error:
        raise RecordingError(f"{log.path}: its task cannot be read: {error}") from error


def _geometry(config: Mapping[str, Any]) -> ArmGeometry:
    try:
        return ArmGeometry(**config.get("geometry", {}))
    except (TypeError, ConfigurationError):
        return ArmGeometry()


def _modes(config: Mapping[str, Any]) -> ModeOptions:
    try:
        return ModeOptions(**config.get("modes", {}))
    except (TypeError, ConfigurationError):
        return ModeOptions()


def _ticks(columns: Mapping[str, NDArray[Any]], start_ns: int) -> Ticks:
    return Ticks(
        time_s=_seconds(columns["time_ns"], start_ns),
        stage=columns["stage"].astype(np.int64),
        C=columns["C"],
        x=columns["x"],
        y=columns["y"],
        depth=np.maximum(columns["depth"], 0.0),
        y_robot=columns["y_robot"],
        force=columns["force"],
        stiffness=columns["stiffness"],
        recorded=columns["recorded"],
    )


def _skills(columns: Mapping[str, NDArray[Any]], start_ns: int) -> tuple[Skill, ...]:
    return tuple(
        Skill(
            time_s=(int(columns["time_ns"][row]) - start_ns) / 1e9,
            update=int(columns["update"][row]),
            samples=int(columns["samples"][row]),
            added=int(columns["added"][row]),
            pruned=int(columns["pruned"][row]),
            coverage=float(columns["coverage"][row]),
            centres=columns["centres"][row].reshape(-1, 2),
            D=columns["D"][row].reshape(-1, 2, 2),
            M=columns["M"][row].reshape(-1, 3),
            say=columns["say"][row] if "say" in columns else None,
            **_deviations(columns, row),
            cause=int(columns["cause"][row]) if "cause" in columns else 0,
        )
        for row in range(len(columns["time_ns"]))
        if int(columns["update"][row]) > 0 or ("cause" in columns and int(columns["cause"][row]) > 0)
    )


def _deviations(columns: Mapping[str, NDArray[Any]], row: int) -> dict[str, FloatArray]:
    """What the deviation of a skill follows from; nothing where it is not in the log."""
    n = len(columns["centres"][row]) // 2
    if "variances" not in columns or len(columns["variances"][row]) != n:
        return {}
    return {"P": columns["P"][row].reshape(-1, 3, 3), "variances": columns["variances"][row]}


def _cycles(
    state: Mapping[str, NDArray[Any]],
    command: Mapping[str, NDArray[Any]],
    timing: Mapping[str, NDArray[Any]],
    start_ns: int,
) -> Cycles:
    """The cycles of which all three messages are there."""
    numbers = np.intersect1d(np.intersect1d(state["sequence"], command["sequence"]), timing["sequence"])
    mine, its, when = (np.searchsorted(table["sequence"], numbers) for table in (state, command, timing))
    return Cycles(
        time_s=_seconds(state["time_ns"], start_ns)[mine],
        dt_s=timing["dt_s"][when],
        x=state["measured_position.x"][mine],
        y=state["measured_position.y"][mine],
        z=state["measured_position.z"][mine],
        velocity_z=state["model_velocity.z"][mine],
        reference_z=command["reference.z"][its],
        reference_velocity_z=command["reference_velocity.z"][its],
        phase_z=command["phase.z"][its],
        assist_reference=command["assist_reference"][its],
        spring_force_z=command["spring_force.z"][its],
        assist_force=command["assist_force"][its],
    )


def _timing(columns: Mapping[str, NDArray[Any]]) -> Timing:
    missed, saturated = columns["missed_periods"], columns["saturated_cycles"]
    return Timing(
        lateness_us=columns["lateness_ns"] / 1e3,
        exchange_us=columns["exchange_ns"] / 1e3,
        missed_periods=int(missed[-1]) if len(missed) else 0,
        saturated_cycles=int(saturated[-1]) if len(saturated) else 0,
    )


def _events(columns: Mapping[str, NDArray[Any]], start_ns: int) -> tuple[Event, ...]:
    rows = zip(columns["time_ns"], columns["level"], columns["name"], columns["text"], strict=True)
    found = [Event((int(time) - start_ns) / 1e9, int(level), name, text) for time, level, name, text in rows]
    return tuple(sorted(found, key=lambda event: event.time_s))


def _table(tables: Mapping[str, dict[str, NDArray[Any]]], topic: str) -> dict[str, NDArray[Any]]:
    """Columns of a topic; empty ones where the log has no such topic."""
    return tables.get(topic) or {name: np.empty(0) for name in WANTED[topic]}


def _seconds(time_ns: NDArray[Any], start_ns: int) -> FloatArray:
    seconds: FloatArray = (time_ns.astype(np.int64) - start_ns) / 1e9
    return seconds

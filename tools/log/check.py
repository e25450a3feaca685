"""Whether a log keeps what it must: each rule a line, with the value found and the limit."""

import json
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

import numpy as np

from hm_driver.errors import ConfigurationError, RecordingError
from hm_driver.geometry import ArmGeometry
from hm_driver.recording.decoding import Columns
from hm_driver.recording.reader import LOG_TIME, Recording, RecordingWarning
from hm_driver.recording.schemas import EVENT_LEVELS

_AXES = ("x", "y", "z")
_NEEDED = {
    "/device/state": [
        f"{vector}.{axis}"
        for vector in ("measured_position", "model_velocity", "measured_force")
        for axis in _AXES
    ],
    "/device/command": [
        f"{vector}.{axis}" for vector in ("spring_force", "reference_velocity") for axis in _AXES
    ],
    "/loop/timing": ["sequence", "missed_periods"],
    "/teaching/arbitration": ["C", "w_max", "stage"],
    "/events": ["level", "name", "text"],
}
"""Columns without which the rules of a topic cannot be judged."""
_ROUNDING = 1e-6
"""Relative excess of a limit that the six digits of the wire may cause."""


@dataclass(frozen=True, slots=True)
class Finding:
    """One rule, and whether the log keeps it."""

    rule: str
    """What is to hold."""
    is_kept: bool
    found: str
    """What the log shows."""


@dataclass(slots=True)
class _Largest:
    """The largest magnitude of a signal, and when it was reached."""

    value: float = 0.0
    time_ns: int = 0

    def take(self, values: np.ndarray[Any, Any], times: np.ndarray[Any, Any]) -> None:
        if len(values):
            place = int(np.argmax(np.abs(values)))
            if abs(values[place]) > self.value:
                self.value, self.time_ns = float(abs(values[place])), int(times[place])


@dataclass(slots=True)
class _Topic:
    """What is followed of each topic from chunk to chunk."""

    last_ns: int = -(2**62)
    backward: int = 0
    due: int | None = None
    lost: int = 0
    messages: int = 0


@dataclass(slots=True)
class _Findings:
    """What a pass over the log collects."""

    topics: dict[str, _Topic] = field(default_factory=dict)
    largest: dict[str, _Largest] = field(default_factory=dict)
    not_finite: dict[str, int] = field(default_factory=dict)
    outside_unit: dict[str, int] = field(default_factory=dict)
    backward_stages: int = 0
    last_stage: int = 0
    cycles: int = 0
    grid: int = 0
    missed: int = 0
    last_cycle: int | None = None
    last_missed: int = 0
    out_of_reach: int = 0
    reach: str = ""
    errors: list[str] = field(default_factory=list)

    def peak(self, name: str) -> _Largest:
        return self.largest.setdefault(name, _Largest())


def check(path: Path) -> list[Finding]:
    """Read the whole log once and judge it; a log of any size takes little memory.

    Raises:
        RecordingError: It cannot be read at all.
    """
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", RecordingWarning)
        with Recording(path) as recording:
            broken = recording.find_broken_checksums()
            config = _config(recording, broken)
            found = _read(recording, config)
            dropped = _dropped(recording)
            damage = [
                str(one.message) for one in caught if issubclass(one.category, RecordingWarning)
            ] + broken
            findings = [
                Finding("every file is whole and bears out its checksums", not damage, _first(damage))
            ]
            findings += _of_messages(found, dropped)
            findings += _of_the_loop(found)
            findings += _of_limits(found, config, recording.start_time_ns)
            findings += _of_teaching(found)
    return findings


def _first(texts: list[str]) -> str:
    more = f"; and {len(texts) - 1} more" if len(texts) > 1 else ""
    return texts[0] + more if texts else "yes"


def _config(recording: Recording, broken: list[str]) -> dict[str, Any]:
    """The configuration inside the log; nothing where there is none, or it is damaged."""
    try:
        config = json.loads(recording.attachments.get("config.json", b"{}"))
    except RecordingError as error:
        broken.append(str(error))
        return {}
    except ValueError:
        return {}
    return config if isinstance(config, dict) else {}


def _section(config: dict[str, Any], name: str) -> dict[str, Any]:
    """The numbers in a table of the configuration."""
    section = config.get(name)
    pairs = section.items() if isinstance(section, dict) else ()
    return {
        key: value for key, value in pairs if isinstance(value, int | float) and not isinstance(value, bool)
    }


def _geometry(config: dict[str, Any]) -> ArmGeometry | None:
    """The arm; what a newer version says of it beyond what is known here is left out."""
    known = {field.name for field in fields(ArmGeometry)}
    values = {key: value for key, value in _section(config, "geometry").items() if key in known}
    try:
        return ArmGeometry(**values) if values else None
    except ConfigurationError:
        return None


def _dropped(recording: Recording) -> int:
    """Messages that the recorder knows it lost."""
    text = recording.metadata.get("recording", {}).get("lost", "0")
    return int(text) if text.isdecimal() and text.isascii() else 0


def _read(recording: Recording, config: dict[str, Any]) -> _Findings:
    found = _Findings()
    geometry = _geometry(config)
    readers: dict[str, Callable[[Columns], None]] = {
        "/device/state": lambda piece: _state(found, piece, geometry),
        "/device/command": lambda piece: _command(found, piece),
        "/loop/timing": lambda piece: _timing(found, piece),
        "/teaching/arbitration": lambda piece: _arbitration(found, piece),
        "/events": lambda piece: _event(found, piece, recording.start_time_ns),
    }
    readers = {topic: reader for topic, reader in readers.items() if _is_ours(recording, topic)}
    for topic, block in recording.blocks():
        _follow(found.topics.setdefault(topic, _Topic()), block.times, block.sequences)
        if topic in readers:
            readers[topic](recording.decode(topic, block))
    return found


def _is_ours(recording: Recording, topic: str) -> bool:
    """Whether a topic is there and has the columns that its rules need; a log of others may have its name."""
    if topic not in recording.topics:
        return False
    try:
        recording.require(topic, _NEEDED[topic])
    except RecordingError:
        return False
    return True


def _follow(topic: _Topic, times: np.ndarray[Any, Any], sequences: np.ndarray[Any, Any]) -> None:
    steps = np.diff(times, prepend=max(topic.last_ns, times[0] if topic.messages == 0 else topic.last_ns))
    topic.backward += int((steps < 0).sum())
    topic.last_ns = int(times[-1])
    numbers = sequences.astype(np.int64)
    gaps = np.diff(numbers, prepend=numbers[0] - 1 if topic.due is None else topic.due - 1) - 1
    topic.lost += int(gaps[gaps > 0].sum())
    topic.due = int(numbers[-1]) + 1
    topic.messages += len(times)


def _finite(found: _Findings, topic: str, piece: Columns) -> None:
    for values in piece.values():
        if values.dtype.kind == "f":
            bad = int((~np.isfinite(values)).sum())
            if bad:
                found.not_finite[topic] = found.not_finite.get(topic, 0) + bad


def _state(found: _Findings, piece: Columns, geometry: ArmGeometry | None) -> None:
    _finite(found, "/device/state", piece)
    times = piece[LOG_TIME]
    for name in ("model_velocity", "measured_force"):
        found.peak(name).take(np.sqrt(sum(piece[f"{name}.{axis}"] ** 2 for axis in _AXES)), times)
    if geometry is not None:
        x, y, z = (piece[f"measured_position.{axis}"] for axis in _AXES)
        joints = np.hypot(geometry.r0 + x, y) - geometry.r0, np.arctan2(y, geometry.r0 + x), z
        beyond = np.zeros(len(x), dtype=bool)
        for (_, _, low, high), values in zip(geometry.joint_limits(), joints, strict=True):
            beyond |= (values < low - 1e-4) | (values > high + 1e-4)
        if beyond.any() and not found.out_of_reach:
            place = int(np.flatnonzero(beyond)[0])
            found.reach = geometry.violation(float(x[place]), float(y[place]), float(z[place])) or ""
        found.out_of_reach += int(beyond.sum())


def _command(found: _Findings, piece: Columns) -> None:
    _finite(found, "/device/command", piece)
    times = piece[LOG_TIME]
    for axis in _AXES:
        found.peak("spring_force").take(piece[f"spring_force.{axis}"], times)
        if f"bias_force.{axis}" in piece:
            found.peak("bias_force").take(piece[f"bias_force.{axis}"], times)
        found.peak("reference_velocity").take(piece[f"reference_velocity.{axis}"], times)
    if "assist_force" in piece:
        found.peak("assist_force").take(piece["assist_force"], times)


def _timing(found: _Findings, piece: Columns) -> None:
    cycles, missed = piece["sequence"].astype(np.int64), piece["missed_periods"].astype(np.int64)
    if found.last_cycle is None:
        found.last_cycle, found.last_missed = int(cycles[0]), int(missed[0])
        found.cycles -= 1
    found.cycles += len(cycles)
    found.grid += int(cycles[-1]) - found.last_cycle
    found.missed += int(missed[-1]) - found.last_missed
    found.last_cycle, found.last_missed = int(cycles[-1]), int(missed[-1])


def _arbitration(found: _Findings, piece: Columns) -> None:
    chosen: Columns = {name: piece[name] for name in ("x", "y", "depth", "y_cmd", "force") if name in piece}
    _finite(found, "/teaching/arbitration", chosen)
    for name in ("C", "w_max"):
        bad = int((~((piece[name] >= 0.0) & (piece[name] <= 1.0 + 1e-12))).sum())
        found.outside_unit[name] = found.outside_unit.get(name, 0) + bad
    stages = piece["stage"].astype(np.int64)
    found.backward_stages += int((np.diff(stages, prepend=found.last_stage) < 0).sum())
    found.last_stage = int(stages[-1])


def _event(found: _Findings, piece: Columns, start_ns: int) -> None:
    for time_ns, level, name, text in zip(
        piece[LOG_TIME], piece["level"], piece["name"], piece["text"], strict=True
    ):
        if int(level) >= EVENT_LEVELS["error"]:
            found.errors.append(f"{(int(time_ns) - start_ns) * 1e-9:.3f} s {name}: {text}")


def _of_messages(found: _Findings, dropped: int) -> Iterator[Finding]:
    backward = {topic: one.backward for topic, one in found.topics.items() if one.backward}
    yield Finding("time never runs backward on a topic", not backward, _counts(backward))
    lost = {topic: one.lost for topic, one in found.topics.items() if one.lost}
    if dropped and not lost:
        lost = {"all": dropped}
    yield Finding("no message was lost", not lost, _counts(lost))
    yield Finding("every number is finite", not found.not_finite, _counts(found.not_finite))
    yield Finding("no event tells of an error", not found.errors, _first(found.errors))


def _of_the_loop(found: _Findings) -> Iterator[Finding]:
    if found.last_cycle is None:
        return
    text = f"{found.cycles} run + {found.missed} missed of {found.grid}"
    yield Finding(
        "cycles run and periods missed are the grid", found.cycles + found.missed == found.grid, text
    )
    state, command = (found.topics.get(f"/device/{name}", _Topic()).messages for name in ("state", "command"))
    same = state == command == found.topics["/loop/timing"].messages
    yield Finding("state, command and timing of each cycle are there", same, f"{state}, {command}")


def _of_limits(found: _Findings, config: dict[str, Any], start_ns: int) -> Iterator[Finding]:
    modes, limits = _section(config, "modes"), _section(config, "limits")
    for name, limit, unit in (
        ("model_velocity", limits.get("velocity_trip"), "m/s"),
        ("measured_force", limits.get("force_trip"), "N"),
        ("spring_force", modes.get("position_force_max"), "N"),
        ("assist_force", modes.get("assist_force_max"), "N"),
        ("bias_force", limits.get("bias_max"), "N"),
        ("reference_velocity", limits.get("reference_speed"), "m/s"),
    ):
        if limit is None or name not in found.largest:
            continue
        peak = found.largest[name]
        at = f" at {(peak.time_ns - start_ns) * 1e-9:.3f} s" if peak.value else ""
        is_kept = peak.value <= limit * (1.0 + _ROUNDING)
        yield Finding(
            f"{name.replace('_', ' ')} is at most {limit:g} {unit}", is_kept, f"{peak.value:.4g} {unit}{at}"
        )
    if _geometry(config) is not None and "/device/state" in found.topics:
        beyond = f"{found.out_of_reach} states beyond, the first: {found.reach}"
        yield Finding(
            "the arm stays within its end stops",
            not found.out_of_reach,
            beyond if found.out_of_reach else "yes",
        )


def _of_teaching(found: _Findings) -> Iterator[Finding]:
    if not found.outside_unit:
        return
    outside = {name: count for name, count in found.outside_unit.items() if count}
    yield Finding("C and w_max are between 0 and 1", not outside, _counts(outside))
    backward = found.backward_stages
    yield Finding(
        "the stages follow each other", not backward, f"{backward} steps back" if backward else "yes"
    )


def _counts(counts: dict[str, int]) -> str:
    return ", ".join(f"{count} on {name}" for name, count in counts.items()) or "yes"

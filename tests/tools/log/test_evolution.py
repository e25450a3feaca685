"""Logs of other versions: fewer fields than ours, and fields that we do not know."""

import json
import warnings

import numpy as np
import pytest

import hm_driver.recording
from hm_driver.errors import RecordingError
from hm_driver.recording.messages import Field, FixedMessage, Kind, VariableMessage
from hm_driver.recording.schemas import (
    DEVICE_COMMAND,
    DEVICE_STATE,
    EVENT,
    LOOP_TIMING,
    Channel,
)
from hm_driver.recording.writer import Attachment, LogWriter
from teaching.messages import ARBITRATION
from tools.cli.main import run
from tools.log.check import check
from tools.log.haptics import analyse as analyse_haptics
from tools.log.timing import analyse as analyse_timing

MESSAGES = {
    "/device/state": (DEVICE_STATE, 5),
    "/device/command": (DEVICE_COMMAND, 6),
    "/loop/timing": (LOOP_TIMING, 7),
    "/events": (EVENT, 5),
    "/teaching/arbitration": (ARBITRATION, 12),
}
"""The messages, and how many of their fields an older version had."""
EXTRA = (Field("tomorrow", Kind.DOUBLE, "What a later version logs", "N"),)
TEXT = (Field("note", Kind.TEXT, "What a later version says"),)


def value_of(field, cycle):
    if field.kind is Kind.VECTOR3:
        return (0.0005 * cycle, 0.0, 0.0)
    if field.kind is Kind.TEXT:
        return field.name
    if field.kind is Kind.DOUBLES:
        return []
    if field.name in ("time_ns", "sequence"):
        return cycle * (1_000_000 if field.name == "time_ns" else 1)
    return field.name == "level" if field.kind is not Kind.DOUBLE else 0.5


def pack(message, cycle):
    values = [value_of(field, cycle) for field in message.fields]
    if isinstance(message, VariableMessage):
        return message.pack(*values)
    return message.pack(
        *(part for value in values for part in (value if isinstance(value, tuple) else (value,)))
    )


def write(path, change, config):
    """A log of the messages as another version has them: `change(topic, fields)` gives their fields."""
    channels = []
    for number, (topic, (message, count)) in enumerate(MESSAGES.items(), start=1):
        other = type(message)(message.name, message.doc, change(message.fields, count))
        channels.append(Channel(number, topic, other))
    attachment = Attachment(
        name="config.json", media_type="application/json", data=json.dumps(config).encode()
    )
    with LogWriter(path, channels, attachments=[attachment], chunk_bytes=8000) as writer:
        for cycle in range(200):
            for channel in channels:
                if channel.topic != "/events" or cycle == 7:
                    writer.add(channel.id, cycle * 1_000_000, pack(channel.message, cycle))
    return path


@pytest.fixture(scope="module", params=["older", "newer", "newer with texts"])
def log(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("log") / "log.mcap"
    config = {
        "geometry": {"r0": 0.45, "elbow": 1.0},
        "modes": {"colour": "red"},
        "limits": {"velocity_trip": 1.5},
    }
    if request.param == "older":
        return write(path, lambda fields, count: fields[:count], {})
    added = EXTRA if request.param == "newer" else TEXT

    def grow(fields, _):
        return (*fields, *added)

    if request.param == "newer":
        return write(path, grow, config)
    variable = {topic: (VariableMessage(m.name, m.doc, m.fields), n) for topic, (m, n) in MESSAGES.items()}
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(globals(), "MESSAGES", variable)
        return write(path, grow, config)


def test_every_column_that_the_versions_share_is_read(log):
    with hm_driver.recording.open(log) as recording:
        state = recording.columns("/device/state")
        np.testing.assert_allclose(state["measured_force.x"], 0.0005 * np.arange(200))
        assert (
            recording.columns("/loop/timing", names=["missed_periods"])["missed_periods"].tolist()
            == [0] * 200
        )


def test_check_judges_what_there_is(log):
    broken = [finding for finding in check(log) if not finding.is_kept]
    assert broken == []


def test_every_command_answers(log, tmp_path, capsys):
    target = tmp_path / "a.csv"
    for words in (
        ["info", log],
        ["events", log],
        ["export", log, target],
        ["plot", log, "measured_force"],
        ["timing", log],
        ["haptics", log],
    ):
        assert run(["log", *map(str, words)]) == 0, capsys.readouterr().err
    assert "defect" not in capsys.readouterr().err


def test_columns_that_came_later_are_taken_for_nothing_or_left_out(log):
    with hm_driver.recording.open(log) as recording:
        is_older = "bias_force.x" not in recording.describe("/device/command").columns
    assert bool(analyse_haptics(log).energy.work[-1][3] == 0.0) == is_older
    timing = analyse_timing(log)
    assert (timing.cycles, timing.saturated) == (200, 0)


def test_a_topic_of_others_with_one_of_our_names_is_not_judged_by_our_rules(tmp_path):
    other = FixedMessage("Other", "Not ours.", (Field("a", Kind.DOUBLE, "A"),))
    path = tmp_path / "other.mcap"
    with LogWriter(path, [Channel(1, "/device/state", other), Channel(2, "/events", other)]) as writer:
        writer.add(1, 5, other.pack(1.0))
    assert all(finding.is_kept for finding in check(path))
    with pytest.raises(RecordingError, match="no column"):
        analyse_haptics(path)
    assert run(["log", "events", str(path)]) == 1


def test_older_events_have_no_numbers(log):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        with hm_driver.recording.open(log) as recording:
            assert list(recording.columns("/events", names=["text"])["text"]) == ["text"]

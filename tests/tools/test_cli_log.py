import json

import pytest

from hm_driver.recording.schemas import DEVICE_CHANNELS, DEVICE_STATE, DEVICE_STATE_CHANNEL
from hm_driver.recording.writer import Attachment, LogWriter
from tools.cli.main import run

EPOCH_NS = 1_800_000_000_000_000_000
CYCLES = 2001


@pytest.fixture
def log(tmp_path):
    path = tmp_path / "session.mcap"
    writer = LogWriter(
        path,
        DEVICE_CHANNELS,
        metadata={"session": {"seed": "3"}},
        attachments=[Attachment("config.toml", "application/toml", b"seed = 3\n")],
        chunk_bytes=20_000,
    )
    with writer:
        for cycle in range(CYCLES):
            time_ns = EPOCH_NS + cycle * 1_000_000
            writer.add(DEVICE_STATE_CHANNEL.id, time_ns, DEVICE_STATE.pack(cycle, time_ns, *[0.5] * 9))
    return path


@pytest.fixture
def cut(log):
    path = log.with_name("cut.mcap")
    path.write_bytes(log.read_bytes()[:-40_000])
    return path


def test_info_tells_time_topics_rates_and_attachments(log, capsys):
    assert run(["log", "info", str(log)]) == 0
    told = capsys.readouterr().out
    for part in ("2.00 s", "whole     yes", "2001 messages  1000.0 Hz", "config.toml", "session.seed"):
        assert part in told


def test_info_as_json_is_one_object_with_the_same_figures(log, capsys):
    assert run(["log", "info", str(log), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["is_whole"] is True
    assert told["damage"] is None
    assert told["duration_s"] == 2.0
    assert told["topics"]["/device/state"] == told["messages"] == CYCLES
    assert told["attachments"] == {"config.toml": 9}
    assert told["metadata"] == {"session": {"seed": "3"}}


@pytest.mark.filterwarnings("ignore:.*is not whole")
def test_a_cut_log_is_called_so_and_recovered_into_a_whole_one(cut, capsys):
    assert run(["log", "info", str(cut)]) == 0
    assert "whole     no" in capsys.readouterr().out
    target = cut.with_name("whole.mcap")
    assert run(["log", "recover", str(cut), str(target)]) == 0
    told = capsys.readouterr()
    assert "messages in" in told.out
    assert "left out" in told.err
    assert run(["log", "info", str(target), "--json"]) == 0
    saved = json.loads(capsys.readouterr().out)
    assert saved["is_whole"] is True
    assert 0 < saved["messages"] <= CYCLES


@pytest.mark.parametrize("content", [None, b"", b"this is no log"])
def test_what_is_no_log_is_refused_with_code_1(tmp_path, capsys, content):
    path = tmp_path / "other.mcap"
    if content is not None:
        path.write_bytes(content)
    assert run(["log", "info", str(path)]) == 1
    assert "other.mcap" in capsys.readouterr().err


def test_recovery_never_writes_over_a_file(log, capsys):
    before = log.read_bytes()
    assert run(["log", "recover", str(log), str(log)]) == 1
    assert log.read_bytes() == before
    assert "session.mcap" in capsys.readouterr().err

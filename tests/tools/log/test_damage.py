"""Files that are not what they should be: no command answers with a defect, or with data that are wrong."""

import contextlib
import random
import warnings

import pytest
from log_bench import write

import hm_driver.recording
from hm_driver.errors import HapticMasterError, RecordingError
from hm_driver.recording.editing import cut
from hm_driver.recording.reader import RecordingWarning
from tools.cli.log import _summary, _write_summary
from tools.cli.main import run
from tools.log.check import check
from tools.log.events import events
from tools.log.export import Selection, export

FLIPS = 250
"""Random flips for each of the four commands."""
RULE = "every file is whole and bears out its checksums"


def info(path):
    with hm_driver.recording.open(path) as recording:
        _write_summary(recording)
        return _summary(recording)


def lines(path, target):
    export(path, target, Selection(topics=("/device/state",)), force=True)
    return target.read_text().splitlines()


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return write(tmp_path_factory.mktemp("log") / "log.mcap", 60)


def flipped(log, tmp_path, seed):
    """The log with one random bit flipped, again and again."""
    whole, rng, path = log.read_bytes(), random.Random(seed), tmp_path / "damaged.mcap"
    for _ in range(FLIPS):
        place, bit = rng.randrange(len(whole)), rng.randrange(8)
        damaged = bytearray(whole)
        damaged[place] ^= 1 << bit
        path.write_bytes(damaged)
        yield path


@contextlib.contextmanager
def only_our_errors():
    with warnings.catch_warnings(), contextlib.suppress(HapticMasterError):
        warnings.simplefilter("ignore", RecordingWarning)
        yield


def test_flipped_bits_never_break_info(log, tmp_path, capsys):
    truth = info(log)
    for path in flipped(log, tmp_path, 1):
        with only_our_errors():
            told = info(path)
            assert told["duration_s"] == truth["duration_s"]
            assert set(told["topics"]) == set(truth["topics"])
    capsys.readouterr()


def test_flipped_bits_never_get_past_check(log, tmp_path):
    assert all(finding.is_kept for finding in check(log))
    for path in flipped(log, tmp_path, 2):
        with only_our_errors():
            findings = {finding.rule: finding.is_kept for finding in check(path)}
            assert not findings[RULE]


def test_flipped_bits_never_give_wrong_lines(log, tmp_path):
    truth = set(lines(log, tmp_path / "truth.csv"))
    for path in flipped(log, tmp_path, 3):
        with only_our_errors():
            assert set(lines(path, tmp_path / "damaged.csv")) <= truth


def test_flipped_bits_never_give_wrong_events(log, tmp_path):
    truth = events(log)
    for path in flipped(log, tmp_path, 4):
        with only_our_errors():
            assert events(path) in (truth, [])


def test_a_log_cut_anywhere_is_read_as_far_as_it_goes(log, tmp_path):
    whole, truth = log.read_bytes(), set(lines(log, tmp_path / "truth.csv"))
    path = tmp_path / "cut.mcap"
    for size in range(0, len(whole), max(1, len(whole) // 60)):
        path.write_bytes(whole[:size])
        with only_our_errors():
            assert set(lines(path, tmp_path / "cut.csv")) <= truth
            assert not next(one for one in check(path) if one.rule == RULE).is_kept


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"\x89PNG\r\n\x1a\n" + bytes(64), "is no MCAP file"),
        (b"\x89MCAP0\r\n", "no channel"),
        (b"\x89MCAP0\r\n" + b"\xff" * 300, "no channel"),
    ],
)
@pytest.mark.parametrize(
    "words",
    [
        ["export", "{}", "{}.csv", "--topic", "/device/state"],
        ["plot", "{}", "force"],
        ["timing", "{}"],
        ["haptics", "{}"],
        ["events", "{}"],
    ],
    ids=lambda words: words[0],
)
def test_empty_and_foreign_files_are_told_with_code_1(tmp_path, capsys, content, said, words):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RecordingWarning)
        assert run(["log", *(word.format(path) for word in words)]) == 1
    told = capsys.readouterr().err
    assert "defect" not in told
    assert (said in told) or (words[0] == "plot" and "no signal force" in told)
    assert [one.name for one in tmp_path.iterdir()] == ["other.mcap"]


def test_a_damaged_attachment_breaks_the_rule_and_not_the_command(log, tmp_path, capsys):
    damaged = bytearray(log.read_bytes())
    damaged[damaged.index(b'"position_force_max"') + 3] ^= 1
    path = tmp_path / "damaged.mcap"
    path.write_bytes(damaged)
    finding = next(one for one in check(path) if one.rule == RULE)
    assert not finding.is_kept
    assert "wrong checksum over its data" in finding.found
    assert run(["log", "info", str(path)]) == 0
    assert "attachment config.json is damaged: wrong checksum" in capsys.readouterr().err
    with hm_driver.recording.open(path) as recording, pytest.raises(RecordingError, match="is damaged"):
        recording.attachments  # noqa: B018 - it is read when it is first asked for


def test_metadata_without_a_checksum_is_covered_by_the_one_over_all_data(log, tmp_path):
    source = tmp_path / "cut.mcap"
    cut(log, source, 0.0, 0.05)
    assert all(finding.is_kept for finding in check(source) if finding.rule == RULE)
    damaged = bytearray(source.read_bytes())
    damaged[damaged.index(b"log.mcap")] ^= 1
    path = tmp_path / "damaged.mcap"
    path.write_bytes(damaged)
    assert not next(one for one in check(path) if one.rule == RULE).is_kept

import json

import pytest
from log_bench import at, write

from hm_driver.recording.reader import Recording
from tools.cli.main import run


def test_check_answers_by_its_exit_code(tmp_path, capsys):
    assert run(["log", "check", str(write(tmp_path / "good.mcap"))]) == 0
    assert "16 of 16 rules are kept" in capsys.readouterr().out
    bad = write(tmp_path / "bad.mcap", change=at("/device/command", 9, 8, 99.0))
    assert run(["log", "check", str(bad), "--json"]) == 1
    answer = json.loads(capsys.readouterr().out)
    assert not answer["is_kept"]
    assert [one["rule"] for one in answer["findings"] if not one["is_kept"]] == [
        "spring force is at most 30 N"
    ]


def test_events_are_chosen_by_name_and_level(tmp_path, capsys):
    log = str(write(tmp_path / "log.mcap", level=3))
    assert run(["log", "events", log, "--level", "warning"]) == 0
    assert "warning  trip  force 90 N" in capsys.readouterr().out
    assert run(["log", "events", log, "--level", "error"]) == 0
    assert capsys.readouterr().out == ""
    assert run(["log", "events", log, "--name", "tripp"]) == 1
    assert "has no event tripp; there are: trip" in capsys.readouterr().err
    assert run(["log", "events", log, "--level", "loud"]) == 1
    assert "none of debug, info, warning, error" in capsys.readouterr().err


def test_a_cut_does_not_write_over_a_file_unless_it_is_told_to(tmp_path, capsys):
    log, target = write(tmp_path / "log.mcap"), tmp_path / "cut.mcap"
    words = ["log", "cut", str(log), str(target), "--start", "0.1", "--end", "0.2"]
    assert run(words) == 0
    before = target.read_bytes()
    assert run(words) == 1
    assert "exists already; give --force" in capsys.readouterr().err
    assert target.read_bytes() == before
    assert run([*words, "--force"]) == 0
    with Recording(target) as cut:
        assert cut.counts["/device/state"] == 100


@pytest.mark.parametrize(
    ("target", "said"),
    [
        ("log.mcap", "is read and cannot be written"),
        ("no/cut.mcap", "is no directory"),
        (".", "is no file"),
    ],
)
def test_a_target_that_cannot_be_is_refused_and_the_source_stays(tmp_path, capsys, target, said):
    log = write(tmp_path / "log.mcap")
    before = log.read_bytes()
    assert run(["log", "cut", str(log), str(tmp_path / target), "--force"]) == 1
    told = capsys.readouterr().err
    assert said in told
    assert log.read_bytes() == before


def test_merge_joins_logs(tmp_path, capsys):
    logs = [write(tmp_path / "log.mcap", 50), write(tmp_path / "log.part2.mcap", 80)]
    assert run(["log", "merge", str(tmp_path / "all.mcap"), str(logs[0])]) == 0
    assert run(["log", "merge", str(tmp_path / "none.mcap")]) == 1
    assert "nothing to merge" in capsys.readouterr().err
    with Recording(tmp_path / "all.mcap") as log:
        assert log.columns("/device/state")["sequence"].tolist()[-1] == 79

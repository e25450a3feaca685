import json
import math
import re

import numpy as np
import pytest

from hm_driver.errors import RecordingError
from hm_driver.recording.schemas import DEVICE_CHANNELS
from hm_driver.recording.writer import LogWriter
from tools.cli.main import run
from tools.log.comparison import METRICS, Comparison, Line, Session, compare, mean_of, rows
from tools.log.comparison_page import draw


def session(name, group, error, *, lateness=math.nan):
    values = {metric.key: error for metric in METRICS} | {"lateness_p99_us": lateness}
    line = Line(np.array([0.0, 10.0, 20.0]), np.array([5.0, 4.0, error]))
    return Session(path=None, name=name, group=group, values=values, learning=line, control=line, border=line)


@pytest.fixture(scope="module")
def comparison():
    sessions = [session(f"a{one}", "method a", float(one)) for one in (1, 2, 3)]
    sessions += [session(f"b{one}", "method b", float(one)) for one in (7, 9)]
    return Comparison(by=("method",), sessions=tuple(sessions))


def test_an_interval_is_students(comparison):
    mean = mean_of([1.0, 2.0, 3.0, math.nan])
    assert mean == pytest.approx((2.0, 2.4841, 3), abs=1e-3)
    assert comparison.means("method a")["run_mean"] == pytest.approx(mean)


def test_one_session_has_no_interval_and_none_has_no_mean():
    one, none = mean_of([4.0]), mean_of([math.nan])
    assert (one.mean, one.n) == (4.0, 1)
    assert math.isnan(one.half)
    assert math.isnan(none.mean)


def test_the_table_has_a_column_for_each_group(comparison):
    table = dict(rows(comparison))
    assert table["sessions"] == ["3", "2"]
    assert table["error of the skill, plane [N]"] == ["2 ± 2.48", "8 ± 12.7"]
    assert table["lateness of the loop, 99 % [µs]"] == ["–", "–"]


def test_what_is_not_known_is_null_in_json(comparison):
    told = json.loads(json.dumps(comparison.as_dict(), allow_nan=False))
    assert told["groups"]["method a"]["lateness_p99_us"] == {"mean": None, "half": None, "n": 0}
    assert told["sessions"][0]["figures"]["run_mean"] == 1.0


def test_a_group_is_drawn_as_its_sessions_and_their_mean(comparison):
    learning, *_ = draw(comparison).axes
    assert [line.get_linewidth() for line in learning.get_lines()] == [0.8] * 3 + [2.2] + [0.8] * 2 + [2.2]
    mean = learning.get_lines()[3]
    assert mean.get_label() == "method a (3)"
    assert (mean.get_ydata()[0], mean.get_ydata()[-1]) == (5.0, 2.0)


@pytest.fixture(scope="module")
def logs(tmp_path_factory, write_session, short_options):
    directory = tmp_path_factory.mktemp("logs")
    return [
        write_session(directory / f"{seed}.mcap", options=short_options, seed=seed, stop_s=6.0)
        for seed in (1, 2)
    ]


def test_sessions_are_compared_from_their_logs_alone(logs, tmp_path, capsys):
    page = tmp_path / "compared.html"
    words = ["log", "compare", *map(str, logs), "--by", "device"]
    assert run([*words, "--output", str(page)]) == 0
    shown = capsys.readouterr().out
    assert shown.splitlines()[0].split() == ["device", "synthetic"]
    assert "±" in shown
    text = page.read_text(encoding="utf-8")
    assert "2 sessions compared by device" in text
    assert "How the skill grew" in text
    assert not re.search(r"<script|src=|href=\"http|url\(http", text)
    assert run([*words, "--output", str(page)]) == 1
    assert "exists already; give --force" in capsys.readouterr().err
    assert run(["log", "compare", *map(str, logs), "--output", str(tmp_path / "c.svg"), "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert [one["name"] for one in told["sessions"]] == ["1", "2"]
    assert all(one["figures"]["updates"] >= 1 for one in told["sessions"])
    assert (tmp_path / "c.svg").read_text().startswith("<?xml")


def test_what_cannot_be_compared_is_refused(logs, tmp_path):
    with pytest.raises(RecordingError, match="name two logs or more"):
        compare(logs[:1])
    with pytest.raises(RecordingError, match="is given twice"):
        compare([logs[0], logs[1], logs[0]])
    with pytest.raises(RecordingError, match="session record has no colour; it has version, seed, device"):
        compare(logs, by=["colour"])
    with LogWriter(tmp_path / "loop.mcap", DEVICE_CHANNELS):
        pass
    with pytest.raises(RecordingError, match="holds no teaching session"):
        compare([logs[0], tmp_path / "loop.mcap"])


def test_a_report_is_not_written_over_unless_it_is_told_to(logs, tmp_path, capsys):
    page = tmp_path / "page.html"
    words = ["log", "report", str(logs[0]), "--output", str(page)]
    assert run(words) == 0
    assert "Teaching session: " in page.read_text(encoding="utf-8")
    page.write_text("mine")
    assert run(words) == 1
    assert page.read_text() == "mine"
    assert run([*words, "--force"]) == 0
    assert page.read_text() != "mine"
    assert "exists already" in capsys.readouterr().err

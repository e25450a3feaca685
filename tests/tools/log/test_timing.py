import json

import oscillating_arm
import pytest
from log_bench import write

from hm_driver.errors import RecordingError
from hm_driver.recording.editing import cut
from hm_driver.recording.schemas import LOOP_TIMING, LOOP_TIMING_CHANNEL, Channel, FixedMessage
from hm_driver.recording.writer import LogWriter
from tools.cli.main import run
from tools.log.timing import analyse


def late(cycle):
    return 900_000 if cycle == 1500 else 10_000 + cycle


@pytest.fixture(scope="module")
def log(tmp_path_factory):
    return oscillating_arm.write(
        tmp_path_factory.mktemp("log") / "arm.mcap", seconds=2.0, late=late, lost={700, 701, 1800}
    )


def test_percentiles_are_those_of_the_cycles(log):
    found = analyse(log).percentiles
    assert set(found) == {"lateness", "response", "execution", "exchange"}
    assert found["lateness"].p50 == pytest.approx(11.0, abs=0.05)
    assert found["lateness"].max == 900.0
    assert found["response"].max == 1100.0
    assert (found["execution"].p50, found["exchange"].p99_9) == (200.0, 100.0)


def test_missed_periods_are_told_from_cycles_that_are_not_in_the_log(log, tmp_path):
    found = analyse(log)
    assert (found.cycles, found.missed, found.unlogged) == (1997, 3, 0)
    assert found.missed_at_s.tolist() == [0.702, 1.801]
    assert found.longest_gap_ms == pytest.approx(3.0)
    found = analyse(write(tmp_path / "lost.mcap", lost={50, 51, 120}))
    assert (found.cycles, found.missed, found.unlogged) == (297, 0, 3)


def test_rate_drift_and_the_latest_cycles_are_found(log):
    found = analyse(log)
    assert found.rate_hz == 1000.0
    assert found.drift_us_per_s == pytest.approx(1.0, rel=0.05)
    assert (found.worst[0].time_s, found.worst[0].lateness_us) == (1.5, 900.0)


def test_a_range_is_judged_alone(log):
    assert analyse(log, 0.0, 1.0).percentiles["lateness"].max < 12.0


def test_an_older_log_tells_what_it_has(tmp_path):
    older = FixedMessage("LoopTiming", "Before responses were logged.", LOOP_TIMING.fields[:3])
    timing = FixedMessage("LoopTiming", "Likewise.", (*older.fields, LOOP_TIMING.fields[6]))
    with LogWriter(tmp_path / "old.mcap", [Channel(3, LOOP_TIMING_CHANNEL.topic, timing)]) as writer:
        for cycle in range(10):
            writer.add(3, cycle * 1_000_000, timing.pack(cycle, cycle * 1_000_000, 5_000, 0))
    found = analyse(tmp_path / "old.mcap")
    assert list(found.percentiles) == ["lateness"]
    assert found.saturated == 0


def test_the_command_prints_draws_and_gives_json(log, tmp_path, capsys):
    picture = tmp_path / "timing.svg"
    assert run(["log", "timing", str(log), "--output", str(picture)]) == 0
    told = capsys.readouterr().out
    for part in (
        "missed periods     3 (0.15 %)",
        "lateness",
        "largest 900.0 µs",
        "900 µs at 1.500 s",
        "1000 Hz",
    ):
        assert part in told
    shown = picture.read_text()
    for part in (
        "Behind the grid [µs]",
        "Cycles that took longer [%]",
        "missed periods: 3",
        "response, largest",
    ):
        assert part in shown
    assert run(["log", "timing", str(log), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["percentiles_us"]["lateness"]["max"] == 900.0


def test_a_log_without_a_loop_says_what_it_has(log, tmp_path):
    cut(log, tmp_path / "state.mcap", topics=["/device/state"])
    with pytest.raises(RecordingError, match="no channel /loop/timing; there are: /device/state"):
        analyse(tmp_path / "state.mcap")

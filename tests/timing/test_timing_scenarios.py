"""Short versions of `hm jitter`, judged by what a noisy machine cannot break.

Other programs' real-time threads and stalls of the host move maxima by milliseconds, whoever they meet. The
median and the 90th percentile of the excess over a canary on the same CPU tell a good loop from a bad one all
the same: a loop that waits for an interpreter lock is late by milliseconds in every second cycle.
"""

import json

import pytest

from tools.cli.main import run
from tools.jitter.faulty import SLEEP_EVERY
from tools.jitter.options import ALL, JitterOptions, Load, parse_scenario
from tools.jitter.result import Run
from tools.jitter.rig import choose_cpus, device_of, run_scenario

pytestmark = pytest.mark.timing

RATE_HZ = 1000.0
PERIOD_US = 1e6 / RATE_HZ
ANY = ["--excess-p99.9", "1e9", "--excess-max", "1e9", "--own-missed", "1000000", "--drift", "1e9"]
"""Limits that any machine keeps."""


@pytest.fixture(scope="module")
def bench():
    """Options of a short run, an emulator and where things run."""
    options = JitterOptions(scenarios=(), rate_hz=RATE_HZ, duration_s=1.0)
    cpus = choose_cpus(None)
    with device_of(options, cpus) as url:
        yield options, url, cpus


def jitter(capsys, *words):
    """Run the command; its exit code and the one scenario of its JSON."""
    code = run(["jitter", "--json", "--duration", "1.5", *words])
    told = capsys.readouterr()
    assert told.out, told.err
    return code, json.loads(told.out)["scenarios"][0]


@pytest.mark.parametrize("name", [*Load, ALL])
def test_a_loop_in_a_process_of_its_own_is_punctual_beside(bench, name):
    options, url, cpus = bench
    result = run_scenario(parse_scenario(name), options, url, cpus)
    assert not result.problem
    assert result.has_identity
    assert result.window_cycles + result.window_missed == round(options.duration_s * RATE_HZ)
    assert len(result.loads) == len(parse_scenario(name).loads)
    assert not any("died" in text for text in result.loads)
    assert result.requests_per_cycle == pytest.approx(1.0, abs=0.01)
    deadlines = round(options.duration_s * RATE_HZ)
    held_up = max(result.canary_missed or 0, result.device_canary_missed or 0)
    if held_up > 0.02 * deadlines:
        pytest.skip(f"the machine stood still: a canary missed {held_up} of {deadlines} deadlines")
    if result.rung == "fifo" == result.canary_rung:  # else whoever shares the CPU may take it
        assert result.excess.p50 < 0.15 * PERIOD_US
        assert result.excess.p90 < 0.5 * PERIOD_US


def test_a_threaded_loop_beside_a_busy_thread_is_told_bad(capsys):
    code, result = jitter(capsys, "--loop", "thread", "--scenario", "spinner")
    assert code == 1
    assert result["excess"]["p50"] > 2.0 * PERIOD_US
    assert result["window_missed"] > 0.5 * 1.5 * RATE_HZ


def test_a_law_that_sleeps_now_and_then_is_told_bad(capsys):
    code, result = jitter(capsys, "--inject", "sleep", "--scenario", "none")
    assert code == 1
    assert result["own_missed"] >= 4
    cycles_apart = SLEEP_EVERY / RATE_HZ
    spans = {round((b - a) / cycles_apart, 1) for a in result["own_misses_s"] for b in result["own_misses_s"]}
    assert {1.0, 2.0} <= spans


def test_a_grid_of_relative_sleeps_is_told_bad(capsys):
    code, result = jitter(capsys, "--inject", "relative", "--scenario", "none")
    assert code == 1
    assert result["drift_us_per_s"] > 5000.0
    assert result["cycles"] + result["missed"] < result["grid_length"]


def test_a_good_loop_passes_and_leaves_run_report_and_trace(capsys, tmp_path):
    words = ["--scenario", "none", "--output", str(tmp_path / "out"), "--trace", str(tmp_path / "trace.json")]
    code, result = jitter(capsys, *words, *ANY)
    assert code == 0
    assert result["drift_us_per_s"] < 1000.0
    assert Run.load(tmp_path / "out" / "run.json").scenarios[0].cycles == result["cycles"]
    assert (tmp_path / "out" / "report.html").read_text().count("<svg") == 2
    events = json.loads((tmp_path / "trace.json").read_text())["traceEvents"]
    assert sum(event["name"] == "cycle" for event in events) >= 0.5 * result["window_cycles"]
    assert (
        run(["jitter", "compare", str(tmp_path / "out"), str(tmp_path / "out" / "run.json"), "--json"]) == 0
    )
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert {ratio for row in rows for ratio in row["ratios"].values()} == {1.0}


def test_a_loop_without_privileges_runs_and_says_what_it_was_refused(capsys):
    code, result = jitter(capsys, "--unprivileged", "--scenario", "none", *ANY)
    assert code in (0, 1)  # its median depends on what else the CPU runs
    assert result["rung"] == "slack"
    assert "SCHED_FIFO 80: Operation not permitted" in result["scheduling"]
    assert "nice -20" in result["scheduling"]
    assert "idle latency" not in result["scheduling"]
    assert result["cycles"] + result["missed"] == result["grid_length"]
    assert result["lateness"]["p50"] < PERIOD_US

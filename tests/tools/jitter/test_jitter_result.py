import json
import re
import xml.etree.ElementTree as ET

import pytest

from hm_driver.errors import ConfigurationError, LoopError
from hm_driver.realtime.trace import TracePoint
from tools.jitter import cyclictest
from tools.jitter.compare import compare_runs, print_comparison
from tools.jitter.options import Limits, Load, parse_scenario
from tools.jitter.page import render, save_comparison
from tools.jitter.perfetto import TraceFile
from tools.jitter.result import Run
from tools.jitter.table import print_run
from tools.jitter.verdict import judge

LIMITS = Limits()
HISTOGRAM = """# /dev/cpu_dma_latency set to 0us
# Histogram
000000 000000
000007 000150
000012 000049
000050 000001
# Total: 000000200
# Min Latencies: 00007
# Avg Latencies: 00008
# Max Latencies: 00050
# Histogram Overflows: 00000
"""


def bad(result, limits=LIMITS):
    return {check.name for check in judge(result, limits) if not check.passed}


def test_a_good_scenario_keeps_every_limit(make_scenario):
    assert bad(make_scenario()) == set()


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        (
            {"own_missed": 1, "window_missed": 1, "window_cycles": 1999},
            "deadlines missed that no canary missed",
        ),
        ({"drift_us_per_s": -1.6}, "drift beyond its resolution [µs/s]"),
        ({"cycles": 2498}, "cycles + missed - length of the grid"),
        ({"problem": "SafetyTrip: law: took 9 ms"}, "deadlines not measured"),
        ({"window_cycles": 1500}, "deadlines not measured"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_each_limit_can_fail(make_scenario, changes, name):
    assert bad(make_scenario(**changes)) == {name}


def test_the_excess_is_held_against_its_percentile_and_its_maximum(make_scenario, make_spread):
    seldom = make_scenario(excess=make_spread(18.0, tail_us=400.0))
    assert bad(seldom) == {"excess max [µs]"}
    assert bad(seldom, Limits(excess_max_us=None)) == set()
    assert bad(make_scenario(excess=make_spread(80.0))) == {"excess p99.9 [µs]"}


def test_without_privileges_the_median_is_limited(make_scenario):
    limits = Limits(lateness_p50_us=30.0)
    assert bad(make_scenario(), limits) == {"lateness p50 [µs]"}


def test_a_run_comes_back_from_its_file_as_it_was(make_run, make_scenario, tmp_path):
    run = make_run(make_scenario(), make_scenario("spinner", own_missed=3), cyclictest=True)
    run.save(tmp_path / "deep" / "run.json")
    assert Run.load(tmp_path / "deep" / "run.json") == run
    assert not run.has_passed


@pytest.mark.parametrize("text", ["", "{}", "[1]", '{"format": 99}', '{"format": 1, "scenarios": [{}]}'])
def test_a_file_that_is_no_run_is_refused_with_the_next_step(tmp_path, text):
    path = tmp_path / "run.json"
    path.write_text(text)
    with pytest.raises(ConfigurationError, match="is no run of hm jitter"):
        Run.load(path)


def test_a_run_that_cannot_be_written_says_which_option(make_run, tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(ConfigurationError, match="--output"):
        make_run().save(tmp_path / "file" / "run.json")


def test_loads_are_joined_by_a_plus_and_all_is_all_of_them():
    assert parse_scenario("spinner+recording").loads == (Load.SPINNER, Load.RECORDING)
    assert parse_scenario("none").loads == ()
    assert set(parse_scenario("all").loads) == set(Load) - {Load.NONE}


def test_an_unknown_load_is_refused_with_those_there_are():
    with pytest.raises(ConfigurationError, match=r"'gpu' is none of none, spinner, .*, all"):
        parse_scenario("spinner+gpu")


def test_the_page_holds_every_scenario_as_a_well_formed_picture(make_run, make_scenario):
    html = render(
        make_run(make_scenario(), make_scenario("gil+load", loads=("gil: 20 calls/s",)), cyclictest=True)
    )
    pictures = re.findall(r"<svg.*?</svg>", html, re.DOTALL)
    assert len(pictures) == 4
    for picture in pictures:
        ET.fromstring(picture)  # noqa: S314  # our own picture
    assert "All 12 limits were kept" in html
    assert "gil: 20 calls/s" in html
    assert "http://" not in re.sub(r'xmlns(:\w+)?="[^"]*"', "", html).replace("http://www.w3.org", "")


def test_the_page_says_which_limits_were_exceeded(make_run, make_scenario):
    html = render(make_run(make_scenario(own_missed=2)))
    assert "1 of 6 limits were exceeded" in html
    assert "deadlines missed that no canary missed: 2 where 0 is allowed" in html


def test_a_comparison_prints_ratios_and_what_else_differs(
    make_run, make_scenario, make_spread, capsys, tmp_path
):
    before = make_run(make_scenario(), make_scenario("gil"))
    after = make_run(make_scenario(excess=make_spread(36.0)), limits=Limits())
    comparison = compare_runs(before, after, names=("a", "b"))
    (excess,) = [row for row in comparison.rows if row.quantity == "excess"]
    assert excess.ratios["p50"] == pytest.approx(2.0, rel=0.05)
    assert comparison.only_once == ("gil",)
    print_comparison(comparison)
    told = capsys.readouterr().out
    assert "in one run alone: gil" in told
    assert re.search(r"none\s+excess\s+18\.\d -> 3\d\.\d\s+x[12]\.\d\d", told)
    save_comparison(comparison, tmp_path / "compare.html")
    assert "<svg" in (tmp_path / "compare.html").read_text()


def test_runs_without_a_scenario_in_common_cannot_be_drawn(make_run, make_scenario, tmp_path):
    comparison = compare_runs(make_run(make_scenario("gil")), make_run(make_scenario("gc")), names=("a", "b"))
    with pytest.raises(ConfigurationError, match="no scenario in common"):
        save_comparison(comparison, tmp_path / "compare.html")


def test_the_table_is_plain_without_a_terminal(make_run, capsys):
    print_run(make_run(cyclictest=True))
    told = capsys.readouterr().out
    assert "\x1b" not in told
    assert "excess over the canary" in told
    assert "cycles 2499 + missed 1 = 2500 of the grid" in told
    assert told.endswith("PASSED\n")


def test_the_histogram_of_cyclictest_is_read():
    spread = cyclictest.parse_histogram(HISTOGRAM)
    assert (spread.samples, spread.p50, spread.p99, spread.max) == (200, 7.0, 12.0, 50.0)


@pytest.mark.parametrize("text", ["", "# Total: 000000000\n# Max Latencies: 00000\n"])
def test_a_cyclictest_that_printed_nothing_is_an_error(text):
    with pytest.raises(LoopError, match="no histogram"):
        cyclictest.parse_histogram(text)


def test_a_missing_cyclictest_is_refused_with_the_command_that_installs_it(monkeypatch):
    monkeypatch.setenv("PATH", "")
    with pytest.raises(ConfigurationError, match="apt-get install rt-tests"):
        cyclictest.find_cyclictest()


def test_the_trace_is_one_of_trace_events_with_names_slices_counters_and_misses(tmp_path):
    trace = TraceFile(tmp_path / "trace.json")
    take = trace.begin("spinner")
    take(
        [
            TracePoint(0, 30_000, 250_000, 10_030_000, 150_000),
            TracePoint(3, 20_000, 200_000, 13_020_000, 140_000),
        ],
        [TracePoint(0, 12_000, 0, 10_012_000)],
    )
    trace.write()
    events = json.loads((tmp_path / "trace.json").read_text())["traceEvents"]
    by_phase = {phase: [event for event in events if event["ph"] == phase] for phase in "MXCi"}
    assert {event["args"]["name"] for event in by_phase["M"]} == {"scenario spinner", "loop", "canary"}
    cycle = next(event for event in by_phase["X"] if event["name"] == "cycle")
    exchange = next(event for event in by_phase["X"] if event["name"] == "exchange")
    assert (cycle["ts"], cycle["dur"]) == (10_030.0, 220.0)
    assert cycle["ts"] <= exchange["ts"] <= exchange["ts"] + exchange["dur"] <= cycle["ts"] + cycle["dur"]
    assert {event["name"] for event in by_phase["C"]} == {"lateness [µs]", "excess [µs]"}
    assert by_phase["i"][0]["args"] == {"periods": 2}
    assert all({"pid", "ts"} <= event.keys() for event in events if event["ph"] != "M")


def test_a_trace_that_cannot_be_written_says_which_option(tmp_path):
    with pytest.raises(ConfigurationError, match="--trace"):
        TraceFile(tmp_path).write()

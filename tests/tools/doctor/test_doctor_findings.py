import json
import os
from pathlib import Path

import pytest

from emulator.process import Emulator
from hm_driver.realtime.scheduling import Granted, Rung
from tools.cli.main import run
from tools.doctor import rights
from tools.doctor.finding import Finding, State
from tools.doctor.kernel import kernel_findings, steal_ticks
from tools.doctor.measurement import LinkMeasurement, Measurement, measure_link
from tools.doctor.rights import rights_findings
from tools.doctor.verdict import judge


def tree(root: Path, files: dict[str, str]) -> Path:
    for name, text in files.items():
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return root


def kernel(root: Path, files: dict[str, str]) -> dict[str, Finding]:
    return {finding.name: finding for finding in kernel_findings(tree(root, files))}


def test_on_a_machine_without_proc_and_sys_everything_is_unknown_and_nothing_raises(tmp_path):
    findings = [*kernel_findings(tmp_path), *rights_findings(tmp_path)]
    by_name = {finding.name: finding for finding in findings}
    for name in ("clock_source", "governor", "isolated", "rt_throttling", "virtualisation", "container"):
        assert by_name[name].state is State.UNKNOWN
        assert "not told here" in by_name[name].value
    assert by_name["rivals"].state is State.UNKNOWN
    assert steal_ticks(tmp_path) is None


@pytest.mark.parametrize(
    ("name", "file", "text", "state", "words"),
    [
        (
            "governor",
            "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor",
            "powersave\n",
            "note",
            "cpupower",
        ),
        ("governor", "sys/devices/system/cpu/cpu0/cpufreq/scaling_governor", "performance\n", "good", ""),
        ("isolated", "sys/devices/system/cpu/isolated", "2-3\n", "good", "timing.cpu=2"),
        ("virtualisation", "proc/cpuinfo", "flags : fpu hypervisor\n", "note", "real hardware"),
        ("virtualisation", "proc/cpuinfo", "flags : fpu vme\n", "good", ""),
        ("preemption", "sys/kernel/realtime", "1\n", "good", ""),
    ],
)
def test_each_file_of_the_kernel_has_its_finding(tmp_path, name, file, text, state, words):
    finding = kernel(tmp_path, {file: text})[name]
    assert (finding.state, words in finding.change) == (state, True)


def test_a_slow_clock_source_is_bad_and_the_change_is_a_command(tmp_path):
    directory = "sys/devices/system/clocksource/clocksource0"
    files = {
        f"{directory}/current_clocksource": "hpet",
        f"{directory}/available_clocksource": "tsc hpet acpi_pm",
    }
    finding = kernel(tmp_path, files)["clock_source"]
    assert finding.state is State.BAD
    assert finding.change == f"echo tsc > /{directory}/current_clocksource"


@pytest.mark.parametrize(
    ("runtime", "state"),
    [("950000", "good"), ("-1", "note"), ("500000", "bad")],
    ids=["usual", "off", "short"],
)
def test_real_time_throttling_is_judged_by_its_share(tmp_path, runtime, state):
    files = {f"proc/sys/kernel/sched_rt_{name}_us": value for name, value in
             (("runtime", runtime), ("period", "1000000"))}  # fmt: skip
    assert kernel(tmp_path, files)["rt_throttling"].state == state


def test_the_cpu_limit_of_a_container_is_found_under_both_cgroup_versions(tmp_path):
    second = kernel(
        tmp_path / "v2",
        {"proc/self/cgroup": "0::/box\n", "sys/fs/cgroup/box/cpu.max": "50000 100000", ".dockerenv": ""},
    )["container"]
    assert (second.state, second.value) == (State.BAD, "a container, cpu.max 0.5 CPUs")
    first = kernel(
        tmp_path / "v1",
        {"proc/self/cgroup": "1:cpu,cpuacct:/box\n", "sys/fs/cgroup/cpu/box/cpu.rt_runtime_us": "0"},
    )["container"]
    assert "cpu.rt_runtime_us 0" in first.value


def test_files_with_other_words_than_expected_do_no_harm(tmp_path):
    files = {"proc/stat": "cpu 1 2\n", "proc/self/cgroup": "nonsense\n", "proc/self/status": "CapEff:\tff\n"}
    names = [
        finding.name for finding in (*kernel_findings(tree(tmp_path, files)), *rights_findings(tmp_path))
    ]
    assert len(names) == len(set(names)) == 15
    assert steal_ticks(tmp_path) is None


def test_a_refused_ladder_is_bad_and_names_the_limits_file(tmp_path, monkeypatch):
    granted = Granted(
        rung=Rung.SLACK, priority=0, refusals=("SCHED_FIFO 80: Operation not permitted",), cpu=None,
        rttime_us=None, dma_latency_held=False,
    )  # fmt: skip
    monkeypatch.setattr(rights, "try_ladder", lambda: granted)
    finding = next(finding for finding in rights_findings(tmp_path) if finding.name == "scheduling")
    assert finding.state is State.BAD
    assert "Operation not permitted" in finding.value
    assert "rtprio 99" in finding.change


@pytest.mark.skipif(not hasattr(os, "sched_getscheduler"), reason="this platform has no scheduling policies")
def test_trying_the_ladder_leaves_the_calling_thread_as_it_was():
    before = os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)
    rights.try_ladder()
    assert (os.sched_getscheduler(0), os.getpriority(os.PRIO_PROCESS, 0)) == before


def verdict_of(make_scenario, steal=None, link=None, **changes):
    return judge((), Measurement(result=make_scenario(**changes), steal=steal), link, rate_hz=1000.0)


def test_a_good_measurement_can_hold_the_rate(make_scenario):
    verdict = verdict_of(make_scenario)
    assert verdict.can_hold
    assert "can hold 1 kHz with real-time scheduling" in verdict.text
    assert "No period of 2000 was missed" in verdict.text


def test_cycles_that_are_too_long_cannot_and_the_rate_that_fits_is_named(make_scenario, make_spread):
    verdict = verdict_of(make_scenario, response=make_spread(1500.0))
    assert not verdict.can_hold
    assert "because its cycles take too long" in verdict.text
    assert "Hz would fit" in verdict.text


def test_misses_that_the_canary_had_too_are_the_machines(make_scenario):
    verdict = verdict_of(make_scenario, window_cycles=1960, window_missed=40, own_missed=0, steal=0.2)
    assert verdict.can_hold
    assert "The machine itself stalled: 40 of 2000 periods" in verdict.text
    assert "took 20% of the CPUs' time" in verdict.text


def test_misses_of_the_loop_alone_cannot(make_scenario):
    verdict = verdict_of(make_scenario, window_cycles=1900, window_missed=100, own_missed=100)
    assert not verdict.can_hold
    assert "missed 100 of 2000 periods that the canary beside it did not" in verdict.text


def test_a_slow_link_cannot_hold_the_rate(make_scenario, make_spread):
    link = LinkMeasurement(
        url="tcp://robot", dialect="text", is_combined=False, state="stop", exchanges=100,
        round_trip=make_spread(3000.0),
    )  # fmt: skip
    verdict = verdict_of(make_scenario, link=link)
    assert not verdict.can_hold
    assert "The link to tcp://robot cannot hold 1 kHz" in verdict.text


def test_what_is_bad_is_to_be_changed_before_what_is_noted():
    findings = tuple(
        Finding(name=state, title=state, value="", state=state, change="do it")
        for state in (State.NOTE, State.GOOD, State.BAD)
    )
    verdict = judge(findings, None, None, rate_hz=1000.0)
    assert verdict.changes == ("bad: do it", "note: do it")
    assert not verdict.can_hold


@pytest.fixture(scope="module")
def url():
    with Emulator(init_seconds=0.1, realtime=False) as emulator:
        yield emulator.url


def test_the_round_trip_of_a_link_is_measured_without_changing_the_device(url):
    link = measure_link(url, exchanges=50)
    assert (link.dialect, link.is_combined, link.exchanges, link.round_trip.samples) == ("text", True, 50, 50)
    assert 0.0 < link.round_trip.p50 <= link.round_trip.p99 <= link.round_trip.max
    assert measure_link(f"{url}?dialect=framed", exchanges=1).dialect == "framed"
    assert measure_link(url, exchanges=1).state == link.state


def test_the_command_tells_all_as_json(url, capsys):
    code = run(["doctor", "--seconds", "0", "--device", url, "--exchanges", "20", "--json"])
    told = json.loads(capsys.readouterr().out)
    assert code == (0 if told["can_hold"] else 1)
    assert told["measurement"] is None
    assert told["link"]["exchanges"] == 20
    assert {"scheduling", "timer_slack", "governor", "isolated", "rt_throttling", "container", "memory_lock",
            "rttime_limit", "rtprio_limit", "cpu_dma_latency", "clock_source", "preemption",
            "virtualisation"} <= {finding["name"] for finding in told["findings"]}  # fmt: skip


@pytest.mark.timing
def test_the_command_measures_and_gives_a_verdict_in_words(capsys):
    code = run(["doctor", "--seconds", "1"])
    told = capsys.readouterr().out
    assert code in (0, 1)
    assert ("This machine can hold 1 kHz" in told) == (code == 0)
    assert "steal" in told
    assert "wake lateness" in told


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--rate", "5000"], "5000 Hz is outside 100 to 2500 Hz"),
        (["--seconds", "0.5"], "0.5 s is outside 1 to 3600 s"),
        (["--exchanges", "0"], "0 is outside 1 to 100000"),
        (["--device", "ftp://x"], "ftp"),
    ],
)
def test_what_is_out_of_range_is_refused_before_anything_starts(capsys, words, message):
    assert run(["doctor", *words]) == 2
    told = capsys.readouterr().err
    assert message in told
    assert "Traceback" not in told


def test_a_device_that_is_not_there_is_an_error_of_the_link(capsys):
    assert run(["doctor", "--seconds", "0", "--device", "tcp://127.0.0.1:1"]) == 3
    assert "127.0.0.1:1" in capsys.readouterr().err

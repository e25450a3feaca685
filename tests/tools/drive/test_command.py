import io
import json
import signal
import subprocess
import sys
from typing import NamedTuple

import pytest

import hm_driver.recording
from hm_driver.protocol.vocabulary import State
from tools.cli.main import run

HM = [sys.executable, "-m", "tools.cli.main", "drive"]
PATIENT = ["missed_s=0", "freeze_s=2", "heartbeat_s=2", "exchange_timeout_s=2"]


class Outcome(NamedTuple):
    """What a command line came to."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def hm(emulator, capsys, monkeypatch):
    """A function that runs ``hm drive`` on the emulator to its end."""

    def execute(*words, lines="", device=emulator.url, world=emulator.world_url):
        command = ["drive", *words]
        command += ["--device", device] if device else []
        command += ["--world", world] if device and world else []
        for setting in PATIENT:
            command += ["--set", f"watch.{setting}"]
        monkeypatch.setattr(sys, "stdin", io.StringIO(lines))
        code = run(command)
        return Outcome(code, *capsys.readouterr())

    return execute


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["goto", "1", "2"], "goto: Z is missing"),
        (["jog", "x", "0.1", "--speed", "7"], "jog --speed: 7 m/s is out of range: 0.001 to 0.25 m/s"),
        (["levitate"], "levitate: unknown word"),
        (["hold", "--set", "motion.speed=3"], "speed: 3 is outside 0.001 to speed_max"),
        (["hold", "--device", "nonsense"], "'nonsense' is no URL"),
    ],
)
def test_a_wrong_command_line_starts_nothing(capsys, words, told):
    assert run(["drive", *words]) == 2
    errors = capsys.readouterr().err
    assert told in errors
    assert "emulator" not in errors
    assert "Traceback" not in errors


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--help"], "goto X Y Z [--speed V]"),
        (["--help"], "--yes-real-robot"),
        (["help"], "goto X Y Z [--speed V]"),
        (["goto", "--help"], "0.001 to 0.25 m/s"),
        (["help", "set"], "raw COMMAND ..."),
        (["effect", "types", "spring"], "Stiffness: a number 0 to 100000 N/m"),
    ],
)
def test_help_needs_no_device(capsys, words, told):
    assert run(["drive", *words]) == 0
    assert told in capsys.readouterr().out


def test_one_command_moves_the_arm_and_leaves_it_stopped(hm, observer):
    outcome = hm("goto", "0.01", "-0.02", "0.01", "--speed", "0.2")
    assert outcome.returncode == 0, outcome.stderr
    assert "mm from the goal" in outcome.stdout
    assert observer.state is State.STOP
    assert observer.measured_position() == pytest.approx((0.01, -0.02, 0.01), abs=0.003)


def test_the_state_is_told_as_json_without_commanding_anything(hm, observer):
    observer.set_state(State.OFF)
    told = json.loads(hm("state", "--once", "--json").stdout)
    assert told["state"] == "off"
    assert told["mode"] is None
    assert len(told["position_m"]) == 3
    assert observer.state is State.OFF


def test_an_own_emulator_is_started_without_a_device(hm):
    outcome = hm("get", "state", device=None)
    assert outcome.stdout == "off\n"


def test_lines_from_a_pipe_end_at_the_first_failure_with_its_exit_code(hm, observer, tmp_path):
    log = tmp_path / "drive.mcap"
    outcome = hm(
        "--record",
        str(log),
        lines="# to a point\nhold\njog z 0.01; state --once --json\nset nothing\ngoto 0 0 0\n",
    )
    assert outcome.returncode == 2
    assert "line 4: set nothing; nothing behind it was carried out" in outcome.stderr
    state = json.loads(next(line for line in outcome.stdout.splitlines() if line.startswith("{")))
    assert state["mode"] == {"x": "position", "y": "position", "z": "position"}
    assert state["recording"] == str(log)
    assert 500.0 < state["rate_hz"] <= 1010.0
    assert observer.state is State.STOP
    with hm_driver.recording.open(log) as recording:
        assert not recording.damage
        assert recording.counts["/events"] == 4


@pytest.mark.parametrize("words", [[], ["state --json; get state"]])
def test_a_state_with_commands_behind_it_is_shown_once_and_they_are_carried_out(hm, observer, words):
    observer.set_state(State.STOP)
    outcome = hm(*words, lines="" if words else "state --json\nget state\n")
    assert outcome.returncode == 0, outcome.stderr
    looks, answer = outcome.stdout.splitlines()
    assert json.loads(looks)["state"] == answer == "stop"


def test_what_the_device_refuses_to_the_user_gives_exit_code_1_and_says_why(hm):
    outcome = hm("get", "measpoz")
    assert outcome.returncode == 1
    assert "the device refused 'get measpoz': --- ERROR" in outcome.stderr
    assert "did you mean measpos" in outcome.stderr


def test_a_device_that_cannot_be_reached_gives_exit_code_3(hm):
    outcome = hm("get", "state", device="tcp://127.0.0.1:1", world=None)
    assert outcome.returncode == 3
    assert "no connection to 127.0.0.1:1" in outcome.stderr


def test_a_trajectory_is_checked_run_and_judged(hm, tmp_path):
    path = tmp_path / "line.csv"
    path.write_text("time_s,x,y,z\n0,0,0,0\n0.5,0.02,0,0\n1,0,0,0\n")
    assert "3 points, 1.00 s; the arm can follow it" in hm("run", str(path), "--check").stdout
    outcome = hm("run", str(path), "--within", "0.00002", "--json", "--speed", "0.2")
    summary = json.loads(outcome.stdout)
    assert outcome.returncode == 1
    assert "allowed were 0.02 mm" in outcome.stderr
    assert 0.00002 < summary["error_max_m"] < 0.003
    path.write_text("time_s,x,y,z\n0,0,0,0\n0.5,0.9,0,0\n")
    assert hm("run", str(path)).returncode == 2


def test_what_may_be_a_robot_is_asked_freely_and_commanded_only_when_confirmed(
    hm, tmp_path, observer, monkeypatch
):
    observer.set_state(State.OFF)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert hm("get", "os", world=None).stdout == "Linux\n"
    refused = hm("goto", "0", "0", "0", world=None)
    assert refused.returncode == 2
    assert "nobody confirmed its first run: --yes-real-robot" in refused.stderr
    assert observer.state is State.OFF
    fast = hm("goto", "0", "0", "0", "--speed", "0.2", "--yes-real-robot", world=None)
    assert fast.returncode == 2
    assert "goto --speed: 0.2 m/s is above 0.05 m/s, the limit of this run" in fast.stderr
    assert observer.state is State.OFF


def test_a_signal_ends_a_hold_with_the_arm_stopped(emulator, observer):
    process = subprocess.Popen(
        [
            *HM,
            "hold",
            "--device",
            emulator.url,
            "--world",
            emulator.world_url,
            "--set",
            "watch.heartbeat_s=2",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "x y z held\n"
    assert observer.state is State.FORCE
    process.send_signal(signal.SIGTERM)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130
    assert "Traceback" not in errors
    assert observer.state is State.STOP

import json
import os
import pty
import signal
import subprocess
import sys
import time

import pytest
from cyclopts import App

from hm_driver import errors
from hm_driver.version import __version__
from tools.cli.console import write_json, write_table
from tools.cli.failures import ExitCode, exit_code, show_failure
from tools.cli.main import run

HM = [sys.executable, "-m", "tools.cli.main"]
CODES = [
    (errors.ConfigurationError("learner.w_gen", "1.5 is outside 0 to 1", source="hm.toml"), 2),
    (errors.TransportError("no route"), 3),
    (errors.TransportTimeout("no reply within 50 ms"), 3),
    (errors.TransportClosed("the device closed the link"), 3),
    (errors.ProtocolError("not a vector", received="x"), 3),
    (errors.DeviceError("set state force", "--- ERROR: not calibrated"), 3),
    (errors.DeviceFault("the device left state force"), 3),
    (errors.SafetyTrip("force", "85 N exceeds 80 N"), 3),
    (errors.LoopError("the loop process died"), 3),
    (errors.RecordingError("the disk is full"), 1),
    (OSError(28, "No space left on device"), 1),
    (RuntimeError("a defect"), 1),
    (KeyboardInterrupt(), 130),
]


@pytest.fixture
def failing():
    """An application whose command raises what it is given."""

    def build(error):
        app = App(name="hm", result_action="return_value", suppress_keyboard_interrupt=False)

        @app.command
        def fail():
            raise error

        return app

    return build


@pytest.mark.parametrize(("error", "code"), CODES, ids=lambda value: type(value).__name__)
def test_each_error_has_its_exit_code_and_no_traceback(failing, capsys, error, code):
    assert run(["fail"], failing(error)) == code
    told = capsys.readouterr()
    assert told.out == ""
    assert "Traceback" not in told.err
    assert told.err.startswith("hm: ")
    assert str(error) in told.err


def test_debug_shows_the_traceback_and_keeps_the_exit_code(failing, capsys):
    assert run(["fail", "--debug"], failing(errors.LoopError("died"))) == 3
    assert "Traceback" in capsys.readouterr().err


def test_notes_that_an_error_gathered_are_told_with_it(capsys):
    error = errors.LoopError("died")
    error.add_note("the log is complete:\n/tmp/session.mcap")
    show_failure(error)
    assert capsys.readouterr().err == "hm: error: died\n    the log is complete:\n    /tmp/session.mcap\n"


def test_an_unforeseen_error_is_called_a_defect(capsys):
    show_failure(ZeroDivisionError("division by zero"))
    assert "ZeroDivisionError: division by zero\n    this is a defect" in capsys.readouterr().err


def test_brackets_in_a_message_are_not_taken_for_markup(capsys):
    show_failure(errors.ProtocolError("got [1,2,3] and [/bold]"))
    assert "got [1,2,3] and [/bold]" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("result", "code"), [(None, 0), (0, 0), (1, 1), (True, 1), (ExitCode.FAILED, 1), ("text", 0)]
)
def test_what_a_command_returns_is_its_exit_code(result, code):
    app = App(name="hm", result_action="return_value")
    app.command(lambda: result, name="go")
    assert run(["go"], app) == code


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["tech"], 'Did you mean "teach"?'),
        (["config", "shw"], "see: hm config --help"),
        (["config", "show", "--sett", "a=1"], "Did you mean --set?"),
        (
            ["config", "show", "--set", "learner.w_gne=1"],
            "learner.w_gne: no such key; did you mean learner.w_gen?",
        ),
        (["config", "show", "--set", "learner"], "key=value"),
        (["config", "show", "--config", "missing.toml"], "missing.toml: file: cannot be read"),
        (["log", "report"], "hm log report --help"),
    ],
)
def test_a_wrong_command_line_is_refused_with_code_2_and_a_hint(capsys, words, told):
    assert run(words) == ExitCode.USAGE
    assert told in capsys.readouterr().err


def test_config_show_prints_a_file_that_gives_the_same_configuration(tmp_path, capsys):
    assert run(["config", "show", "--set", "learner.w_gen=0.7"]) == 0
    first = capsys.readouterr().out
    assert "w_gen = 0.7  # [command line]" in first
    path = tmp_path / "hm.toml"
    path.write_text(first)
    assert run(["config", "show", "--config", str(path), "--json"]) == 0
    shown = json.loads(capsys.readouterr().out)
    assert shown["values"]["learner"]["w_gen"] == 0.7
    assert shown["sources"]["learner.w_gen"] == str(path)


def test_help_and_version_need_none_of_the_heavy_packages():
    script = (
        "import sys; from tools.cli.main import application, run\n"
        "assert run(['--help']) == 0 and run(['--version']) == 0\n"
        "heavy = {'numpy', 'numba', 'scipy', 'matplotlib', 'mcap', 'google.protobuf', 'can', 'serial'}\n"
        "sys.exit(' '.join(heavy & set(sys.modules)) or 0)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", script], capture_output=True, text=True, timeout=60, check=False
    )
    assert done.stderr == ""
    assert done.returncode == 0
    assert done.stdout.splitlines()[-1] == f"hm {__version__}"


def test_the_help_of_a_command_is_its_docstring_and_the_list_has_one_line_each(capsys):
    assert run(["config", "show", "--help"]) == 0
    assert "Behind each value stands what it means" in capsys.readouterr().out
    assert run(["config", "--help"]) == 0
    assert "Behind each value" not in capsys.readouterr().out


def test_every_command_names_itself_in_the_help(capsys):
    assert run(["--help"]) == 0
    shown = capsys.readouterr().out
    for command in ("teach", "emulate", "config", "log", "--version"):
        assert command in shown


def test_colour_is_used_on_a_terminal_alone_and_not_against_the_users_wish():
    def told(environment, *, terminal):
        controller, stream = pty.openpty()
        target = stream if terminal else subprocess.PIPE
        done = subprocess.run(
            [*HM, "config", "shw"], stderr=target, env=os.environ | environment, timeout=60, check=False
        )
        data = os.read(controller, 4096) if terminal else done.stderr
        os.close(controller)
        os.close(stream)
        assert done.returncode == 2
        return data

    base = {"TERM": "xterm-256color"}
    assert b"\x1b[" in told(base, terminal=True)
    assert b"\x1b[31m" not in told(base | {"NO_COLOR": "1"}, terminal=True)
    assert b"\x1b" not in told(base, terminal=False)


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_request_to_end_unwinds_the_command_and_returns_130(ending):
    script = (
        "import sys, time; from cyclopts import App; from tools.cli import main\n"
        "def wait():\n"
        "    try:\n"
        "        print('waiting', flush=True); time.sleep(60)\n"
        "    finally:\n"
        "        print('stopped', flush=True)\n"
        "def application():\n"
        "    app = App(suppress_keyboard_interrupt=False, result_action='return_value')\n"
        "    app.default(wait)\n"
        "    return app\n"
        "main.application = lambda words: application()\n"
        "sys.argv = ['hm']\n"
        "main.main()\n"
    )
    process = subprocess.Popen(
        [sys.executable, "-c", script], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    assert process.stdout.readline() == "waiting\n"
    time.sleep(0.05)
    process.send_signal(ending)
    out, err = process.communicate(timeout=30)
    assert (process.returncode, out, err) == (130, "stopped\n", "hm: interrupted\n")


def test_a_reader_that_went_away_is_no_error_worth_a_word():
    done = subprocess.run(
        ["/bin/sh", "-c", f"{sys.executable} -m tools.cli.main config show | true"],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.stderr == ""


def test_the_codes_of_the_table_are_those_of_the_enumeration():
    assert [exit_code(error) for error, _ in CODES] == [code for _, code in CODES]
    assert {int(code) for code in ExitCode} == {0, 1, 2, 3, 130}


def test_json_is_one_line_and_never_holds_what_json_cannot_say(capsys):
    write_json({"a": 1, "b": None})
    assert capsys.readouterr().out == '{"a": 1, "b": null}\n'
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json({"a": float("nan")})


def test_a_table_is_aligned(capsys):
    write_table([("a", "1"), ("long", "2")])
    assert capsys.readouterr().out == "a     1\nlong  2\n"

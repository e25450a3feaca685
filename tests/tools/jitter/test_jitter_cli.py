import os
import signal
import subprocess
import sys
import time

import pytest

from tools.cli.main import run
from tools.jitter.result import Run


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--rate", "50"], "50 Hz is outside 100 to 2500 Hz"),
        (["--duration", "0.1"], "0.1 s is outside 1 to 86400 s"),
        (["--scenario", "gpu"], "'gpu' is none of none, spinner"),
        (["--cpu", "4096"], "4096 is none of the CPUs"),
        (["--spin", "0.9"], "outside 0 to 0.5"),
        (["--loop", "thread", "--unprivileged"], "thread is judged as it is"),
        (["--excess-max", "-1"], "must be positive"),
        (["--cyclictest", "--slices", "0"], "0 is outside 1 to 1000"),
        (["--world", "tcp://127.0.0.1:1"], "give that too"),
        (["--output", os.devnull], "--output"),
        (["--trace", "/"], "--trace"),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_what_is_wrong_is_refused_before_anything_starts(capsys, monkeypatch, tmp_path, words, message):
    program = tmp_path / "cyclictest"
    program.touch(mode=0o755)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    assert run(["jitter", *words]) == 2
    told = capsys.readouterr()
    assert message in told.err.replace("\n", " ")
    assert "scenario" not in told.err.partition("hm: error")[0]
    assert "Traceback" not in told.err


def test_a_file_that_is_no_run_cannot_be_compared(capsys, tmp_path):
    (tmp_path / "run.json").write_text("{}")
    assert run(["jitter", "compare", str(tmp_path), str(tmp_path)]) == 2
    assert "is no run of hm jitter" in capsys.readouterr().err


def interrupted_after(seconds, output):
    """Exit code and standard output of a soak that is interrupted so many seconds after it began to start."""
    command = [sys.executable, "-m", "tools.cli.main", "jitter", "--soak", "--scenario", "none", "--output"]
    pipe = subprocess.PIPE
    with subprocess.Popen([*command, str(output)], stdout=pipe, stderr=pipe, text=True) as process:  # ours
        while "scenario none" not in process.stderr.readline():
            pass
        time.sleep(seconds)
        process.send_signal(signal.SIGINT)
        told, _ = process.communicate(timeout=60)
    return process.returncode, told


@pytest.mark.timing
def test_a_run_that_is_interrupted_keeps_what_was_measured(tmp_path):
    for seconds in (4.0, 12.0, 36.0):  # a busy machine takes its time to start everything
        code, told = interrupted_after(seconds, tmp_path)
        if code != 130:
            break
    assert code == 1
    assert "interrupted" in told
    (result,) = Run.load(tmp_path / "run.json").scenarios
    assert result.problem == "interrupted"

"""The examples, run as a user runs them."""

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from emulator.process import Emulator

ROOT = Path(__file__).parents[2]


_NOTHING = (0.0, 0.0, 0.0)
PUSH = {"position": _NOTHING, "stiffness": _NOTHING, "damping": (30.0,) * 3, "force": (0.0, 0.0, 4.0)}


@pytest.fixture(scope="module")
def emulator():
    with Emulator(init_seconds=0.3) as emulator:
        yield emulator


def patient(source):
    """A program of ours with time-outs that a busy machine does not reach, and nothing else changed."""
    watch = "watch=WatchOptions(heartbeat_s=5.0, exchange_timeout_s=2.0, freeze_s=5.0, missed_s=0.0), "
    changed = source.replace("import LoopOptions", "import LoopOptions, WatchOptions")
    changed = changed.replace("LoopOptions(url=", f"LoopOptions({watch}url=")
    assert changed.count("WatchOptions") == 2
    return changed


def run(name, *arguments):
    done = subprocess.run(  # our own example
        [sys.executable, str(ROOT / "examples" / name), *arguments],
        capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    return done.stdout


def test_hold_moves_the_arm_and_holds_it(emulator):
    told = run("hold.py", emulator.url)
    assert re.match(r"text dialect; z \d\.\d+ m, the hand pushed -?0\.\d+ N", told)


def test_the_control_law_lets_the_arm_move_inside_its_box_and_holds_it_at_the_wall(emulator, tmp_path):
    program = tmp_path / "control_law.py"
    program.write_text(patient((ROOT / "examples" / "control_law.py").read_text(encoding="utf-8")))
    with emulator.connect_world() as world:
        start = world.observe().position
        command = [sys.executable, str(program), emulator.url, "3"]
        process = subprocess.Popen(  # our own example
            command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        while world.observe().state != "force" and process.poll() is None:
            time.sleep(0.01)
        time.sleep(0.3)
        world.exchange(PUSH)
        time.sleep(1.5)
        reached = world.observe().position[2] - start[2]
        world.release()
        told, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert 0.009 < reached < 0.013
    assert "cycles" in told


def blocks(document, start):
    text = (ROOT / document).read_text(encoding="utf-8")
    return [block for block in re.findall(r"```python\n(.*?)```", text, flags=re.DOTALL) if start in block]


def test_the_readme_s_first_lines_from_python_run(capsys):
    (block,) = blocks("README.md", "hm_driver.connect")
    assert len(block.strip().splitlines()) <= 10
    execute(block.replace("tcp://127.0.0.1:7654", "sim://?init_seconds=0.2"), "README.md")
    assert capsys.readouterr().out


def test_the_client_of_the_driver_s_page_runs(capsys):
    (block,) = blocks("docs/driver.md", "hm_driver.connect")
    assert len(block.strip().splitlines()) <= 10
    execute(block.replace("tcp://127.0.0.1:7654", "sim://?init_seconds=0.2"), "driver.md")
    assert "Measurement(position=" in capsys.readouterr().out


def test_the_loop_of_the_driver_s_page_moves_the_arm(emulator, tmp_path):
    (block,) = blocks("docs/driver.md", "LoopProcess(")
    program = tmp_path / "loop.py"
    program.write_text(patient(block.replace("tcp://127.0.0.1:7654", emulator.url)))
    with emulator.connect_world() as world:
        before = world.observe().position[2]
        done = subprocess.run(  # what the page tells users to run
            [sys.executable, str(program)], capture_output=True, text=True, timeout=120, check=False
        )
        moved = world.observe().position[2] - before
    assert done.stderr == ""
    assert moved == pytest.approx(0.03, abs=5e-3)


def execute(source, name):
    exec(compile(source, name, "exec"), {})  # noqa: S102  # what a document tells users to run

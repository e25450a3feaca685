"""The examples, run as a user runs them."""

import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from emulator.process import Emulator

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def emulator():
    with Emulator(init_seconds=0.3) as emulator:
        yield emulator


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


def test_the_control_law_lets_the_arm_move_inside_its_box_and_holds_it_at_the_wall(emulator):
    with emulator.connect_world() as world:
        start = world.observe().position
        process = subprocess.Popen(  # our own example
            [sys.executable, str(ROOT / "examples" / "control_law.py"), emulator.url, "3"],
            stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        )  # fmt: skip
        while world.observe().state != "force":
            assert process.poll() is None, process.stderr.read()
            time.sleep(0.01)
        time.sleep(0.3)
        nothing = (0.0, 0.0, 0.0)
        world.exchange(
            {"position": nothing, "stiffness": nothing, "damping": (30.0,) * 3, "force": (0.0, 0.0, 4.0)}
        )
        time.sleep(1.5)
        reached = world.observe().position[2] - start[2]
        world.release()
        told, errors = process.communicate(timeout=60)
    assert process.returncode == 0, errors
    assert 0.009 < reached < 0.013
    assert "cycles" in told


def test_the_readme_s_first_lines_from_python_run(capsys):
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(import hm_driver\n.*?)```", text, flags=re.DOTALL)
    assert blocks
    assert len(blocks[0].strip().splitlines()) <= 10
    exec(compile(blocks[0].replace("tcp://127.0.0.1:7654", "sim://?init_seconds=0.2"), "README.md", "exec"))  # noqa: S102  # what the README tells users to run
    assert capsys.readouterr().out

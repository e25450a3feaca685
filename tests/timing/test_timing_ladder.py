"""The fallback of the scheduling ladder where the kernel itself refuses real-time priorities to root."""

import contextlib
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from emulator.process import Emulator

CPU_GROUP = Path("/sys/fs/cgroup/cpu")


@pytest.fixture
def group():
    """A cpu cgroup without a share of real time, in which root gets EPERM for SCHED_FIFO."""
    path = CPU_GROUP / f"hm-test-{os.getpid()}"
    try:
        path.mkdir()
    except OSError as error:
        pytest.skip(f"no cpu cgroup can be made here: {error.strerror}")
    try:
        budget = path / "cpu.rt_runtime_us"
        if not budget.exists() or budget.read_text().strip() != "0":
            pytest.skip("this kernel does not share out real time by cgroup")
        yield path
    finally:
        with contextlib.suppress(OSError):
            path.rmdir()


LOOP = """
import json, sys
from hm_driver.realtime.options import LoopOptions, WatchOptions
from hm_driver.realtime.process import LoopProcess
watch = WatchOptions(heartbeat_s=30.0, exchange_timeout_s=5.0, freeze_s=30.0, missed_s=0.0)
with LoopProcess(LoopOptions(url=sys.argv[1], watch=watch, has_guardian=False)) as loop:
    loop.start()
    while loop.state().cycle < 50.0:
        loop.check()
    loop.request_stop()
    loop.wait(30.0)
    print(json.dumps(loop.result().as_dict()))
"""
DOCTOR = "import sys; from tools.cli.main import run; sys.exit(run(['doctor', '--seconds', '0', '--json']))"


def in_group(group, program, *arguments):
    """Run a Python program whose process, and all that it starts, is in the group."""
    enter = f"import os; open('{group}/cgroup.procs', 'w').write(str(os.getpid()))\n"
    words = [sys.executable, "-c", enter + program, *arguments]
    return subprocess.run(words, capture_output=True, text=True, timeout=100, check=False)  # ours


@pytest.mark.timing
def test_a_loop_that_is_refused_real_time_scheduling_runs_one_rung_below(group):
    with Emulator(init_seconds=0.1) as emulator:
        done = in_group(group, LOOP, emulator.url)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["rung"] == "nice"
    assert "SCHED_FIFO 80: Operation not permitted" in result["scheduling"]
    assert result["status"] == "stopped"
    assert result["cycles"] + result["missed"] == result["grid_length"] >= 50


def test_the_doctor_says_that_the_cgroup_is_in_the_way(group):
    done = in_group(group, DOCTOR)
    assert done.returncode == 1, done.stderr
    told = json.loads(done.stdout)
    findings = {finding["name"]: finding for finding in told["findings"]}
    assert findings["scheduling"]["state"] == "bad"
    assert "SCHED_FIFO 80: Operation not permitted" in findings["scheduling"]["value"]
    assert "cpu.rt_runtime_us 0" in findings["container"]["value"]
    assert not told["can_hold"]

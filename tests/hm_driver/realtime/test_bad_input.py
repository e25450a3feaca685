"""What a user may get wrong, and what the machine may lack: refused or survived, with a clear message."""

import os
import signal
import subprocess
import sys
import time

import pytest

from hm_driver.errors import ConfigurationError, LoopError, SafetyTrip
from hm_driver.realtime.options import LoopOptions, TimingOptions, WatchOptions
from hm_driver.realtime.process import LoopProcess
from hm_driver.realtime.shared import shared_directory

PATIENT = WatchOptions(heartbeat_s=2.0, exchange_timeout_s=1.0, freeze_s=2.0, missed_s=5.0)

SCRIPT = """
import sys, time
from hm_driver.errors import HapticMasterError
from hm_driver.realtime.options import LoopOptions, TimingOptions, WatchOptions
from hm_driver.realtime.process import LoopProcess
{before}
watch = WatchOptions(heartbeat_s=2.0, exchange_timeout_s=1.0, freeze_s=2.0, missed_s=5.0)
options = LoopOptions(url=sys.argv[1], watch=watch, timing=TimingOptions({timing}))
try:
    with LoopProcess(options) as loop:
        loop.start()
        print(loop.pid, flush=True)
        {during}
    print(loop.result().status.name, loop.result().spun_s)
except HapticMasterError as error:
    print(type(error).__name__, error)
"""
"""A script as a user writes one: without the guard that children of ``multiprocessing`` need."""


def start(directory, url, *, before="", timing="", during="time.sleep(0.2)"):
    program = directory / "users_script.py"
    program.write_text(SCRIPT.format(before=before, timing=timing, during=during))
    return subprocess.Popen(  # our own program
        [sys.executable, str(program), url],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def run(directory, url, **parts):
    told, errors = start(directory, url, **parts).communicate(timeout=60)
    assert errors == ""
    return told.splitlines()


@pytest.mark.parametrize("rate_hz", [99.0, 2501.0, float("nan")])
def test_a_rate_out_of_range_is_refused(rate_hz):
    with pytest.raises(ConfigurationError, match="100 to 2500 Hz"):
        TimingOptions(rate_hz=rate_hz)


def test_a_script_without_a_main_guard_starts_loop_and_guardian_once(device, tmp_path):
    told = run(tmp_path, device.url)
    assert len(told) == 2  # a child that ran the script again would print again
    assert told[1].startswith("STOPPED")


def test_a_device_that_is_too_slow_for_the_rate_trips_and_says_so(device):
    device.control("delay_s", argument=0.004)
    watch = WatchOptions(heartbeat_s=2.0, exchange_timeout_s=1.0, freeze_s=2.0, missed_s=0.05)
    with LoopProcess(LoopOptions(url=device.url, watch=watch)) as loop:
        loop.start()
        with pytest.raises(SafetyTrip, match="lower the rate") as caught:
            wait_for_the_end(loop)
    assert caught.value.reason == "deadline"


def wait_for_the_end(loop):
    deadline = time.monotonic() + 20.0
    while time.monotonic() < deadline:
        loop.check()
        time.sleep(0.005)
    pytest.fail("nothing tripped")


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give up capabilities"
)
def test_real_time_that_is_required_and_not_allowed_is_refused_and_the_device_left_stopped(device, tmp_path):
    before = "import ctypes\nfor c in (23, 24): ctypes.CDLL(None).prctl(24, c, 0, 0, 0)"
    (told,) = run(tmp_path, device.url, before=before, timing="require_realtime=True")
    assert told.startswith("LoopError real-time scheduling is required")
    assert "RLIMIT_RTPRIO" in told
    assert device.log("set state")[-1][0] == "set state stop"


def test_with_a_short_rttime_limit_the_loop_runs_and_does_not_spin(device, tmp_path):
    before = "import resource\nresource.setrlimit(15, (15_000, 15_000))"  # RLIMIT_RTTIME on Linux
    status, spun_s = run(tmp_path, device.url, before=before)[1].split()
    assert status == "STOPPED"
    assert float(spun_s) == 0.0


def test_two_programs_on_one_device_are_kept_apart(device, tmp_path):
    first = start(tmp_path, device.url, during="sys.stdin.readline()")
    try:
        first.stdout.readline()
        second = LoopProcess(LoopOptions(url=device.url, watch=PATIENT))
        with second, pytest.raises(LoopError, match=r"another loop \(process \d+\) drives .* already"):
            second.start()
    finally:
        first.kill()
        first.communicate()


def test_what_a_killed_program_leaves_behind_disturbs_no_later_one(device, tmp_path):
    first = start(tmp_path, device.url, during="sys.stdin.readline()")
    loop_pid = int(first.stdout.readline())
    for pid in (loop_pid, first.pid):
        os.kill(pid, signal.SIGKILL)
    first.communicate()
    with LoopProcess(LoopOptions(url=device.url, watch=PATIENT)) as loop:
        loop.start()
        loop.check()
    left = [path.name for path in shared_directory().glob(f"hapticmaster-{first.pid}-*")]
    assert left == []

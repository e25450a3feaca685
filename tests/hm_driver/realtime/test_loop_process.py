import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest

from hm_driver.errors import (
    ConfigurationError,
    DeviceError,
    DeviceFault,
    LoopError,
    ProtocolError,
    SafetyTrip,
    TransportError,
    TransportTimeout,
)
from hm_driver.realtime.failure import decode_error, encode_error
from hm_driver.realtime.options import LoopOptions, TimingOptions, WatchOptions
from hm_driver.realtime.process import LoopProcess, LoopThread
from hm_driver.realtime.segment import GuardianStatus, Status, Trip
from hm_driver.realtime.setpoint import SetPoint

PATIENT = WatchOptions(heartbeat_s=2.0, exchange_timeout_s=1.0, freeze_s=2.0, missed_s=5.0)
"""Time-outs that a busy machine does not reach."""


def run_ticks(loop, ticks, *, engage_z=1.0):
    for tick in range(1, ticks + 1):
        loop.publish(SetPoint(sequence=float(tick), engage_z=engage_z, target_z=0.005))
        loop.check()
        time.sleep(0.01)


def wait_until_it_trips(loop, timeout_s=5.0):
    deadline = time.monotonic() + timeout_s
    while time.monotonic() < deadline:
        loop.heartbeat()
        try:
            loop.check()
        except SafetyTrip as trip:
            return trip
        time.sleep(0.002)
    return pytest.fail("nothing tripped")


@pytest.mark.parametrize("kind", [LoopProcess, LoopThread])
def test_a_loop_brings_the_device_up_runs_and_leaves_it_stopped(device, kind):
    with kind(LoopOptions(url=device.url, watch=PATIENT)) as loop:
        loop.start()
        assert loop.status is Status.RUNNING
        run_ticks(loop, 30)
        assert loop.state().engaged_z == 1.0
    result = loop.result()
    assert result.status is Status.STOPPED
    assert result.cycles + result.missed == result.grid_length
    assert result.requests == result.cycles
    assert (result.dialect, result.is_combined, result.stops_sent) == ("text", True, 1)
    assert result.guardian.status is GuardianStatus.ENDED
    assert result.response.samples == result.cycles
    commands = [command for command, _ in device.log()]
    assert commands[-2:] == ["set state stop", "remove all"]
    assert commands.count("set state stop") == 1
    assert "create spring spring_z" in commands


@pytest.mark.parametrize("kind", [LoopProcess, LoopThread])
def test_a_loop_that_has_started_knows_where_the_arm_is(device, kind):
    with kind(LoopOptions(url=device.url, watch=PATIENT, timing=TimingOptions(rate_hz=100.0))) as loop:
        loop.start()
        state = loop.state()
        assert state.cycle >= 1.0
        assert state.time_ns > 0.0


def test_a_framed_device_gets_one_command_a_request(framed_device):
    timing = TimingOptions(rate_hz=200.0)
    with LoopProcess(LoopOptions(url=framed_device.url, watch=PATIENT, timing=timing)) as loop:
        loop.start()
        run_ticks(loop, 20, engage_z=0.0)
    result = loop.result()
    assert (result.dialect, result.is_combined) == ("framed", False)
    assert 3.0 <= result.requests_per_cycle < 4.5


def test_the_loop_s_process_imports_the_standard_library_and_the_driver_alone(device):
    with LoopProcess(LoopOptions(url=device.url, watch=PATIENT)) as loop:
        loop.start()
        maps = Path(f"/proc/{loop.pid}/maps")
        mapped = maps.read_text() if maps.exists() else ""
    assert not [name for name in ("numpy", "numba", "scipy", "google") if name in mapped]
    code = (
        "import sys, hm_driver.realtime.loop_main, hm_driver.realtime.guardian;"
        "print(*sorted({name.partition('.')[0] for name in sys.modules} - set(sys.stdlib_module_names)))"
    )
    command = [sys.executable, "-c", code]
    names = subprocess.run(command, capture_output=True, text=True, check=True).stdout.split()  # ours
    assert "hm_driver" in names
    assert not set(names) & {"numpy", "numba", "google", "mcap", "scipy", "matplotlib"}


WITHOUT_PRIVILEGE = """
import ctypes, sys, time
from hm_driver.realtime.options import LoopOptions, WatchOptions
from hm_driver.realtime.process import LoopProcess
libc = ctypes.CDLL(None)
for capability in (14, 23, 24):  # lock memory, nice and scheduling, resources: gone for every child
    libc.prctl(24, capability, 0, 0, 0)
watch = WatchOptions(heartbeat_s=2.0, exchange_timeout_s=1.0, freeze_s=2.0, missed_s=5.0)
with LoopProcess(LoopOptions(url=sys.argv[1], watch=watch)) as loop:
    loop.start()
    time.sleep(0.2)
result = loop.result()
print(result.status.name, result.rung, result.scheduling, sep="|")
"""


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give up capabilities"
)
def test_without_privilege_the_loop_runs_and_says_so(device):
    command = [sys.executable, "-c", WITHOUT_PRIVILEGE, device.url]
    told = subprocess.run(command, capture_output=True, text=True, check=True, timeout=30).stdout  # ours
    status, rung, scheduling = told.strip().split("|")
    assert (status, rung) == ("STOPPED", "slack")
    assert "SCHED_FIFO 80: Operation not permitted" in scheduling


def test_nothing_that_listens_is_a_transport_error():
    with LoopProcess(LoopOptions(url="tcp://127.0.0.1:1")) as loop, pytest.raises(TransportError):
        loop.start()


def test_a_device_that_never_leaves_init_is_a_fault_and_is_stopped(device):
    device.control("calibrated", argument=False)
    device.control("init_ends", argument=False)
    with (
        LoopProcess(LoopOptions(url=device.url, init_timeout_s=0.2)) as loop,
        pytest.raises(DeviceFault, match="init"),
    ):
        loop.start()
    assert device.log("set state")[-1][0] == "set state stop"


def test_a_pushed_emergency_button_is_a_fault(device):
    device.control("button", argument=True)
    with LoopProcess(LoopOptions(url=device.url)) as loop, pytest.raises(DeviceFault, match="button"):
        loop.start()


def test_a_refused_command_is_a_device_error_with_command_and_reply(device):
    device.control("refused", "create biasforce")
    with LoopProcess(LoopOptions(url=device.url)) as loop, pytest.raises(DeviceError) as caught:
        loop.start()
    assert caught.value.command == "create biasforce feedback"


def test_a_law_that_cannot_be_loaded_is_refused_before_the_device_is_touched(device):
    options = LoopOptions(url=device.url, law="nowhere:Law")
    with LoopProcess(options) as loop, pytest.raises(ConfigurationError, match="nowhere"):
        loop.start()
    assert device.log() == []


def test_a_second_loop_on_the_same_device_is_refused(device):
    options = LoopOptions(url=device.url, watch=PATIENT)
    with LoopProcess(options) as first:
        first.start()
        with LoopProcess(options) as second, pytest.raises(LoopError, match="another loop"):
            second.start()
        first.check()
        assert first.status is Status.RUNNING


def test_a_limit_stops_the_device_within_20_ms_once(device, floor):
    with LoopProcess(LoopOptions(url=device.url, watch=PATIENT)) as loop:
        loop.start()
        run_ticks(loop, 30)
        device.control("measforce", [0.0, 0.0, 200.0])
        assert wait_until_it_trips(loop).reason == "force"
    result = loop.result()
    assert result.trip is Trip.FORCE
    assert result.stop_latency_s <= floor.allows(0.02)
    assert len(device.times_of("set state stop")) == 1


def test_a_silent_application_is_noticed_and_the_device_stopped_within_100_ms(device, floor):
    watch = replace(PATIENT, heartbeat_s=0.06)
    with LoopProcess(LoopOptions(url=device.url, watch=watch)) as loop:
        loop.start()
        loop.heartbeat()
        last_ns = time.monotonic_ns()
        loop.wait(5.0)
        with pytest.raises(SafetyTrip, match="silent"):
            loop.check()
    stopped = device.times_of("set state stop")
    assert len(stopped) == 1, loop.result()
    assert (stopped[0] - last_ns) * 1e-9 <= floor.allows(0.1)


def test_the_result_of_a_killed_loop_tells_that_the_guardian_stopped_the_device(device):
    with LoopProcess(LoopOptions(url=device.url, watch=PATIENT)) as loop:
        loop.start()
        run_ticks(loop, 10)
        os.kill(loop.pid, signal.SIGKILL)
        device.wait_for("set state stop")
        assert wait_until_it_trips(loop).reason == "loop_lost"
    result = loop.result()
    assert result.guardian.status is GuardianStatus.STOPPED_DEVICE
    assert result.status is Status.TRIPPED
    assert 0.0 < result.stop_latency_s <= 1.0


def test_a_device_that_no_longer_answers_the_loop_is_stopped_by_the_guardian(device, floor):
    with LoopProcess(
        LoopOptions(url=device.url, watch=replace(PATIENT, exchange_timeout_s=0.05, freeze_s=0.06))
    ) as loop:
        loop.start()
        run_ticks(loop, 10)
        struck_ns = time.monotonic_ns()
        device.control("silent", argument=True)
        assert wait_until_it_trips(loop).reason in {"link", "loop_lost"}  # on a busy machine who is first
        stopped = device.wait_for("set state stop")
    assert (stopped[0] - struck_ns) * 1e-9 <= floor.allows(0.1)


def test_a_device_that_sends_stale_data_is_stopped_within_100_ms(device, floor):
    with LoopProcess(LoopOptions(url=device.url, watch=PATIENT)) as loop:
        loop.start()
        run_ticks(loop, 10)
        struck_ns = time.monotonic_ns()
        device.control("stale", argument=True)
        error = wait_until_it_trips(loop)
    assert (error.reason, "stale" in error.detail) == ("device", True)
    stopped = device.times_of("set state stop")
    assert len(stopped) == 1
    assert (stopped[0] - struck_ns) * 1e-9 <= floor.allows(0.1)


def test_a_link_that_is_cut_is_said_to_be_beyond_our_reach(device):
    with LoopProcess(LoopOptions(url=device.url, watch=PATIENT)) as loop:
        loop.start()
        run_ticks(loop, 5)
        device.cut()
        assert wait_until_it_trips(loop).reason == "link"
    assert loop.result().guardian.status is GuardianStatus.FAILED


APPLICATION = """
import sys, time
from hm_driver.realtime.options import LoopOptions, WatchOptions
from hm_driver.realtime.process import LoopProcess
from hm_driver.realtime.setpoint import SetPoint
if __name__ == "__main__":
    watch = WatchOptions(heartbeat_s=2.0, exchange_timeout_s=1.0, freeze_s=2.0, missed_s=5.0)
    with LoopProcess(LoopOptions(url=sys.argv[1], watch=watch)) as loop:
        loop.start()
        print(loop.pid, flush=True)
        tick = 0
        while True:
            tick += 1
            loop.publish(SetPoint(sequence=float(tick), engage_z=1.0, target_z=0.005))
            time.sleep(0.01)
"""


def test_nothing_is_left_running_behind_a_killed_application(device, tmp_path):
    program = tmp_path / "application.py"
    program.write_text(APPLICATION)
    command = [sys.executable, str(program), device.url]
    application = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)  # ours
    try:
        loop_pid = int(application.stdout.readline())
        time.sleep(0.1)
    finally:
        application.kill()
        application.wait()
        application.stdout.close()
    device.wait_for("set state stop")
    deadline = time.monotonic() + 5.0
    while Path(f"/proc/{loop_pid}").exists() and time.monotonic() < deadline:
        time.sleep(0.01)
    assert not Path(f"/proc/{loop_pid}").exists()


def test_a_terminated_loop_ends_gently(device):
    with LoopProcess(LoopOptions(url=device.url, watch=PATIENT)) as loop:
        loop.start()
        os.kill(loop.pid, signal.SIGTERM)
        assert loop.wait(5.0) is Status.STOPPED


@pytest.mark.parametrize(
    "error",
    [
        ConfigurationError("rate_hz", "too high"),
        DeviceError("set state force", "--- ERROR"),
        SafetyTrip("force", "too much"),
        DeviceFault("no"),
        TransportError("gone"),
        TransportTimeout("late", command="get state", received="sto"),
        ProtocolError("odd", command="get state", received="what"),
    ],
)
def test_an_error_crosses_from_process_to_process(error):
    decoded = decode_error(*encode_error(error))
    assert type(decoded) is type(error)
    assert str(decoded) == str(error)
    assert vars(decoded) == vars(error)


def test_an_unknown_error_becomes_a_loop_error():
    assert isinstance(decode_error("Exception", "what"), LoopError)
    assert isinstance(decode_error("", ""), LoopError)

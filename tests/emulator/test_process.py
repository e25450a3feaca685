import json
import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from emulator import Emulator, EmulatorOptions
from emulator.scheduling import schedule_realtime
from hm_driver.errors import ConfigurationError


def is_running(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def wait_until(condition, timeout=10.0):
    deadline = time.monotonic() + timeout
    while not condition():
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_the_process_ends_with_the_block_and_close_may_be_called_twice():
    with Emulator() as emulator:
        pid = emulator.pid
        assert emulator.url.startswith("tcp://127.0.0.1:")
        assert emulator.world_url != emulator.url
        assert emulator.is_alive
    assert not is_running(pid)
    emulator.close()


def test_the_process_ends_when_its_parent_is_killed(tmp_path):
    script = tmp_path / "parent.py"
    script.write_text(
        "import sys, time\nfrom emulator import Emulator\n"
        "emulator = Emulator()\nemulator.start()\n"
        "sys.stdout.write(f'{emulator.pid}\\n'); sys.stdout.flush()\ntime.sleep(60)\n",
        encoding="utf-8",
    )
    with subprocess.Popen([sys.executable, str(script)], stdout=subprocess.PIPE, text=True) as parent:
        pid = int(parent.stdout.readline())
        parent.kill()
    wait_until(lambda: not is_running(pid))


def test_a_taken_port_is_told_with_the_option_and_the_next_step():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        url = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        emulator = Emulator(listen=url)
        with pytest.raises(ConfigurationError, match=r"listen: .*in use.*port 0") as refusal:
            emulator.start()
        assert refusal.value.field == "listen"
        assert not emulator.is_alive


def test_an_unknown_constant_of_the_arm_is_told_with_its_file(tmp_path):
    config = tmp_path / "my_arm.toml"
    config.write_text("[geometry]\nr00 = 0.5\n", encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"my_arm.toml.*r00"):
        Emulator(config=config).start()


@pytest.mark.parametrize(
    "options",
    [
        {"listen": "localhost"},
        {"listen": "udp://127.0.0.1:1"},
        {"listen": "tcp://127.0.0.1:99999"},
        {"world": "tcp://"},
        {"speed": 0.0},
        {"init_seconds": -1.0},
        {"on_client_lost": "explode"},
        {"lag": 3},
    ],
)
def test_an_impossible_option_is_refused_by_its_name(options):
    with pytest.raises(ConfigurationError, match=next(iter(options))):
        Emulator(**options)


def test_options_survive_their_way_to_the_process(tmp_path):
    options = EmulatorOptions(seed=7, log=tmp_path / "log", speed=0.5, lockstep=True)
    assert EmulatorOptions.from_json(options.to_json()) == options


def test_the_conversation_is_logged_and_the_status_told(start_emulator, tmp_path, connect):
    messages = []
    log = tmp_path / "conversation.jsonl"
    emulator = start_emulator(log=log, on_message=messages.append)
    client = connect(emulator)
    client.ask("get os")
    client.ask("get nonsense")
    client.close()
    wait_until(lambda: any("status" in message for message in messages))
    wait_until(lambda: log.read_text(encoding="utf-8").count("\n") >= 6)
    entries = [json.loads(line) for line in log.read_text(encoding="utf-8").splitlines()]
    assert [entry["direction"] for entry in entries] == ["+", ">", "<", ">", "<", "-"]
    assert entries[1]["text"] == "get os"
    assert entries[2]["text"] == "Linux;"
    assert "--- ERROR" in entries[4]["text"]
    assert emulator.status["state"] == "off"


def test_the_device_runs_at_another_speed(start_emulator):
    emulator = start_emulator(speed=5.0)
    with emulator.connect_world() as world:
        first, start = world.observe(), time.monotonic()
        time.sleep(0.5)
        last, elapsed = world.observe(), time.monotonic() - start
    lost = 0.1 + 5 * 4e-4 * (last.missed - first.missed)
    assert last.time_s - first.time_s == pytest.approx(5.0 * elapsed, abs=lost)


def test_the_fixtures_of_the_plugin_start_an_emulator(
    hapticmaster, lockstep_hapticmaster, device_url, connect
):
    assert device_url == hapticmaster.url
    assert connect(hapticmaster).ask("get state") == "off;"
    assert lockstep_hapticmaster.handle(b"get state\n") == b"off;\n"


def test_scheduling_says_what_was_granted_and_what_not():
    code = (
        "from emulator.scheduling import schedule_realtime\nimport gc, sys\n"
        "granted = schedule_realtime(lock_memory=False)\n"
        "sys.stdout.write(f'{granted}|{gc.isenabled()}')\n"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    granted, _, collects = told.partition("|")
    assert granted.startswith(("fifo 79", "nice -20", "plain"))
    assert collects == "False"
    assert schedule_realtime.__module__ == "emulator.scheduling"


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give up being root")
def test_without_privilege_the_ladder_ends_on_a_lower_rung_and_says_why():
    code = (
        "import os, resource, sys\nfrom emulator.scheduling import schedule_realtime\n"
        "resource.setrlimit(resource.RLIMIT_RTPRIO, (0, 0))\n"
        "resource.setrlimit(resource.RLIMIT_NICE, (0, 0))\n"
        "os.setuid(65534)\nsys.stdout.write(str(schedule_realtime(lock_memory=False)))\n"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert told.startswith("plain")
    assert "refused: SCHED_FIFO" in told


@pytest.mark.parametrize("ending", [signal.SIGINT, signal.SIGTERM])
def test_the_command_names_its_addresses_and_ends_cleanly(ending):
    command = [sys.executable, "-m", "tools.cli.main", "emulate", "--listen", "tcp://127.0.0.1:0"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        device, world = process.stdout.readline().strip(), process.stdout.readline().strip()
        assert device.startswith("tcp://127.0.0.1:")
        assert world.startswith("tcp://127.0.0.1:")
        process.send_signal(ending)
        rest, told = process.communicate(timeout=20)
    assert process.returncode == 130
    assert rest == ""
    assert "Traceback" not in told


def test_the_command_tells_a_taken_port_by_exit_code_2():
    with socket.create_server(("127.0.0.1", 0)) as taken:
        url = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        command = [sys.executable, "-m", "tools.cli.main", "emulate", "--listen", url]
        done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "in use" in done.stderr
    assert "Traceback" not in done.stderr

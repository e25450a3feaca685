"""The emulator's grid, judged against a canary that sleeps to the same deadlines and does nothing."""

import re
import signal
import subprocess
import sys
import time

import pytest

from emulator.canary import Canary


@pytest.mark.timing
def test_periods_are_missed_only_where_the_machine_misses_them_too(start_emulator, connect):
    emulator = start_emulator(init_seconds=0.2)
    client = connect(emulator)
    client.ask("set state init")
    client.wait_for_state("stop")
    client.ask("set state force")
    with emulator.connect_world() as world, Canary() as canary:
        before, ticks, missed = world.observe(), canary.ticks, canary.missed
        time.sleep(3.0)
        after, ticks, missed = world.observe(), canary.ticks - ticks, canary.missed - missed
    assert ticks + missed == pytest.approx(7500, abs=1000)
    share = missed / (ticks + missed)
    emulated_share = (after.missed - before.missed) / (
        after.step - before.step + after.missed - before.missed
    )
    assert emulated_share < 3.0 * share + 0.05


@pytest.mark.timing
def test_ticks_and_missed_periods_make_up_the_length_of_the_grid(start_emulator):
    statuses = []
    start_emulator(on_message=lambda message: statuses.append(message["status"]))
    while len(statuses) < 3:
        time.sleep(0.05)
    first, last = statuses[1], statuses[2]
    periods = last["ticks"] + last["missed"] - first["ticks"] - first["missed"]
    given_up = last["given_up"] - first["given_up"]
    assert periods == pytest.approx((last["time_s"] - first["time_s"]) * 2500 + given_up, abs=1)


def test_a_canary_ends_with_its_block_and_close_may_be_called_twice():
    with Canary() as canary:
        process = canary._process
        assert canary.ticks >= 1
    canary.close()
    assert process.returncode == 0


def test_the_status_line_tells_how_many_periods_a_canary_missed():
    command = [sys.executable, "-m", "tools.cli.main", "emulate", "--listen", "tcp://127.0.0.1:0", "--canary"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        line = ""
        while process.poll() is None and "missed periods" not in line:
            line = process.stderr.readline()
        process.send_signal(signal.SIGINT)
        process.communicate(timeout=20)
    assert re.search(r"\d+ missed periods \(canary \d+\)", line)

"""The emulator's grid, judged against a canary that sleeps to the same deadlines and does nothing."""

import subprocess
import sys
import time

import pytest

CANARY = """
import select, sys, time
from emulator.grid import TickGrid
from emulator.scheduling import schedule_realtime
schedule_realtime(priority=80)
grid = TickGrid(start_ns=time.monotonic_ns())
end = time.monotonic_ns() + 3_000_000_000
while time.monotonic_ns() < end:
    select.select((), (), (), max(0.0, (grid.next_ns - time.monotonic_ns()) * 1e-9))
    grid.take_due(time.monotonic_ns())
sys.stdout.write(f"{grid.ticks} {grid.missed}")
"""


@pytest.mark.timing
def test_periods_are_missed_only_where_the_machine_misses_them_too(start_emulator, connect):
    emulator = start_emulator(init_seconds=0.2)
    client = connect(emulator)
    client.ask("set state init")
    client.wait_for_state("stop")
    client.ask("set state force")
    with emulator.connect_world() as world:
        before = world.observe()
        told = subprocess.run(
            [sys.executable, "-c", CANARY], capture_output=True, text=True, check=True
        ).stdout
        after = world.observe()
    ticks, missed = (int(word) for word in told.split())
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

import os
import signal
import time

import pytest

from hm_driver.errors import TransportClosed, TransportTimeout
from teaching.hands.contract import HandIntent
from tools.run.hands import LONGEST_SILENCE_NS, RemoteWorld

INTENT = HandIntent((0.0, 0.0, 0.05), (0.0, 0.0, 0.0), (500.0, 500.0, 500.0), (30.0, 30.0, 30.0))


@pytest.fixture
def emulator(start_emulator):
    return start_emulator(init_seconds=0.2)


def felt_of(world, count, *, intent=INTENT):
    """Ticks the world until it has told of the first `count` intents."""
    felt, ticks, limit = [], 0, time.monotonic() + 20.0
    while len(felt) < count and time.monotonic() < limit:
        felt += world.move(ticks * 10_000_000, intent)
        ticks += 1
        time.sleep(0.001)
    return felt


def test_each_intent_is_told_with_what_it_met_and_its_own_time(emulator):
    with emulator.connect_world() as client:
        felt = felt_of(RemoteWorld(client), 20)
        assert [each.time_ns for each in felt[:20]] == [n * 10_000_000 for n in range(20)]
        assert {each.intent for each in felt} == {INTENT}
        assert any(abs(force) > 0.01 for force in felt[-1].hand_force)


def test_a_stopped_emulator_does_not_hold_up_a_tick_and_is_told_of_when_it_stays_silent(emulator):
    with emulator.connect_world() as client:
        world = RemoteWorld(client)
        felt_of(world, 3)
        os.kill(emulator.pid, signal.SIGSTOP)
        try:
            spent = time.thread_time()
            began = time.monotonic()
            for n in range(100):
                world.move(n * 10_000_000, INTENT)
            assert time.monotonic() - began < 1.0 + (time.thread_time() - spent)
            with pytest.raises(TransportTimeout, match="has not answered for 2 s"):
                world.move(LONGEST_SILENCE_NS + 10**10, INTENT)
        finally:
            os.kill(emulator.pid, signal.SIGCONT)
        assert len(felt_of(world, 50)) >= 50


def test_a_question_after_unread_replies_gets_its_own_answer(emulator):
    with emulator.connect_world() as client:
        for _ in range(5):
            client.begin(None)
        first = client.observe()
        assert client.observe().time_s >= first.time_s
        assert client.finished() == []


def test_an_emulator_that_ends_is_a_closed_connection(emulator):
    with emulator.connect_world() as client:
        world = RemoteWorld(client)
        felt_of(world, 1)
        emulator.close()
        with pytest.raises(TransportClosed, match="world endpoint"):
            felt_of(world, 10**6)

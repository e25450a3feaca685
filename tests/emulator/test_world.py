import json
import socket
import time
from urllib.parse import urlsplit

import pytest

from emulator.in_process import LockstepEmulator
from emulator.world import Truth, WorldClient, WorldError
from hm_driver.errors import ConfigurationError, TransportError

HAND = {"position": [0.0, 0.0, 0.05], "stiffness": [500.0] * 3, "damping": [30.0] * 3}


@pytest.fixture(params=["in process", "socket"])
def world(request, start_emulator):
    """The same world, in this process and over a socket; `world.pass_time(seconds)` lets time pass."""
    if request.param == "in process":
        emulator = LockstepEmulator(init_seconds=0.2)
        world = emulator.world
        clock = [0]

        def pass_time(seconds):
            clock[0] += round(seconds * 1e9)
            emulator.advance_to_ns(clock[0])

        yield world, pass_time, lambda text: emulator.handle(text.encode() + b"\n").decode()[:-1]
    else:
        process = start_emulator(lockstep=True, init_seconds=0.2)
        parts = urlsplit(process.url)
        with (
            process.connect_world() as client,
            socket.create_connection((parts.hostname, parts.port), timeout=5.0) as link,
        ):

            def ask(text):
                link.sendall(text.encode() + b"\n")
                return link.recv(4096).decode()[:-1]

            yield client, client.advance, ask


def test_a_hand_moves_the_unpowered_arm(world):
    world, pass_time, _ = world
    world.exchange(HAND)
    before = world.observe()
    for _ in range(200):
        world.exchange(HAND)
        pass_time(0.01)
    after = world.observe()
    assert isinstance(after, Truth)
    assert abs(after.position[2] - 0.05) < abs(before.position[2] - 0.05)
    assert after.time_s == pytest.approx(2.0)


def test_in_force_the_hand_feels_the_virtual_mass_and_lets_go(world):
    world, pass_time, ask = world
    ask("set state init")
    pass_time(3.0)
    assert ask("set state force") == "state set to 'force';"
    for _ in range(300):
        truth = world.exchange(HAND)
        pass_time(0.01)
    assert truth.position[2] == pytest.approx(0.05, abs=2e-3)
    assert truth.state == "force"
    world.release()
    pass_time(0.2)
    assert world.observe().hand_force == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("hand", "named"),
    [
        ({"position": [0, 0, 0]}, "stiffness"),
        (HAND | {"position": [0, 0]}, "three numbers"),
        (HAND | {"position": [0, 0, 5]}, "-2 to 2"),
        (HAND | {"stiffness": [-1, 0, 0]}, "0 to"),
        (HAND | {"position": ["a", 0, 0]}, "three numbers"),
        (HAND | {"position": 3}, "three numbers"),
        (HAND | {"grip": [0, 0, 0]}, "position, velocity"),
    ],
)
def test_a_malformed_hand_is_refused_with_what_is_accepted(world, hand, named):
    world, _, _ = world
    with pytest.raises(WorldError, match=named):
        world.exchange(hand)


def test_faults_are_injected_and_cleared(world):
    world, pass_time, ask = world
    assert world.inject("emergency_button", duration_s=0.5).faults == ("emergency_button",)
    assert ask("get emergencybuttonpushed; get emergencyrelay") == "true;false;"
    pass_time(0.6)
    assert world.observe().faults == ()
    assert ask("get emergencybuttonpushed; get emergencyrelay") == "false;true;"
    world.inject("force_bias", value=(0.0, 0.0, 5.0))
    assert world.clear_faults().faults == ()
    with pytest.raises(WorldError, match="accepted: reply_delay"):
        world.inject("gremlins")


@pytest.fixture(scope="module")
def link():
    from emulator import Emulator

    with Emulator() as emulator:
        parts = urlsplit(emulator.world_url)
        with socket.create_connection((parts.hostname, parts.port), timeout=5.0) as link:
            yield link


@pytest.mark.parametrize(
    ("line", "named"),
    [
        (b"hello", "one JSON object"),
        (b"[1,2]", "no JSON object"),
        (b"{", "one JSON object"),
        (b"\xff\xfe", "one JSON object"),
        (b"[" * 3000, "one JSON object"),
        (b'{"hans": 1}', "hand, advance_s, fault"),
        (b'{"hand": 1}', "position"),
        (b'{"hand": {"position": [NaN,0,0], "stiffness": [0,0,0], "damping": [0,0,0]}}', "three numbers"),
        (b'{"hand": {"position": [true,0,0], "stiffness": [0,0,0], "damping": [0,0,0]}}', "three numbers"),
        (b'{"advance_s": 1}', "--lockstep"),
        (b'{"fault": {"kind": "reply_delay"}}', "a number of 0 to 60 s"),
        (b'{"fault": {"kind": "reply_delay", "value": -1}}', "a number of 0 to 60 s"),
        (b'{"fault": {"kind": "frozen", "value": 1}}', "no value"),
        (b'{"fault": {"kind": "frozen", "duration_s": -1}}', "0 to"),
        (b'{"fault": {"kind": ["a"]}}', "accepted: reply_delay"),
        (b'{"fault": {"clear": "gremlins"}}', "accepted: all"),
        (b'{"fault": 7}', "must have kind"),
    ],
)
def test_a_request_that_is_none_is_answered_by_a_json_error(link, line, named):
    link.sendall(line + b"\n")
    reply = json.loads(link.recv(65536))
    assert set(reply) == {"error"}
    assert named in reply["error"]
    link.sendall(b"{}\n")
    assert "time_s" in json.loads(link.recv(65536))


def test_the_hand_lets_go_when_its_connection_is_lost(start_emulator):
    emulator = start_emulator()
    with emulator.connect_world() as watcher:
        with emulator.connect_world() as hand:
            deadline = time.monotonic() + 5.0
            while watcher.observe().hand_force == (0.0, 0.0, 0.0):
                hand.exchange(HAND)
                assert time.monotonic() < deadline
        while watcher.observe().hand_force != (0.0, 0.0, 0.0):
            assert time.monotonic() < deadline


def test_nobody_listening_is_told_with_the_address():
    with pytest.raises(TransportError, match=r"127\.0\.0\.1:9"):
        WorldClient("tcp://127.0.0.1:9")
    with pytest.raises(ConfigurationError, match="tcp://HOST:PORT"):
        WorldClient("localhost")

import errno
import re
import socket
import struct
import time
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from emulator.world import WorldClient

VECTOR = r"\[[-+.e\d]+,[-+.e\d]+,[-+.e\d]+\]"


def still_alive(emulator, connect):
    """The emulator answers, and the arm's time goes on."""
    assert connect(emulator).ask("get os") == "Linux;"
    with emulator.connect_world() as world:
        before = world.observe().step
        time.sleep(0.05)
        assert world.observe().step > before


def memory_kb(emulator):
    status = Path(f"/proc/{emulator.pid}/status").read_text(encoding="ascii")
    return int(re.search(r"VmRSS:\s+(\d+)", status).group(1))


def test_the_start_sequence_and_the_cycle_of_the_cup_task_run(emulator, connect):
    client = connect(emulator)
    assert client.ask("remove all") == "Removed;"
    assert client.ask("get os") == "Linux;"
    assert client.ask("get emergencybuttonpushed") == "false;"
    assert client.ask("get emergencyrelay") == "true;"
    assert client.ask("get position_calibrated") in ("true;", "false;")
    assert client.ask("set state init") == "state set to 'init';"
    client.wait_for_state("stop")
    assert client.ask("set state force") == "state set to 'force';"
    assert client.ask("remove all") == "Removed;"
    assert client.ask("set inertia 3.5") == "Inertia set;"
    assert client.ask("create spring spring_X") == "Effect spring with name spring_X created;"
    for command, reply in (
        ("set spring_X stiffness 500", "Spring's stiffness set;"),
        ("set spring_X dampfactor 0.7", "Spring's damp factor set;"),
        ("set spring_X direction [1.0, 0.0, 0.0]", "Spring's direction set;"),
        ("set spring_X maxforce 20", "Spring's maximum force set;"),
    ):
        assert client.ask(command) == reply
    assert "enabled" in client.ask("set spring_X enable")
    assert client.ask("create biasforce ballForce") == "Effect biasforce with name ballForce created;"
    assert "enabled" in client.ask("set ballForce enable")
    for cycle in range(100):
        measured = client.ask("get modelpos; get modelvel; get modelacc; get measforce")
        assert re.fullmatch(f"({VECTOR};){{4}}", measured)
        assert client.ask(f"set ballForce force [0,{1.25 * (cycle % 2):g},0]") == "Bias force's force set;"
    assert client.ask("remove all") == "Removed;"
    assert client.ask("set state stop") == "state set to 'stop';"


def test_both_dialects_are_told_apart_by_the_first_byte(emulator, connect):
    text, framed = connect(emulator), connect(emulator)
    for _ in range(3):
        framed.send(struct.pack(">II", 6, 0) + b"get os")
        assert framed.socket.recv(1024) == struct.pack(">II", 7, 0) + b'"Linux"'
        assert text.ask("get os") == "Linux;"


def test_a_request_in_single_bytes_and_two_requests_in_one_packet_are_answered(emulator, connect):
    client = connect(emulator)
    for byte in b"get os\nget o":
        client.send(bytes((byte,)))
    assert client.socket.recv(100) == b"Linux;\n"
    client.send(b"s\nget os\nget os\n")
    received = b""
    while received.count(b"\n") < 3:
        received += client.socket.recv(100)
    assert received == b"Linux;\n" * 3


def test_many_clients_may_command_and_see_the_same_device(emulator, connect):
    clients = [connect(emulator) for _ in range(20)]
    for number, client in enumerate(clients):
        assert client.ask(f"set inertia {number + 2}") == "Inertia set;"
        assert all(other.ask("get inertia") == f"{number + 2};" for other in clients)


@pytest.mark.parametrize(
    "data",
    [
        struct.pack(">II", 0xFFFFFF, 0),
        struct.pack(">II", 6, 1) + b"get os",
        b"\xff\xfe\xfd",
        b"\x16\x03\x01\x02\x00\x01\x00\x01\xfc\x03\x03",
        b"get " + b"x" * 1_000_000,
        b"set s pos [" + b"1," * 500_000 + b"]\n",
    ],
    ids=["absurd length", "no header", "neither dialect", "TLS", "1 MB without an end", "1 MB command"],
)
def test_bytes_that_cannot_be_followed_get_an_error_or_a_closed_connection(emulator, connect, data):
    client = connect(emulator)
    try:
        client.send(data)
    except OSError:
        pass
    else:
        assert client.is_cut()
    still_alive(emulator, connect)


def test_text_that_is_not_ascii_is_answered_by_an_error(emulator, connect):
    client = connect(emulator)
    assert client.ask("get mésspös").startswith("--- ERROR: ")
    assert client.ask("get os") == "Linux;"


def test_half_a_frame_and_silence_keeps_nobody_waiting(emulator, connect):
    silent = [connect(emulator) for _ in range(10)]
    for client in silent:
        client.send(b"\x00\x00\x00\x20\x00\x00\x00\x00get")
    still_alive(emulator, connect)


def test_a_client_that_never_reads_costs_bounded_memory(emulator, connect):
    client = connect(emulator, timeout=0.2)
    before = memory_kb(emulator)
    request = b"get workspace_r; " * 50 + b"get os\n"
    with pytest.raises(TimeoutError):
        client.send(request * 200_000)
    still_alive(emulator, connect)
    assert memory_kb(emulator) - before < 20_000


def test_thousands_of_connections_keep_no_new_client_out(emulator, connect):
    parts = urlsplit(emulator.url)
    before = memory_kb(emulator)
    crowd = []
    try:
        for _ in range(2000):
            crowd.append(socket.create_connection((parts.hostname, parts.port), timeout=5.0))
            if len(crowd) > 300:
                crowd.pop(0).close()
    finally:
        deadline = time.monotonic() + 10.0
        while True:
            try:
                still_alive(emulator, connect)
                break
            except OSError:
                assert time.monotonic() < deadline
        for link in crowd:
            link.close()
    assert memory_kb(emulator) - before < 20_000


command = st.sampled_from(
    [
        "get measpos",
        "set inertia 3",
        "create spring s",
        "remove all",
        "set s pos [1,2,nan]",
        "set state force",
    ]
)
garbage = st.one_of(
    st.binary(max_size=200),
    command.map(lambda text: text.encode() + b"\n"),
    command.map(lambda text: struct.pack(">II", len(text), 0) + text.encode()),
    st.builds(
        lambda n, rest: struct.pack(">II", n, 0) + rest, st.integers(0, 2**32 - 1), st.binary(max_size=50)
    ),
    st.text(max_size=60).map(lambda text: text.encode() + b"\n"),
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(garbage, max_size=6))
def test_any_bytes_at_all_leave_the_emulator_alive(emulator, pieces):
    parts = urlsplit(emulator.url)
    with socket.create_connection((parts.hostname, parts.port), timeout=5.0) as link:
        try:
            for piece in pieces:
                link.sendall(piece)
            link.shutdown(socket.SHUT_WR)
            while link.recv(65536):
                pass
        except OSError as error:
            if error.errno not in (errno.EPIPE, errno.ECONNRESET, errno.ENOTCONN):
                raise
    with socket.create_connection((parts.hostname, parts.port), timeout=5.0) as link:
        link.sendall(b"get os\n")
        assert link.recv(100) == b"Linux;\n"


def test_the_arm_goes_on_when_a_client_vanishes_by_default(emulator, connect):
    client = connect(emulator)
    client.ask("set state init")
    client.wait_for_state("stop")
    client.ask("set state force")
    client.close()
    time.sleep(0.1)
    assert connect(emulator).ask("get state") == "force;"


def test_the_arm_stops_when_a_client_vanishes_if_asked_to(start_emulator, connect):
    emulator = start_emulator(on_client_lost="stop", init_seconds=0.2)
    observer, client = connect(emulator), connect(emulator)
    client.ask("set state init")
    client.wait_for_state("stop")
    client.ask("set state force; create biasforce b; set b force [0,8,0]; set b enable")
    watcher = connect(emulator)
    watcher.ask("get state")
    watcher.close()
    time.sleep(0.2)
    assert observer.ask("get state") == "force;"
    client.close()
    observer.wait_for_state("stop")
    time.sleep(0.3)
    with emulator.connect_world() as world:
        assert max(abs(v) for v in world.observe().velocity) < 1e-3


def test_the_arm_keeps_its_time(emulator):
    with emulator.connect_world() as world:
        first, start = world.observe(), time.monotonic()
        time.sleep(1.0)
        last, elapsed = world.observe(), time.monotonic() - start
    lost = 0.02 + 4e-4 * (last.missed - first.missed)
    assert last.time_s - first.time_s == pytest.approx(elapsed, abs=lost)


def test_a_lock_step_server_moves_when_it_is_told_to(start_emulator, connect):
    emulator = start_emulator(lockstep=True)
    client = connect(emulator)
    with WorldClient(emulator.world_url) as world:
        assert client.ask("set state init") == "state set to 'init';"
        time.sleep(0.05)
        assert world.observe().step == 0
        assert world.advance(0.0014).step == 3
        assert world.advance(0.0001).step == 3
        assert world.advance(0.0001).step == 4
        world.advance(3.0)
        assert client.ask("get state") == "stop;"

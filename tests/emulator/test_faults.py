import time
from pathlib import Path
from statistics import median

import pytest

from emulator.faults import KINDS, Fault, load_schedule, parse_fault
from emulator.in_process import LockstepEmulator
from hm_driver.errors import ConfigurationError, TransportTimeout
from hm_driver.transport.in_process import InProcessTransport


def ask(emulator, text):
    return emulator.handle(text.encode() + b"\n").decode().rstrip("\n")


def pass_time(emulator, seconds):
    emulator.advance_to_ns(round((emulator.device.time_s + seconds) * 1e9))


@pytest.fixture
def arm():
    return LockstepEmulator(init_seconds=0.2)


@pytest.fixture
def ready(arm):
    """An emulator in state force."""
    ask(arm, "set state init")
    pass_time(arm, 3.0)
    assert ask(arm, "set state force") == "state set to 'force';"
    return arm


def test_the_documentation_lists_every_kind():
    page = (Path(__file__).parents[2] / "docs" / "emulator.md").read_text(encoding="utf-8")
    for name, kind in KINDS.items():
        assert f"| `{name}` | {kind.expected()} | {kind.doc} |" in page


def test_every_kind_begins_and_ends(arm):
    for name, kind in KINDS.items():
        value = None if kind.size == 0 else max(kind.low, 0.0) if kind.size == 1 else (0.0, 0.0, 0.001)
        arm.faults.inject(Fault(kind=name, value=value))
        assert (name in arm.faults.active_kinds()) != kind.is_momentary
        pass_time(arm, 0.01)
        arm.faults.clear(name)
    assert arm.faults.active_kinds() == ()
    assert ask(arm, "get state") == "off;"


def test_init_that_fails_ends_in_fault_with_its_reason(arm):
    arm.faults.inject(Fault(kind="init_fails"))
    ask(arm, "set state init")
    pass_time(arm, 3.0)
    assert ask(arm, "get state; get position_calibrated") == "fault;false;"
    assert "initialisation failed" in ask(arm, "set state force")
    assert "initialisation failed" in arm.world.observe().fault
    arm.faults.clear()
    assert ask(arm, "set state init") == "state set to 'init';"
    pass_time(arm, 3.0)
    assert ask(arm, "get state") == "stop;"


def test_init_that_never_ends_can_be_stopped(arm):
    arm.faults.inject(Fault(kind="init_never_ends"))
    ask(arm, "set state init")
    pass_time(arm, 60.0)
    assert ask(arm, "get state") == "init;"
    assert ask(arm, "set state stop; get position_calibrated") == "state set to 'stop';false;"


def test_init_takes_as_long_as_it_is_told_to(arm):
    arm.faults.inject(Fault(kind="init_takes", value=7.0))
    ask(arm, "set state init")
    pass_time(arm, 6.9)
    assert ask(arm, "get state") == "init;"
    pass_time(arm, 1.0)
    assert ask(arm, "get state") == "stop;"


def test_the_emergency_button_cuts_the_power_until_it_is_released(ready):
    ready.faults.inject(Fault(kind="emergency_button", duration_s=1.0))
    assert ask(ready, "get state; get emergencybuttonpushed; get emergencyrelay") == "off;true;false;"
    assert "emergency button" in ask(ready, "set state force")
    pass_time(ready, 1.1)
    assert ask(ready, "set state force; get emergencyrelay") == "state set to 'force';true;"


def test_the_relay_alone_cuts_the_power_too(ready):
    ready.faults.inject(Fault(kind="relay_off"))
    assert ask(ready, "get state; get emergencybuttonpushed; get emergencyrelay") == "off;false;false;"
    assert "relay" in ask(ready, "set state stop")


def test_an_encoder_jump_trips_the_guard_and_names_value_and_limit(ready):
    ready.faults.inject(Fault(kind="encoder_jump", value=(0.0, 0.0, 0.1)))
    pass_time(ready, 0.1)
    assert ask(ready, "get state") == "fault;"
    assert "above" in ready.world.observe().fault
    assert ask(ready, "set state off; get state") == "state set to 'off';off;"


def test_a_biased_sensor_drives_the_arm_and_a_stuck_one_reads_the_same(ready):
    ready.faults.inject(Fault(kind="force_bias", value=(0.0, 5.0, 0.0)))
    pass_time(ready, 0.2)
    assert float(ask(ready, "get measforce").strip("[];").split(",")[1]) == pytest.approx(5.0, abs=0.3)
    assert ready.world.observe().position[1] > 0.005
    ready.faults.clear()
    ready.faults.inject(Fault(kind="force_stuck"))
    readings = set()
    for _ in range(20):
        pass_time(ready, 0.01)
        readings.add(ask(ready, "get measforce"))
    assert len(readings) <= 2


def test_a_noisy_sensor_is_noisier(ready):
    def spread():
        values = []
        for _ in range(100):
            pass_time(ready, 0.002)
            values.append(float(ask(ready, "get measforce").strip("[];").split(",")[0]))
        return max(values) - min(values)

    calm = spread()
    ready.faults.inject(Fault(kind="force_noise", value=10.0))
    assert spread() > 4.0 * calm


def test_lost_replies_and_a_frozen_device_time_out_in_lock_step(arm):
    link = InProcessTransport(arm)
    for kind, value in (("reply_lost", 1.0), ("frozen", None)):
        arm.faults.inject(Fault(kind=kind, value=value, duration_s=0.1))
        link.send(b"get os\n")
        with pytest.raises(TransportTimeout):
            link.receive(0.1)
        pass_time(arm, 0.2)
        link.send(b"get os\n")
        assert link.receive(0.1) == b"Linux;\n"


def test_corrupted_and_refused_replies_come_as_often_as_they_are_told_to(arm):
    arm.faults.inject(Fault(kind="reply_corrupted", value=0.5))
    wrong = sum(arm.handle(b"get os\n") != b"Linux;\n" for _ in range(400))
    assert 140 < wrong < 260
    arm.faults.clear()
    arm.faults.inject(Fault(kind="reply_error", value=0.25))
    refused = sum("--- ERROR" in ask(arm, "get os") for _ in range(400))
    assert 60 < refused < 140


def test_two_emulators_of_one_seed_fail_alike():
    answers = []
    for _ in range(2):
        arm = LockstepEmulator(seed=5)
        arm.faults.inject(Fault(kind="reply_corrupted", value=0.3))
        answers.append([arm.handle(b"get measforce\n") for _ in range(100)])
        pass_time(arm, 0.1)
    assert answers[0] == answers[1]


@pytest.mark.parametrize(
    ("kind", "value", "low"),
    [("reply_delay", 0.05, 0.05), ("reply_split", 0.05, 0.05), ("reply_merged", 2.0, 0.1)],
)
def test_replies_come_late_split_or_merged_over_tcp(emulator, connect, kind, value, low):
    client = connect(emulator)
    healthy = median(timed(client) for _ in range(5))
    with emulator.connect_world() as world:
        world.inject(kind, value=value)
        assert median(timed(client) for _ in range(5)) > low * 0.9
        world.clear_faults()
    assert healthy < low / 2.0
    assert client.ask("get os") == "Linux;"


def timed(client):
    start = time.monotonic()
    assert client.ask("get os") == "Linux;"
    return time.monotonic() - start


def test_merged_replies_come_in_one_packet(emulator, connect):
    client = connect(emulator)
    with emulator.connect_world() as world:
        world.inject("reply_merged", value=3.0)
        client.send(b"get os\nget os\nget os\n")
        assert client.socket.recv(1000) == b"Linux;\n" * 3
        world.clear_faults()


def test_jitter_lets_replies_overtake_nobody(emulator, connect):
    client = connect(emulator)
    with emulator.connect_world() as world:
        world.inject("reply_jitter", value=0.02)
        client.ask("set inertia 3")
        for number in range(3, 20):
            client.send(f"set inertia {number}\nget inertia\n".encode())
            received = b""
            while received.count(b"\n") < 2:
                received += client.socket.recv(1000)
            assert received == f"Inertia set;\n{number};\n".encode()
        world.clear_faults()


def test_a_frozen_device_answers_when_it_thaws_and_the_arm_goes_on(emulator, connect):
    client = connect(emulator)
    with emulator.connect_world() as world:
        before = world.inject("frozen", duration_s=0.3).step
        client.send(b"get os\n")
        start = time.monotonic()
        assert client.socket.recv(100) == b"Linux;\n"
        assert time.monotonic() - start > 0.2
        assert world.observe().step - before > 300


def test_a_reset_connection_is_reset_and_the_next_one_works(emulator, connect):
    client = connect(emulator)
    client.ask("get os")
    with emulator.connect_world() as world:
        world.inject("connection_reset")
        with pytest.raises(ConnectionResetError):
            client.socket.recv(100)
        world.observe()
    assert connect(emulator).ask("get os") == "Linux;"


def test_a_schedule_is_carried_out_in_device_time(tmp_path, arm):
    path = tmp_path / "faults.toml"
    path.write_text(
        '[[fault]]\nat_s = 0.5\nkind = "emergency_button"\nduration_s = 0.25\n'
        '[[fault]]\nat_s = 0.6\nkind = "reply_error"\nvalue = 1\n',
        encoding="utf-8",
    )
    arm.faults.schedule(load_schedule(path))
    pushed = []
    for _ in range(10):
        pass_time(arm, 0.1)
        pushed.append(arm.device.machine.emergency_button_pushed)
    assert pushed == [False] * 4 + [True] * 3 + [False] * 3
    assert "injected fault" in ask(arm, "get os")


@pytest.mark.parametrize(
    ("text", "named"),
    [
        ("[[fault]]\nat_s = 1", "entry 1"),
        ('[[fault]]\nkind = "gremlins"', "accepted: reply_delay"),
        ('[[fault]]\nkind = "reply_delay"\nvalue = "long"', "a number of 0 to 60 s"),
        ('[[fault]]\nkind = "reply_delay"\nvalue = 1\nhow = 2', "duration_s"),
        ('[[fault]]\nkind = "frozen"\nat_s = -1', "at_s"),
        ("[fault]\nkind = 1", "must consist"),
        ("fault = 3", "must consist"),
        ("x", "cannot be read"),
    ],
)
def test_a_schedule_that_is_wrong_is_refused_with_its_file(tmp_path, text, named):
    path = tmp_path / "faults.toml"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(ConfigurationError, match=r"faults\.toml") as refusal:
        load_schedule(path)
    assert named in str(refusal.value)


@pytest.mark.parametrize("entry", [None, 3, [], {}, {"kind": 3}, {"kind": "force_bias", "value": [1, 2]}])
def test_what_is_no_fault_is_refused(entry):
    with pytest.raises(ConfigurationError):
        parse_fault(entry)

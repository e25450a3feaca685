import json
from pathlib import Path

import pytest

from emulator.process import Emulator
from hm_driver.errors import ConfigurationError, TransportError
from hm_driver.geometry import ArmGeometry
from hm_driver.realtime.modes import LimitOptions, ModeOptions
from tools.check.doubts import DOUBTS
from tools.check.first_run import FORCE, SPEED, Terminal, approach_device, is_emulator, memory_path

URL = "tcp://10.1.2.3"
FIDELITY = Path(__file__).parents[3] / "docs" / "fidelity.md"


class Person:
    """Answers, and keeps what it was told."""

    def __init__(self, answer=None):
        self.told = []
        self.answer = answer

    @property
    def terminal(self):
        return Terminal(self.told.append, None if self.answer is None else lambda _: self.answer)


@pytest.fixture
def memory(tmp_path):
    return tmp_path / "state" / "robots.json"


def approach(memory, person, *, yes=False, url=URL):
    return approach_device(url, world=None, yes=yes, terminal=person.terminal, memory=memory)


@pytest.mark.parametrize("answer", [None, "no", "", "y"])
def test_without_a_yes_nothing_is_driven(memory, answer):
    with pytest.raises(ConfigurationError, match="--yes-real-robot"):
        approach(memory, Person(answer))
    assert not memory.exists()


@pytest.mark.parametrize(("answer", "yes"), [("yes\n", False), (None, True)])
def test_a_first_run_is_confirmed_and_lists_what_is_not_sure(memory, answer, yes):
    person = Person(answer)
    assert approach(memory, person, yes=yes).is_first_run
    text = "\n".join(person.told)
    assert all(doubt.fact in text and doubt.consequence in text for doubt in DOUBTS)
    assert "emergency button" in text


def test_a_first_run_is_slow_and_weak(memory):
    geometry = ArmGeometry()
    modes, limits = approach(memory, Person("yes")).reduce(ModeOptions(), LimitOptions(), geometry)
    trip = limits.velocity_trip
    assert limits.velocity_r * trip == pytest.approx(SPEED)
    assert limits.velocity_z * trip == pytest.approx(SPEED)
    assert limits.velocity_phi * (geometry.r0 + geometry.r_max) * trip == pytest.approx(SPEED)
    assert limits.reference_speed < SPEED
    assert limits.force_trip == FORCE
    assert max(modes.position_force_max, modes.assist_force_max) + limits.bias_max <= FORCE


def test_limits_that_are_lower_already_stay(memory):
    configured = (ModeOptions(position_force_max=1.0), LimitOptions(velocity_z=0.01, force_trip=2.0))
    modes, limits = approach(memory, Person("yes")).reduce(*configured, ArmGeometry())
    assert (modes.position_force_max, limits.velocity_z, limits.force_trip) == (1.0, 0.01, 2.0)


def test_a_run_that_ended_in_order_is_remembered_for_its_host_alone(memory):
    first = approach(memory, Person("yes"))
    assert approach(memory, Person("yes")).is_first_run  # a run that did not end in order counts for nothing
    first.completed()
    person = Person()
    later = approach(memory, person)
    assert not later.is_first_run
    assert "taken for a robot" in person.told[0]
    assert later.reduce(ModeOptions(), LimitOptions(), ArmGeometry()) == (ModeOptions(), LimitOptions())
    assert list(json.loads(memory.read_text())) == ["10.1.2.3:7654"]
    with pytest.raises(ConfigurationError):
        approach(memory, Person(), url="tcp://10.1.2.4")


@pytest.mark.parametrize("text", ["", "[]", "{", '{"10.1.2.3:7654": 1}'])
def test_a_memory_that_cannot_be_read_knows_no_host(memory, text):
    memory.parent.mkdir()
    memory.write_text(text)
    assert approach(memory, Person("yes")).is_first_run


def test_the_memory_is_in_the_user_s_state_directory(monkeypatch):
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setenv("XDG_STATE_HOME", "/somewhere")
    assert memory_path() == Path("/somewhere/hapticmaster/robots.json")


def test_an_emulator_is_known_by_its_own_world_endpoint_alone(memory):
    with Emulator(init_seconds=0.2) as one, Emulator(init_seconds=0.2) as other:
        assert is_emulator(one.url, one.world_url)
        assert not is_emulator(one.url, None)
        with other.connect_world() as world:
            world.inject("encoder_jump", value=(0.01, 0.0, 0.0))
            with pytest.raises(ConfigurationError, match="not one emulator"):
                is_emulator(other.url, other.world_url)
        found = approach_device(
            one.url, world=one.world_url, yes=False, terminal=Person().terminal, memory=memory
        )
        assert not found.is_first_run
        found.completed()
        assert not memory.exists()
    assert is_emulator("sim://", None)


def test_a_world_endpoint_that_is_not_there_makes_no_emulator():
    with pytest.raises(TransportError):
        is_emulator("tcp://127.0.0.1:9", "tcp://127.0.0.1:9")


def rows():
    """First cell and confidence of every row of the fidelity tables."""
    cells = [line.split("|") for line in FIDELITY.read_text(encoding="utf-8").splitlines() if line[:1] == "|"]
    return {row[1].strip(): row[3].strip() for row in cells if len(row) > 4}


@pytest.mark.parametrize("doubt", DOUBTS, ids=lambda doubt: doubt.fact)
def test_each_doubt_stands_in_the_fidelity_table_with_its_confidence(doubt):
    assert rows()[doubt.fact] == doubt.confidence
    assert doubt.confidence in {"M", "L", "C"}

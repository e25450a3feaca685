"""``hm check`` against emulators: one that is as the table says, and others."""

import json
from pathlib import Path

import pytest

from emulator.process import Emulator
from hm_driver.device.link import connect_link
from tools.check.active import ACTIVE
from tools.check.comparison import Conversation, Verdict, compare
from tools.check.passive import PASSIVE
from tools.cli.main import run

FIDELITY = Path(__file__).parents[3] / "docs" / "fidelity.md"


@pytest.fixture(scope="module")
def emulator():
    with Emulator(init_seconds=0.2) as emulator:
        yield emulator


@pytest.mark.parametrize("dialect", ["text", "framed"])
def test_the_emulator_agrees_with_everything_that_can_be_asked(emulator, tmp_path, capsys, dialect):
    path = tmp_path / "check.json"
    words = ["check", "--device", f"{emulator.url}?dialect={dialect}", "--output", str(path), "--json"]
    assert run([*words, "--active", "--yes-real-robot"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["counts"]["differs"] == 0
    assert told["counts"]["unknown"] == (0 if dialect == "text" else 2)  # nothing to combine in frames
    record = json.loads(path.read_text())
    assert record["dialect"] == dialect
    assert len(record["findings"]) == len(PASSIVE) + len(ACTIVE)
    assert all(exchange["reply"] for exchange in record["exchanges"])
    assert "127.0.0.1" not in path.read_text()


def test_the_passive_questions_change_nothing(emulator, tmp_path, capsys):
    path = tmp_path / "check.json"
    assert run(["check", "--device", emulator.url, "--output", str(path)]) == 0
    asked = [exchange["command"] for exchange in json.loads(path.read_text())["exchanges"]]
    assert asked
    assert all(part.strip().startswith("get ") for command in asked for part in command.split(";"))
    assert f"{len(PASSIVE)} same, 0 differs, 0 unknown" in capsys.readouterr().out


def test_the_active_questions_leave_no_object_and_the_virtual_mass_as_it_was(emulator):
    link = connect_link(emulator.url)
    try:
        before = link.ask("get inertia")
        compare(Conversation(link), ACTIVE)
        assert link.ask("get inertia") == before
        assert "ERROR" in Conversation(link).ask("get hmcheck enabled")
    finally:
        link.close()


def test_the_active_questions_are_not_asked_where_effects_are_rendered():
    with Emulator(init_seconds=0.2) as emulator:
        link = connect_link(emulator.url)
        try:
            link.ask("set state init")
            while link.ask("get state") != "stop":
                pass
            link.ask("set state force")
            conversation = Conversation(link)
            findings = compare(conversation, ACTIVE)
            link.ask("set state stop")
        finally:
            link.close()
    assert {finding.verdict for finding in findings} == {Verdict.UNKNOWN}
    assert {exchange.command for exchange in conversation.exchanges} == {"get state"}


@pytest.mark.parametrize(
    ("config", "fault", "different"),
    [
        ("[geometry]\njoint_max = [0.19, 0.507, 0.15]\n", (), {"end stops"}),
        ("[geometry]\nr0 = 0.55\n", (), {"R0"}),
        ("", ("force_noise=30",), {"noise of the force sensor"}),
    ],
)
def test_another_arm_and_a_faulty_one_are_told_apart(tmp_path, capsys, config, fault, different):
    arm = tmp_path / "arm.toml"
    arm.write_text(config)
    with Emulator(init_seconds=0.2, config=arm if config else None, fault=fault) as emulator:
        path = tmp_path / "check.json"
        assert run(["check", "--device", emulator.url, "--output", str(path)]) == 1
    findings = json.loads(path.read_text())["findings"]
    assert {finding["question"] for finding in findings if finding["verdict"] == "differs"} == different
    assert "expected" in capsys.readouterr().out


def test_a_device_that_refuses_everything_differs_and_is_written_down(tmp_path):
    path = tmp_path / "check.json"
    with Emulator(init_seconds=0.2, fault=("reply_error=1",)) as emulator:
        assert run(["check", "--device", f"{emulator.url}?dialect=text", "--output", str(path)]) == 1
    assert json.loads(path.read_text())["counts"]["differs"] > 5


def test_without_a_confirmation_nothing_is_made(emulator, capsys, monkeypatch):
    monkeypatch.setattr("sys.stdin.isatty", lambda: False, raising=False)
    assert run(["check", "--device", emulator.url, "--active"]) == 2
    assert "--yes-real-robot" in capsys.readouterr().err


def test_a_device_that_cannot_be_reached_is_a_fault(tmp_path):
    assert run(["check", "--device", "tcp://127.0.0.1:9", "--output", str(tmp_path / "x.json")]) == 3


@pytest.mark.parametrize("question", [*PASSIVE, *ACTIVE], ids=lambda question: question.name)
def test_each_question_s_fact_stands_in_the_fidelity_table_with_its_confidence(question):
    lines = [line for line in FIDELITY.read_text(encoding="utf-8").splitlines() if line[:1] == "|"]
    confidences = {cells[1].strip(): cells[3].strip() for line in lines if len(cells := line.split("|")) > 4}
    assert confidences[question.fact] == question.confidence

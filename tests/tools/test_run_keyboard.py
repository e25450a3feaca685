"""What the user types while a session runs."""

import os
import pty
from pathlib import Path

import pytest

from teaching.task_file import load_task
from tools.live import LiveView
from tools.run.keyboard import HELP, Keyboard, Wishes
from tools.run.view import SessionView


class Asked:
    """Notes what a session is asked for."""

    def __init__(self):
        self.wishes = []
        self.is_latched = False
        self.task = load_task("paper")
        self.learner = self
        self.n_models = 12

    def __getattr__(self, name):
        if name.startswith("_"):
            raise AttributeError(name)
        return lambda: self.wishes.append(name)


@pytest.fixture
def session():
    return Asked()


@pytest.mark.parametrize(
    ("line", "wish"),
    [
        ("f", "forget"),
        ("forget this", "forget"),
        ("u", "undo"),
        ("U", "undo"),
        ("d", "discard"),
        ("a", "request_autonomy"),
    ],
)
def test_a_letter_asks_the_session(session, line, wish):
    assert Wishes().obey(line, session) == ""
    assert session.wishes == [wish]


def test_everything_is_forgotten_only_when_it_is_confirmed(session):
    wishes = Wishes()
    assert "12 models" in wishes.obey("F", session)
    assert session.wishes == []
    assert wishes.obey("YES", session) == ""
    assert session.wishes == ["forget_all"]


@pytest.mark.parametrize("line", ["", "y", "f", "no"])
def test_what_is_no_yes_leaves_everything_as_it_is(session, line):
    wishes = Wishes()
    wishes.obey("F", session)
    assert wishes.obey(line, session) == "nothing was forgotten"
    assert session.wishes == []
    assert wishes.obey("yes", session) == HELP


def test_the_button_stays_down_until_it_is_pressed_again(session):
    wishes = Wishes()
    assert "down" in wishes.obey("b", session)
    assert session.is_latched
    assert "up" in wishes.obey("b", session)
    assert not session.is_latched


@pytest.mark.parametrize(("line", "answer"), [("?", HELP), ("x", HELP), ("", "")])
def test_another_letter_is_answered_with_the_letters_there_are(session, line, answer):
    assert Wishes().obey(line, session) == answer
    assert session.wishes == []


@pytest.fixture
def terminal(monkeypatch):
    """The other end of a terminal that is standard input."""
    near, far = pty.openpty()
    with os.fdopen(far) as stdin:
        monkeypatch.setattr("sys.stdin", stdin)
        yield near
    os.close(near)


def test_lines_typed_at_once_are_all_read_and_half_a_line_waits(terminal):
    keyboard = Keyboard()
    assert keyboard.is_there
    assert keyboard.lines() == []
    os.write(terminal, b"f\nu \nF")
    lines = keyboard.lines()
    while len(lines) < 2:
        lines += keyboard.lines()
    assert lines == ["f", "u"]
    os.write(terminal, b"\n")
    while len(lines) < 3:
        lines += keyboard.lines()
    assert lines[-1] == "F"


def test_without_a_terminal_nothing_is_asked(monkeypatch):
    with Path(os.devnull).open() as nowhere:
        monkeypatch.setattr("sys.stdin", nowhere)
        keyboard = Keyboard()
        assert not keyboard.is_there
        assert keyboard.lines() == []


@pytest.mark.usefixtures("terminal")
def test_the_letters_are_told_at_the_start_and_fit_into_the_live_view():
    with LiveView(enabled=False) as live:
        view = SessionView(live, accumulation_length=10, coverage_goal=0.99)
    assert view._messages == [HELP]
    assert len(HELP) <= 120

"""What the user may ask for while a session runs: a letter and Enter on the terminal."""

import os
import select
import sys
from typing import Final

from teaching.session import Session

HELP: Final = (
    "a letter and Enter: f forget here, F forget all, u undo, d discard samples, b button, a go on alone"
)
_CONFIRM: Final = "yes"


class Keyboard:
    """Looks for lines on standard input without ever waiting; silent where that is no terminal."""

    def __init__(self) -> None:
        self._is_open = sys.stdin is not None and sys.stdin.isatty()
        self._typed = b""

    @property
    def is_there(self) -> bool:
        """Whether there is a terminal to type on."""
        return self._is_open

    def lines(self) -> list[str]:
        """The lines that were typed since the last call, without blanks about them."""
        while self._is_open and select.select([sys.stdin], [], [], 0.0)[0]:
            data = os.read(sys.stdin.fileno(), 4096)
            self._is_open = bool(data)
            self._typed += data
        *lines, self._typed = self._typed.split(b"\n")
        return [line.decode(errors="replace").strip() for line in lines]


class Wishes:
    """Does with a session what a line asks for; what cannot be had back is asked for twice."""

    def __init__(self) -> None:
        self._awaits_yes = False

    def obey(self, line: str, session: Session) -> str:
        """Ask the session for what a line says; the change comes with its next tick.

        Args:
            line: What was typed.
            session: The session.

        Returns:
            An answer to show; empty where the session itself will tell.
        """
        awaited, self._awaits_yes = self._awaits_yes, False
        if awaited:
            if line.lower() == _CONFIRM:
                session.forget_all()
                return ""
            return "nothing was forgotten"
        key = line[:1]
        if key == "F":
            self._awaits_yes = True
            return f"forget all {session.learner.n_models} models? type {_CONFIRM} and Enter"
        if key == "f":
            session.forget()
        elif key in ("u", "U"):
            session.undo()
        elif key in ("d", "D"):
            session.discard()
        elif key in ("b", "B"):
            session.is_latched = not session.is_latched
            return f"the button is {'down' if session.is_latched else 'up'}"
        elif key in ("a", "A"):
            session.request_autonomy()
        elif key:
            return HELP
        return ""

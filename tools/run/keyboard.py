"""What the user may ask for while a session runs: a letter and Enter on the terminal."""

import select
import sys


class Keyboard:
    """Looks for a line on standard input without ever waiting; silent where that is no terminal."""

    def __init__(self) -> None:
        self._is_open = sys.stdin is not None and sys.stdin.isatty()

    @property
    def is_there(self) -> bool:
        """Whether there is a terminal to type on."""
        return self._is_open

    def asked(self) -> str:
        """The letter that was typed since the last call, in lower case; empty if none."""
        if not self._is_open or not select.select([sys.stdin], [], [], 0.0)[0]:
            return ""
        line = sys.stdin.readline()
        self._is_open = bool(line)
        return line.strip().lower()[:1]

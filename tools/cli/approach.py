"""The question before the first run on a robot, at a terminal."""

import sys
from typing import TYPE_CHECKING

from tools.cli.console import tell

if TYPE_CHECKING:
    from tools.check.first_run import Approach


def approach_at_terminal(url: str, *, world: str | None, yes: bool) -> "Approach":
    """As `tools.check.first_run.approach_device`, with the user at the terminal, if there is one."""
    from tools.check.first_run import Terminal, approach_device

    is_interactive = sys.stdin.isatty() and sys.stderr.isatty()
    return approach_device(
        url, world=world, yes=yes, terminal=Terminal(tell, _ask if is_interactive else None)
    )


def _ask(question: str) -> str:
    sys.stderr.write(question)
    sys.stderr.flush()
    return sys.stdin.readline()

"""The drawing process: statuses come in on standard input, pictures go out on standard error."""

import contextlib
import os
import select
import signal
import sys
import time
from collections.abc import Iterator
from types import FrameType
from typing import Protocol

from tools.live.status import SessionStatus, decode

_POLL_S = 0.25
_READ_BYTES = 65536
_NICENESS = 5


class Screen(Protocol):
    """Something that shows statuses. `finish` is always called, and must restore the terminal."""

    def show(self, statuses: list[SessionStatus]) -> None:
        """Show what arrived since the last call, oldest first; the list may be empty."""

    def finish(self) -> None:
        """Show the last state for good and leave the terminal as it was."""


def main(arguments: list[str]) -> int:
    """Draw until standard input ends or the parent, whose process id is the first argument, is gone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for ending in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(ending, _end)
    _step_back()
    screen = _open_screen(plain="--plain" in arguments)
    try:
        for statuses in _arrivals(parent=int(arguments[0])):
            screen.show(statuses)
    except (OSError, _Ended):
        return 1
    finally:
        screen.finish()
    return 0


def _step_back() -> None:
    """Whatever scheduling the session has been granted, its picture comes last."""
    with contextlib.suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    with contextlib.suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, max(_NICENESS, os.getpriority(os.PRIO_PROCESS, 0)))


class _Ended(Exception):
    """A signal asked to end."""


def _end(_signal: int, _frame: FrameType | None) -> None:
    raise _Ended


def _open_screen(*, plain: bool) -> Screen:
    if plain:
        from tools.live.lines import LineScreen

        return LineScreen(sys.stderr, time.monotonic)
    from tools.live.panel import PanelScreen

    return PanelScreen(sys.stderr)


def _arrivals(parent: int) -> Iterator[list[SessionStatus]]:
    """What standard input brings, in batches; an empty one now and then, so that the picture stays alive."""
    stdin = sys.stdin.fileno()
    rest = b""
    while os.getppid() == parent:
        if not select.select([stdin], [], [], _POLL_S)[0]:
            yield []
            continue
        data = os.read(stdin, _READ_BYTES)
        if not data:
            return
        statuses, rest = decode(rest + data)
        yield statuses


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

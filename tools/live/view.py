"""The session's end of the live view: hand over a status and go on, whatever the terminal does."""

import contextlib
import os
import select
import signal
import subprocess
import sys
from collections import deque
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import tools
from tools.live.status import SessionStatus, encode

_STDERR = 2
_CLOSE_TIMEOUT_S = 2.0
_SHOW_CURSOR = b"\x1b[?25h\r\n"
_KEPT_MESSAGES = 20


class LiveView:
    """Shows a session in the terminal without ever making it wait.

    A process of its own draws. `update` writes one line into a pipe and returns; where the pipe is full,
    because the terminal is slow or stopped, that picture is dropped and only its messages are kept for the
    next one. The drawing process ends when the view is closed or when its parent is gone, and leaves the
    terminal as it found it.

    Args:
        enabled: False makes every method do nothing.
        plain: Lines instead of a picture; None decides by whether the stream is a terminal.
        stream: File descriptor to draw on; standard error, so that standard output stays free for results.
    """

    def __init__(self, *, enabled: bool = True, plain: bool | None = None, stream: int = _STDERR) -> None:
        self._enabled = enabled and os.name == "posix"
        self._plain = not _is_capable_terminal(stream) if plain is None else plain
        self._stream = stream
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: int | None = None
        self._messages: deque[str] = deque(maxlen=_KEPT_MESSAGES)
        self.dropped = 0
        """Pictures that were not handed over, because the drawing process was behind."""

    def __enter__(self) -> Self:
        if self._enabled:
            self._start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.close()

    def update(self, status: SessionStatus) -> None:
        """Hand over the present state; never blocks."""
        if self._pipe is None:
            return
        self._messages.extend(status.messages)
        try:
            os.write(self._pipe, encode(status, tuple(self._messages), select.PIPE_BUF))
        except BlockingIOError:
            self.dropped += 1
        except OSError:
            self._drop_pipe()
        else:
            self._messages.clear()

    def close(self) -> None:
        """Draw what is left and end the drawing process; may be called twice."""
        self._drop_pipe()
        process, self._process = self._process, None
        if process is None:
            return
        try:
            process.wait(_CLOSE_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if process.returncode != 0 and not self._plain:
            with contextlib.suppress(OSError):
                os.write(self._stream, _SHOW_CURSOR)

    def _start(self) -> None:
        reading, writing = os.pipe()
        os.set_blocking(writing, False)
        command = [sys.executable, "-P", "-m", "tools.live.display", str(os.getpid())]
        if self._plain:
            command.append("--plain")
        try:
            with _without_interrupts():
                self._process = subprocess.Popen(
                    command, stdin=reading, stdout=subprocess.DEVNULL, stderr=self._stream, env=_environment()
                )
        except OSError:  # a session does not fail for want of a picture
            os.close(writing)
        else:
            self._pipe = writing
        finally:
            os.close(reading)

    def _drop_pipe(self) -> None:
        pipe, self._pipe = self._pipe, None
        if pipe is not None:
            os.close(pipe)


def _is_capable_terminal(stream: int) -> bool:
    try:
        return os.isatty(stream) and os.environ.get("TERM", "") not in ("", "dumb")
    except OSError:
        return False


def _environment() -> dict[str, str]:
    """The child finds the same `tools` as we did, wherever it is started."""
    root = str(Path(tools.__file__).parent.parent)
    inherited = os.environ.get("PYTHONPATH")
    return os.environ | {"PYTHONPATH": os.pathsep.join([root, inherited] if inherited else [root])}


@contextlib.contextmanager
def _without_interrupts() -> Iterator[None]:
    """A child started here never sees Ctrl-C: it goes on to draw how the session ends."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)

"""Python processes of our own that import the driver alone, and notice when their parent ends.

``multiprocessing`` imports the application's main module into every child, and with it all that the
application imports. A child here gets the parent's import path, one function to call, and one argument on its
standard input; that pipe stays open, and reads end-of-file when the parent is gone, however it went.
"""

import json
import os
import pickle
import select
import signal
import struct
import subprocess
import sys
from collections.abc import Sequence

_LENGTH = struct.Struct("@Q")
_BOOTSTRAP = (
    "import sys, json; sys.path[:] = json.loads(sys.argv[1]); "
    "from importlib import import_module; getattr(import_module(sys.argv[2]), sys.argv[3])()"
)


def spawn(
    module: str, function: str, argument: object, *, pass_fds: Sequence[int] = ()
) -> "subprocess.Popen[bytes]":
    """Start ``module.function()`` in a new process with an argument for `receive_argument`.

    The child is in a session of its own: Ctrl-C in the terminal is the application's to judge.

    Args:
        module: Where the function is.
        function: What the process runs; takes no argument.
        argument: What `receive_argument` returns in it; pickled.
        pass_fds: File descriptors that stay open in it under their numbers.
    """
    command = [sys.executable, "-c", _BOOTSTRAP, json.dumps(sys.path), module, function]
    process = subprocess.Popen(  # our own interpreter and module
        command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, start_new_session=True, pass_fds=pass_fds
    )
    payload = pickle.dumps(argument)
    if process.stdin is not None:
        process.stdin.write(_LENGTH.pack(len(payload)) + payload)
        process.stdin.flush()
    return process


def receive_argument() -> object:
    """The argument that the parent sent; in the child, once. Ignores SIGINT from here on."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    (length,) = _LENGTH.unpack(_read_exactly(_LENGTH.size))
    return pickle.loads(_read_exactly(length))  # noqa: S301  # our own parent wrote it


def parent_is_gone(timeout_s: float | None, *, wake_fd: int | None = None) -> bool:
    """Wait for the parent's end; False after the time-out [s], or when ``wake_fd`` becomes readable."""
    waiting = [0] if wake_fd is None else [0, wake_fd]
    readable, _, _ = select.select(waiting, [], [], timeout_s)
    return 0 in readable and not os.read(0, 64)


def _read_exactly(size: int) -> bytes:
    data = b""
    while len(data) < size:
        part = os.read(0, size - len(data))
        if not part:
            raise SystemExit(1)  # the parent died while it was starting this process
        data += part
    return data

"""Errors on the command line: which exit code each gets, and the block of text that tells it."""

import os
import sys
from collections.abc import Sequence
from enum import IntEnum

from hm_driver.errors import (
    ConfigurationError,
    DeviceError,
    DeviceFault,
    HapticMasterError,
    LoopError,
    ProtocolError,
    TransportError,
)


class ExitCode(IntEnum):
    """What the ``hm`` command returns to the shell."""

    OK = 0
    """Done."""
    FAILED = 1
    """A check failed, or a command could not do its work: an unreadable log, a full disk, a
    command of the user that the device refused, a defect."""
    USAGE = 2
    """The command line or the configuration is wrong; nothing was started."""
    DEVICE_FAULT = 3
    """The device, the link to it or the driver loop failed; the arm was stopped if the link was alive."""
    INTERRUPTED = 130
    """Ctrl-C, or a signal that asks to end; the arm was stopped."""


_CODES: tuple[tuple[tuple[type[BaseException], ...], ExitCode], ...] = (
    ((KeyboardInterrupt,), ExitCode.INTERRUPTED),
    ((ConfigurationError,), ExitCode.USAGE),
    ((TransportError, DeviceError, DeviceFault, ProtocolError, LoopError), ExitCode.DEVICE_FAULT),
)


def exit_code(error: BaseException) -> ExitCode:
    """The exit code of an error."""
    return next((code for kinds, code in _CODES if isinstance(error, kinds)), ExitCode.FAILED)


def show_usage_error(error: Exception, chain: Sequence[str]) -> None:
    """Tell what is wrong with a command line, and where its help is."""
    _show("error", str(error), [f"see: {' '.join(('hm', *chain))} --help"])


def show_failure(error: BaseException) -> None:
    """Tell an error in one block, with the notes that were added to it on its way up."""
    notes = list(getattr(error, "__notes__", ()))
    if isinstance(error, KeyboardInterrupt):
        _show("interrupted", str(error), notes)
    elif isinstance(error, BrokenPipeError) and not isinstance(error, HapticMasterError):
        _give_up_standard_output()
    elif isinstance(error, HapticMasterError | OSError):
        _show("error", str(error), notes)
    else:
        told = "this is a defect of the program: run again with --debug and report what it prints"
        _show("error", f"{type(error).__name__}: {error}", [*notes, told])


def _show(kind: str, message: str, notes: Sequence[str]) -> None:
    from rich.console import Console
    from rich.text import Text

    text = Text.assemble((f"hm: {kind}", "bold red"), f": {message}" if message else "")
    for note in notes:
        text.append("\n    " + note.replace("\n", "\n    "), "dim")
    Console(stderr=True, soft_wrap=True).print(text)


def _give_up_standard_output() -> None:
    """Nobody reads on: keep the interpreter from complaining about it when it flushes at exit."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())

"""The ``hm`` command: the tree of its subcommands, and the one place where errors become exit codes.

Each command lives in a module of its own that is imported when it is run, so that ``hm --help`` needs neither
numpy nor numba.
"""

import signal
import sys
import warnings
from collections.abc import Sequence
from types import FrameType

from cyclopts import App, CycloptsError

from hm_driver.version import __version__
from tools.cli.failures import ExitCode, exit_code, show_failure, show_usage_error

_DEBUG = "--debug"
_HELP = """Driver, emulator and online teaching by demonstration for the Moog HapticMASTER.

Exit codes: 0 ok, 1 a check or a command failed, 2 usage, 3 device fault, 130 interrupted.
Anywhere on the line, --debug adds the traceback of an error.
"""

_GROUPS = {
    "config": "The configuration of a teaching session.",
    "log": "What sessions have recorded.",
    "study": "Many sessions over methods, surfaces and parameters.",
}
_COMMANDS = {
    "teach": ("tools.cli.teach:teach", "Teach the arm a task: human and robot share control."),
    "drive": ("tools.cli.drive:drive", "Drive the device by hand: move, hold, effects, record; a prompt."),
    "check": ("tools.cli.check:check", "Compare a robot with what docs/fidelity.md says about it."),
    "emulate": ("tools.cli.emulate:emulate", "Be a HapticMASTER on a TCP port."),
    "doctor": ("tools.cli.doctor:doctor", "Say what this machine allows the loop, and what to change."),
    "jitter": ("tools.cli.jitter:app", "Measure how punctual the loop is, beside any load."),
    "config show": ("tools.cli.config:show", "Print it, with the source of each value."),
    "study run": ("tools.cli.study:run", "Run a study file, or go on with it."),
    "study show": ("tools.cli.study:show", "Print its tables, and draw its pictures."),
    "study list": ("tools.cli.study:list_", "List the studies that are shipped."),
    "log info": ("tools.cli.log:info", "Say what a log holds."),
    "log check": ("tools.cli.log:check", "Say which rules a log keeps, and which it breaks."),
    "log events": ("tools.cli.log:events", "List what happened in a session."),
    "log report": ("tools.cli.log:report", "Write the report of a session from its log."),
    "log compare": ("tools.cli.log:compare", "Set sessions beside each other."),
    "log timing": ("tools.cli.log:timing", "Say how punctual the loop was."),
    "log haptics": ("tools.cli.log:haptics", "Say what the hand felt: springs, spectra, energies."),
    "log plot": ("tools.cli.log:plot", "Draw signals over time, in the terminal or a file."),
    "log export": ("tools.cli.log:export", "Write CSV, Parquet or MATLAB files."),
    "log cut": ("tools.cli.log:cut", "Copy a piece of a log."),
    "log merge": ("tools.cli.log:merge", "Copy several logs, or the parts of one, into one."),
    "log recover": ("tools.cli.log:recover", "Make a damaged log readable."),
}

_OWN_HELP = frozenset({"drive"})
"""Commands with words of their own, which answer --help themselves."""


def application(words: Sequence[str] = ()) -> App:
    """The tree of commands; none of them is imported before it is run.

    Args:
        words: The command line. The command that it names explains itself by its docstring; in a list a
            command has one line, known without importing it.
    """
    app = App(
        name="hm",
        help=_HELP,
        version=f"hm {__version__}",
        version_format="plaintext",
        result_action="return_value",
        suppress_keyboard_interrupt=False,
    )
    groups = {"": app}
    for name, text in _GROUPS.items():
        groups[name] = App(name=name, help=text)
        app.command(groups[name])
    for path, (target, text) in _COMMANDS.items():
        group, _, name = path.rpartition(" ")
        is_named = list(words[: len(path.split())]) == path.split()
        flags = {"help_flags": ()} if path in _OWN_HELP else {}
        groups[group].command(target, name=name, help=None if is_named else text, **flags)
    return app


def run(words: Sequence[str], app: App | None = None) -> int:
    """Run one command line and return its exit code; errors are told on standard error.

    Args:
        words: The command line, without the program's name.
        app: The commands; by default those of ``hm``.
    """
    debug = _DEBUG in words
    words = [word for word in words if word != _DEBUG]
    app = application(words) if app is None else app
    try:
        result = app(words, exit_on_error=False, print_error=False)
        sys.stdout.flush()
    except (Exception, KeyboardInterrupt) as error:  # noqa: BLE001 - the outermost command tells every error
        if debug:
            sys.excepthook(type(error), error, error.__traceback__)
        elif isinstance(error, CycloptsError):
            show_usage_error(error, error.command_chain or ())
        else:
            show_failure(error)
        return ExitCode.USAGE if isinstance(error, CycloptsError) else exit_code(error)
    return int(result) if isinstance(result, int) else ExitCode.OK


def main() -> None:
    """Entry point of the ``hm`` command."""
    for ending in ("SIGTERM", "SIGHUP"):
        _interrupt_on(ending)
    warnings.showwarning = _show_warning
    sys.exit(run(sys.argv[1:]))


def _interrupt_on(name: str) -> None:
    """Let a request to end take the way of Ctrl-C, which stops the arm; one that is ignored stays so."""
    number = getattr(signal, name, None)
    if number is not None and signal.getsignal(number) is not signal.SIG_IGN:
        signal.signal(number, _interrupt)


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    sys.stderr.write(f"hm: warning: {message}\n")


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()

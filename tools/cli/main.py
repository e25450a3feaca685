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


def application() -> App:
    """The tree of commands; nothing of it is imported before it is run."""
    app = App(
        name="hm",
        help=_HELP,
        version=f"hm {__version__}",
        version_format="plaintext",
        result_action="return_value",
        suppress_keyboard_interrupt=False,
    )
    for name, target, text in (
        ("teach", "tools.cli.teach:teach", "Teach the arm a task: human and robot share control."),
        ("emulate", "tools.cli.emulate:emulate", "Be a HapticMASTER on a TCP port."),
        ("report", "tools.cli.report:report", "Write the report of a session from its log."),
    ):
        app.command(target, name=name, help=text)
    config = App(name="config", help="The configuration of a teaching session.")
    config.command("tools.cli.config:show", name="show", help="Print it, with the source of each value.")
    app.command(config)
    log = App(name="log", help="What sessions have recorded.")
    log.command("tools.cli.log:info", name="info", help="Say what a log holds.")
    log.command("tools.cli.log:recover", name="recover", help="Make a damaged log readable.")
    app.command(log)
    return app


def run(words: Sequence[str], app: App) -> int:
    """Run one command line and return its exit code; errors are told on standard error."""
    debug = _DEBUG in words
    try:
        result = app([word for word in words if word != _DEBUG], exit_on_error=False, print_error=False)
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
    sys.exit(run(sys.argv[1:], application()))


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

"""The interactive prompt: completion, history, the live state below, and Ctrl-C that stops motion first."""

import sys
import threading
from collections.abc import Callable, Iterable

from prompt_toolkit import PromptSession
from prompt_toolkit.completion import CompleteEvent, Completer, Completion
from prompt_toolkit.document import Document
from prompt_toolkit.history import FileHistory, History, InMemoryHistory
from prompt_toolkit.input import Input
from prompt_toolkit.output import Output
from prompt_toolkit.patch_stdout import patch_stdout
from prompt_toolkit.shortcuts import CompleteStyle

from hm_driver.errors import HapticMasterError
from tools.drive.completion import candidates, hint, unfinished
from tools.drive.history import history_path
from tools.drive.language import commands
from tools.drive.outcome import EndRequested, MotionStopped
from tools.drive.surface import Context
from tools.drive.words import carry_out

_REFRESH_S = 0.2
_GREETING = "Tab completes, 'help' lists the words, Ctrl-C stops motion, Ctrl-D ends with the arm stopped."


class Prompt:
    """Reads commands from a terminal and carries them out.

    Args:
        context: What the words work with.
        show_failure: Tells an error to the person.
        source: Where keys come from; the terminal unless said.
        output: Where the prompt is drawn.
    """

    def __init__(
        self,
        context: Context,
        *,
        show_failure: Callable[[BaseException], None],
        source: Input | None = None,
        output: Output | None = None,
    ) -> None:
        self._context = context
        self._show_failure = show_failure
        self._lock = threading.Lock()
        self._told: HapticMasterError | None = None
        self._is_reading = False
        self._was_interrupted = False
        path = history_path()
        history: History = InMemoryHistory() if path is None else FileHistory(path)
        self._session: PromptSession[str] = PromptSession(
            history=history,
            completer=_WordCompleter(context),
            complete_while_typing=False,
            complete_style=CompleteStyle.MULTI_COLUMN,
            bottom_toolbar=self._toolbar,
            refresh_interval=_REFRESH_S,
            input=source,
            output=output,
        )

    def notice(self, error: HapticMasterError) -> None:
        """Tell at once, above the line that is being typed, what ended the loop; from any thread."""
        with self._lock:
            if not self._is_reading:
                return  # the command that runs raises it
            self._told = error
        self._show_failure(error)

    def run(self) -> None:
        """Read and carry out until Ctrl-D, ``quit``, or a second Ctrl-C.

        Raises:
            KeyboardInterrupt: Ctrl-C twice, or a signal that asks to end.
        """
        self._context.console.tell(_GREETING)
        while not self._context.is_over:
            try:
                line = self._read()
            except EOFError:
                return
            except EndRequested:
                raise
            except KeyboardInterrupt:
                self._interrupt()
                continue
            self._forget_told_failure()
            self._carry_out(line)

    def _read(self) -> str:
        with self._lock:
            self._is_reading = True
        try:
            with patch_stdout(raw=True):
                return self._session.prompt("drive> ")
        finally:
            with self._lock:
                self._is_reading = False

    def _carry_out(self, line: str) -> None:
        try:
            for command in commands(line):
                carry_out(self._context, command)
        except MotionStopped as stopped:
            self._context.console.tell(f"{stopped}; Ctrl-C again ends")
            self._was_interrupted = True
            return
        except KeyboardInterrupt:
            raise
        except (HapticMasterError, OSError) as error:
            self._context.console.clear()
            self._show_failure(error)
        self._was_interrupted = False

    def _interrupt(self) -> None:
        """Ctrl-C while nothing moves: hold an arm that is free; the second one ends."""
        if self._was_interrupted:
            raise KeyboardInterrupt
        self._was_interrupted = True
        drive = self._context.drive
        if drive.is_driving and drive.pilot is not None and not all(drive.pilot.engaged):
            drive.hold()
            self._context.console.tell("held; Ctrl-C again ends")
        else:
            self._context.console.tell("Ctrl-C again, or Ctrl-D, ends with the arm stopped")

    def _forget_told_failure(self) -> None:
        with self._lock:
            told, self._told = self._told, None
        if told is not None:
            self._context.drive.take_failure()

    def _toolbar(self) -> str:
        try:
            status = self._context.drive.status().line()
        except (HapticMasterError, OSError) as error:
            status = f"no answer: {error}"
        usage = hint(self._session.default_buffer.document.text_before_cursor, self._context.words)
        return f"{status}\n{usage}" if usage else status


class _WordCompleter(Completer):
    """Candidates from the one table of words."""

    def __init__(self, context: Context) -> None:
        self._context = context

    def get_completions(self, document: Document, complete_event: CompleteEvent) -> Iterable[Completion]:
        """Candidates for what stands before the cursor."""
        del complete_event
        line = document.text_before_cursor
        _, last = unfinished(line)
        for candidate in candidates(line, self._context.words, self._context.drive.effects):
            yield Completion(candidate.text, start_position=-len(last), display_meta=candidate.doc)


def is_terminal() -> bool:
    """Whether a person sits at both ends."""
    return sys.stdin.isatty() and sys.stderr.isatty()

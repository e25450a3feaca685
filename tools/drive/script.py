"""Lines from a pipe or a file: one after the other, until the end or the first that fails."""

from typing import TextIO

from hm_driver.errors import HapticMasterError
from tools.drive.language import commands
from tools.drive.surface import Context
from tools.drive.words import carry_out


def run_script(context: Context, lines: TextIO) -> None:
    """Carry out the commands of each line; nothing behind the first that fails is carried out.

    What the arm would do next depends on where the line that failed left it, so the rest is not tried.

    Raises:
        HapticMasterError: The first failure; a note names its line.
    """
    context.is_followed = True
    for number, line in enumerate(lines, start=1):
        try:
            for command in commands(line):
                carry_out(context, command)
                if context.is_over:
                    return
        except (HapticMasterError, OSError, KeyboardInterrupt) as error:
            error.add_note(f"line {number}: {line.strip()[:80]}; nothing behind it was carried out")
            raise
    failure = None if context.opened is None else context.opened.take_failure()
    if failure is not None:
        raise failure

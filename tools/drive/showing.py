"""Showing the state, and waiting: what words have in common that last."""

import math
import time

from tools.drive.language import Option, number
from tools.drive.status import DriveStatus
from tools.drive.surface import Context

SECONDS = Option(
    name="--seconds",
    doc="go on after this time; on the command line it ends with Ctrl-C without it",
    value=number("S", "time", "s", 0.0, 86400.0),
)


def watch(context: Context, seconds: float, *, as_json: bool = False, rate_hz: float = 0.0) -> None:
    """Show the state; in the prompt Ctrl-C ends the showing alone."""
    drive = context.drive

    def look() -> DriveStatus:
        failure = drive.take_failure()
        if failure is not None:
            raise failure
        return drive.status()

    try:
        context.console.watch(look, seconds=seconds, as_json=as_json, rate_hz=rate_hz)
    except KeyboardInterrupt as stop:
        if context.is_one_shot or type(stop) is not KeyboardInterrupt:
            raise


def stay(context: Context) -> None:
    """Leave what was brought about as it is, showing the state, until Ctrl-C or the loop's end."""
    drive = context.drive
    if not drive.is_driving:
        drive.ensure_loop()
        drive.release()
    context.console.tell("until Ctrl-C:")
    watch(context, math.inf)


def wait(context: Context, seconds: float) -> None:
    """Wait, with the state shown meanwhile; raises what ends the loop."""
    drive = context.drive
    ends = time.monotonic() + seconds
    while (remaining := ends - time.monotonic()) > 0.0:
        failure = drive.take_failure()
        if failure is not None:
            raise failure
        context.console.draw(lambda: drive.status().line())
        time.sleep(min(0.05, remaining))
    context.console.clear()

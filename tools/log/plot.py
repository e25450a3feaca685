"""From a log to a picture of signals, in a file or in the terminal."""

from collections.abc import Sequence
from pathlib import Path

from hm_driver.recording.reader import Recording
from tools.log import picture
from tools.log.curves import Curve, read_curves
from tools.log.signals import find_signals


def read(
    log: Path, names: Sequence[str], start: float | None = None, end: float | None = None
) -> list[Curve]:
    """Read the signals that names stand for, thinned for a picture.

    Raises:
        RecordingError: The log cannot be read, a name stands for none of its signals, or the range lies
            outside.
    """
    with Recording(log) as recording:
        return read_curves(recording, find_signals(recording, names), start, end)


def plot(
    log: Path,
    names: Sequence[str],
    target: Path,
    *,
    start: float | None = None,
    end: float | None = None,
    force: bool = False,
) -> None:
    """Draw signals into a file: ``.png``, ``.svg`` or ``.pdf``.

    Raises:
        RecordingError: as `read` does, or the file cannot be made.
    """
    picture.write(
        target,
        lambda: picture.draw(read(log, names, start, end), log.name),
        force=force,
        sources=(log,),
    )

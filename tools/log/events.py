"""The events of a log, as rows."""

from pathlib import Path
from typing import NamedTuple

from hm_driver.errors import RecordingError
from hm_driver.recording.reader import LOG_TIME, Recording
from hm_driver.recording.schemas import EVENT_LEVELS, EVENTS_CHANNEL


class EventRow(NamedTuple):
    """One event."""

    time_s: float
    """Time since the beginning of the log [s]."""
    level: str
    """``debug``, ``info``, ``warning`` or ``error``."""
    name: str
    """Its short name."""
    text: str
    """What happened."""


def events(path: Path, *, name: str | None = None, least: str = "debug") -> list[EventRow]:
    """The events of a log in the order of time.

    Args:
        path: The log.
        name: Only events of this name.
        least: Only events of this level or above.

    Raises:
        RecordingError: The log cannot be read, has no events, or none has this name or level.
    """
    if least not in EVENT_LEVELS:
        raise RecordingError(f"--level {least} is none of {', '.join(EVENT_LEVELS)}")
    with Recording(path) as recording:
        start_ns = recording.start_time_ns
        columns = recording.columns(EVENTS_CHANNEL.topic, names=("level", "name", "text"))
    names = {number: level for level, number in EVENT_LEVELS.items()}
    rows = [
        EventRow((int(time_ns) - start_ns) * 1e-9, names.get(int(level), str(level)), str(event), str(text))
        for time_ns, level, event, text in zip(
            columns[LOG_TIME], columns["level"], columns["name"], columns["text"], strict=True
        )
    ]
    rows.sort(key=lambda row: row.time_s)
    there = sorted({row.name for row in rows})
    if name is not None and name not in there:
        raise RecordingError(f"{path} has no event {name}; there are: {', '.join(there) or 'none'}")
    return [
        row
        for row in rows
        if name in (None, row.name) and EVENT_LEVELS.get(row.level, 4) >= EVENT_LEVELS[least]
    ]

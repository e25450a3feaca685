"""``hm log``: what a log holds, and how to make a damaged one readable."""

from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from tools.cli.console import tell, write, write_json, write_table

if TYPE_CHECKING:
    from hm_driver.recording.reader import Recording


def info(log: Path, /, *, json: Annotated[bool, Parameter(negative="")] = False) -> None:
    """Say what a log holds: time, topics with their rates, attachments, and whether it is whole.

    Args:
        log: MCAP file.
        json: One JSON object instead.
    """
    import hm_driver.recording

    with hm_driver.recording.open(log) as recording:
        if json:
            write_json(_summary(recording))
        else:
            _write_summary(recording)


def recover(source: Path, target: Path, /) -> None:
    """Copy all that can be read of a truncated or damaged log into a new one that is whole.

    Args:
        source: The damaged log; it is not changed.
        target: The new log; it must not exist.
    """
    from hm_driver.recording.recovery import recover as copy

    recovery = copy(source, target)
    for damage in recovery.damaged:
        tell(f"left out: {damage}")
    write(f"{target}: {recovery.messages} messages in {recovery.chunks} chunks")


def _summary(recording: "Recording") -> dict[str, object]:
    return {
        "path": str(recording.path),
        "is_whole": not recording.damage,
        "damage": recording.damage or None,
        "start_time_ns": recording.start_time_ns,
        "duration_s": recording.duration_s,
        "messages": sum(recording.counts.values()),
        "topics": recording.counts,
        "attachments": {name: len(data) for name, data in recording.attachments.items()},
        "metadata": recording.metadata,
    }


def _write_summary(recording: "Recording") -> None:
    start = datetime.fromtimestamp(recording.start_time_ns / 1e9, tz=UTC)
    write_table(
        (
            ("log", str(recording.path)),
            ("start", f"{start:%Y-%m-%d %H:%M:%S} UTC"),
            ("duration", f"{recording.duration_s:.2f} s"),
            ("messages", str(sum(recording.counts.values()))),
            ("whole", f"no: {recording.damage}" if recording.damage else "yes"),
        )
    )
    write("")
    write_table((topic, _rate(count, recording.duration_s)) for topic, count in recording.counts.items())
    write("")
    write_table((f"attachment {name}", f"{len(data)} bytes") for name, data in recording.attachments.items())
    for name, values in recording.metadata.items():
        write_table((f"{name}.{key}", value) for key, value in values.items())


def _rate(count: int, duration_s: float) -> str:
    often = f"  {(count - 1) / duration_s:.1f} Hz" if count > 1 and duration_s > 0.0 else ""
    return f"{count} messages{often}"

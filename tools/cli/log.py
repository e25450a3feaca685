"""``hm log``: what a log holds, whether it keeps what it must, and new logs made of it."""

from datetime import UTC, datetime
from pathlib import Path
from shutil import get_terminal_size
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from hm_driver.errors import RecordingError
from tools.cli.console import tell, write, write_json, write_table
from tools.cli.failures import ExitCode

if TYPE_CHECKING:
    from hm_driver.recording.reader import Recording

Flag = Annotated[bool, Parameter(negative="")]


def info(log: Path, /, *, json: Flag = False) -> None:
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


def check(log: Path, /, *, json: Flag = False) -> int:
    """Read the whole log and say which rules it keeps: whole, in order, nothing lost, within every limit.

    Limits are those of the configuration inside the log. Exit code 1 where a rule is broken.

    Args:
        log: MCAP file; its further parts are read with it.
        json: One JSON object instead.
    """
    from tools.log.check import check as judge

    findings = judge(log)
    broken = [finding for finding in findings if not finding.is_kept]
    if json:
        rows = [{"rule": one.rule, "is_kept": one.is_kept, "found": one.found} for one in findings]
        write_json({"log": str(log), "is_kept": not broken, "findings": rows})
    else:
        write_table(
            (("ok    " if one.is_kept else "BROKEN") + f"  {one.rule}", one.found) for one in findings
        )
        write(f"{len(findings) - len(broken)} of {len(findings)} rules are kept")
    return ExitCode.FAILED if broken else ExitCode.OK


def events(log: Path, /, *, name: str | None = None, level: str = "debug", json: Flag = False) -> None:
    """List what happened: updates, hand-overs, stages, trips.

    Args:
        log: MCAP file.
        name: Only events of this name.
        level: Only events of this level or above: debug, info, warning, error.
        json: One JSON object instead.
    """
    from tools.log.events import events as read

    rows = read(log, name=name, least=level)
    if json:
        write_json({"log": str(log), "events": [row._asdict() for row in rows]})
    else:
        write_table((f"{row.time_s:9.3f} s  {row.level:<7}  {row.name}", row.text) for row in rows)


def export(
    log: Path,
    target: Path,
    /,
    *,
    topic: list[str] | None = None,
    column: list[str] | None = None,
    start: float | None = None,
    end: float | None = None,
    force: Flag = False,
) -> None:
    """Write topics into a file for other programs: .csv, .parquet or .mat, by the suffix of the target.

    A CSV or Parquet file holds one topic; of several, each goes into a file of its own, TARGET-TOPIC. A
    MATLAB file holds each topic as a struct. The first column is the time since the beginning of the log [s].

    Args:
        log: MCAP file; its further parts are read with it.
        target: The file to write.
        topic: Export this topic; can be given several times. Default: all but those made for viewers.
        column: Export this column, or this vector; can be given several times. Default: all.
        start: First time, from the beginning of the log [s].
        end: Time at which to stop [s].
        force: Write over files that exist.
    """
    from tools.log.export import Selection
    from tools.log.export import export as write_files

    selection = Selection(topics=tuple(topic or ()), columns=tuple(column or ()), start=start, end=end)
    for path, messages in write_files(log, target, selection, force=force).items():
        write(f"{path}: {messages} messages")


def report(log: Path, /, *, output: Path | None = None, force: Flag = False) -> None:
    """Write the report of a session, from its log alone: one HTML file that loads nothing.

    Args:
        log: The session's MCAP file; it may be damaged.
        output: HTML file to write; by default beside the log, with its name.
        force: Write over a file that exists.
    """
    from tools.log.output import whole_file
    from tools.report import build_report

    path = output if output is not None else log.with_suffix(".html")
    with whole_file(path, force=force, sources=(log,)) as draft:
        build_report(log, draft)
    write(str(path))


def compare(
    *logs: Path,
    by: list[str] | None = None,
    output: Path | None = None,
    force: Flag = False,
    json: Flag = False,
) -> None:
    """Set sessions beside each other: their figures in a table, and their curves in one picture.

    Args:
        logs: The sessions' MCAP files.
        by: Group sessions that agree in this, and print means with their 95 % intervals: method, learner,
            task, seed, or any other key of the log's session record. Can be given several times.
        output: Write table and pictures into this file: .html, or the pictures alone as .svg.
        force: Write over a file that exists.
        json: One JSON object instead of the table.
    """
    from tools.log import comparison, comparison_page

    compared = comparison.compare(logs, by=tuple(by or ()))
    if output is not None:
        comparison_page.write(compared, output, force=force)
        tell(str(output))
    if json:
        write_json(compared.as_dict())
    else:
        write(comparison.as_text(compared))


def plot(
    log: Path,
    /,
    *signals: str,
    output: Path | None = None,
    start: float | None = None,
    end: float | None = None,
    force: Flag = False,
) -> None:
    """Draw signals over time, in the terminal or into a file. Each peak is in the picture.

    A long log is thinned to the smallest and the largest value of each of 2000 intervals.

    Args:
        log: MCAP file; its further parts are read with it.
        signals: Names such as /device/state.measured_force.z; the column alone where one topic has it, and a
            vector's name for its components.
        output: File to write instead: .png, .svg or .pdf.
        start: First time, from the beginning of the log [s].
        end: Time at which to stop [s].
        force: Write over a file that exists.
    """
    from tools.log.plot import plot as draw
    from tools.log.plot import read

    if not signals:
        raise RecordingError("name a signal or more behind the log, such as measured_force.z")
    if output is not None:
        draw(log, signals, output, start=start, end=end, force=force)
        write(str(output))
        return
    from tools.log.terminal import render

    size = get_terminal_size()
    write(render(read(log, signals, start, end), width=size.columns, height=size.lines))


def timing(
    log: Path,
    /,
    *,
    start: float | None = None,
    end: float | None = None,
    output: Path | None = None,
    force: Flag = False,
    json: Flag = False,
) -> None:
    """Say how punctual the loop was: lateness, response, execution, missed periods and drift.

    Args:
        log: MCAP file; its further parts are read with it.
        start: First time, from the beginning of the log [s].
        end: Time at which to stop [s].
        output: Draw a picture into this file too: .png, .svg or .pdf.
        force: Write over a file that exists.
        json: One JSON object instead of the table.
    """
    from tools.log import picture
    from tools.log import timing as timings
    from tools.log.timing_picture import draw

    found = timings.analyse(log, start, end)
    if output is not None:
        picture.write(
            output, lambda: draw(found, f"Timing of the loop: {log.name}"), force=force, sources=(log,)
        )
        tell(str(output))
    if json:
        write_json(found.as_dict())
    else:
        write_table(timings.as_rows(found))


def haptics(
    log: Path,
    /,
    *,
    start: float | None = None,
    end: float | None = None,
    output: Path | None = None,
    force: Flag = False,
    json: Flag = False,
) -> None:
    """Say what the hand felt: stiffness and damping of the springs, spectra of force and position, energies.

    Stiffness K, damping B and mass m are estimated from motion and force while a spring was engaged, and in
    free motion; behind ± stands half the 95 % interval.

    Args:
        log: MCAP file; its further parts are read with it.
        start: First time, from the beginning of the log [s].
        end: Time at which to stop [s].
        output: Draw a picture into this file too: .png, .svg or .pdf.
        force: Write over a file that exists.
        json: One JSON object instead of the table.
    """
    from tools.log import haptics as felt
    from tools.log import picture
    from tools.log.haptics_picture import draw

    found = felt.analyse(log, start, end)
    if output is not None:
        picture.write(
            output, lambda: draw(found, f"What the hand felt: {log.name}"), force=force, sources=(log,)
        )
        tell(str(output))
    if json:
        write_json(found.as_dict())
    else:
        write_table(felt.as_rows(found))


def cut(
    source: Path,
    target: Path,
    /,
    *,
    start: float | None = None,
    end: float | None = None,
    topic: list[str] | None = None,
    force: Flag = False,
) -> None:
    """Copy a piece of a log into a new one, with its configuration.

    Args:
        source: The log.
        target: The new log.
        start: First time, from the beginning of the log [s].
        end: Time at which to stop [s].
        topic: Keep this topic alone; can be given several times.
        force: Write over a target that exists.
    """
    from hm_driver.recording.editing import cut as copy
    from tools.log.output import whole_file

    with whole_file(target, force=force, sources=(source,)) as draft:
        messages = copy(source, draft, start, end, topics=topic)
    write(f"{target}: {messages} messages")


def merge(target: Path, /, *sources: Path, force: Flag = False) -> None:
    """Copy several logs, or the parts of one, into one new log.

    Args:
        target: The new log.
        sources: The logs; of a log in parts, its first file.
        force: Write over a target that exists.
    """
    from hm_driver.recording.editing import merge as copy
    from tools.log.output import whole_file

    if not sources:
        raise RecordingError("there is nothing to merge; name one log or more behind the target")
    with whole_file(target, force=force, sources=sources) as draft:
        messages = copy(sources, draft)
    write(f"{target}: {messages} messages")


def _summary(recording: "Recording") -> dict[str, object]:
    return {
        "path": str(recording.path),
        "parts": [str(part) for part in recording.parts],
        "is_whole": not recording.damage,
        "damage": recording.damage or None,
        "start_time_ns": recording.start_time_ns,
        "duration_s": recording.duration_s,
        "messages": sum(recording.counts.values()),
        "topics": recording.counts,
        "attachments": {name: len(data) for name, data in _attachments(recording).items()},
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
            ("parts", ", ".join(part.name for part in recording.parts[1:]) or "one"),
            ("lost", recording.metadata.get("recording", {}).get("lost", "not known: it was not finished")),
            ("whole", f"no: {recording.damage}" if recording.damage else "yes"),
        )
    )
    write("")
    write_table((topic, _rate(count, recording.duration_s)) for topic, count in recording.counts.items())
    write("")
    write_table(
        (f"attachment {name}", f"{len(data)} bytes") for name, data in _attachments(recording).items()
    )
    for name, values in recording.metadata.items():
        write_table((f"{name}.{key}", value) for key, value in values.items())


def _attachments(recording: "Recording") -> dict[str, bytes]:
    try:
        return recording.attachments
    except RecordingError as error:
        tell(f"hm: warning: {error}")
        return {}


def _rate(count: int, duration_s: float) -> str:
    often = f"  {(count - 1) / duration_s:.1f} Hz" if count > 1 and duration_s > 0.0 else ""
    return f"{count} messages{often}"

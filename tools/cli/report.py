"""``hm report``: from a log to one self-contained HTML file."""

from pathlib import Path

from tools.cli.console import write


def report(log: Path, /, *, output: Path | None = None) -> None:
    """Write the report of a session, from its log alone, and print the report's path.

    Args:
        log: The session's MCAP file.
        output: HTML file to write; by default beside the log, with its name.
    """
    from tools.report import build_report

    path = output if output is not None else log.with_suffix(".html")
    build_report(log, path)
    write(str(path))

"""What a comparison leaves: a file to send in, without a word about who or where."""

import json
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path

from hm_driver.errors import RecordingError
from hm_driver.version import __version__
from tools.check.comparison import Conversation, Finding, Verdict

FORMAT = "hm check 1"


def build_record(
    conversation: Conversation, findings: Sequence[Finding], *, active: bool
) -> dict[str, object]:
    """The record, for JSON: date, versions, findings, and every command with its reply.

    No address, name or path is in it.
    """
    return {
        "format": FORMAT,
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
        "software": __version__,
        "python": platform.python_version(),
        "system": f"{platform.system()} {platform.machine()}",
        "dialect": conversation.dialect,
        "active": active,
        "counts": {verdict.value: count(findings, verdict) for verdict in Verdict},
        "findings": [finding._asdict() | {"verdict": finding.verdict.value} for finding in findings],
        "exchanges": [exchange._asdict() for exchange in conversation.exchanges],
    }


def count(findings: Sequence[Finding], verdict: Verdict) -> int:
    """How many findings have this verdict."""
    return sum(finding.verdict is verdict for finding in findings)


def write_record(record: dict[str, object], path: Path) -> None:
    """Write the record as JSON.

    Raises:
        RecordingError: It cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(record, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise RecordingError(f"{path} cannot be written: {error.strerror or error}") from error

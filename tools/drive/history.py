"""Where the prompt remembers what was typed: the user's state directory, by the XDG rules."""

import os
from collections.abc import Mapping
from pathlib import Path

_FILE = Path("hapticmaster") / "drive-history"


def history_path(environment: Mapping[str, str] | None = None) -> Path | None:
    """The file, with its directory made; None where it cannot be written, so that nothing is remembered."""
    environment = os.environ if environment is None else environment
    given = Path(environment.get("XDG_STATE_HOME", ""))
    try:
        base = given if given.is_absolute() else Path.home() / ".local" / "state"
        path = base / _FILE
        path.parent.mkdir(parents=True, exist_ok=True, mode=0o700)
        with path.open("a", encoding="utf-8"):
            pass
    except (OSError, RuntimeError):  # no home, a read-only one, or a full disk
        return None
    return path

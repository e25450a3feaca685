"""Files that a command writes: nothing is written over unless the user says so."""

from pathlib import Path

from hm_driver.errors import RecordingError


def make_room(target: Path, *, force: bool, sources: tuple[Path, ...] = ()) -> None:
    """See to it that a file can be made.

    Args:
        target: The file to come.
        force: Whether one that is there may be removed.
        sources: Files that are read meanwhile; the target may be none of them.

    Raises:
        RecordingError: It is there and may not be removed, is a source, or its directory is not there.
    """
    if not target.parent.is_dir():
        raise RecordingError(f"{target.parent} is no directory; make it first, or choose another output")
    if not target.exists():
        return
    if any(target.samefile(source) for source in sources if source.exists()):
        raise RecordingError(f"{target} is read and cannot be written too; choose another output")
    if not force:
        raise RecordingError(
            f"{target} exists already; give --force to write over it, or choose another name"
        )
    if not target.is_file():
        raise RecordingError(f"{target} is no file; choose another output")
    target.unlink()

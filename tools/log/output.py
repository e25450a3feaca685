"""Files that a command writes: nothing is written over unasked, and none is left half written."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from hm_driver.errors import RecordingError


def check_room(target: Path, *, force: bool, sources: tuple[Path, ...] = ()) -> None:
    """See whether a file may be made.

    Args:
        target: The file to come.
        force: Whether one that is there may be written over.
        sources: Files that are read meanwhile; the target may be none of them.

    Raises:
        RecordingError: It is there and may not be written over, is a source, or its directory is not there.
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


@contextmanager
def whole_file(target: Path, *, force: bool, sources: tuple[Path, ...] = ()) -> Iterator[Path]:
    """A file to write, which becomes the target when it is whole; after an error the target is as it was.

    Raises:
        RecordingError: as `check_room` does.
    """
    check_room(target, force=force, sources=sources)
    draft = target.with_name(f".{target.name}.unfinished")
    draft.unlink(missing_ok=True)
    try:
        yield draft
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)

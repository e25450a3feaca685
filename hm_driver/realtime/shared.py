"""Memory that several processes share: a file that all of them map, named after the process that owns it.

``multiprocessing.shared_memory`` is not used: until Python 3.13 every process that attaches registers the
block with a resource tracker, which then removes it from under the others and warns about a leak. The owner
alone unlinks the file here; what a killed owner leaves behind is removed by the next one that starts.
"""

import contextlib
import mmap
import os
import secrets
import tempfile
from pathlib import Path
from typing import Self

from hm_driver.errors import ConfigurationError, LoopError

PREFIX = "hapticmaster-"


def shared_directory() -> Path:
    """Where shared blocks live: /dev/shm where there is one, else the directory for temporary files."""
    memory_file_system = Path("/dev/shm")  # noqa: S108  # mode 600, random name, exclusive creation below
    return memory_file_system if os.access(memory_file_system, os.W_OK) else Path(tempfile.gettempdir())


class SharedBlock:
    """A mapped file of fixed size; ``create`` owns it, ``attach`` borrows it.

    Args:
        mapping: The mapped bytes.
        path: The file.
        is_owner: Whether ``close`` removes the file.
    """

    __slots__ = ("_is_owner", "_mapping", "path")

    def __init__(self, mapping: mmap.mmap, path: Path, *, is_owner: bool) -> None:
        self._mapping = mapping
        self._is_owner = is_owner
        self.path = path

    @classmethod
    def create(cls, size: int, *, tag: str) -> Self:
        """Make a block of zeros, and remove what dead owners left.

        Args:
            size: Length in bytes.
            tag: Word for the file's name, such as ``segment``.

        Raises:
            ConfigurationError: The size is not positive.
            LoopError: The file system has no room for it.
        """
        if size <= 0:
            raise ConfigurationError("size", f"{size} bytes must be positive")
        remove_stale_blocks()
        path = shared_directory() / f"{PREFIX}{os.getpid()}-{tag}-{secrets.token_hex(6)}"
        fd = os.open(path, os.O_RDWR | os.O_CREAT | os.O_EXCL, 0o600)
        try:
            _reserve(fd, size)
            mapping = mmap.mmap(fd, size)
        except OSError as error:
            path.unlink()
            raise LoopError(f"no room for {size} bytes of shared memory in {path.parent}: {error}") from error
        finally:
            os.close(fd)
        return cls(mapping, path, is_owner=True)

    @classmethod
    def attach(cls, path: str | Path) -> Self:
        """Map a block that another process owns.

        Raises:
            LoopError: The block is gone: its owner ended.
        """
        try:
            fd = os.open(path, os.O_RDWR)
        except OSError as error:
            raise LoopError(f"the shared block {path} is gone: its owner has ended") from error
        try:
            mapping = mmap.mmap(fd, 0)
        finally:
            os.close(fd)
        return cls(mapping, Path(path), is_owner=False)

    @property
    def buffer(self) -> mmap.mmap:
        """The bytes; release every view of them before ``close``."""
        return self._mapping

    def close(self) -> None:
        """Unmap, and as the owner remove the file; idempotent."""
        if self._is_owner:
            self._is_owner = False
            self.path.unlink(missing_ok=True)
        with contextlib.suppress(BufferError):  # a view is still held: the mapping ends with it
            self._mapping.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def remove_stale_blocks() -> list[Path]:
    """Remove the blocks whose owner is no longer alive; returns their paths."""
    removed = []
    for path in shared_directory().glob(f"{PREFIX}*"):
        owner = path.name.removeprefix(PREFIX).partition("-")[0]
        if owner.isdigit() and not _is_alive(int(owner)):
            with contextlib.suppress(OSError):  # another user's, or already removed by another run
                path.unlink()
                removed.append(path)
    return removed


def _reserve(fd: int, size: int) -> None:
    """Give the file its size with every page allocated, so that no later write finds the disk full."""
    if hasattr(os, "posix_fallocate"):
        os.posix_fallocate(fd, 0, size)
    else:
        os.ftruncate(fd, size)


def _is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:  # alive, and another user's
        return True
    return True

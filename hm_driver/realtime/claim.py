"""One loop a device: a lock that ends with the process that holds it."""

import contextlib
import os
from pathlib import Path
from typing import Self

from hm_driver.errors import LoopError
from hm_driver.realtime.shared import PREFIX, shared_directory

_RETRIES = 10


class DeviceClaim:
    """The right of one loop of this machine to a device; a context manager.

    It does not see loops on other machines, and where the platform has no file locks it sees none.

    Args:
        url: The device, as the user named it.
    """

    __slots__ = ("_fd", "_path", "_url")

    def __init__(self, url: str) -> None:
        self._url = url
        name = "".join(c if c.isalnum() else "_" for c in url.partition("?")[0])
        self._path = shared_directory() / f"{PREFIX}claim-{_user()}-{name}"
        self._fd: int | None = None

    def __enter__(self) -> Self:
        remove_stale_claims()
        for _ in range(_RETRIES):
            fd = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
            if not _lock(fd):
                holder = os.pread(fd, 20, 0).decode(errors="replace").strip() or "unknown"
                os.close(fd)
                raise LoopError(
                    f"another loop (process {holder}) drives {self._url} already; "
                    "end it, or use another device"
                )
            if _is_at(fd, self._path):  # else its last holder removed it between our opening and locking
                os.pwrite(fd, f"{os.getpid():<20}".encode(), 0)
                self._fd = fd
                return self
            os.close(fd)
        raise LoopError(f"{self._path} changes all the time: too many loops start on {self._url}")

    def __exit__(self, *_: object) -> None:
        if self._fd is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._fd)
            self._fd = None


def remove_stale_claims() -> None:
    """Remove the files of claims whose holder was killed."""
    for path in shared_directory().glob(f"{PREFIX}claim-{_user()}-*"):
        with contextlib.suppress(OSError):
            fd = os.open(path, os.O_RDWR | os.O_CLOEXEC)
            try:
                if _lock(fd) and _is_at(fd, path):
                    path.unlink()
            finally:
                os.close(fd)


def _lock(fd: int) -> bool:
    try:
        import fcntl
    except ImportError:  # no file locks on this platform
        return True
    try:
        fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        return False
    return True


def _is_at(fd: int, path: Path) -> bool:
    """Whether the open file is the one at the path."""
    try:
        return os.path.samestat(os.fstat(fd), path.stat())
    except OSError:
        return False


def _user() -> int:
    return os.getuid() if hasattr(os, "getuid") else 0

"""One loop a device: a lock that ends with the process that holds it."""

import contextlib
import os
from pathlib import Path
from typing import Self

from hm_driver.errors import LoopError
from hm_driver.realtime.shared import PREFIX, shared_directory


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

    @property
    def path(self) -> Path:
        """The lock's file."""
        return self._path

    def __enter__(self) -> Self:
        try:
            import fcntl
        except ImportError:  # no file locks on this platform
            return self
        fd = os.open(self._path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        try:
            fcntl.flock(fd, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            holder = os.pread(fd, 20, 0).decode(errors="replace").strip() or "unknown"
            os.close(fd)
            raise LoopError(
                f"another loop (process {holder}) drives {self._url} already; end it, or use another device"
            ) from error
        os.ftruncate(fd, 0)
        os.pwrite(fd, str(os.getpid()).encode(), 0)
        self._fd = fd
        return self

    def __exit__(self, *_: object) -> None:
        if self._fd is not None:
            with contextlib.suppress(OSError):
                self._path.unlink()
            os.close(self._fd)
            self._fd = None


def _user() -> int:
    return os.getuid() if hasattr(os, "getuid") else 0

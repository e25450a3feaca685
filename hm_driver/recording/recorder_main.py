"""What happens inside the recorder's process: drain, write, sync, and end with a complete file."""

import contextlib
import mmap
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path

from hm_driver.errors import RecordingError
from hm_driver.recording.ring import Ring
from hm_driver.recording.schemas import Bundle, Channel
from hm_driver.recording.spooler import Spooler
from hm_driver.recording.writer import Attachment, Compression, LogWriter

_POLL_S = 0.01
_BUSY_RECORDS = 500  # more than this at once: do not sleep, the rings fill quickly


@dataclass(frozen=True, slots=True)
class RingSource:
    """Where the recorder finds a ring.

    Args:
        path: File that holds the shared memory.
        offset: Where the ring begins in it [B], a multiple of eight.
        size: Bytes of the ring with its header; None for the rest of the file.
    """

    path: str | Path
    offset: int = 0
    size: int | None = None

    @contextlib.contextmanager
    def open(self) -> Iterator[Ring]:
        """The ring, for its reader.

        Raises:
            RecordingError: if the memory is gone or holds no ring.
        """
        try:
            with Path(self.path).open("r+b") as file:
                mapping = mmap.mmap(file.fileno(), 0)
        except (OSError, ValueError) as error:
            raise RecordingError(f"the ring in {self.path} cannot be opened: {error}") from error
        end = len(mapping) if self.size is None else self.offset + self.size
        with (
            contextlib.closing(mapping),
            memoryview(mapping) as whole,
            whole[self.offset : end] as part,
            Ring(part) as ring,
        ):
            yield ring


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderOptions:
    """How the recorder writes."""

    compression: Compression = Compression.ZSTD
    """How chunks are compressed."""
    chunk_bytes: int = 1 << 18
    """Size at which a chunk ends, uncompressed [B]."""
    sync_interval_s: float = 0.5
    """Most that a power cut may lose [s of wall time]."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderStatus:
    """What the recorder has done so far, or in all."""

    path: Path
    """The file that is being written."""
    messages: int = 0
    """Messages written."""
    lost: int = 0
    """Messages dropped because a ring was full, or not written because the disk failed."""
    bytes: int = 0
    """Size of the file [B]."""
    problem: str = ""
    """Why nothing is written any more; empty while all is well."""
    is_final: bool = False
    """Whether the file is finished and the process about to end."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RecorderJob:
    """Everything that the process is told at its start."""

    path: Path
    """The file to make."""
    rings: tuple[RingSource, ...]
    """Where the records come from."""
    channels: tuple[Channel, ...]
    """Every channel that may come."""
    bundles: tuple[Bundle, ...]
    """Bundles that may come."""
    metadata: dict[str, dict[str, str]]
    """Records of metadata, by name."""
    attachments: tuple[Attachment, ...]
    """Files inside the log."""
    options: RecorderOptions
    """How to write."""
    part: int = 1
    """Which part of the log this is; the first unless a recorder died."""


class _Terminated:
    """Whether somebody asked the process to end."""

    def __init__(self) -> None:
        self.is_set = False
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, self._set)

    def _set(self, *_: object) -> None:
        self.is_set = True


def run_recorder(link: Connection, job: RecorderJob) -> None:
    """Main function of the process: drain the rings until told to stop, or until the parent is gone."""
    terminated = _Terminated()
    with contextlib.ExitStack() as stack:
        try:
            rings = [stack.enter_context(source.open()) for source in job.rings]
            writer = LogWriter(
                job.path,
                job.channels,
                metadata=job.metadata,
                attachments=job.attachments,
                compression=job.options.compression,
                chunk_bytes=job.options.chunk_bytes,
            )
        except (OSError, ValueError) as error:
            link.send(RecorderStatus(path=job.path, problem=str(error)))
            return
        spooler = Spooler(rings, writer, job.bundles, is_continued=job.part > 1)
        session = _Session(link, rings, writer, spooler, job.options)
        link.send(session.status())
        session.run(terminated)


class _Session:
    """The recorder's life between its start and its last word."""

    def __init__(
        self,
        link: Connection,
        rings: Sequence[Ring],
        writer: LogWriter,
        spooler: Spooler,
        options: RecorderOptions,
    ) -> None:
        self._link = link
        self._rings = rings
        self._writer = writer
        self._spooler = spooler
        self._sync_interval_s = options.sync_interval_s
        self._unwritten = 0
        self._problem = ""

    def run(self, terminated: _Terminated) -> None:
        last_sync = time.monotonic()
        while not (self._is_asked_to_stop() or terminated.is_set):
            moved = self._spool()
            now = time.monotonic()
            if now - last_sync >= self._sync_interval_s:
                self._guarded(self._writer.sync)
                last_sync = now
            if moved < _BUSY_RECORDS:
                time.sleep(_POLL_S)
        while self._spool():
            pass
        self._guarded(self._finish)
        with contextlib.suppress(OSError):
            self._link.send(replace(self.status(), is_final=True))

    def status(self) -> RecorderStatus:
        return RecorderStatus(
            path=self._writer.path,
            messages=self._spooler.messages - self._unwritten,
            lost=self._spooler.lost + self._unwritten,
            bytes=self._writer.bytes_written,
            problem=self._problem,
        )

    def _spool(self) -> int:
        if self._problem:
            thrown = self._spooler.discard()
            self._unwritten += thrown
            return thrown
        return self._guarded(self._spooler.spool)

    def _guarded(self, action: Callable[[], int | None]) -> int:
        if self._problem:
            return 0
        try:
            return action() or 0
        except OSError as error:
            self._problem = f"{self._writer.path}: {error.strerror or error}"
            self._unwritten = self._spooler.messages - self._writer.messages_written
            self._writer.abandon()
            return 1

    def _finish(self) -> None:
        self._writer.add_metadata(
            "recording",
            {"messages": str(self._spooler.messages), "lost": str(self._spooler.lost)},
        )
        self._writer.finish()

    def _is_asked_to_stop(self) -> bool:
        try:
            while self._link.poll():
                if self._link.recv() == "stop":
                    return True
                self._link.send(self.status())
        except (EOFError, OSError):  # the parent is gone
            return True
        return False

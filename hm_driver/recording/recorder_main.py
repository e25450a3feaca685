"""What happens inside the recorder's process: drain, write, sync, and end with a complete file."""

import contextlib
import math
import mmap
import signal
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path

from hm_driver.errors import ConfigurationError, RecordingError
from hm_driver.realtime.child import receive_argument
from hm_driver.recording.derivation import Deriver
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
    split_bytes: float = math.inf
    """Size from which on the log goes on in another part [B]."""
    split_s: float = math.inf
    """Duration after which the log goes on in another part [s of wall time]."""

    def __post_init__(self) -> None:
        for name, least in (("chunk_bytes", 1024), ("split_bytes", 1 << 16)):
            if not getattr(self, name) >= least:
                raise ConfigurationError(name, f"{getattr(self, name)} B must be {least} B or more")
        for name, least_s in (("sync_interval_s", 0.001), ("split_s", 1.0)):
            if not getattr(self, name) >= least_s:
                raise ConfigurationError(name, f"{getattr(self, name)} s must be {least_s} s or more")


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


@dataclass(slots=True, kw_only=True)
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
    derivers: tuple[Deriver, ...]
    """Make further messages of those that come."""
    metadata: dict[str, dict[str, str]]
    """Records of metadata, by name."""
    attachments: tuple[Attachment, ...]
    """Files inside the log."""
    options: RecorderOptions
    """How to write."""
    link_fd: int = -1
    """Descriptor of the connection to the parent, in the recorder's process."""
    part: int = 1
    """Which part of the log comes first; the second or a later one where a recorder died before."""

    def open_part(self) -> LogWriter:
        """Make the file of the first part from `part` on that is not there yet.

        Raises:
            RecordingError: if it cannot be made, or `path` exists and is to be the first.
        """
        part = self.part
        while part > 1 and part_path(self.path, part).exists():
            part += 1
        self.part = part + 1
        return LogWriter(
            part_path(self.path, part),
            (*self.channels, *(made for deriver in self.derivers for made in deriver.channels)),
            metadata={**self.metadata, "part": {"number": str(part), "log": self.path.name}},
            attachments=self.attachments,
            compression=self.options.compression,
            chunk_bytes=self.options.chunk_bytes,
        )


def part_path(path: Path, part: int) -> Path:
    """The file of a part of a log: the log's own for the first, ``NAME.partN.mcap`` for others."""
    return path if part == 1 else path.with_suffix(f".part{part}{path.suffix}")


class _Terminated:
    """Whether somebody asked the process to end."""

    def __init__(self) -> None:
        self.is_set = False
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, self._set)

    def _set(self, *_: object) -> None:
        self.is_set = True


def run_recorder() -> None:
    """Main function of the process: drain the rings until told to stop, or until the parent is gone."""
    job = receive_argument()
    if not isinstance(job, RecorderJob):
        raise SystemExit(f"the recorder was started without a job: {job!r}")
    terminated = _Terminated()
    with contextlib.ExitStack() as stack:
        link = stack.enter_context(Connection(job.link_fd))
        try:
            rings = [stack.enter_context(source.open()) for source in job.rings]
            is_continued = job.part > 1
            writer = job.open_part()
        except (OSError, ValueError) as error:
            link.send(RecorderStatus(path=job.path, problem=str(error)))
            return
        spooler = Spooler(rings, writer, job.bundles, job.derivers, is_continued=is_continued)
        session = _Session(link, writer, spooler, job)
        link.send(session.status())
        session.run(terminated)


class _Session:
    """The recorder's life between its start and its last word."""

    def __init__(
        self,
        link: Connection,
        writer: LogWriter,
        spooler: Spooler,
        job: RecorderJob,
    ) -> None:
        self._link = link
        self._writer = writer
        self._spooler = spooler
        self._job = job
        self._options = job.options
        self._began = time.monotonic()
        self._written = 0
        self._unwritten = 0
        self._problem = ""

    def run(self, terminated: _Terminated) -> None:
        last_sync = time.monotonic()
        while not (self._is_asked_to_stop() or terminated.is_set):
            moved = self._spool()
            now = time.monotonic()
            if now - last_sync >= self._options.sync_interval_s:
                self._guarded(self._sync)
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
            written = self._written + self._writer.messages_written
            self._unwritten = max(0, self._spooler.messages + self._spooler.derived - written)
            self._writer.abandon()
            return 1

    def _sync(self) -> None:
        self._spooler.settle()
        self._writer.sync()
        options, age_s = self._options, time.monotonic() - self._began
        if self._writer.bytes_written >= options.split_bytes or age_s >= options.split_s:
            self._split()

    def _split(self) -> None:
        following = self._job.open_part()
        self._finish()
        self._written += self._writer.messages_written
        self._spooler.follow(following)
        self._writer, self._began = following, time.monotonic()

    def _finish(self) -> None:
        self._spooler.settle()
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

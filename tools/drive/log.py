"""The log of a drive: the loop's records and what was typed, written by the recorder's process."""

import contextlib
import json
import platform
import time
from contextlib import ExitStack
from dataclasses import asdict
from datetime import UTC, datetime
from enum import Enum
from pathlib import Path

from hm_driver.errors import ConfigurationError, RecordingError
from hm_driver.realtime.shared import SharedBlock
from hm_driver.recording.recorder import RecorderProcess, RecorderStatus, RingSource
from hm_driver.recording.ring import Ring
from hm_driver.recording.schemas import DEVICE_CHANNELS, EVENT, EVENT_LEVELS, EVENTS_CHANNEL
from hm_driver.recording.writer import Attachment
from hm_driver.version import __version__
from tools.drive.options import DriveOptions

_LOOP_RING_BYTES = 1 << 23
_OWN_RING_BYTES = 1 << 18


class DriveLog:
    """Recordings of a drive, one after the other; a context manager whose end finishes the one under way.

    Each has rings of its own. A loop writes into the ring that there is when it starts.

    Args:
        device: Address of the device, for the metadata.
        options: The configuration, which goes into the log.
    """

    def __init__(self, device: str, options: DriveOptions) -> None:
        self._device = device
        self._options = options
        self._blocks = ExitStack()
        self._recorder: RecorderProcess | None = None
        self._ring: Ring | None = None
        self._events = 0
        self.epoch_ns = time.time_ns() - time.monotonic_ns()
        """Unix time minus the loop's clock [ns]."""
        self.path: Path | None = None
        """The log that is being written."""
        self.loop_ring = ""
        """Path of the ring for the loop's records; empty while nothing is recorded."""

    def __enter__(self) -> "DriveLog":
        return self

    def __exit__(self, *_: object) -> None:
        if self._recorder is not None:
            self.finish()

    def start(self, path: Path) -> None:
        """Begin a log.

        Raises:
            ConfigurationError: One is being written, or the file exists.
            RecordingError: It cannot be written.
        """
        if self._recorder is not None:
            raise ConfigurationError("record", f"{self.path} is being written; 'record stop' first")
        if path.exists():
            raise ConfigurationError("record", f"{path} exists and is not overwritten; choose another name")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(f"{path.parent} cannot be made: {error.strerror}; choose another") from error
        with ExitStack() as stack:
            sizes = (_LOOP_RING_BYTES, _OWN_RING_BYTES)
            blocks = [stack.enter_context(SharedBlock.create(size, tag="ring")) for size in sizes]
            for block in blocks:
                Ring.format(memoryview(block.buffer))
            ring = stack.enter_context(Ring(memoryview(blocks[1].buffer)))
            recorder = RecorderProcess(
                path,
                rings=[RingSource(block.path) for block in blocks],
                channels=DEVICE_CHANNELS,
                metadata={"session": self._metadata()},
                attachments=[self._configuration()],
            )
            recorder.start()
            self._recorder, self._ring, self._events = recorder, ring, 0
            self.path, self.loop_ring = path, str(blocks[0].path)
            self._blocks = stack.pop_all()

    def finish(self) -> RecorderStatus:
        """Have everything written and the file closed.

        Raises:
            ConfigurationError: Nothing is being recorded.
            RecordingError: The recorder died or its disk failed; what was written stays readable.
        """
        if self._recorder is None:
            raise ConfigurationError("record", "nothing is being recorded; 'record FILE.mcap' begins")
        recorder, path = self._recorder, self.path
        self._recorder, self._ring, self.path, self.loop_ring = None, None, None, ""
        try:
            status = recorder.stop()
        finally:
            recorder.close()
            self._blocks.close()
        if status.problem:
            raise RecordingError(f"the log is not complete: {status.problem}; keep {path}")
        return status

    def event(self, name: str, text: str, *, level: str = "info") -> None:
        """Note something that happened now, such as a line that was typed."""
        if self._recorder is None or self._ring is None:
            return
        self._events += 1
        time_ns = time.monotonic_ns() + self.epoch_ns
        payload = EVENT.pack(self._events, time_ns, EVENT_LEVELS[level], name, text, [])
        self._ring.write(EVENTS_CHANNEL.id, time_ns, payload)

    def _metadata(self) -> dict[str, str]:
        return {
            "version": __version__,
            "clock": "wall",
            "device": self._device,
            "program": "hm drive",
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "host": platform.node(),
            "system": platform.platform(),
            "python": platform.python_version(),
        }

    def _configuration(self) -> Attachment:
        data = json.dumps(asdict(self._options), default=_plain).encode()
        return Attachment(name="config.json", data=data, media_type="application/json")


def free_log(directory: Path) -> Path:
    """A name in a directory that no log has yet."""
    stamp = datetime.now(UTC).strftime("%Y%m%d-%H%M%S")
    candidates = (
        directory / f"drive-{stamp}{suffix}.mcap" for suffix in ("", *(f"-{n}" for n in range(2, 100)))
    )
    with contextlib.suppress(StopIteration):
        return next(path for path in candidates if not path.exists())
    raise RecordingError(f"{directory} has no free name; name the log")


def _plain(value: object) -> object:
    return value.value if isinstance(value, Enum) else str(value)

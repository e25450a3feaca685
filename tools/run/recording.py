"""The log of a session: rings in shared memory, the recorder's process, and what it is told at the start."""

import contextlib
import json
import platform
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from hm_driver.errors import RecordingError
from hm_driver.realtime.shared import SharedBlock
from hm_driver.recording.derivation import ArmDeriver
from hm_driver.recording.recorder import RecorderProcess, RecorderStatus, RingSource
from hm_driver.recording.ring import Ring, WhenFull
from hm_driver.recording.schemas import DEVICE_CHANNELS
from hm_driver.recording.writer import Attachment
from hm_driver.version import __version__
from teaching.messages import CHANNELS
from tools.config_text import to_dict
from tools.run.request import TeachRequest
from tools.run.scene import SceneDeriver

RING_BYTES = 1 << 23
"""Memory of a ring [B]: more than 10 s of the loop at 1 kHz."""


@dataclass(slots=True)
class SessionRecording:
    """A session's recording while it runs."""

    path: Path
    """The log."""
    ring: Ring
    """Ring of the session's own messages."""
    loop_ring: Path | None
    """File of the loop's ring, where the loop has one of its own."""
    recorder: RecorderProcess
    tell: Callable[[str], None]
    """Where the user is told of a recorder that died, or of a disk that fails."""

    def wait_until_open(self) -> None:
        """Wait for the recorder, which starts while the caller does something else.

        Raises:
            RecordingError: The log cannot be written.
        """
        self.recorder.wait_until_open()
        self.recorder.tend(self.tell)

    def finish(self) -> RecorderStatus:
        """Have everything written and the file closed.

        Raises:
            RecordingError: The recorder died or its disk failed; what was written stays readable.
        """
        status = self.recorder.stop()
        if status.problem:
            raise RecordingError(
                f"the log is not complete: {status.problem}; free some space, keep {self.path}"
            )
        return status


@contextlib.contextmanager
def open_recording(
    request: TeachRequest,
    *,
    name: str,
    clock: str,
    device: str,
    is_lockstep: bool,
    tell: Callable[[str], None],
) -> Iterator[SessionRecording]:
    """Open rings and start the recorder of a session; whatever ends it, what is in the rings is written.

    The caller waits for the recorder by `SessionRecording.wait_until_open`.

    Args:
        request: The session.
        name: Name of the log in the output directory, without suffix.
        clock: ``wall`` or ``virtual``.
        device: Address of the device, for the metadata.
        is_lockstep: One ring for loop and session, which blocks instead of dropping.
        tell: Where the user is told of what befalls the recorder; called from a thread.

    Raises:
        RecordingError: The log cannot be written.
    """
    path = request.output / f"{name}.mcap"
    session = {
        "version": __version__,
        "clock": clock,
        "seed": str(request.seed),
        "device": device,
        "hand": request.hand.value,
        "task": request.task.name,
        "method": request.options.method.value,
        "learner": request.options.learner.kind.value,
        "arbitration": request.options.arbitration.kind.value,
    }
    if not is_lockstep:
        session |= {
            "started": datetime.now(UTC).isoformat(timespec="seconds"),
            "host": platform.node(),
            "system": platform.platform(),
            "python": platform.python_version(),
        }
    attachments = [
        _attachment("config.json", to_dict(request.options)),
        _attachment("task.json", request.task.to_dict()),
    ]
    with contextlib.ExitStack() as stack:
        try:
            request.output.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise RecordingError(
                f"{request.output} cannot be made: {error}; choose another --output"
            ) from error
        blocks = [
            stack.enter_context(SharedBlock.create(RING_BYTES, tag="ring"))
            for _ in range(1 if is_lockstep else 2)
        ]
        for block in blocks:
            Ring.format(memoryview(block.buffer))
        recorder = RecorderProcess(
            path,
            rings=[RingSource(block.path) for block in blocks],
            channels=(*DEVICE_CHANNELS, *CHANNELS),
            derivers=(
                ArmDeriver(request.options.geometry),
                SceneDeriver(request.task, w_th=request.options.arbitration.w_th),
            ),
            metadata={"session": session},
            attachments=attachments,
        )
        when_full = WhenFull.BLOCK if is_lockstep else WhenFull.DROP
        ring = stack.enter_context(Ring(memoryview(blocks[0].buffer), when_full=when_full))
        recorder.launch()
        stack.callback(recorder.close)
        yield SessionRecording(path, ring, None if is_lockstep else blocks[1].path, recorder, tell)


def _attachment(name: str, value: dict[str, Any]) -> Attachment:
    return Attachment(name=name, data=json.dumps(value).encode(), media_type="application/json")

"""The recorder: a process of its own that drains rings into an MCAP file.

It cannot disturb the loop, survives Ctrl-C, and ends by itself with a complete file when its parent is gone.
"""

import contextlib
import signal
import subprocess
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path

from hm_driver.errors import RecordingError
from hm_driver.realtime.child import spawn
from hm_driver.recording.derivation import Deriver
from hm_driver.recording.recorder_main import (
    RecorderJob,
    RecorderOptions,
    RecorderStatus,
    RingSource,
    part_path,
    run_recorder,
)
from hm_driver.recording.schemas import DEVICE_CHANNELS, LOOP_BUNDLE, Bundle, Channel
from hm_driver.recording.writer import Attachment

_WATCH_S = 0.2
"""How often a recorder that is tended is looked after [s]."""

__all__ = ["RecorderOptions", "RecorderProcess", "RecorderStatus", "RingSource"]


class RecorderProcess:
    """A recorder, started and stopped by the session; a context manager.

    Args:
        path: The log; what follows a crash of the recorder gets ``.part2`` and so on before its suffix.
        rings: Where the records come from.
        channels: Every channel that may come.
        bundles: Bundles that may come.
        derivers: Make further messages of those that come, in the recorder's process.
        metadata: Records of metadata, by name: what is known at the start.
        attachments: Files inside the log, such as the configuration.
        options: How to write.
    """

    def __init__(
        self,
        path: str | Path,
        *,
        rings: Sequence[RingSource],
        channels: Sequence[Channel] = DEVICE_CHANNELS,
        bundles: Sequence[Bundle] = (LOOP_BUNDLE,),
        derivers: Sequence[Deriver] = (),
        metadata: Mapping[str, Mapping[str, str]] | None = None,
        attachments: Sequence[Attachment] = (),
        options: RecorderOptions | None = None,
    ) -> None:
        self._job = RecorderJob(
            path=Path(path),
            rings=tuple(rings),
            channels=tuple(channels),
            bundles=tuple(bundles),
            derivers=tuple(derivers),
            metadata={name: dict(values) for name, values in (metadata or {}).items()},
            attachments=tuple(attachments),
            options=options or RecorderOptions(),
        )
        self._parts = 0
        self._process: subprocess.Popen[bytes] | None = None
        self._link: Connection | None = None
        self._status = RecorderStatus(path=self._job.path)
        self._is_asked = False
        self._lock = threading.RLock()
        self._has_ended = threading.Event()
        self._watcher: threading.Thread | None = None

    @property
    def pid(self) -> int | None:
        """Process id, None before the start."""
        return self._process.pid if self._process else None

    @property
    def is_alive(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.poll() is None

    def start(self, timeout_s: float = 20.0) -> None:
        """Start the process and wait until the file is open.

        Raises:
            RecordingError: if the file cannot be made, a ring not be opened, or the process does not come up.
        """
        self.launch()
        self.wait_until_open(timeout_s)

    def launch(self) -> None:
        """Start the process and return at once: what is written into the rings waits for it.

        Raises:
            RecordingError: if it was started already.
        """
        if self._process is not None:
            raise RecordingError("the recorder was started already")
        self._launch()

    def wait_until_open(self, timeout_s: float = 20.0) -> None:
        """Wait until the file is open; raises as `start` does."""
        link = self._link
        if link is None:
            raise RecordingError("the recorder is not running")
        try:
            answer = link.recv() if link.poll(timeout_s) else None
        except EOFError:
            answer = None
        if not isinstance(answer, RecorderStatus) or answer.problem:
            self._end()
            reason = answer.problem if answer else f"it did not come up within {timeout_s:g} s"
            raise RecordingError(f"the recorder could not start: {reason}")
        self._status = answer

    def _launch(self) -> None:
        self._parts += 1
        link, other = Pipe()
        job = replace(self._job, part=self._parts, link_fd=other.fileno())
        with other, _interrupts_blocked():
            process = spawn(run_recorder.__module__, run_recorder.__name__, job, pass_fds=[other.fileno()])
        self._process, self._link, self._is_asked = process, link, False
        self._status = RecorderStatus(path=part_path(job.path, self._parts))

    def tend(self, tell: Callable[[str], None]) -> None:
        """From now on restart the process where it dies; what it did not write waits in the rings.

        Args:
            tell: Called from the thread with what a user should know: a restart, or a disk that fails.
        """
        self._watcher = threading.Thread(
            target=self._watch, args=(tell,), name="hm-recorder-watch", daemon=True
        )
        self._watcher.start()

    def _watch(self, tell: Callable[[str], None]) -> None:
        told = ""
        while not self._has_ended.wait(_WATCH_S):
            with self._lock:
                if self._has_ended.is_set():
                    return
                try:
                    if self.restart_if_dead():
                        tell(f"the recorder died; the log goes on in {self._status.path.name}")
                except RecordingError as error:
                    tell(f"the log ends here, the device goes on: {error}")
                    return
                problem = self.status().problem
            if problem and problem != told:
                tell(f"nothing more is logged, the device goes on: {problem}")
                told = problem

    def status(self) -> RecorderStatus:
        """The last that the recorder told; asks for news without waiting for them."""
        with self._lock:
            if self._link is not None and self.is_alive:
                with contextlib.suppress(OSError, EOFError):
                    while self._link.poll():
                        self._status = self._link.recv()
                        self._is_asked = False
                    if not self._is_asked:
                        self._link.send("status")
                        self._is_asked = True
            return self._status

    def restart_if_dead(self, timeout_s: float = 20.0) -> bool:
        """Go on in a new part if the process died, with what the rings hold; returns whether it had died.

        Raises:
            RecordingError: if the new process does not come up.
        """
        if self._process is None or self._process.poll() is None:
            return False
        self._end()
        self._launch()
        self.wait_until_open(timeout_s)
        return True

    def stop(self, timeout_s: float = 60.0) -> RecorderStatus:
        """Have everything that is in the rings written and the file finished; returns the final count.

        Raises:
            RecordingError: if the process has died or does not end in time.
        """
        self._stop_watching()
        if self._process is None or self._link is None:
            raise RecordingError("the recorder is not running")
        try:
            self._link.send("stop")
            final = _receive_final(self._link, timeout_s)
        except (OSError, EOFError) as error:
            code = _exit_code(self._process, 1.0)
            raise RecordingError(
                f"the recorder died (exit code {code}); {self._status.path} is readable up to its last flush"
            ) from error
        finally:
            self.close()
        self._status = final
        return final

    def close(self) -> None:
        """End the process whatever it does; idempotent. What it has not written is lost: `stop` first."""
        self._stop_watching()
        self._end()

    def _stop_watching(self) -> None:
        self._has_ended.set()
        if self._watcher is not None and self._watcher is not threading.current_thread():
            self._watcher.join()

    def _end(self) -> None:
        if self._link is not None:
            self._link.close()
            self._link = None
        if self._process is not None:
            if self._process.stdin is not None:
                self._process.stdin.close()
            if _exit_code(self._process, 5.0) is None:  # the closed connection tells it to finish the file
                self._process.kill()
                self._process.wait()
            self._process = None

    def __enter__(self) -> "RecorderProcess":
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@contextlib.contextmanager
def _interrupts_blocked() -> Iterator[None]:
    """Ctrl-C must not reach a child before it ignores it: the child inherits the mask."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _exit_code(process: "subprocess.Popen[bytes]", timeout_s: float) -> int | None:
    with contextlib.suppress(subprocess.TimeoutExpired):
        return process.wait(timeout_s)
    return None


def _receive_final(link: Connection, timeout_s: float) -> RecorderStatus:
    deadline = time.monotonic() + timeout_s
    while link.poll(max(0.0, deadline - time.monotonic())):
        status: RecorderStatus = link.recv()
        if status.is_final:
            return status
    raise RecordingError(f"the recorder did not finish its file within {timeout_s:g} s")

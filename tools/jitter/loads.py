"""What runs beside the loop in a scenario: a context manager each, which tells afterwards what it did."""

import contextlib
import gc
import io
import os
import subprocess
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from pathlib import Path

from hm_driver.errors import LoopError
from hm_driver.realtime.child import parent_is_gone, receive_argument, spawn
from hm_driver.realtime.shared import SharedBlock
from hm_driver.recording.recorder import RecorderOptions, RecorderProcess, RingSource
from hm_driver.recording.ring import Ring
from hm_driver.recording.schemas import DEVICE_STATE, DEVICE_STATE_CHANNEL, LOOP_BUNDLE
from tools.jitter.options import Load

MESSAGES_HZ = 5000
"""What the recording scenario writes in a second."""
FRAMES_HZ = 60
_RING_BYTES = 1 << 23
_HEAP_OBJECTS = 200_000
_GIL_CALL_S = 0.02
_PART_BYTES = 64 << 20
_PARTS_KEPT = 2


class Signals:
    """When the loads of a scenario begin and end: all at once, so that none slows another's start."""

    def __init__(self) -> None:
        self.go = threading.Event()
        self.done = threading.Event()


class Tally:
    """What a load did, filled in while it runs."""

    def __init__(self, signals: Signals) -> None:
        self.signals = signals
        self.text = ""
        """One line, complete when the load has ended."""


class RecordingLoad:
    """A real recorder that takes the loop's records and messages of the application; runs from the first.

    Args:
        rate_hz: Rate of the loop, which writes three messages a cycle.
    """

    def __init__(self, rate_hz: float) -> None:
        self._stack = contextlib.ExitStack()
        self._directory = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="hm-jitter-")))
        self._blocks = [
            self._stack.enter_context(SharedBlock.create(_RING_BYTES, tag="ring")) for _ in range(2)
        ]
        for block in self._blocks:
            Ring.format(memoryview(block.buffer))
        self._rate_hz = max(500.0, MESSAGES_HZ - len(LOOP_BUNDLE.channels) * rate_hz)
        self._recorder = RecorderProcess(
            self._directory / "jitter.mcap",
            rings=[RingSource(block.path) for block in self._blocks],
            options=RecorderOptions(split_bytes=_PART_BYTES),
        )
        self._stack.callback(self._recorder.close)
        self._began, self._before = time.monotonic(), 0
        try:
            self._recorder.start()
        except BaseException:
            self.close()
            raise

    @property
    def loop_ring(self) -> str:
        """Path of the ring that the loop writes."""
        return str(self._blocks[0].path)

    @contextlib.contextmanager
    def running(self, tally: Tally) -> Iterator[None]:
        """Record, with a thread of the application writing in batches of 10 ms as a session does."""
        with Ring(memoryview(self._blocks[1].buffer)) as ring:
            with _thread("recording", lambda done: self._write(ring, done), tally.signals):
                yield
            seconds = time.monotonic() - self._began
            status = self._recorder.stop()
            problem = f", {status.problem}" if status.problem else ""
            rate = (status.messages - self._before) / max(seconds, 1e-3)
            tally.text = f"recording: {rate:.0f} messages/s, {status.lost} lost{problem}"

    def close(self) -> None:
        """End the recorder and remove what it wrote; idempotent."""
        self._stack.close()

    def _write(self, ring: Ring, done: threading.Event) -> None:
        epoch_ns = time.time_ns() - time.monotonic_ns()
        values = (0.1, 0.0, -0.1) * 3
        self._recorder.status()  # asks; what it tells comes with the next
        done.wait(0.1)
        written, start = 0, time.monotonic()
        self._began, self._before = start, self._recorder.status().messages
        while not done.wait(0.01):
            now = time.monotonic()
            wanted = int((now - start) * self._rate_hz)
            for number in range(written, wanted):
                time_ns = epoch_ns + time.monotonic_ns()
                ring.write(DEVICE_STATE_CHANNEL.id, time_ns, DEVICE_STATE.pack(number, time_ns, *values))
            written = wanted
            if written % 1000 < 50:
                self._remove_old_parts()

    def _remove_old_parts(self) -> None:
        """Keep the newest parts alone, so that a soak does not fill the disk."""
        parts = sorted(self._directory.glob("*.mcap"), key=lambda path: path.stat().st_mtime_ns)
        for path in parts[:-_PARTS_KEPT]:
            path.unlink(missing_ok=True)


def run_load(load: Load, tally: Tally) -> AbstractContextManager[None]:
    """A load that needs nothing of the loop; all but `Load.RECORDING`.

    Args:
        load: Which.
        tally: Where to say what it did.
    """
    return _LOADS[load](tally)


@contextlib.contextmanager
def _spinner(tally: Tally) -> Iterator[None]:
    def spin(done: threading.Event) -> int:
        rounds = 0
        while not done.is_set():
            for _ in range(1000):
                rounds += 1
        return rounds

    with _counted("spinner", spin, "{:.1f} million rounds/s", 1e-6, tally):
        yield


@contextlib.contextmanager
def _numpy(tally: Tally) -> Iterator[None]:
    import numpy as np

    rng = np.random.default_rng(1)
    a, b = rng.standard_normal((2, 300, 300))

    def multiply(done: threading.Event) -> int:
        products = 0
        while not done.is_set():
            np.tanh(a @ b).sum()
            products += 1
        return products

    with _counted("numpy", multiply, "{:.0f} matrix products/s", 1.0, tally):
        yield


@contextlib.contextmanager
def _interface(tally: Tally) -> Iterator[None]:
    from rich.console import Console
    from rich.table import Table

    def draw(done: threading.Event) -> int:
        console = Console(file=io.StringIO(), width=120, force_terminal=True)
        frames, due = 0, time.monotonic()
        while not done.is_set():
            table = Table("quantity", "x", "y", "z", title=f"frame {frames}")
            for row in range(20):
                table.add_row(f"row {row}", *(f"{(frames + row) * axis:.3f}" for axis in range(3)))
            console.print(table)
            console.file = io.StringIO()
            frames += 1
            due = max(due + 1.0 / FRAMES_HZ, time.monotonic() - 0.1)
            done.wait(max(0.0, due - time.monotonic()))
        return frames

    with _counted("interface", draw, "{:.0f} frames/s", 1.0, tally):
        yield


@contextlib.contextmanager
def _gil(tally: Tally) -> Iterator[None]:
    terms = _terms_of(_GIL_CALL_S)

    def hold(done: threading.Event) -> int:
        calls = 0
        while not done.wait(_GIL_CALL_S):
            sum(range(terms))  # one call into C: the lock is not offered until it is done
            calls += 1
        return calls

    with _counted("gil", hold, "{:.0f} calls/s", 1.0, tally):
        yield


@contextlib.contextmanager
def _gc(tally: Tally) -> Iterator[None]:
    heap: list[list[object]] = [[None] for _ in range(_HEAP_OBJECTS)]
    for index, item in enumerate(heap):
        item[0] = heap[index - 1]

    def collect(done: threading.Event) -> int:
        collections = 0
        while not done.wait(0.1):
            gc.collect()
            collections += 1
        return collections

    try:
        with _counted("gc", collect, "{:.1f} collections/s", 1.0, tally):
            yield
    finally:
        for item in heap:
            item[0] = None


@contextlib.contextmanager
def _load(tally: Tally) -> Iterator[None]:
    count = os.cpu_count() or 1
    processes: list[subprocess.Popen[bytes]] = []
    try:
        processes += [spawn("tools.jitter.loads", "burn", None) for _ in range(count)]
        yield
        dead = sum(process.poll() is not None for process in processes)
        tally.text = f"load: {count} busy processes" + (f", {dead} died" if dead else "")
    finally:
        for process in processes:
            process.kill()
            process.wait()
            if process.stdin is not None:
                process.stdin.close()


def burn() -> None:
    """Main function of a busy process; it ends with its parent."""
    receive_argument()
    while not parent_is_gone(0.0):
        sum(i * i for i in range(100_000))


def _terms_of(seconds: float) -> int:
    """Terms of a sum that takes so long [s]."""
    terms, took = 100_000, 0.0
    while took < 0.2 * seconds:
        terms *= 2
        start = time.thread_time()
        sum(range(terms))
        took = time.thread_time() - start
    return int(terms * seconds / took)


@contextlib.contextmanager
def _counted(
    name: str, work: Callable[[threading.Event], int], text: str, scale: float, tally: Tally
) -> Iterator[None]:
    """Run work in a thread until all loads end, and tell its rate."""
    counts: list[tuple[int, float]] = []

    def run(done: threading.Event) -> None:
        began = time.monotonic()
        counts.append((work(done), time.monotonic() - began))

    with _thread(name, run, tally.signals):
        yield
    if not counts:
        raise LoopError(f"the load '{name}' failed; its error is on standard error")
    count, seconds = counts[0]
    tally.text = f"{name}: " + text.format(count * scale / max(seconds, 1e-3))


@contextlib.contextmanager
def _thread(name: str, work: Callable[[threading.Event], object], signals: Signals) -> Iterator[None]:
    def run() -> None:
        signals.go.wait()
        work(signals.done)

    thread = threading.Thread(target=run, name=f"load {name}", daemon=True)
    thread.start()
    try:
        yield
    finally:
        signals.done.set()
        signals.go.set()
        thread.join()


_LOADS: dict[Load, Callable[[Tally], AbstractContextManager[None]]] = {
    Load.SPINNER: _spinner,
    Load.NUMPY: _numpy,
    Load.INTERFACE: _interface,
    Load.GIL: _gil,
    Load.GC: _gc,
    Load.LOAD: _load,
}

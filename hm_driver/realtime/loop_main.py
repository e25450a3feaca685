"""Main function of the loop's process: the loop in a real-time thread, the parent's end watched beside it."""

import os
import signal
import threading

from hm_driver.realtime.child import parent_is_gone, receive_argument
from hm_driver.realtime.options import LoopOptions
from hm_driver.realtime.runner import run_loop
from hm_driver.realtime.scheduling import enter_realtime
from hm_driver.realtime.segment import PARENT_LOST, STOP_GENTLY, Segment, Word
from hm_driver.realtime.shared import SharedBlock

_WATCH_PRIORITY = 2
"""Of the main thread: on a busy machine the parent's end would be seen late, and a killed process, which is
gone only with its last thread, would not be missed for tens of milliseconds."""


def main() -> None:
    """Run the loop that the parent describes on standard input."""
    options, path = _receive()
    with SharedBlock.attach(path) as block:
        segment = Segment(block.buffer)
        segment.words[Word.LOOP_PID] = os.getpid()
        signal.signal(signal.SIGTERM, lambda *_: _request(segment, STOP_GENTLY))
        done_reader, done_writer = os.pipe()
        thread = threading.Thread(target=_run, args=(options, segment, done_writer), name="loop", daemon=True)
        thread.start()
        granted = enter_realtime(_WATCH_PRIORITY, hold_dma_latency=False)
        if parent_is_gone(timeout_s=None, wake_fd=done_reader):
            _request(segment, PARENT_LOST)
        thread.join()
        granted.release()
        segment.close()


def _receive() -> tuple[LoopOptions, str]:
    argument = receive_argument()
    if not (isinstance(argument, tuple) and isinstance(argument[0], LoopOptions)):
        raise SystemExit(2)
    return argument


def _run(options: LoopOptions, segment: Segment, done: int) -> None:
    try:
        run_loop(options, segment, owns_process=True)
    finally:
        os.write(done, b".")


def _request(segment: Segment, kind: int) -> None:
    if not segment.words[Word.STOP_REQUESTED]:
        segment.words[Word.STOP_REQUESTED] = kind

"""A canary: a process that sleeps from period to period as the emulator does, and does nothing else.

Whoever stalls it stalls the emulator beside it: periods that both miss are the machine's, those that only the
emulator misses are its own. It asks for the priority above the emulator's, since it is awake for a few
microseconds a period. It ends with its parent.
"""

import json
import os
import select
import subprocess
import sys
import threading
import time
from typing import Self

from emulator.grid import STEP_RATE_HZ, TickGrid
from emulator.scheduling import FIFO_PRIORITY, schedule_realtime

_START_S = 10.0


class Canary:
    """A canary's process; a context manager."""

    def __init__(self) -> None:
        self.ticks = 0
        """Periods at which it was awake, as of a tenth of a second ago."""
        self.missed = 0
        """Periods of 400 µs that it missed, as of a tenth of a second ago."""
        self._process: subprocess.Popen[str] | None = None
        self._listener: threading.Thread | None = None
        self._is_there = threading.Event()

    def __enter__(self) -> Self:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "emulator.canary"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._listener = threading.Thread(target=self._listen, args=(self._process,), daemon=True)
        self._listener.start()
        self._is_there.wait(_START_S)
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the process; may be called twice."""
        process, self._process = self._process, None
        if process is None:
            return
        if process.stdin is not None:
            process.stdin.close()
        process.wait()
        if self._listener is not None:
            self._listener.join()
        if process.stdout is not None:
            process.stdout.close()

    def _listen(self, process: "subprocess.Popen[str]") -> None:
        for line in process.stdout or ():
            self.ticks, self.missed = json.loads(line)
            self._is_there.set()


def main() -> None:
    """Sleep from period to period until standard input is closed; tell how often a period was missed."""
    schedule_realtime(priority=FIFO_PRIORITY + 1)
    grid = TickGrid(start_ns=time.monotonic_ns())
    next_report = 0
    while True:
        readable, _, _ = select.select([0], (), (), max(0.0, (grid.next_ns - time.monotonic_ns()) * 1e-9))
        if readable:
            return
        grid.take_due(time.monotonic_ns())
        if grid.ticks + grid.missed >= next_report:
            next_report += STEP_RATE_HZ // 10
            try:
                os.write(1, f"[{grid.ticks}, {grid.missed}]\n".encode())
            except BrokenPipeError:
                return


if __name__ == "__main__":
    main()

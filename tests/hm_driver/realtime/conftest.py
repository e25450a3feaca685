import json
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

HERE = Path(__file__).parent


class DeviceProcess:
    """A still device in a process of its own, and what a test asks of it."""

    def __init__(self, *arguments):
        command = [sys.executable, str(HERE / "still_device.py"), *arguments]
        self._process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)  # ours
        self.port = int(self._process.stdout.readline())
        self.url = f"tcp://127.0.0.1:{self.port}"

    def control(self, name, argument):
        with socket.create_connection(("127.0.0.1", self.port), timeout=5) as connection:
            connection.sendall(f"test {name} {json.dumps(argument)}\n".encode())
            with connection.makefile() as lines:
                return lines.readline()

    def log(self, start=""):
        """Commands that begin so, with the time at which the device had them [ns]."""
        return [(command, time_ns) for command, time_ns in json.loads(self.control("log", start))]

    def times_of(self, start):
        return [time_ns for _, time_ns in self.log(start)]

    def wait_for(self, start, *, count=1, timeout_s=10.0):
        deadline = time.monotonic() + timeout_s
        while len(times := self.times_of(start)) < count:
            assert time.monotonic() < deadline, f"the device never got {count} x {start!r}"
            time.sleep(0.005)
        return times

    def cut(self):
        self._process.kill()
        self._process.wait()

    def close(self):
        self.cut()
        self._process.stdout.close()


class Floor:
    """What this machine itself does to a millisecond's sleep while a test runs: the worst oversleep [s]."""

    def __init__(self):
        self.worst_s = 0.0
        self._done = threading.Event()
        self._thread = threading.Thread(target=self._run)

    def _run(self):
        while not self._done.is_set():
            start = time.monotonic()
            time.sleep(0.001)
            self.worst_s = max(self.worst_s, time.monotonic() - start - 0.001)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._done.set()
        self._thread.join()

    def allows(self, limit_s):
        """The limit plus what the machine takes: both ends of a time span can be late."""
        return limit_s + 2.0 * self.worst_s


@pytest.fixture
def device():
    process = DeviceProcess()
    yield process
    process.close()


@pytest.fixture
def framed_device():
    process = DeviceProcess("framed")
    yield process
    process.close()


@pytest.fixture
def floor():
    with Floor() as floor:
        yield floor

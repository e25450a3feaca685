import fcntl
import os
import pty
import re
import select
import signal
import struct
import sys
import termios
import time

import pytest

from hm_driver.protocol.vocabulary import State
from tools.drive.history import history_path

ESCAPES = re.compile(r"\x1b\[[0-9;?]*[A-Za-z]|\x1b[()=>][A-Z0-9]?")


class Terminal:
    """``hm drive`` behind a real pseudo-terminal."""

    def __init__(self, emulator, state_directory):
        command = [sys.executable, "-m", "tools.cli.main", "drive", "--device", emulator.url]
        command += ["--world", emulator.world_url]
        for setting in ("heartbeat_s=2", "missed_s=0", "freeze_s=2", "exchange_timeout_s=2"):
            command += ["--set", f"watch.{setting}"]
        self.pid, self._fd = pty.fork()
        if self.pid == 0:
            os.environ |= {"TERM": "xterm", "XDG_STATE_HOME": state_directory}
            os.execv(command[0], command)  # noqa: S606 - the child of a fork
        fcntl.ioctl(self._fd, termios.TIOCSWINSZ, struct.pack("HHHH", 30, 160, 0, 0))
        self.text = ""
        self._read = 0

    def send(self, keys):
        os.write(self._fd, keys.encode())

    def expect(self, pattern, timeout=30.0):
        """Wait until a pattern stands behind what was expected before."""
        deadline = time.monotonic() + timeout
        while (found := re.compile(pattern).search(self.text, self._read)) is None:
            assert time.monotonic() < deadline, f"no {pattern!r} in {self.text[self._read :]!r}"
            assert self._pump(), f"ended before {pattern!r}: {self.text[self._read :]!r}"
        self._read = found.end()

    def wait(self):
        """Exit code, once it has ended."""
        deadline = time.monotonic() + 30.0
        while self._pump():
            assert time.monotonic() < deadline, "it does not end"
        _, status = os.waitpid(self.pid, 0)
        self.pid = 0
        os.close(self._fd)
        return os.waitstatus_to_exitcode(status)

    def close(self):
        if self.pid:
            os.kill(self.pid, signal.SIGKILL)
            os.waitpid(self.pid, 0)
            os.close(self._fd)

    def _pump(self):
        if not select.select([self._fd], [], [], 0.1)[0]:
            return True
        try:
            data = os.read(self._fd, 65536).decode(errors="replace")
        except OSError:
            return False
        if "\x1b[6n" in data:
            self.send("\x1b[25;1R")  # where the cursor is: near the bottom
        self.text += ESCAPES.sub("", data)
        return bool(data)


@pytest.fixture
def terminal(emulator, tmp_path):
    """A prompt that waits for its first line."""
    terminal = Terminal(emulator, str(tmp_path))
    terminal.expect("drive>")
    yield terminal
    terminal.close()


def test_a_person_completes_moves_interrupts_and_ends(terminal, observer, tmp_path):
    terminal.expect("no loop")  # the line of state below the prompt
    terminal.send("go\t")
    terminal.expect("goto")
    terminal.send(" 0.1 0 0 --speed 0.02\r")
    terminal.expect("force, position")
    time.sleep(1.0)
    terminal.send("\x03")
    terminal.expect("stopped on the way, held at")
    terminal.expect("Ctrl-C again ends")
    x = observer.measured_position()[0]
    assert x < 0.09
    assert observer.state is State.FORCE
    terminal.send("release\r")
    terminal.expect("x y z free")
    terminal.expect("drive>")
    terminal.send("\x03")
    terminal.expect("held; Ctrl-C again ends")
    terminal.send("set state stop\r")
    terminal.expect("not while the loop drives the arm")
    terminal.expect("drive>")
    terminal.send("\x04")
    assert terminal.wait() == 0
    assert observer.state is State.STOP
    history = tmp_path / "hapticmaster" / "drive-history"
    assert "+goto 0.1 0 0 --speed 0.02" in history.read_text()
    assert "Traceback" not in terminal.text


def test_ctrl_c_twice_ends_with_the_arm_stopped(terminal, observer):
    terminal.send("goto -0.05 0 0 --speed 0.01\r")
    terminal.expect("force, position")
    time.sleep(0.3)
    terminal.send("\x03")
    time.sleep(0.1)
    terminal.send("\x03")
    assert terminal.wait() == 130
    assert observer.state is State.STOP


def test_a_trip_is_told_above_the_prompt_which_goes_on(terminal, observer):
    terminal.send("hold\r")
    terminal.expect("x y z held")
    terminal.expect("drive>")
    observer.set_state(State.STOP)
    terminal.expect("the device left state 'force' for 'stop'")
    terminal.send("hold\r")
    terminal.expect("x y z held")
    terminal.send("quit\r")
    assert terminal.wait() == 0
    assert observer.state is State.STOP


def test_a_signal_ends_the_prompt_at_once(terminal, observer):
    terminal.send("release\r")
    terminal.expect("x y z free")
    terminal.expect("drive>")
    os.kill(terminal.pid, signal.SIGTERM)
    assert terminal.wait() == 130
    assert observer.state is State.STOP


def test_the_history_lies_in_the_users_state_directory(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert history_path({}) == tmp_path / ".local" / "state" / "hapticmaster" / "drive-history"
    given = tmp_path / "elsewhere"
    assert history_path({"XDG_STATE_HOME": str(given)}) == given / "hapticmaster" / "drive-history"
    assert history_path({"XDG_STATE_HOME": "relative"}).is_relative_to(tmp_path / ".local")


def test_where_nothing_can_be_written_nothing_is_remembered(tmp_path):
    blocked = tmp_path / "a-file"
    blocked.write_text("no directory")
    assert history_path({"XDG_STATE_HOME": str(blocked)}) is None

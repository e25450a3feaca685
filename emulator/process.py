"""The emulator in a process of its own.

>>> with Emulator(init_seconds=0.5) as emulator:  # doctest: +SKIP
...     device = hm_driver.connect(emulator.url)

The process ends with the ``with`` block, and with its parent however that ends: its standard input is a pipe
that the parent holds open. What it has to say comes over its standard output, a JSON object a line: its
addresses or why it could not start, then its status every second and, on request, the conversation.
"""

import json
import select
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path
from typing import IO, Any, Self

from emulator.address import parse_address
from emulator.world import WorldClient
from hm_driver.errors import ConfigurationError, TransportError

DEFAULT_PORT = 7654
"""The device's TCP port (device facts, confidence H)."""
START_TIMEOUT_S = 120.0
"""How long a start may take [s]; the first one compiles the arm's model."""
STOP_TIMEOUT_S = 5.0

Message = Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class EmulatorOptions:
    """How an emulator is started.

    Raises:
        ConfigurationError: An address is none, or a number is out of range.
    """

    listen: str = "tcp://127.0.0.1:0"
    """Where clients of the device connect; port 0 for a free one."""
    world: str = "tcp://127.0.0.1:0"
    """Where the hand connects."""
    config: Path | None = None
    """Constants of the arm, in the form of ``arm.toml``; it may hold any part of it."""
    seed: int = 0
    """Of the sensors' noise and of the faults."""
    speed: float = 1.0
    """Device seconds a wall second."""
    init_seconds: float = 3.0
    """Device time that an initialisation takes [s]."""
    on_client_lost: str = "continue"
    """What the arm does when a client that commanded is gone: ``continue`` or ``stop``."""
    lockstep: bool = False
    """Time passes only on request of the world endpoint."""
    faults: Path | None = None
    """Schedule of faults."""
    fault: tuple[str, ...] = ()
    """More faults, each as ``KIND[=VALUE][@START][+DURATION]``."""
    log: Path | None = None
    """File that the conversation is written to, a JSON object a line."""
    realtime: bool = True
    """Ask for real-time scheduling."""

    def __post_init__(self) -> None:
        parse_address("listen", self.listen, default_port=DEFAULT_PORT)
        parse_address("world", self.world, default_port=0)
        if self.on_client_lost not in ("continue", "stop"):
            raise ConfigurationError("on_client_lost", f"{self.on_client_lost!r} must be continue or stop")
        if not 0.001 <= self.speed <= 100.0:
            raise ConfigurationError("speed", f"{self.speed} must be 0.001 to 100")
        if not 0.0 <= self.init_seconds <= 600.0:
            raise ConfigurationError("init_seconds", f"{self.init_seconds} s must be 0 to 600")

    def to_json(self) -> str:
        """One line that `from_json` reads."""
        values = asdict(self)
        for name in ("config", "faults", "log"):
            values[name] = None if values[name] is None else str(values[name])
        return json.dumps(values)

    @classmethod
    def from_json(cls, line: str) -> Self:
        """Read what `to_json` wrote.

        Raises:
            ConfigurationError: A value is wrong.
        """
        values = json.loads(line)
        for name in ("config", "faults", "log"):
            values[name] = None if values[name] is None else Path(values[name])
        values["fault"] = tuple(values["fault"])
        return cls(**values)


class Emulator:
    """An emulated HapticMASTER on the wall clock, in a process of its own, as a context manager.

    Args:
        options: How it is started; keywords given beside it change single ones.
        on_message: Is handed what the process says after its start (keys ``status`` and ``log``), from a
            thread of this object.
        changes: Fields of `EmulatorOptions`.

    Raises:
        ConfigurationError: An unknown or impossible option.
    """

    def __init__(
        self,
        options: EmulatorOptions | None = None,
        *,
        on_message: Callable[[Message], None] | None = None,
        **changes: Any,  # noqa: ANN401 - checked by the options that they change
    ) -> None:
        unknown = set(changes) - {field.name for field in fields(EmulatorOptions)}
        if unknown:
            known = ", ".join(field.name for field in fields(EmulatorOptions))
            raise ConfigurationError(min(unknown), f"is no option of the emulator; there are: {known}")
        self.options = replace(options or EmulatorOptions(), **changes)
        self.url = ""
        """Address of the device, once started."""
        self.world_url = ""
        """Address of the world endpoint, once started."""
        self.scheduling = ""
        """What the machine granted, in words."""
        self.status: Message = {}
        """The latest status; keys as `emulator.server.Status`."""
        self._on_message = on_message
        self._process: subprocess.Popen[str] | None = None
        self._listener: threading.Thread | None = None

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Start the process and wait for its addresses.

        Raises:
            ConfigurationError: The arm's constants or the faults are wrong; names file and key.
            TransportError: A port is taken, or the process died or did not answer.
        """
        log = self._open_log()
        process = subprocess.Popen(
            [sys.executable, "-m", "emulator.child"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
        self._process = process
        try:
            first = self._begin(process)
        except BaseException:
            if log is not None:
                log.close()
            self.close()
            raise
        self.url, self.world_url = first["url"], first["world_url"]
        self.scheduling = first["scheduling"]
        self._listener = threading.Thread(
            target=self._listen, args=(process, log), name="emulator status", daemon=True
        )
        self._listener.start()

    def connect_world(self) -> WorldClient:
        """A hand's connection to the arm; the caller closes it."""
        return WorldClient(self.world_url)

    @property
    def is_alive(self) -> bool:
        """Whether the process runs."""
        return self._process is not None and self._process.poll() is None

    @property
    def exit_code(self) -> int | None:
        """Exit code of a process that ended by itself; None while it runs."""
        return self._process.poll() if self._process is not None else None

    @property
    def pid(self) -> int | None:
        """Process identifier; None before the start and after the end."""
        return self._process.pid if self._process is not None else None

    def wait(self, timeout_s: float | None = None) -> bool:
        """Wait for the process to end by itself; returns whether it did."""
        if self._process is None:
            return True
        try:
            self._process.wait(timeout_s)
        except subprocess.TimeoutExpired:
            return False
        return True

    def close(self) -> None:
        """End the process; may be called twice."""
        process, self._process = self._process, None
        if process is None:
            return
        if process.stdin is not None:
            process.stdin.close()
        try:
            process.wait(STOP_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
        if self._listener is not None:
            self._listener.join(STOP_TIMEOUT_S)
        if process.stdout is not None:
            process.stdout.close()

    def _begin(self, process: "subprocess.Popen[str]") -> Message:
        if process.stdin is None or process.stdout is None:
            raise TransportError("the emulator's process has no pipes")
        try:
            process.stdin.write(self.options.to_json() + "\n")
            process.stdin.flush()
        except OSError as error:
            raise TransportError(f"the emulator's process ended at once: {error}") from error
        first: Message = json.loads(_read_line(process.stdout) or "{}")
        if "url" in first:
            return first
        problem = first.get("error")
        if problem is None:
            process.wait(STOP_TIMEOUT_S)
            raise TransportError(f"the emulator's process ended at its start, exit code {process.returncode}")
        if problem["type"] == "ConfigurationError":
            raise ConfigurationError(problem["field"], problem["problem"], source=problem["source"])
        raise TransportError(problem["problem"])

    def _open_log(self) -> IO[str] | None:
        path = self.options.log
        if path is None:
            return None
        try:
            return path.open("w", encoding="utf-8", buffering=1)
        except OSError as error:
            raise ConfigurationError("log", f"{path} cannot be written: {error.strerror}") from error

    def _listen(self, process: "subprocess.Popen[str]", log: IO[str] | None) -> None:
        try:
            for line in process.stdout or ():
                message: Message = json.loads(line)
                if "status" in message:
                    self.status = message["status"]
                elif log is not None:
                    log.write(json.dumps(message["log"]) + "\n")
                if self._on_message is not None:
                    self._on_message(message)
        finally:
            if log is not None:
                log.close()


def _read_line(stream: IO[str]) -> str:
    """First line of a process; the time-out bounds a start that hangs."""
    deadline = time.monotonic() + START_TIMEOUT_S
    while not select.select([stream], [], [], 0.5)[0]:
        if time.monotonic() > deadline:
            raise TransportError(f"the emulator did not start within {START_TIMEOUT_S:g} s")
    return stream.readline()

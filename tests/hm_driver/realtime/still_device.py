"""A device that understands what the loop says and moves nothing: for the loop's own logic.

Run as a program it serves TCP on a free port in both dialects, prints the port, and takes ``test …`` requests
that a robot does not have: what it logged, and how it shall misbehave.
"""

import json
import socket
import sys
import threading
import time

from hm_driver.errors import DeviceError
from hm_driver.protocol.framing import Dialect, RequestDecoder, encode_reply


class StillDevice:
    """Answers commands; keeps what it was told, with the time. It is a link to itself."""

    def __init__(self, *, combined: bool = True) -> None:
        self.combined = combined
        self.state = "stop"
        self.calibrated = True
        self.init_ends = True
        self.vectors = {
            "measpos": (0.0, 0.0, 0.0),
            "modelvel": (0.0, 0.0, 0.0),
            "measforce": (0.0, 0.0, 0.0),
            "workspace_r": (-0.19, 0.45, 0.19),
            "workspace_phi": (-0.504, 0.0, 0.507),
            "workspace_z": (-0.228, 0.0, 0.228),
        }
        self.log: list[str] = []
        self.times_ns: list[int] = []
        self.requests: list[str] = []
        self.refused = ""
        self.silent = False
        self.failure: Exception | None = None
        self.button = False
        self.stale = False
        self.delay_s = 0.0
        self._asked = 0

    def exchange(self, request: str) -> str:
        """As `CommandLink.exchange`, for tests without a socket."""
        if self.failure is not None:
            raise self.failure
        self.requests.append(request)
        parts = [self.answer(command) for command in request.split("; ")]
        for command, part in zip(request.split("; "), parts, strict=True):
            if "--- ERROR" in part:
                raise DeviceError(command, part)
        return "".join(f"{part};" for part in parts)

    def send_line(self, line: bytes) -> None:
        """As `CommandLink.send_line`."""
        if self.failure is not None:
            raise self.failure
        self.requests.append(line.decode().rstrip("\n"))

    def receive_line(self) -> bytes:
        """As `CommandLink.receive_line`."""
        commands = self.requests[-1].split("; ")
        return "".join(f"{self.answer(command)};" for command in commands).encode() + b"\n"

    def answer(self, command: str) -> str:
        if self.refused and self.refused in command:
            return "--- ERROR unknown"
        words = command.split()
        if words[0] == "get":
            return self.value(words[1])
        self.log.append(command)
        self.times_ns.append(time.monotonic_ns())
        if words[:2] == ["set", "state"]:
            self.state = "stop" if words[2] == "init" and self.init_ends else words[2]
            self.calibrated = self.calibrated or words[2] == "init"
            return f"state set to '{words[2]}'"
        return "done"

    def value(self, name: str) -> str:
        if name == "measforce" and not self.stale:
            self._asked += 1
            x, y, z = self.vectors[name]
            return f"[{x + 1e-3 * (self._asked % 2):g},{y:g},{z:g}]"  # no sensor is still
        if name in self.vectors:
            return "[{:g},{:g},{:g}]".format(*self.vectors[name])
        words = {
            "state": self.state,
            "os": "Linux",
            "position_calibrated": str(self.calibrated).lower(),
            "emergencybuttonpushed": str(self.button).lower(),
            "emergencyrelay": "true",
            "inertia": "3",
        }
        return words[name]

    def told(self, start: str) -> list[str]:
        return [command for command in self.log if command.startswith(start)]

    def control(self, name: str, argument: str) -> str:
        """What ``test NAME ARGUMENT`` does."""
        if name == "log":
            kept = zip(self.log, self.times_ns, strict=True)
            wanted = [entry for entry in kept if entry[0].startswith(json.loads(argument))]
            return json.dumps(wanted).replace(";", ",")
        if name in self.vectors:
            self.vectors[name] = tuple(json.loads(argument))
        else:
            setattr(self, name, json.loads(argument))
        return "done"


def serve(device: StillDevice, connection: socket.socket, *, takes_text: bool) -> None:
    decoder = RequestDecoder(limit=1 << 20)
    drives = False
    with connection:
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        while data := connection.recv(65536):
            for request in decoder.feed(data):
                dialect = decoder.dialect or Dialect.TEXT
                if request.startswith("test "):
                    _, name, argument = request.split(" ", 2)
                    connection.sendall(device.control(name, argument).encode() + b"\n")
                    continue
                drives = drives or "measpos" in request
                if (device.silent and drives) or (dialect is Dialect.TEXT and not takes_text):
                    continue
                if drives:
                    time.sleep(device.delay_s)
                parts = [device.answer(command) for command in request.split("; ")]
                if dialect is Dialect.FRAMED:
                    parts = [part if part[0] in "[0123456789" else f'"{part}"' for part in parts]
                connection.sendall(encode_reply(dialect, parts))


def main() -> None:
    device = StillDevice()
    listener = socket.create_server(("127.0.0.1", 0))
    print(listener.getsockname()[1], flush=True)  # noqa: T201  # how a test finds the port
    takes_text = "framed" not in sys.argv
    while True:
        connection, _ = listener.accept()
        threading.Thread(
            target=serve, args=(device, connection), kwargs={"takes_text": takes_text}, daemon=True
        ).start()


if __name__ == "__main__":
    main()

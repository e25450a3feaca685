"""The world endpoint: what a person's body does to the arm, and what only a simulation can know.

It lies outside the device's protocol, and the driver never sees it. One JSON object a line in, one a line
out, each reply in one write::

    {"hand": {"position": [x,y,z], "velocity": [..], "stiffness": [..], "damping": [..], "force": [..]}}
    {"hand": null}                  let go
    {}                              only ask
    {"advance_s": 0.01}             let time pass (lock-step servers only)
    {"fault": {"kind": "reply_delay", "value": 0.02, "duration_s": 1.0}}
    {"fault": {"clear": "all"}}

``position`` [m], ``stiffness`` [N/m] and ``damping`` [N·s/m] of a hand are required, ``velocity`` [m/s] and
``force`` [N] are zero unless given. The reply is the truth after that (see `Truth`), or
``{"error": "..."}``. The hand that was set last holds the arm. Its position moves on with its velocity for
20 ms without news and then stays (``hand.hold`` of the arm's constants); it lets go when the connection that
set it is lost.
"""

import json
import select
import socket
from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol
from urllib.parse import urlsplit

from hm_driver.errors import (
    ConfigurationError,
    HapticMasterError,
    TransportClosed,
    TransportError,
    TransportTimeout,
)

Vector = tuple[float, float, float]
Hand = Mapping[str, Sequence[float]]
"""What a hand wants: lists of three numbers by name, as in the module's description."""


class Truth(NamedTuple):
    """What is really so, as only a simulation can know it; the keys of a reply."""

    time_s: float
    """Device time [s]."""
    step: int
    """Device time [steps of 400 µs]."""
    position: Vector
    """True position of the end effector [m]."""
    velocity: Vector
    """True velocity of the end effector [m/s]."""
    hand_force: Vector
    """Force of the hand on the end effector [N]."""
    contact_force: Vector
    """Force of the rendered shapes on the virtual mass [N]."""
    state: str
    """State of the device."""
    fault: str
    """Reason of the state ``fault``, else empty."""
    missed: int
    """Periods of 400 µs that the server missed so far; 0 in lock-step."""
    faults: tuple[str, ...]
    """Kinds of the injected faults that are active."""


class WorldError(HapticMasterError, ValueError):
    """A request to the world endpoint was refused; the text says what would be accepted."""


class World(Protocol):
    """A hand's way to the arm, the same in this process and over a socket."""

    def exchange(self, hand: Hand | None) -> Truth:
        """Hold the arm as `hand` says, or let go for None; returns what is true now."""

    def observe(self) -> Truth:
        """What is true now, without touching the arm."""

    def inject(
        self, kind: str, *, value: float | Vector | None = None, duration_s: float | None = None
    ) -> Truth:
        """Let a fault happen, of the kinds that `emulator.faults` lists."""

    def clear_faults(self, kind: str = "all") -> Truth:
        """End one kind of injected fault, or all."""

    def release(self) -> None:
        """Let the arm go."""

    def close(self) -> None:
        """Let the arm go and end the connection; may be called twice."""


class WorldClient:
    """The world endpoint of an emulator in another process.

    Args:
        url: Address that the emulator named, ``tcp://HOST:PORT``.
        timeout_s: Longest wait for a reply [s].

    Raises:
        ConfigurationError: Not such an address.
        TransportError: Nothing listens there.
    """

    def __init__(self, url: str, *, timeout_s: float = 2.0) -> None:
        parts = urlsplit(url)
        if parts.scheme != "tcp" or not parts.hostname or not parts.port:
            raise ConfigurationError("world", f"{url!r} must be tcp://HOST:PORT")
        self.url = url
        try:
            self._socket = socket.create_connection((parts.hostname, parts.port), timeout=timeout_s)
        except OSError as error:
            raise TransportError(f"no world endpoint at {url}: {error}; is the emulator running?") from error
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._received = b""
        self._awaited = 0
        self._is_closed = False

    def exchange(self, hand: Hand | None) -> Truth:
        """Hold the arm as `hand` says, or let go for None; returns what is true now.

        Raises:
            WorldError: The endpoint refused the request.
            TransportError: No reply in time, or the connection is lost.
        """
        return self._ask({"hand": hand})

    def begin(self, hand: Hand | None) -> None:
        """Send what `exchange` sends; `finished` gives the reply. Raises as `exchange` does."""
        self._send({"hand": hand})

    def finished(self) -> list[Truth]:
        """The replies to `begin` that have come by now, in order; never waits, raises as `exchange` does."""
        while self._awaited and select.select([self._socket], [], [], 0.0)[0]:
            self._received_more()
        return [self._next_truth() for _ in range(self._received.count(b"\n"))]

    def observe(self) -> Truth:
        """What is true now, without touching the arm; raises as `exchange` does."""
        return self._ask({})

    def advance(self, seconds: float) -> Truth:
        """Let time pass in a lock-step emulator; raises as `exchange` does."""
        return self._ask({"advance_s": seconds})

    def inject(
        self, kind: str, *, value: float | Vector | None = None, duration_s: float | None = None
    ) -> Truth:
        """Let a fault happen; raises as `exchange` does.

        Args:
            kind: One of the kinds that `emulator.faults` lists.
            value: Its size, in the unit of the kind.
            duration_s: Device time until it ends by itself [s]; None for until it is cleared.
        """
        return self._ask({"fault": fault_request(kind, value, duration_s)})

    def clear_faults(self, kind: str = "all") -> Truth:
        """End one kind of injected fault, or all; raises as `exchange` does."""
        return self._ask({"fault": {"clear": kind}})

    def release(self) -> None:
        """Let the arm go; raises as `exchange` does."""
        self.exchange(None)

    def close(self) -> None:
        """End the connection, whereupon the hand lets go; may be called twice."""
        if not self._is_closed:
            self._is_closed = True
            self._socket.close()

    def __enter__(self) -> "WorldClient":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _ask(self, request: Mapping[str, object]) -> Truth:
        """Send a request and wait for its reply; replies to `begin` that nobody asked for are passed over."""
        self._send(request)
        while self._awaited > 1:
            self._next_truth()
        return self._next_truth()

    def _send(self, request: Mapping[str, object]) -> None:
        if self._is_closed:
            raise TransportClosed(f"the connection to the world endpoint {self.url} was closed")
        try:
            self._socket.sendall(json.dumps(request, default=list).encode() + b"\n")
        except OSError as error:
            raise self._lost(error) from error
        self._awaited += 1

    def _next_truth(self) -> Truth:
        while b"\n" not in self._received:
            self._received_more()
        line, _, self._received = self._received.partition(b"\n")
        self._awaited -= 1
        reply = json.loads(line)
        if "error" in reply:
            raise WorldError(reply["error"])
        values = (reply[name] for name in Truth._fields)
        return Truth._make(tuple(value) if isinstance(value, list) else value for value in values)

    def _received_more(self) -> None:
        try:
            data = self._socket.recv(65536)
        except OSError as error:
            raise self._lost(error) from error
        if not data:
            self.close()
            raise TransportClosed(f"the world endpoint {self.url} closed the connection")
        self._received += data

    def _lost(self, error: OSError) -> TransportError:
        self.close()
        if isinstance(error, TimeoutError):
            return TransportTimeout(f"the world endpoint {self.url} did not answer in time")
        return TransportClosed(f"the connection to the world endpoint {self.url} is lost: {error}")


def fault_request(kind: str, value: float | Vector | None, duration_s: float | None) -> dict[str, object]:
    """The value of ``fault`` in a request."""
    fault: dict[str, object] = {"kind": kind}
    if value is not None:
        fault["value"] = list(value) if isinstance(value, tuple) else value
    if duration_s is not None:
        fault["duration_s"] = duration_s
    return fault

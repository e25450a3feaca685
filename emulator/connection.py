"""One connection of the server, with bounded memory whatever the peer does."""

import socket
from collections import deque
from typing import Protocol

from hm_driver.errors import ProtocolError
from hm_driver.protocol.framing import RequestDecoder

RECEIVE_SIZE = 4096
"""Most bytes taken from a connection at a time."""
MAX_LATE_REPLIES = 64
"""Replies that may wait for an injected delay; a client with more is not listened to meanwhile."""


class Decoder(Protocol):
    """Turns a connection's bytes into requests, in bounded memory."""

    def feed(self, data: bytes) -> list[str]:
        """Take bytes, return the requests that they complete; raises `ProtocolError` where it is lost."""


class LineDecoder:
    """Requests of the world endpoint: lines of at most `limit` bytes."""

    def __init__(self, *, limit: int) -> None:
        self._limit = limit
        self._rest = b""

    def feed(self, data: bytes) -> list[str]:
        """Take bytes, return the lines that they complete.

        Raises:
            ProtocolError: A line above the limit.
        """
        *lines, self._rest = (self._rest + data).split(b"\n")
        if len(self._rest) > self._limit or any(len(line) > self._limit for line in lines):
            raise ProtocolError(f"a line above the limit of {self._limit} bytes")
        return [line.decode("utf-8", "backslashreplace") for line in lines]


class Connection:
    """A client's socket, the requests it sent and the bytes that wait to be sent to it.

    Args:
        link: Accepted socket; it is made non-blocking here.
        number: Counted from 1, for the log.
        decoder: What turns its bytes into requests.
    """

    __slots__ = (
        "decoder",
        "has_commanded",
        "has_spoken",
        "heard_ns",
        "is_closing",
        "is_mid_request",
        "late",
        "link",
        "number",
        "outgoing",
        "requests",
    )

    def __init__(self, link: socket.socket, *, number: int, decoder: Decoder, now_ns: int) -> None:
        link.settimeout(0.0)
        link.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self.link = link
        self.number = number
        self.decoder = decoder
        self.requests: deque[str] = deque()
        self.outgoing = b""
        """What the peer has not taken yet."""
        self.late: deque[tuple[int, bytes]] = deque()
        """Replies that wait for an injected delay, with the time they are due [ns]."""
        self.heard_ns = now_ns
        self.is_mid_request = False
        """A request has begun and is not complete."""
        self.has_spoken = False
        """A complete request came."""
        self.has_commanded = False
        """A request other than a question came."""
        self.is_closing = False
        """To be closed once everything is sent."""

    def fileno(self) -> int:
        """Descriptor to wait on."""
        return self.link.fileno()

    @property
    def is_listened_to(self) -> bool:
        """Whether more may be read: the peer has taken its replies and has no request waiting."""
        return not (self.outgoing or self.requests or self.is_closing or len(self.late) >= MAX_LATE_REPLIES)

    def receive(self, now_ns: int) -> bool:
        """Take what has come; returns False where the peer is gone.

        Raises:
            ProtocolError: The bytes cannot be followed any further.
        """
        try:
            data = self.link.recv(RECEIVE_SIZE)
        except (BlockingIOError, InterruptedError):
            return True
        except OSError:
            return False
        if not data:
            return False
        self.heard_ns = now_ns
        self.is_mid_request = True
        requests = self.decoder.feed(data)
        if requests:
            self.requests.extend(requests)
            self.has_spoken = True
            self.is_mid_request = False
        return True

    def send(self, data: bytes) -> bool:
        """Send, in one write where the peer keeps up; returns False where it is gone."""
        if self.outgoing:
            self.outgoing += data
            return True
        try:
            sent = self.link.send(data)
        except (BlockingIOError, InterruptedError):
            sent = 0
        except OSError:
            return False
        if sent < len(data):
            self.outgoing = data[sent:]
        return True

    def flush(self) -> bool:
        """Send on what is left; returns False where the peer is gone."""
        data, self.outgoing = self.outgoing, b""
        return self.send(data) if data else True

    def dialect_decoder(self) -> RequestDecoder | None:
        """The decoder of a device client; None for a connection of the world endpoint."""
        return self.decoder if isinstance(self.decoder, RequestDecoder) else None

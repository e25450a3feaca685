"""Stream sockets: TCP, and Unix sockets, which differ in the address alone."""

import socket
import struct
import sys
import threading
from collections.abc import Callable
from time import perf_counter_ns
from typing import NamedTuple

from hm_driver.errors import TransportClosed, TransportError, TransportTimeout
from hm_driver.transport.contract import LinkStatistics
from hm_driver.transport.counters import LinkCounters
from hm_driver.transport.urls import DEFAULT_PORT, DeviceUrl

_CHUNK = 8192
"""Most bytes that one call takes; a larger block costs its allocation each time."""
_SHORTEST_WAIT_S = 1e-6
_WITHOUT_WAITING = getattr(socket, "MSG_DONTWAIT", 0)
_CLOSING_S = 1.0


class SocketCalls(NamedTuple):
    """See `TcpTransport.socket_calls`."""

    sendall: Callable[[bytes], None]
    recv: Callable[[int], bytes]


class TcpTransport:
    """A connected stream socket as a `Transport`.

    The socket blocks, and the kernel keeps the time-outs (SO_RCVTIMEO, SO_SNDTIMEO): one system call for
    each send and receive. Interrupted calls are taken up again by Python.

    Args:
        connected: A connected stream socket; it belongs to the transport from now on.
        url: Where it leads, for messages.
        timeout_s: Longest wait for the peer to take what is sent [s].
    """

    def __init__(self, connected: socket.socket, *, url: str, timeout_s: float = 1.0) -> None:
        self.url = url
        self._socket = connected
        self._socket.settimeout(None)
        self._send_timeout_s = timeout_s
        self._receive_timeout_s = -1.0
        self._in_use = threading.Lock()
        self._is_closed = False
        self._counters = LinkCounters()
        _set_timeout(connected, socket.SO_SNDTIMEO, timeout_s)

    @property
    def statistics(self) -> LinkStatistics:
        """What went over the link so far."""
        return self._counters.statistics()

    def socket_calls(self, timeout_s: float) -> SocketCalls:
        """The socket's own calls, for one thread that keeps its own statistics and wants nothing between.

        They count nothing and raise OSError, BlockingIOError where the time is over; the next `send` or
        `receive` then says what is wrong with the link.

        Args:
            timeout_s: Longest wait of ``recv`` [s], until `receive` is called.
        """
        if timeout_s != self._receive_timeout_s:
            self._change_timeout(timeout_s)
        return SocketCalls(self._socket.sendall, self._socket.recv)

    def send(self, data: bytes) -> None:
        """Send all of `data`.

        Raises:
            TransportTimeout: The peer took nothing in time; the link is closed, as part may have gone.
            TransportClosed: The link is closed, or the peer is gone.
        """
        started_ns = perf_counter_ns()
        with self._in_use:
            try:
                self._socket.sendall(data)
            except BlockingIOError as error:
                self._counters.errors += 1
                self._shut_down()
                raise TransportTimeout(
                    f"{self.url}: the peer took nothing for {self._send_timeout_s:g} s; "
                    "the link was closed, reconnect"
                ) from error
            except OSError as error:
                raise self._gone(error.strerror) from error
        self._counters.sent(len(data), started_ns)

    def receive(self, timeout_s: float) -> bytes:
        """Return the next bytes as soon as there are any; never empty.

        Raises:
            TransportTimeout: No byte in time; the link stays open.
            TransportClosed: The link is closed, or the peer is gone.
        """
        with self._in_use:
            try:
                if timeout_s != self._receive_timeout_s:
                    self._change_timeout(timeout_s)
                data = self._socket.recv(_CHUNK, 0 if timeout_s > 0.0 else _WITHOUT_WAITING)
            except BlockingIOError as error:
                self._counters.errors += 1
                raise TransportTimeout(f"{self.url}: no byte within {timeout_s:g} s") from error
            except OSError as error:
                raise self._gone(str(error)) from error
        if not data:
            raise self._gone("the peer closed the connection")
        self._counters.received(len(data))
        return data

    def close(self) -> None:
        """Close the link, from any thread; who waits in `receive` gets `TransportClosed`."""
        self._shut_down()
        is_free = self._in_use.acquire(timeout=_CLOSING_S)  # never for ever: the holder may be our own thread
        self._socket.close()
        if is_free:
            self._in_use.release()

    def _shut_down(self) -> None:
        self._is_closed = True
        try:
            self._socket.shutdown(socket.SHUT_RDWR)
        except OSError:
            return  # the peer was faster, or it is closed already

    def _change_timeout(self, timeout_s: float) -> None:
        _set_timeout(self._socket, socket.SO_RCVTIMEO, timeout_s)
        self._receive_timeout_s = timeout_s

    def _gone(self, reason: str | None) -> TransportClosed:
        if self._is_closed:
            return TransportClosed(f"{self.url}: the link is closed; open a new one")
        self._counters.errors += 1
        return TransportClosed(f"{self.url}: connection lost: {reason}; reconnect")


def open_tcp(url: DeviceUrl, *, timeout_s: float) -> TcpTransport:
    """Connect to ``tcp://HOST[:PORT]``; see `hm_driver.transport.urls.open_transport`."""
    url.refuse_options()
    port = DEFAULT_PORT if url.port is None else url.port
    where = f"{url.host}:{port}"
    try:
        connected = socket.create_connection((url.host, port), timeout=timeout_s)
    except TimeoutError as error:
        raise TransportTimeout(
            f"no connection to {where} within {timeout_s:g} s; is the device on and the cable in?"
        ) from error
    except socket.gaierror as error:
        raise TransportError(
            f"host {url.host!r} is unknown ({error.strerror}); check the name in {url.url}"
        ) from error
    except OSError as error:
        raise TransportError(
            f"no connection to {where}: {error.strerror}; is the device on, or `hm emulate` running there?"
        ) from error
    connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return TcpTransport(connected, url=url.url, timeout_s=timeout_s)


def open_unix(url: DeviceUrl, *, timeout_s: float) -> TcpTransport:
    """Connect to ``unix:///PATH``; see `hm_driver.transport.urls.open_transport`."""
    url.refuse_options()
    connected = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
    connected.settimeout(timeout_s)
    try:
        connected.connect(url.path)
    except OSError as error:
        connected.close()
        raise TransportError(
            f"no connection to {url.path!r}: {error.strerror}; is a server running there?"
        ) from error
    return TcpTransport(connected, url=url.url, timeout_s=timeout_s)


def _set_timeout(connected: socket.socket, option: int, timeout_s: float) -> None:
    timeout_s = max(timeout_s, _SHORTEST_WAIT_S)
    if sys.platform == "win32":
        connected.setsockopt(socket.SOL_SOCKET, option, max(1, round(timeout_s * 1e3)))
    else:
        seconds, microseconds = divmod(round(timeout_s * 1e6), 1_000_000)
        connected.setsockopt(socket.SOL_SOCKET, option, struct.pack("@ll", seconds, microseconds))

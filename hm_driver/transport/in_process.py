"""A peer in the same process: what is sent is handled in the call, so that both sides run in lock-step."""

from time import perf_counter_ns
from typing import Protocol

from hm_driver.errors import TransportClosed, TransportTimeout
from hm_driver.transport.contract import LinkStatistics
from hm_driver.transport.counters import LinkCounters


class InProcessPeer(Protocol):
    """The other end of an `InProcessTransport`; the emulator provides one."""

    def handle(self, data: bytes) -> bytes:
        """Take what was sent and return what there is to answer, or b"" where it says nothing.

        Raises:
            TransportClosed: The peer is gone.
        """
        ...


class InProcessTransport:
    """A `Transport` to a peer in the same thread.

    Nothing can arrive while the caller waits, so `receive` times out at once where no answer is there.

    Args:
        peer: Takes what is sent.
        url: Name of the link, for messages.
    """

    def __init__(self, peer: InProcessPeer, *, url: str = "sim://") -> None:
        self.url = url
        self._handle = peer.handle
        self._answer = b""
        self._is_closed = False
        self._counters = LinkCounters()

    @property
    def statistics(self) -> LinkStatistics:
        """What went over the link so far."""
        return self._counters.statistics()

    def send(self, data: bytes) -> None:
        """Let the peer handle `data` and keep its answer.

        Raises:
            TransportClosed: The link is closed, or the peer is gone.
        """
        if self._is_closed:
            raise TransportClosed(f"{self.url}: the link is closed; open a new one")
        started_ns = perf_counter_ns()
        try:
            answer = self._handle(data)
        except TransportClosed:
            self._counters.errors += 1
            raise
        self._answer = self._answer + answer if self._answer else answer
        self._counters.sent(len(data), started_ns)

    def receive(self, timeout_s: float) -> bytes:
        """Return what the peer answered.

        Raises:
            TransportTimeout: It answered nothing.
            TransportClosed: The link is closed.
        """
        if self._is_closed:
            raise TransportClosed(f"{self.url}: the link is closed; open a new one")
        data = self._answer
        if not data:
            self._counters.errors += 1
            raise TransportTimeout(f"{self.url}: no byte within {timeout_s:g} s")
        self._answer = b""
        self._counters.received(len(data))
        return data

    def close(self) -> None:
        """Close the link; closing again does nothing."""
        self._is_closed = True

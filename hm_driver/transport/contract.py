"""What every transport promises; ``tests/hm_driver/transport/transport_contract.py`` holds each one to it."""

from typing import NamedTuple, Protocol


class LinkStatistics(NamedTuple):
    """What went over a link since it was opened."""

    sent_messages: int
    """Calls of `Transport.send` that succeeded."""
    received_messages: int
    """Calls of `Transport.receive` that returned bytes."""
    sent_bytes: int
    received_bytes: int
    errors: int
    """Time-outs and failures."""
    round_trips: int = 0
    """Messages sent that bytes came back for."""
    mean_round_trip_s: float = 0.0
    """From the beginning of a `Transport.send` to the end of the `Transport.receive` behind it [s]."""
    longest_round_trip_s: float = 0.0
    last_round_trip_s: float = 0.0


class Transport(Protocol):
    """A two-way stream of bytes to one device.

    Whoever implements it promises:

    - An open transport is returned by an opener; nothing opens in ``__init__``.
    - Bytes arrive in order and without loss, or an exception says that the link failed. Message boundaries
      may change: `receive` can return half a reply or two.
    - Nothing blocks for longer than its time-out.
    - One thread at a time calls `send` and `receive`; `close` may come from any thread at any time, and wakes
      the one that waits.
    - Its errors are `TransportTimeout` and `TransportClosed`, and name the link.
    """

    @property
    def url(self) -> str:
        """Where the link leads, in the form that opens it again."""
        ...

    @property
    def statistics(self) -> LinkStatistics:
        """What went over the link so far."""
        ...

    def send(self, data: bytes) -> None:
        """Send all of `data`.

        Raises:
            TransportTimeout: The peer took nothing for the time-out that the link was opened with; part of
                `data` may have gone, so the link is closed.
            TransportClosed: The link is closed, or the peer is gone.
        """
        ...

    def receive(self, timeout_s: float) -> bytes:
        """Return the next bytes as soon as there are any; never empty.

        Args:
            timeout_s: Longest wait [s]; 0 takes only what is there.

        Raises:
            TransportTimeout: No byte in time; the link stays open.
            TransportClosed: The link is closed, or the peer is gone.
        """
        ...

    def close(self) -> None:
        """Close the link; closing again does nothing."""
        ...

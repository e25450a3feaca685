"""What a transport counts of its traffic, for its statistics."""

from time import perf_counter_ns

from hm_driver.transport.contract import LinkStatistics


class LinkCounters:
    """Messages, bytes, errors and round trips of one transport.

    A round trip lasts from the beginning of `Transport.send` to the end of the first `Transport.receive`
    behind it that returned bytes; where several messages went out before, from the last one.
    """

    __slots__ = (
        "_last_ns",
        "_longest_ns",
        "_received_bytes",
        "_received_messages",
        "_round_trips",
        "_sent_bytes",
        "_sent_messages",
        "_sent_ns",
        "_total_ns",
        "errors",
    )

    def __init__(self) -> None:
        self._sent_messages = self._sent_bytes = 0
        self._received_messages = self._received_bytes = 0
        self._round_trips = self._total_ns = self._longest_ns = self._last_ns = 0
        self._sent_ns = 0
        self.errors = 0
        """Time-outs and failures so far."""

    def sent(self, size: int, started_ns: int) -> None:
        """Count a message of so many bytes, whose sending began at this ``time.perf_counter_ns`` [ns]."""
        self._sent_messages += 1
        self._sent_bytes += size
        self._sent_ns = started_ns

    def received(self, size: int) -> None:
        """Count so many bytes that were received just now."""
        self._received_messages += 1
        self._received_bytes += size
        if self._sent_ns:
            self._last_ns = last_ns = perf_counter_ns() - self._sent_ns
            self._sent_ns = 0
            self._round_trips += 1
            self._total_ns += last_ns
            if last_ns > self._longest_ns:
                self._longest_ns = last_ns

    def statistics(self) -> LinkStatistics:
        """What was counted so far."""
        return LinkStatistics(
            self._sent_messages,
            self._received_messages,
            self._sent_bytes,
            self._received_bytes,
            self.errors,
            self._round_trips,
            self._total_ns / self._round_trips * 1e-9 if self._round_trips else 0.0,
            self._longest_ns * 1e-9,
            self._last_ns * 1e-9,
        )

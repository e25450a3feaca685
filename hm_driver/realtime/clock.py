"""Time as an object: the wall clock of a real session, and the virtual clock of a lock-step one."""

import time
from collections.abc import Callable
from typing import Protocol


class Clock(Protocol):
    """A monotonic clock in whole nanoseconds that can be waited for.

    ``now_ns`` never goes back. After ``sleep_until_ns(t)`` and ``spin_until_ns(t)`` it is at least t; both
    return at once where t has passed.
    """

    def now_ns(self) -> int:
        """Time since the clock's epoch [ns]."""
        ...

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Give up the processor until the deadline [ns]."""
        ...

    def spin_until_ns(self, deadline_ns: int) -> int:
        """Wait for the deadline [ns] without giving up the processor; returns the time then [ns]."""
        ...


class WallClock:
    """CLOCK_MONOTONIC, which every process of the machine shares."""

    __slots__ = ()

    now_ns = staticmethod(time.monotonic_ns)
    """Time since the machine's start [ns]."""

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Sleep until the deadline [ns]; signals do not shorten it."""
        while (remaining_ns := deadline_ns - time.monotonic_ns()) > 0:
            time.sleep(remaining_ns * 1e-9)

    def spin_until_ns(self, deadline_ns: int) -> int:
        """Spin until the deadline [ns]; returns the time then [ns]."""
        monotonic_ns = time.monotonic_ns
        while (now_ns := monotonic_ns()) < deadline_ns:
            pass
        return now_ns


class VirtualClock:
    """A clock that stands still until someone waits on it.

    Waiting moves it, and tells every registered call-back the time it has reached; that is how the emulator
    is stepped in lock-step. No call-back may wait on the clock.

    Args:
        start_ns: First reading [ns].
    """

    __slots__ = ("_listeners", "_now_ns")

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns
        self._listeners: list[Callable[[int], object]] = []

    def on_advance(self, listener: Callable[[int], object]) -> None:
        """Call ``listener(now_ns)`` after each advance, in the order of registration."""
        self._listeners.append(listener)

    def now_ns(self) -> int:
        """Time reached so far [ns]."""
        return self._now_ns

    def sleep_until_ns(self, deadline_ns: int) -> None:
        """Advance to the deadline [ns]."""
        if deadline_ns > self._now_ns:
            self._now_ns = deadline_ns
            for listener in self._listeners:
                listener(deadline_ns)

    def spin_until_ns(self, deadline_ns: int) -> int:
        """Advance to the deadline [ns]; returns the time then [ns]."""
        self.sleep_until_ns(deadline_ns)
        return self._now_ns

"""Where a drive says things: results on standard output, everything else on standard error."""

import json
import sys
import time
from collections.abc import Callable, Mapping
from typing import TextIO

from tools.drive.status import DriveStatus

_LIVE_S = 0.1
_PLAIN_S = 1.0
_CLEAR = "\r\x1b[K"


class Console:
    """The two streams, and a line on the terminal that is drawn over and over.

    Args:
        out: For results.
        err: For everything else.
    """

    def __init__(self, out: TextIO | None = None, err: TextIO | None = None) -> None:
        self._out = out
        self._err = err
        self._has_line = False
        self._drawn_at = float("-inf")

    @property
    def out(self) -> TextIO:
        """Standard output, whatever it is just now."""
        return self._out or sys.stdout

    @property
    def err(self) -> TextIO:
        """Standard error, whatever it is just now."""
        return self._err or sys.stderr

    def write(self, text: str) -> None:
        """Write a line of the result."""
        self.clear()
        self.out.write(f"{text}\n")
        self.out.flush()

    def write_json(self, value: Mapping[str, object]) -> None:
        """Write a result as one JSON object on one line."""
        self.write(json.dumps(value, allow_nan=False, ensure_ascii=False))

    def write_rows(self, rows: list[tuple[str, str]]) -> None:
        """Write names and values in two columns."""
        width = max((len(name) for name, _ in rows), default=0)
        for name, value in rows:
            self.write(f"{name:<{width}}  {value}".rstrip())

    def tell(self, text: str) -> None:
        """Say something that is no result."""
        self.clear()
        self.err.write(f"{text}\n")
        self.err.flush()

    def draw(self, text: Callable[[], str]) -> None:
        """Draw a line over the one drawn before, ten times a second at most; nothing without a terminal."""
        if not self.err.isatty() or time.monotonic() - self._drawn_at < _LIVE_S:
            return
        self._drawn_at = time.monotonic()
        self._has_line = True
        self.err.write(f"{_CLEAR}{text()}")
        self.err.flush()

    def clear(self) -> None:
        """Take the drawn line away."""
        if self._has_line:
            self._has_line = False
            self.err.write(_CLEAR)
            self.err.flush()

    def watch(
        self, look: Callable[[], DriveStatus], *, seconds: float, as_json: bool, rate_hz: float = 0.0
    ) -> None:
        """Show the status again and again.

        Args:
            look: One look at the device.
            seconds: How long; endless for infinity.
            as_json: JSON, a line each, instead of text.
            rate_hz: Looks in a second; 0 for ten on a terminal and in JSON, and one else.
        """
        is_live = self.out.isatty() and not as_json
        period = 1.0 / rate_hz if rate_hz else _LIVE_S if is_live or as_json else _PLAIN_S
        ends = time.monotonic() + seconds
        try:
            while True:
                status = look()
                if as_json:
                    self.write_json(status.as_dict())
                elif is_live:
                    self.out.write(f"{_CLEAR}{status.line()}")
                    self.out.flush()
                else:
                    self.write(status.line())
                remaining = ends - time.monotonic()
                if remaining <= 0.0:
                    return
                time.sleep(min(period, remaining))
        finally:
            if is_live:
                self.out.write("\n")
                self.out.flush()

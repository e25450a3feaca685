"""The live view on a terminal: a panel with bars, redrawn in place, messages scrolling by above it."""

import math
import time
from itertools import groupby
from typing import TextIO

from rich.console import Console
from rich.live import Live
from rich.panel import Panel
from rich.table import Table
from rich.text import Text

from tools.live.lines import loop_text
from tools.live.status import SessionStatus

_LEAST_GAP_S = 0.1
_BAR_WIDTH = 36
_CONTROL_STYLE = {"human": "bold cyan", "robot": "bold green", "blending": "bold yellow"}
_MISSED_STYLE = "yellow"
_FORCE_SPAN = 2.0  # the bar ends at this multiple of the reference


class PanelScreen:
    """Draws on a terminal.

    Args:
        stream: The terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self._console = Console(file=stream)
        self._live = Live(
            console=self._console, auto_refresh=False, redirect_stdout=False, redirect_stderr=False
        )
        self._live.start()
        self._latest: SessionStatus | None = None
        self._drawn_at = float("-inf")

    def show(self, statuses: list[SessionStatus]) -> None:
        """Scroll the messages by and redraw the panel, at most ten times a second."""
        for status in statuses:
            for message in status.messages:
                self._console.print(Text.assemble((f"{status.time_s:7.1f} s  ", "dim"), message))
            self._latest = status
        if time.monotonic() - self._drawn_at >= _LEAST_GAP_S:
            self._draw()

    def finish(self) -> None:
        """Draw the last state and give the cursor back."""
        try:
            self._draw()
        finally:
            self._live.stop()

    def _draw(self) -> None:
        if self._latest is not None:
            ascii_only = not (self._console.encoding or "").startswith("utf")
            self._live.update(picture(self._latest, ascii_only=ascii_only), refresh=True)
            self._drawn_at = time.monotonic()


def picture(status: SessionStatus, *, ascii_only: bool = False) -> Panel:
    """The panel for one status."""
    reference, tolerance = status.reference_force_n, status.force_tolerance_n
    full = _FORCE_SPAN * reference or 1.0
    zone = ((reference - tolerance) / full, (reference + tolerance) / full)
    in_zone = abs(status.force_n - reference) <= tolerance
    rows = Table.grid(padding=(0, 2))
    rows.add_column(justify="right", style="dim")
    rows.add_column()
    rows.add_column()
    rows.add_row("control", _control(status, ascii_only=ascii_only), f"C {status.C:.2f}")
    rows.add_row(
        "force",
        bar(status.force_n / full, zone=zone, style="green" if in_zone else "yellow", ascii_only=ascii_only),
        f"{status.force_n:.1f} N of {reference:.1f} N",
    )
    rows.add_row(
        "coverage",
        bar(status.coverage, zone=(status.coverage_goal, 1.0), style="green", ascii_only=ascii_only),
        f"{100.0 * status.coverage:.1f} %, {status.models} models",
    )
    share = status.accumulated / status.accumulation_length if status.accumulation_length else 0.0
    rows.add_row(
        "samples",
        bar(share, style="blue", ascii_only=ascii_only),
        f"{status.accumulated} of {status.accumulation_length}, {status.updates} updates",
    )
    rows.add_row(
        "loop", Text(loop_text(status), _MISSED_STYLE if status.missed_periods else ""), status.scheduling
    )
    return Panel(rows, title=f"{status.stage}  {status.time_s:.1f} s", title_align="left", expand=False)


def bar(
    share: float, *, style: str, zone: tuple[float, float] | None = None, ascii_only: bool = False
) -> Text:
    """A bar filled to a share of 0 to 1; cells inside the zone are marked, so that the target is seen.

    Args:
        share: How far to fill; what lies outside 0 to 1, or is not a number, is drawn at the end or empty.
        style: Colour of the filled part.
        zone: Start and end of the target, as shares.
        ascii_only: For terminals without other characters.
    """
    filled_cell, empty_cell, target_cell = ("#", ".", "|") if ascii_only else ("█", "·", "┃")
    filled = round((0.0 if math.isnan(share) else max(0.0, min(1.0, share))) * _BAR_WIDTH)
    cells = [(filled_cell, style) if cell < filled else (empty_cell, "dim") for cell in range(_BAR_WIDTH)]
    for end in map(_cell, zone or ()):
        cells[end] = (target_cell, f"bold {style}" if end < filled else "bold")
    return Text.assemble(
        *(("".join(c for c, _ in run), key) for key, run in groupby(cells, lambda cell: cell[1]))
    )


def _cell(share: float) -> int:
    return max(0, min(_BAR_WIDTH - 1, int(share * _BAR_WIDTH)))


def _control(status: SessionStatus, *, ascii_only: bool) -> Text:
    dot = "*" if ascii_only else "●"
    words = {"human": "the human leads", "robot": "the robot leads", "blending": "blending"}
    return Text(f"{dot} {words[status.control]}", _CONTROL_STYLE[status.control])

"""The timing of a loop as a picture: its course over the log, and the share of cycles beyond a time."""

from typing import TYPE_CHECKING

import numpy as np

from tools.log.timing import LoopTiming

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LEAST_US = 0.1
"""Smallest time on the logarithmic axes: a cycle on a virtual clock is not late at all."""


def draw(timing: LoopTiming, title: str) -> "Figure":
    """Draw lateness and response over the log, and the tails of all that is timed."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.5, 5.2), layout="constrained")
    course, tail = figure.subplots(1, 2, width_ratios=(1.4, 1.0))
    _draw_course(course, timing)
    _draw_tails(tail, timing)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12.5, fontweight="bold")
    for axes in (course, tail):
        axes.grid(visible=True, which="major")
        axes.set_axisbelow(True)
    return figure


def _draw_course(axes: "Axes", timing: LoopTiming) -> None:
    from tools.report.figures import drawing

    for name, colour in (("response", drawing.ORANGE), ("lateness", drawing.BLUE)):
        if name not in timing.course:
            continue
        medians, largest = np.maximum(timing.course[name], _LEAST_US).T
        axes.plot(timing.course_s, largest, color=colour, linewidth=0.9, label=f"{name}, largest")
        axes.plot(
            timing.course_s, medians, color=colour, linewidth=2.0, linestyle="--", label=f"{name}, median"
        )
    if len(timing.missed_at_s):
        low = np.full(len(timing.missed_at_s), 0.02)
        axes.plot(
            timing.missed_at_s,
            low,
            linestyle="",
            marker="|",
            markersize=9,
            color=drawing.RED,
            transform=axes.get_xaxis_transform(),
            label=f"missed periods: {timing.missed}",
        )
    axes.set_yscale("log")
    axes.set_xlabel("Time since the beginning of the log [s]")
    axes.set_ylabel("Behind the grid [µs]")
    axes.set_title(f"Over the log, in {len(timing.course_s)} parts", loc="left")
    axes.margins(x=0.01, y=0.08)
    drawing.draw_legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3)


def _draw_tails(axes: "Axes", timing: LoopTiming) -> None:
    from tools.report.figures import drawing

    strokes = ("-", "--", "-.", ":")
    colours = (drawing.BLUE, drawing.ORANGE, drawing.GREEN, drawing.PURPLE)
    for (name, (times, shares)), colour, stroke in zip(timing.tails.items(), colours, strokes, strict=False):
        axes.plot(
            np.maximum(times, _LEAST_US), shares, color=colour, linestyle=stroke, linewidth=2.0, label=name
        )
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel("Time [µs]")
    axes.set_ylabel("Cycles that took longer [%]")
    axes.set_title("Distribution", loc="left")
    drawing.draw_legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=2)

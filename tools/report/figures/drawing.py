"""What all figures share: colours, type sizes, the plane, and the way to an SVG."""

import io
import itertools
import re
from contextlib import AbstractContextManager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import Polygon, Rectangle

from teaching.task import Task
from tools.report.session_data import STAGE_NAMES, FloatArray, Ticks

INK = "#1a1a1a"
GREY = "#8c8c8c"
PALE = "#e6e6e6"
GREEN = "#009e73"
BLUE = "#0072b2"
SKY = "#56b4e9"
RED = "#d55e00"
ORANGE = "#e69f00"
PURPLE = "#cc79a7"
"""Okabe and Ito's colours, which people with any colour vision tell apart."""

COLOURS = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY, INK)
"""The same for lines, in the order in which they are taken."""

STAGE_COLOURS = {0: "#f3f0e6", 1: "#ffffff", 2: "#e8f3ef"}

RC: dict[Any, Any] = {
    "font.family": "sans-serif",
    "font.sans-serif": ["DejaVu Sans", "Verdana", "Arial", "Helvetica"],
    "font.size": 12.0,
    "axes.titlesize": 12.5,
    "axes.titleweight": "bold",
    "axes.labelsize": 12.0,
    "axes.edgecolor": "#4d4d4d",
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.9,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 11.0,
    "ytick.labelsize": 11.0,
    "legend.fontsize": 11.0,
    "legend.frameon": False,
    "grid.color": "#d9d9d9",
    "grid.linewidth": 0.7,
    "lines.solid_capstyle": "round",
    "path.simplify_threshold": 0.5,
    "svg.fonttype": "none",
    "svg.hashsalt": "hapticmaster",
}


def to_svg(figure: Figure, name: str) -> str:
    """The figure as an ``<svg>`` element that scales with its page; ids begin with the name."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None, "Creator": None})
    text = buffer.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'(<svg[^>]*?) width="[^"]*"', r"\1", text, count=1)
    text = re.sub(r'(<svg[^>]*?) height="[^"]*"', r"\1", text, count=1)
    return re.sub(r'(\bid="|url\(#|href="#)', rf"\1{name}-", text)


def context() -> AbstractContextManager[None]:
    """The settings under which figures are made and written."""
    return mpl.rc_context(RC)


def draw_borders(axes: Axes, task: Task, *, colour: str = INK, width: float = 1.0) -> None:
    """The plane's edge and the borders between its objects."""
    half = 0.5 * task.size
    edge = [(-half, -half), (half, -half), (half, half), (-half, half)]
    axes.add_patch(Polygon(edge, closed=True, fill=False, edgecolor=colour, linewidth=width, zorder=4))
    lines = LineCollection(task.border_segments, colors=colour, linewidths=width, zorder=4)
    axes.add_collection(lines)


def fill_plane(axes: Axes, task: Task, colour: str) -> None:
    """A ground of one colour under the plane."""
    half = 0.5 * task.size
    axes.add_patch(Rectangle((-half, -half), task.size, task.size, facecolor=colour, linewidth=0, zorder=0))


def set_plane(axes: Axes, task: Task, *, labels: tuple[bool, bool] = (True, True)) -> None:
    """Scale and label axes that show the plane, with labels at the bottom and at the left if wanted."""
    half = 0.5 * task.size
    margin = 0.04 * task.size
    axes.set_xlim(-half - margin, half + margin)
    axes.set_ylim(-half - margin, half + margin)
    axes.set_aspect("equal")
    ticks = np.linspace(-half, half, 3)
    axes.set_xticks(ticks)
    axes.set_yticks(ticks)
    axes.tick_params(length=3)
    if labels[0]:
        axes.set_xlabel("x [m]")
    else:
        axes.set_xticklabels([])
    if labels[1]:
        axes.set_ylabel("y [m]")
    else:
        axes.set_yticklabels([])


def draw_legend(axes: Axes, **options: Any) -> None:  # noqa: ANN401 - as matplotlib takes them
    """A legend whose lines are thick enough to tell their colours, where there is something to name."""
    handles, names = axes.get_legend_handles_labels()
    if not handles:
        return
    legend = axes.legend(handles, names, **options)
    for line in legend.get_lines():
        line.set_linewidth(2.2)


def as_image(values: FloatArray) -> FloatArray:
    """Values on ``task.grid``, shape (n^2,), as an image with y upwards, shape (n, n)."""
    n = round(len(values) ** 0.5)
    image: FloatArray = values.reshape(n, n).T
    return image


def extent(task: Task) -> tuple[float, float, float, float]:
    """Where such an image lies on its axes."""
    half = 0.5 * task.size
    return -half, half, -half, half


def shade_stages(axes: Axes, ticks: Ticks, *, names: bool = False) -> None:
    """The stages of the session as pale bands, with their names on top if wanted."""
    time_s, stage = ticks.time_s, ticks.stage
    bounds = np.concatenate(([0], np.flatnonzero(np.diff(stage)) + 1, [len(stage)]))
    for first, last in itertools.pairwise(bounds.tolist()):
        number = int(stage[first])
        if number not in STAGE_NAMES:
            continue
        left, right = float(time_s[first]), float(time_s[min(last, len(time_s) - 1)])
        axes.axvspan(left, right, color=STAGE_COLOURS[number], linewidth=0, zorder=0)
        if number != 1:
            for edge in (left, right):
                axes.axvline(edge, color=GREY, linewidth=0.8, linestyle=(0, (2, 2)), zorder=1)
        if names and right - left > 0.02 * (time_s[-1] - time_s[0]):
            axes.annotate(
                STAGE_NAMES[number],
                ((left + right) / 2.0, 1.0),
                xycoords=("data", "axes fraction"),
                xytext=(0, 15),
                textcoords="offset points",
                ha="center",
                va="bottom",
                fontsize=11,
                color="#4d4d4d",
                style="italic",
            )

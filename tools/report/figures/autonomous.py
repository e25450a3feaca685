"""The autonomous run: where the force was wrong, by how much, and whose fault it was."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from teaching.evaluation import BAND, INSIDE
from tools.report.figures import drawing
from tools.report.figures.learning import ERROR
from tools.report.metrics import decimate, profile
from tools.report.session_data import FloatArray
from tools.report.summary import Analysis

BINS = 1000


def draw_maps(analysis: Analysis) -> Figure:
    """The path of the run, coloured by the force error and by its two parts."""
    run, task = analysis.run, analysis.data.task
    figure = Figure(figsize=(11.5, 4.35))
    grid = figure.add_gridspec(1, 3, left=0.065, right=0.895, top=0.9, bottom=0.12, wspace=0.1)
    panels = (
        ("Force error $|F - F_{ref}|$", run.force),
        ("of it, skill: $|K y - F_{ref}|$", run.skill),
        ("of it, rendering: $K |z - z_{ref}|$", run.rendering),
    )
    for column, (title, values) in enumerate(panels):
        axes = figure.add_subplot(grid[column])
        drawing.fill_plane(axes, task, "#dddddd")
        points = axes.scatter(
            run.x,
            run.y,
            c=values,
            s=7,
            marker="s",
            linewidths=0,
            cmap=ERROR,
            vmin=0.0,
            vmax=task.reference_force / 2.0,
        )
        points.set_rasterized(True)
        drawing.draw_borders(axes, task)
        drawing.set_plane(axes, task, labels=(True, column == 0))
        axes.set_title(title, pad=8)
    box = axes.get_position()
    bar = figure.add_axes((box.x1 + 0.018, box.y0, 0.015, box.height))
    figure.colorbar(points, cax=bar, extend="max")
    bar.set_ylabel("Error [N]")
    return figure


def draw_course(analysis: Analysis) -> Figure:
    """The run's error over time, and errors by the distance from the nearest border."""
    run = analysis.run
    figure = Figure(figsize=(11.5, 4.1))
    grid = figure.add_gridspec(
        1, 2, width_ratios=(1.25, 1.0), left=0.07, right=0.985, top=0.89, bottom=0.15, wspace=0.2
    )
    course, by_distance = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    course.plot(
        *decimate(run.time_s, run.force, BINS), color=drawing.BLUE, linewidth=0.9, label="force error"
    )
    course.plot(
        *decimate(run.time_s, run.rendering, BINS),
        color=drawing.ORANGE,
        linewidth=0.9,
        label="of it, rendering",
    )
    course.set_title("Over time", loc="left")
    course.set_xlabel("Time [s]")
    course.set_ylabel("Error [N]")
    course.set_ylim(bottom=0.0)
    course.margins(x=0.01)
    drawing.draw_legend(course, loc="lower right", ncols=2, bbox_to_anchor=(1.02, 0.99))
    by_distance.set_title("By distance from the nearest border", loc="left")
    if analysis.errors:
        _draw_profile(
            by_distance, analysis.errors[-1], analysis.border, drawing.INK, "grid: learned skill", "-"
        )
    _draw_profile(by_distance, run.force, run.border, drawing.BLUE, "run: measured", (0, (4, 1.5)))
    top = by_distance.get_ylim()[1]
    right = by_distance.get_xlim()[1]
    for left, end, name, shade in (
        (0.0, 100.0 * BAND, "border", "#fbe9df"),
        (100.0 * INSIDE, right, "inside", "#eaf4ef"),
    ):
        by_distance.axvspan(left, end, color=shade, linewidth=0, zorder=0)
        by_distance.annotate(
            name,
            ((left + end) / 2.0, 0.55 * top),
            rotation=90 if end - left < 3.0 else 0,
            ha="center",
            va="center",
            style="italic",
            color="#4d4d4d",
            fontsize=11,
        )
    by_distance.set_xlabel("Distance [cm]")
    by_distance.set_ylabel("Error [N]")
    by_distance.set_xlim(0.0, right)
    by_distance.set_ylim(0.0, top)
    drawing.draw_legend(by_distance, loc="upper right")
    for axes in (course, by_distance):
        axes.grid(axis="y")
        axes.set_axisbelow(True)
    return figure


def _draw_profile(
    axes: Axes,
    errors: FloatArray,
    border: FloatArray,
    colour: str,
    name: str,
    style: "str | tuple[int, tuple[float, ...]]",
) -> None:
    if not np.isfinite(border).any():
        return
    found = profile(errors, border, width=0.01)
    centimetres = 100.0 * found.distance
    axes.fill_between(centimetres, found.mean, found.p95, color=colour, alpha=0.13, linewidth=0)
    axes.plot(
        centimetres,
        found.mean,
        color=colour,
        linewidth=1.9,
        linestyle=style,
        label=f"{name}, mean (band: to 95 %)",
    )

"""The paper's Fig. 5: force, control factor and position over the session."""

import itertools

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from tools.report.figures import drawing
from tools.report.metrics import decimate
from tools.report.session_data import SessionData
from tools.report.summary import Analysis

BINS = 1200


def draw(analysis: Analysis) -> Figure:
    """Force against reference, C, position, and the colour under the manipulator, over time."""
    data = analysis.data
    ticks = data.ticks
    figure = Figure(figsize=(11.5, 7.6))
    grid = figure.add_gridspec(
        4,
        1,
        height_ratios=(3.0, 1.0, 2.2, 0.32),
        left=0.1,
        right=0.985,
        top=0.87,
        bottom=0.085,
        hspace=0.16,
    )
    force, control, position, colours = (figure.add_subplot(grid[row]) for row in range(4))
    reference = data.task.reference_force
    force.plot(
        *decimate(ticks.time_s, ticks.force, BINS), color=drawing.BLUE, linewidth=0.9, label="force", zorder=3
    )
    force.axhline(reference, color=drawing.INK, linewidth=1.3, linestyle="--", label="reference", zorder=4)
    top = max(1.6 * reference, 1.05 * float(np.quantile(ticks.force, 0.999)))
    force.set_ylim(0.0, top)
    force.set_ylabel("Force $F_z$ [N]")
    drawing.draw_legend(
        force, loc="lower right", ncols=2, facecolor="white", frameon=True, edgecolor="none", framealpha=0.85
    )
    for skill in data.skills:
        force.plot(skill.time_s, top, marker="o", markersize=8, color=drawing.INK, clip_on=False, zorder=6)
        force.annotate(
            str(skill.update),
            (skill.time_s, top),
            xytext=(8, 0),
            textcoords="offset points",
            va="center",
            fontsize=11,
        )
        for axes in (force, control, position):
            axes.axvline(skill.time_s, color=drawing.INK, linewidth=0.7, linestyle=":", zorder=1)
    control.plot(
        *decimate(ticks.time_s, ticks.C, BINS), color=drawing.INK, linewidth=1.2, drawstyle="steps-post"
    )
    control.fill_between(
        *decimate(ticks.time_s, ticks.C, BINS), color=drawing.GREY, alpha=0.3, linewidth=0, step="post"
    )
    control.set_ylim(-0.08, 1.12)
    control.set_yticks([0, 1], ["0 skill", "1 human"])
    control.set_ylabel("C")
    position.plot(*decimate(ticks.time_s, ticks.x, BINS), color=drawing.RED, linewidth=1.1, label="x")
    position.plot(
        *decimate(ticks.time_s, ticks.y, BINS),
        color=drawing.BLUE,
        linewidth=1.1,
        linestyle=(0, (4, 1.2)),
        label="y",
    )
    half = 0.5 * data.task.size
    position.set_ylim(-1.1 * half, 1.35 * half)
    position.set_ylabel("Position [m]")
    drawing.draw_legend(position, loc="upper right", ncols=2, borderaxespad=0.1)
    _draw_objects(colours, data)
    for axes in (force, control, position, colours):
        axes.set_xlim(ticks.time_s[0], ticks.time_s[-1])
    for axes in (force, control, position):
        drawing.shade_stages(axes, ticks, names=axes is force)
        axes.tick_params(labelbottom=False)
        axes.grid(axis="y")
        axes.set_axisbelow(True)
    colours.set_xlabel("Time [s]")
    figure.align_ylabels((force, control, position))
    return figure


def _draw_objects(axes: Axes, data: SessionData) -> None:
    """A strip with the colour of the object under the manipulator."""
    ticks, task = data.ticks, data.task
    every = max(1, len(ticks.time_s) // 3000)
    x, y, time_s = ticks.x[::every].tolist(), ticks.y[::every].tolist(), ticks.time_s[::every]
    found = np.array([task.object_at(a, b) for a, b in zip(x, y, strict=True)])
    bounds = np.concatenate(([0], np.flatnonzero(np.diff(found)) + 1, [len(found) - 1]))
    for index, thing in enumerate(task.objects):
        spans = [
            (time_s[a], time_s[b] - time_s[a])
            for a, b in itertools.pairwise(bounds.tolist())
            if found[a] == index
        ]
        axes.broken_barh(spans, (0, 1), facecolors=thing.hex, linewidth=0, label=f"{thing.stiffness:g} N/m")
    axes.set_ylim(0, 1)
    axes.set_yticks([0.5], ["object"])
    axes.tick_params(axis="y", length=0)
    axes.figure.legend(
        *axes.get_legend_handles_labels(),
        loc="upper right",
        ncols=len(task.objects),
        bbox_to_anchor=(0.99, 1.0),
        title="object under the manipulator",
        title_fontsize=11,
        columnspacing=1.2,
        handlelength=1.2,
    )

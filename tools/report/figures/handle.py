"""The handle against its reference in z, and the spring forces at a hand-over."""

import numpy as np
from matplotlib.figure import Figure

from tools.report.figures import drawing
from tools.report.metrics import decimate
from tools.report.session_data import FloatArray, SessionData

BINS = 1200
BEFORE_S, AFTER_S = 0.4, 1.2


def draw(data: SessionData) -> Figure:
    """Depth of handle and references over the session; below, one hand-over with its spring forces."""
    cycles = data.cycles
    figure = Figure(figsize=(11.5, 7.0))
    grid = figure.add_gridspec(
        2,
        2,
        height_ratios=(1.0, 1.0),
        left=0.075,
        right=0.985,
        top=0.925,
        bottom=0.085,
        hspace=0.36,
        wspace=0.18,
    )
    whole = figure.add_subplot(grid[0, :])
    handle, reference, assist = _depths(data)
    whole.plot(*decimate(cycles.time_s, handle, BINS), color=drawing.INK, linewidth=0.9, label="handle")
    whole.plot(
        *decimate(cycles.time_s, reference, BINS),
        color=drawing.ORANGE,
        linewidth=0.9,
        label="reference of position mode",
    )
    whole.set_xlim(data.ticks.time_s[0], data.ticks.time_s[-1])
    drawing.shade_stages(whole, data.ticks, names=True)
    whole.set_ylabel("Depth below surface [mm]")
    whole.set_xlabel("Time [s]")
    low, high = np.nanmin(handle, initial=0.0), np.nanmax(handle, initial=1.0)
    whole.set_ylim(high + 0.2 * (high - low), low - 0.05 * (high - low))
    drawing.draw_legend(whole, loc="lower right", ncols=2)
    depth, force = figure.add_subplot(grid[1, 0]), figure.add_subplot(grid[1, 1])
    at = hand_over_time(data)
    part = (cycles.time_s >= at - BEFORE_S) & (cycles.time_s <= at + AFTER_S)
    time_s = cycles.time_s[part]
    depth.plot(time_s, handle[part], color=drawing.INK, linewidth=1.8, label="handle")
    depth.plot(
        time_s, assist[part], color=drawing.GREEN, linewidth=1.5, linestyle="--", label="assist's rest height"
    )
    depth.plot(time_s, reference[part], color=drawing.ORANGE, linewidth=1.8, label="position reference")
    depth.set_ylabel("Depth below surface [mm]")
    depth.invert_yaxis()
    depth.set_title("A hand-over to the skill")
    drawing.draw_legend(depth, loc="best", fontsize=10)
    force.plot(
        time_s, cycles.spring_force_z[part], color=drawing.ORANGE, linewidth=1.8, label="position spring"
    )
    force.plot(
        time_s,
        cycles.assist_force[part],
        color=drawing.GREEN,
        linewidth=1.5,
        linestyle="--",
        label="assist spring",
    )
    force.set_ylabel("Commanded force in z [N]")
    force.set_title("The spring forces meanwhile")
    drawing.draw_legend(force, loc="best", fontsize=10)
    for axes in (depth, force):
        axes.set_xlabel("Time [s]")
        axes.set_xlim(at - BEFORE_S, at + AFTER_S)
        axes.axvline(at, color=drawing.GREY, linewidth=0.9, linestyle=":")
    for axes in (whole, depth, force):
        axes.grid(axis="y")
        axes.set_axisbelow(True)
    figure.align_ylabels((whole, depth))
    return figure


def _depths(data: SessionData) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Depth [mm] of the handle, of the position reference where engaged, of the assist where not."""
    cycles, task = data.cycles, data.task

    def depth(z: FloatArray) -> FloatArray:
        return 1e3 * (task.surface_z - task.scale[2] * (z - task.offset[2]))

    engaged = cycles.phase_z == 1.0
    reference = np.where(engaged, depth(cycles.reference_z), np.nan)
    assist = np.where(cycles.phase_z == 0.0, depth(cycles.assist_reference), np.nan)
    return depth(cycles.z), reference, assist


def hand_over_time(data: SessionData) -> float:
    """When the skill first took control while teaching, else the middle of the session [s]."""
    ticks = data.ticks
    falling = np.flatnonzero((ticks.C[1:] < 1.0) & (ticks.C[:-1] >= 1.0) & (ticks.stage[1:] == 1))
    middle = float(ticks.time_s[len(ticks.time_s) // 2])
    return float(ticks.time_s[falling[0] + 1]) if len(falling) else middle

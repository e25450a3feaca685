"""How punctual the loop was."""

import numpy as np
from matplotlib.figure import Figure

from tools.report.figures import drawing
from tools.report.metrics import lateness
from tools.report.session_data import SessionData

BINS = 500


def draw(data: SessionData) -> Figure:
    """Lateness over the session, and the share of cycles that were later than a value."""
    timing = data.timing
    late = np.maximum(timing.lateness_us, 0.1)
    figure = Figure(figsize=(11.5, 3.9))
    grid = figure.add_gridspec(
        1, 2, width_ratios=(1.4, 1.0), left=0.07, right=0.985, top=0.9, bottom=0.155, wspace=0.2
    )
    course, tail = figure.add_subplot(grid[0]), figure.add_subplot(grid[1])
    n = min(len(late), len(data.cycles.time_s))
    parts = np.array_split(late[:n], min(BINS, n))
    middles = [float(part[len(part) // 2]) for part in np.array_split(data.cycles.time_s[:n], len(parts))]
    course.plot(middles, [part.max() for part in parts], color=drawing.BLUE, linewidth=0.9, label="largest")
    medians = [np.median(part) for part in parts]
    course.plot(middles, medians, color=drawing.ORANGE, linewidth=1.4, label="median")
    drawing.draw_legend(course, loc="lower right", ncols=2, bbox_to_anchor=(1.02, 0.99))
    course.set_yscale("log")
    course.set_xlabel("Time [s]")
    course.set_ylabel("Lateness [µs]")
    course.set_title(f"Lateness, in {len(parts)} intervals", loc="left")
    course.margins(x=0.01)
    ordered = np.sort(late)[::-1]
    share = np.arange(1, len(ordered) + 1) / len(ordered)
    pick = np.unique(np.geomspace(1, len(ordered), 400).astype(int)) - 1
    tail.plot(ordered[pick], 100.0 * share[pick], color=drawing.BLUE, linewidth=1.8)
    tail.set_xscale("log")
    tail.set_yscale("log")
    tail.set_xlabel("Lateness [µs]")
    tail.set_ylabel("Cycles later than that [%]")
    tail.set_title("Its distribution", loc="left")
    quantiles = lateness(timing.lateness_us)
    for value, part, name in (
        (quantiles.p50, 50.0, "median"),
        (quantiles.p99, 1.0, "99 %"),
        (quantiles.p99_9, 0.1, "99.9 %"),
    ):
        tail.plot(max(value, 0.1), part, marker="o", color=drawing.INK, markersize=5, zorder=5)
        tail.annotate(
            f"{name}: {value:.0f} µs",
            (max(value, 0.1), part),
            xytext=(-8, -4),
            ha="right",
            va="top",
            textcoords="offset points",
            fontsize=10.5,
        )
    for axes in (course, tail):
        axes.grid(which="major")
        axes.set_axisbelow(True)
    return figure

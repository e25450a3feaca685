"""The paper's Fig. 4: how the skill grows, update by update."""

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import EllipseCollection
from matplotlib.colors import Colormap, LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from tools.report.figures import drawing
from tools.report.session_data import FloatArray, SessionData, Skill
from tools.report.summary import Analysis

DISPLACEMENT = "cividis"
ERROR = LinearSegmentedColormap.from_list("error", ["#ffffff", "#fddbc7", "#ef8a62", "#b2182b", "#4d0013"])
"""White where there is no error, dark red where there is much: lightness alone tells it."""

MOST_COLUMNS = 6


def draw(analysis: Analysis) -> Figure:
    """One column an update: displacement, force error, and path with models. Needs one update or more."""
    data = analysis.data
    chosen = _columns(len(data.skills))
    n = len(chosen)
    figure = Figure(figsize=(2.45 * n + 1.9, 8.6))
    left, right, top, bottom = 0.75 / figure.get_figwidth(), 1.0 - 1.05 / figure.get_figwidth(), 0.925, 0.115
    grid = figure.add_gridspec(3, n, left=left, right=right, top=top, bottom=bottom, wspace=0.08, hspace=0.1)
    deepest = 1.05 * max(data.task.reference_force / thing.stiffness for thing in data.task.objects)
    for column, index in enumerate(chosen):
        skill, evaluation, error = data.skills[index], analysis.evaluations[index], analysis.errors[index]
        has_model = evaluation.w_max >= data.w_th
        rows = [figure.add_subplot(grid[row, column]) for row in range(3)]
        rows[0].set_title(f"{skill.title}\nt = {skill.time_s:.1f} s", pad=8, linespacing=1.35)
        pictures: tuple[tuple[FloatArray, str | Colormap, float], ...] = (
            (1e3 * evaluation.y, DISPLACEMENT, 1e3 * deepest),
            (error, ERROR, data.task.reference_force),
        )
        images = []
        for axes, (values, colours, most) in zip(rows[:2], pictures, strict=True):
            drawing.fill_plane(axes, data.task, drawing.PALE)
            shown = drawing.as_image(np.where(has_model, values, np.nan))
            images.append(
                axes.imshow(
                    shown,
                    origin="lower",
                    extent=drawing.extent(data.task),
                    cmap=colours,
                    vmin=0.0,
                    vmax=most,
                    interpolation="nearest",
                )
            )
            drawing.draw_borders(axes, data.task, colour="#ffffff" if axes is rows[0] else drawing.INK)
        _draw_path(rows[2], analysis, index)
        for row, axes in enumerate(rows):
            drawing.set_plane(axes, data.task, labels=(row == 2, column == 0))
    names = ("Predicted displacement\n$z_r - z_a$ [mm]", "Force error\n$|K y - F_{ref}|$ [N]")
    for row, (image, name) in enumerate(zip(images, names, strict=True)):
        box = rows[row].get_position()
        bar = figure.add_axes(
            (box.x1 + 0.16 / figure.get_figwidth(), box.y0, 0.16 / figure.get_figwidth(), box.height)
        )
        figure.colorbar(image, cax=bar, extend="max")
        bar.set_ylabel(name, fontsize=11, labelpad=6)
        bar.tick_params(labelsize=10.5)
    rows[2].annotate(
        "Path and\nlocal models",
        (1.0, 0.5),
        xycoords="axes fraction",
        xytext=(26, 0),
        textcoords="offset points",
        rotation=90,
        ha="center",
        va="center",
        fontsize=11,
    )
    _legend(figure)
    return figure


def _columns(n: int) -> list[int]:
    """Indexes of the updates that are drawn: all, or the first, the last and some between."""
    if n <= MOST_COLUMNS:
        return list(range(n))
    return sorted({round(index) for index in np.linspace(0, n - 1, MOST_COLUMNS)})


def _draw_path(axes: Axes, analysis: Analysis, index: int) -> None:
    data = analysis.data
    skill = data.skills[index]
    until = _end_of_examination(data, skill)
    ticks = data.ticks
    shown = (ticks.time_s <= until) & (ticks.stage == 1)
    x, y, C = ticks.x[shown], ticks.y[shown], ticks.C[shown]
    kinds = (
        (C >= 1.0, drawing.INK, 1.5),
        ((C > 0.0) & (C < 1.0), "#9a9a9a", 1.5),
        (C <= 0.0, drawing.GREEN, 1.5),
    )
    for chosen, colour, width in kinds:
        line = _gaps(x, y, chosen)
        axes.plot(*line, color=colour, linewidth=width, zorder=2)
    drawing.draw_borders(axes, data.task, width=1.0)
    widths, heights, angles = activation_ellipses(skill.D, data.w_th)
    ellipses = EllipseCollection(
        widths,
        heights,
        angles,
        units="xy",
        offsets=skill.centres,
        offset_transform=axes.transData,
        facecolors="none",
        edgecolors=drawing.BLUE,
        linewidths=0.9,
        alpha=0.7,
        zorder=3,
    )
    axes.add_collection(ellipses)
    axes.plot(
        skill.centres[:, 0],
        skill.centres[:, 1],
        linestyle="none",
        marker="x",
        markersize=5,
        markeredgewidth=1.4,
        color=drawing.RED,
        zorder=5,
    )


def _end_of_examination(data: SessionData, skill: Skill) -> float:
    """When the human took over again after an update, or the end of teaching [s]."""
    ticks = data.ticks
    after = ticks.time_s > skill.time_s
    in_control = np.flatnonzero(after & (ticks.C <= 0.0))
    if not len(in_control):
        return skill.time_s
    back = np.flatnonzero((ticks.C >= 1.0) & (np.arange(len(ticks.C)) > in_control[0]))
    return float(ticks.time_s[back[0]]) if len(back) else float(ticks.time_s[-1])


def _gaps(x: FloatArray, y: FloatArray, chosen: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The chosen points, joined to their predecessors, with NaN elsewhere; every third point is enough."""
    keep = chosen.astype(bool)
    joined = keep.copy()
    joined[:-1] |= keep[1:]
    edge = np.zeros(len(keep), dtype=bool)
    edge[1:] = joined[1:] != joined[:-1]
    edge[:-1] |= edge[1:]
    use = edge | (np.arange(len(keep)) % 3 == 0)
    return np.where(joined, x, np.nan)[use], np.where(joined, y, np.nan)[use]


def activation_ellipses(D: FloatArray, w: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Full widths, heights [m] and angles [deg] of the ellipses where fields of D, (N, 2, 2), reach w."""
    values, vectors = np.linalg.eigh(D)
    axes = 2.0 * np.sqrt(-2.0 * np.log(w) / values)
    angles = np.degrees(np.arctan2(vectors[:, 1, 0], vectors[:, 0, 0]))
    return axes[:, 0], axes[:, 1], angles


def _legend(figure: Figure) -> None:
    handles = [
        Line2D([], [], color=drawing.INK, linewidth=2, label="human in control (C = 1)"),
        Line2D([], [], color=drawing.GREEN, linewidth=2, label="skill in control (C = 0)"),
        Line2D([], [], color="#9a9a9a", linewidth=2, label="blend"),
        Line2D(
            [],
            [],
            color=drawing.RED,
            marker="x",
            markeredgewidth=1.6,
            linestyle="none",
            label="centre of a model",
        ),
        Line2D(
            [],
            [],
            marker="o",
            markersize=10,
            markerfacecolor="none",
            markeredgecolor=drawing.BLUE,
            linestyle="none",
            label="activation $w_{th}$",
        ),
        Patch(facecolor=drawing.PALE, edgecolor=drawing.GREY, label="no model yet"),
    ]
    columns = 6 if figure.get_figwidth() > 10 else 3
    figure.legend(
        handles=handles,
        loc="lower center",
        ncols=columns,
        columnspacing=1.6,
        handletextpad=0.6,
        borderaxespad=0.3,
    )

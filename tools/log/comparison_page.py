"""A comparison as one file: the table and the overlaid curves as HTML, or the curves alone as SVG."""

import math
from collections.abc import Callable, Iterable
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from hm_driver.errors import RecordingError
from tools.log.comparison import CONTROL_STEP_S, Comparison, Line, Session, rows
from tools.log.output import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STROKES = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1)))
_POINTS = 300
"""Points of the mean of a group's curves."""
_MOST_NAMES = 14
"""Groups that a legend names; more are not told apart by eye."""


def write(compared: Comparison, target: Path, *, force: bool = False) -> None:
    """Write a comparison into a file.

    Args:
        compared: The sessions.
        target: The file, ``.html`` or ``.svg``.
        force: Whether one that is there may be written over.

    Raises:
        RecordingError: The suffix is another, or the file cannot be made.
    """
    from tools.report.figures import drawing

    suffix = target.suffix.lower()
    if suffix not in (".html", ".svg"):
        raise RecordingError(f"{target}: a comparison is written as .html or .svg, by the suffix")
    with whole_file(target, force=force, sources=tuple(one.path for one in compared.sessions)) as draft:
        with drawing.context():
            figure = draw(compared)
            if suffix == ".svg":
                figure.savefig(draft, format="svg", metadata={"Date": None})
                return
            svg = drawing.to_svg(figure, "comparison")
        draft.write_text(_page(compared, svg), encoding="utf-8")


def draw(compared: Comparison) -> "Figure":
    """Learning, control and the error at borders; thin lines are sessions, thick ones the mean of a group."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.5, 9.2), layout="constrained")
    grid = figure.add_gridspec(2, 2)
    learning, control, border = (
        figure.add_subplot(grid[place]) for place in ((0, slice(None)), (1, 0), (1, 1))
    )
    time, distance = "Time since teaching began [s]", "Distance from the nearest border [cm]"
    who = f"Who was in control, in steps of {CONTROL_STEP_S:g} s"
    for axes, title, x, y, line_of in (
        (learning, "How the skill grew", time, "Error of the skill [N]", _learning),
        (control, who, time, "Control of the human [%]", _control),
        (border, "Error of the autonomous run", distance, "Mean error [N]", _border),
    ):
        _overlay(axes, compared, line_of, is_stepped=axes is learning)
        axes.set_title(title, loc="left")
        axes.set_xlabel(x)
        axes.set_ylabel(y)
        axes.set_ylim(bottom=0.0)
        axes.margins(x=0.01)
        axes.grid(visible=True)
        axes.set_axisbelow(True)
    handles, names = learning.get_legend_handles_labels()
    if handles:
        figure.legend(handles, names, loc="outside upper center", ncols=min(4, len(names)))
    return figure


def _learning(session: Session) -> Line:
    return session.learning


def _control(session: Session) -> Line:
    return session.control


def _border(session: Session) -> Line:
    return session.border


def _overlay(
    axes: "Axes", compared: Comparison, line_of: Callable[[Session], Line], *, is_stepped: bool
) -> None:
    from tools.report.figures import drawing

    colours = (
        drawing.BLUE,
        drawing.RED,
        drawing.GREEN,
        drawing.PURPLE,
        drawing.ORANGE,
        drawing.SKY,
        drawing.INK,
    )
    style = "steps-post" if is_stepped else "default"
    for number, (group, sessions) in enumerate(compared.groups.items()):
        colour = colours[number % len(colours)]
        stroke = _STROKES[(number + number // len(colours)) % len(_STROKES)]
        lines = [line_of(session) for session in sessions]
        many = len(lines) > 1
        if many:
            for line in lines:
                axes.plot(*line, color=colour, linewidth=0.8, alpha=0.4, drawstyle=style)
        axes.plot(
            *(_mean(lines, is_stepped=is_stepped) if many else lines[0]),
            color=colour,
            linestyle=stroke,
            linewidth=2.2,
            drawstyle=style,
            label=f"{group} ({len(lines)})" if many else group if number < _MOST_NAMES else None,
        )


def _mean(lines: list[Line], *, is_stepped: bool) -> Line:
    """Mean of the curves as far as half of them go."""
    lines = [line for line in lines if len(line.x)]
    if not lines:
        return Line(np.empty(0), np.empty(0))
    end = float(np.median([line.x[-1] for line in lines]))
    x = np.linspace(min(line.x[0] for line in lines), end, _POINTS)
    sampled = np.array([_sample(line, x, is_stepped=is_stepped) for line in lines])
    counts = np.isfinite(sampled).sum(axis=0)
    total = np.nansum(sampled, axis=0)
    return Line(x, np.where(counts > 0, total / np.maximum(counts, 1), math.nan))


def _sample(line: Line, x: np.ndarray, *, is_stepped: bool) -> np.ndarray:
    if is_stepped:
        return line.y[np.clip(np.searchsorted(line.x, x, side="right") - 1, 0, len(line.y) - 1)]
    return np.asarray(np.interp(x, line.x, line.y, left=math.nan, right=math.nan))


def _page(compared: Comparison, svg: str) -> str:
    from tools.report.page import document

    groups = compared.groups
    title = f"{len(compared.sessions)} sessions compared"
    by = f" by {', '.join(compared.by)}" if compared.by else ""
    logs = "".join(
        f'<tr><td class="text">{escape(one.group)}</td><td class="text">{escape(str(one.path))}</td></tr>'
        for one in compared.sessions
    )
    caption = (
        "<b>Top:</b> mean error of the force that the skill would make on 80 × 80 points of the plane, after "
        "each update; before the first it is the whole reference. <b>Left:</b> the share of control that the "
        "human had while teaching. <b>Right:</b> the error of the autonomous run by the distance from the "
        "nearest border."
    )
    thick = " Thin lines are sessions, thick ones the mean of a group as far as half of its sessions go."
    mean = "<p>Mean ± half the width of its 95 % interval, by Student’s t.</p>" if compared.by else ""
    body = (
        f"<header><h1>{escape(title + by)}</h1></header>"
        f'<section id="numbers"><h2>The numbers</h2>{_table(compared)}{mean}</section>'
        f'<section id="curves"><h2>The curves</h2><figure>{svg}<figcaption><p>{caption}'
        f"{thick if any(len(one) > 1 for one in groups.values()) else ''}</p></figcaption></figure></section>"
        f"<details><summary>Logs ({len(compared.sessions)})</summary><table>{logs}</table></details>"
    )
    return document(title, body)


def _table(compared: Comparison) -> str:
    head = "".join(f"<th>{escape(name)}</th>" for name in compared.groups)
    body = "".join(
        f'<tr><th scope="row">{escape(label)}</th>{_cells(cells)}</tr>' for label, cells in rows(compared)
    )
    return f'<table class="facts"><thead><tr><th></th>{head}</tr></thead><tbody>{body}</tbody></table>'


def _cells(cells: Iterable[str]) -> str:
    return "".join(f"<td>{escape(cell)}</td>" for cell in cells)

"""Signals over time as a picture: an axis for each unit, lines told apart by colour and by their strokes."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from hm_driver.errors import RecordingError
from tools.log.curves import Curve, by_unit
from tools.log.output import whole_file
from tools.log.signals import short_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

QUANTITIES = {
    "m": "Position",
    "m/s": "Velocity",
    "N": "Force",
    "N/m": "Stiffness",
    "s": "Time",
    "ns": "Time",
}
"""What a unit measures, for the label of an axis that several signals share."""
SUFFIXES = (".png", ".svg", ".pdf")
"""Formats of pictures."""
_FEW = 400
"""Points of a line up to which its strokes can be seen beside its peaks."""
_STROKES = ("-", (0, (5, 1.5)), (0, (1.5, 1)), (0, (6, 1.5, 1.5, 1.5)))


def draw(curves: Sequence[Curve], title: str) -> "Figure":
    """Draw curves, those of one unit on one axis."""
    from matplotlib.figure import Figure

    groups = by_unit(curves)
    names = short_names(curve.signal for curve in curves)
    figure = Figure(figsize=(11.5, 1.3 + max(3.2, 2.5 * len(groups))), layout="constrained")
    all_axes = figure.subplots(len(groups), 1, sharex=True, squeeze=False)[:, 0]
    for axes, (unit, group) in zip(all_axes, groups, strict=True):
        _draw_group(axes, unit, group, names)
    all_axes[0].set_title(title, loc="left")
    all_axes[-1].set_xlabel("Time since the beginning of the log [s]")
    all_axes[-1].margins(x=0.01)
    figure.align_ylabels(all_axes)
    return figure


def write(target: Path, make: Callable[[], "Figure"], *, force: bool, sources: tuple[Path, ...]) -> None:
    """Draw a figure into a file, by its suffix.

    Args:
        target: The file.
        make: What draws the figure; run when it is clear that the file can be made.
        force: Whether one that is there may be written over.
        sources: Logs that are read meanwhile.

    Raises:
        RecordingError: The suffix is none of `SUFFIXES`, or the file cannot be made.
    """
    from tools.report.figures import drawing

    suffix = target.suffix.lower()
    if suffix not in SUFFIXES:
        raise RecordingError(f"{target}: pictures are {', '.join(SUFFIXES)}, by the suffix")
    with whole_file(target, force=force, sources=sources) as draft, drawing.context():
        _save(make(), draft, suffix)


def _save(figure: "Figure", path: Path, suffix: str) -> None:
    date = {".png": "Software", ".svg": "Date", ".pdf": "CreationDate"}[suffix]
    figure.savefig(path, format=suffix.removeprefix("."), dpi=110, metadata={date: None})


def _draw_group(axes: "Axes", unit: str, group: Sequence[Curve], names: dict[str, str]) -> None:
    from matplotlib.ticker import MaxNLocator

    from tools.report.figures import drawing

    colours = drawing.COLOURS
    for number, curve in enumerate(group):
        stroke = _STROKES[number % len(_STROKES)] if len(group) > 1 else "-"
        axes.plot(
            curve.time_s,
            curve.values,
            color=colours[number % len(colours)],
            linestyle=stroke
            if len(curve.time_s) < _FEW
            else _STROKES[number // len(colours) % len(_STROKES)],
            linewidth=1.4,
            drawstyle="steps-post" if curve.signal.is_whole else "default",
            marker="o" if len(curve.time_s) < 30 else "",
            markersize=4,
            label=names[curve.signal.name],
        )
    if all(curve.signal.is_whole for curve in group):
        axes.yaxis.set_major_locator(MaxNLocator(integer=True))
    only = names[group[0].signal.name] if len(group) == 1 else QUANTITIES.get(unit, "")
    axes.set_ylabel(f"{only} [{unit}]".strip() if unit else only or "no unit")
    axes.grid(visible=True)
    axes.set_axisbelow(True)
    if len(group) > 1:
        drawing.draw_legend(axes, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=min(4, len(group)))

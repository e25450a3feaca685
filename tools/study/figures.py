"""The pictures of a study."""

import io
import math
import re
import textwrap
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from tools.study.statistics import CaseResult, Results, mean_of, varying_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS: Final = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
"""Told apart by people with any colour vision (Okabe and Ito)."""
MARKERS: Final = ("o", "s", "^", "D", "v", "P", "X")
LINES: Final = ("-", "--", "-.", ":", (0, (5, 1)), (0, (3, 1, 1, 1)), (0, (1, 1)))
_STYLE: Final[dict[Any, Any]] = {
    "font.size": 17.0,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "grid.color": "#dddddd",
    "axes.axisbelow": True,
    "legend.frameon": False,
    "svg.hashsalt": "study",
    "svg.fonttype": "none",
    "font.sans-serif": ["DejaVu Sans", "Verdana", "sans-serif"],
    "figure.constrained_layout.w_pad": 0.12,
    "figure.constrained_layout.h_pad": 0.08,
    "path.simplify_threshold": 0.5,
}
_NOT_COMPARED: Final = "method"
_LONG_NUMBER: Final = re.compile(r"(?<![\w.#-])-?\d+\.\d{3,}(?![\w.])")
"""Coordinates are told to a hundredth of a point."""
_CURVE_END_S: Final = 150.0
"""The growth of a skill is drawn up to here [s]; most are done long before."""
_CURVE_RANGE: Final = (0.25, 40.0)
"""Range of the error while it grows [N]."""
_MOST_ABOVE: Final = 1.8
"""How far above the largest mean an interval is drawn, in terms of it."""

_CONTROL: Final = (
    ("human_share", 100.0, "share of human control [%]"),
    ("hand_overs", 1.0, "hand-overs"),
    ("autonomy_s", 1.0, "time to autonomy [s]"),
)
_ERRORS: Final = (
    ("grid_overall_mean", "whole plane: force error [N]"),
    ("grid_border_mean", "within 2 cm of a border [N]"),
)


def draw(results: Results, directory: Path) -> list[Path]:
    """Draw what there is to be drawn.

    Args:
        results: The results.
        directory: Of the SVG files; made if need be.

    Returns:
        Their paths.
    """
    import matplotlib as mpl

    directory.mkdir(parents=True, exist_ok=True)
    paths: list[Path] = []
    with mpl.rc_context(_STYLE):
        cross = [case for case in results.cross if case.sessions]
        if cross:
            paths.append(_save(_draw_errors(cross), directory / "study-errors.svg"))
            paths.append(_save(_draw_curves(cross), directory / "study-curves.svg"))
            paths.append(_save(_draw_control(cross), directory / "study-control.svg"))
        if results.sensitivity:
            paths.append(_save(_draw_sensitivity(results.sensitivity), directory / "study-sensitivity.svg"))
    return paths


def _save(figure: "Figure", path: Path) -> Path:
    drawn = io.StringIO()
    figure.savefig(drawn, format="svg", metadata={"Date": None})
    path.write_text(_LONG_NUMBER.sub(lambda number: f"{float(number[0]):.2f}", drawn.getvalue()))
    return path


def _new(rows: int, columns: int, size: tuple[float, float]) -> "tuple[Figure, list[Axes]]":
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    FigureCanvasSVG(figure)
    axes = figure.subplots(rows, columns, squeeze=False)
    return figure, list(axes.ravel())


def _split(cases: Sequence[CaseResult]) -> tuple[dict[str, int], dict[str, int]]:
    """Series (first axis that differs) and groups (the others), numbered in their order."""
    axes = varying_axes(cases) or [cases[0].settings[0][0] if cases[0].settings else ""]
    series: dict[str, int] = {}
    groups: dict[str, int] = {}
    for case in cases:
        one, rest = _places(case, axes)
        series.setdefault(one, len(series))
        groups.setdefault(rest, len(groups))
    return series, groups


def _places(case: CaseResult, axes: Sequence[str]) -> tuple[str, str]:
    settings = dict(case.settings)
    return settings.get(axes[0], "base"), ", ".join(settings.get(axis, "") for axis in axes[1:])


def _draw_groups(axis: "Axes", cases: Sequence[CaseResult], column: str, factor: float) -> list[Any]:
    """Mean and interval of each case, series beside series in each group."""
    series, groups = _split(cases)
    axes = varying_axes(cases) or [cases[0].settings[0][0] if cases[0].settings else ""]
    handles: dict[str, Any] = {}
    for case in cases:
        one, rest = _places(case, axes)
        place = series[one]
        x = groups[rest] + 0.7 * ((place + 0.5) / len(series) - 0.5)
        mean = case.figures[column]
        if mean.n == 0:
            continue
        half = mean.half if math.isfinite(mean.half) else 0.0
        handles[one] = axis.errorbar(
            x, factor * mean.mean, factor * half, color=COLOURS[place % len(COLOURS)],
            marker=MARKERS[place % len(MARKERS)], markersize=9, capsize=5, elinewidth=2, linestyle="none",
            label=one,
        )  # fmt: skip
    names = [textwrap.fill(name, 14) for name in groups]
    axis.set_xticks(range(len(groups)), names if any(names) else ["" for _ in groups])
    axis.set_xlim(-0.6, len(groups) - 0.4)
    axis.grid(visible=False, axis="x")
    means = [factor * case.figures[column].mean for case in cases if case.figures[column].n]
    top = min(axis.get_ylim()[1], _MOST_ABOVE * max(means, default=1.0))
    axis.set_ylim(0.0, top)
    return [handles[one] for one in series if one in handles]


def _draw_errors(cases: Sequence[CaseResult]) -> "Figure":
    _, groups = _split(cases)
    figure, axes = _new(len(_ERRORS), 1, (max(9.0, 1.8 * len(groups)), 9.0))
    for axis, (column, label) in zip(axes, _ERRORS, strict=True):
        handles = _draw_groups(axis, cases, column, 1.0)
        axis.set_ylabel(label)
    figure.legend(handles=handles, loc="outside upper center", ncols=min(5, len(handles)))
    return figure


def _draw_control(cases: Sequence[CaseResult]) -> "Figure":
    _, groups = _split(cases)
    figure, axes = _new(len(_CONTROL), 1, (max(9.0, 1.8 * len(groups)), 12.0))
    most: list[Any] = []
    for axis, (column, factor, label) in zip(axes, _CONTROL, strict=True):
        handles = _draw_groups(axis, cases, column, factor)
        most = max(most, handles, key=len)
        axis.set_ylabel(label)
    figure.legend(handles=most, loc="outside upper center", ncols=min(5, len(most)))
    return figure


def _draw_curves(cases: Sequence[CaseResult]) -> "Figure":
    series, groups = _split(cases)
    axes_names = varying_axes(cases) or [cases[0].settings[0][0] if cases[0].settings else ""]
    columns = min(3, len(groups))
    rows = math.ceil(len(groups) / columns)
    figure, axes = _new(rows, columns, (max(9.0, 4.6 * columns), 0.8 + 4.2 * rows))
    handles: dict[str, Any] = {}
    for axis, group in zip(axes, groups, strict=False):
        for case in cases:
            one, rest = _places(case, axes_names)
            if rest == group and len(case.curve_s):
                handles[one] = _draw_curve(axis, case, series[one])
        axis.set_title(group, fontsize=17.0)
        axis.set_yscale("log")
        axis.set_ylim(*_CURVE_RANGE)
        axis.set_yticks([0.5, 1.0, 2.0, 5.0, 10.0, 20.0], ["0.5", "1", "2", "5", "10", "20"])
        axis.set_yticks([], minor=True)
        axis.set_xlim(0.0, min(_CURVE_END_S, axis.get_xlim()[1]))
        axis.set_xlabel("teaching time [s]")
    for axis in axes[::columns]:
        axis.set_ylabel("force error [N]")
    for axis in axes[len(groups) :]:
        axis.remove()
    found = [handles[one] for one in series if one in handles]
    figure.legend(handles=found, loc="outside upper center", ncols=min(5, len(found)))
    return figure


def _draw_curve(axis: "Axes", case: CaseResult, place: int) -> Any:  # noqa: ANN401 - a matplotlib line
    enough = np.count_nonzero(np.isfinite(case.curve_error), axis=0) >= max(1, 0.5 * case.sessions)
    enough &= case.curve_s <= _CURVE_END_S
    times = case.curve_s[enough]
    means = [mean_of(column) for column in case.curve_error[:, enough].T]
    colour = COLOURS[place % len(COLOURS)]
    low = [max(mean.low, 0.1 * _CURVE_RANGE[0]) for mean in means]
    high = [mean.high for mean in means]
    axis.fill_between(times, low, high, color=colour, alpha=0.12, linewidth=0.0, step="post")
    middle = [mean.mean for mean in means]
    (line,) = axis.plot(
        times, middle, color=colour, linestyle=LINES[place % len(LINES)], linewidth=2.5,
        drawstyle="steps-post",
        marker=MARKERS[place % len(MARKERS)], markevery=max(1, len(times) // 5), markersize=7,
        label=_places(case, varying_axes([case]) or [_NOT_COMPARED])[0],
    )  # fmt: skip
    return line


def _draw_sensitivity(parts: Mapping[str, Sequence[CaseResult]]) -> "Figure":
    """A row a parameter: error on the plane and at its borders, and teaching time, against its value."""
    columns = min(3, len(parts))
    rows = math.ceil(len(parts) / columns)
    figure, axes = _new(rows, columns, (max(9.0, 4.6 * columns), 0.8 + 4.0 * rows))
    handles: list[Any] = []
    for axis, (part, cases) in zip(axes, parts.items(), strict=False):
        handles = _draw_parameter(axis, part, cases)
    for axis in axes[len(parts) :]:
        axis.remove()
    figure.legend(handles=handles, loc="outside upper center", ncols=3)
    return figure


def _draw_parameter(axis: "Axes", part: str, cases: Sequence[CaseResult]) -> list[Any]:
    values = [dict(case.settings)[part] for case in cases]
    places = list(range(len(values)))
    times = axis.twinx()
    handles = []
    for on, column, label, place in (
        (axis, "grid_overall_mean", "force error [N], left", 0),
        (axis, "grid_border_mean", "at borders [N], left", 1),
        (times, "teaching_s", "teaching [s], right", 2),
    ):
        means = [case.figures[column] for case in cases]
        handles.append(
            on.errorbar(
                places, [mean.mean for mean in means],
                [mean.half if math.isfinite(mean.half) else 0.0 for mean in means],
                color=COLOURS[place], marker=MARKERS[place], linestyle=LINES[place], markersize=8, capsize=4,
                linewidth=2, label=label,
            )
        )  # fmt: skip
    errors = [case.figures[name].mean for case in cases for name, _ in _ERRORS]
    axis.set_ylim(0.0, 1.25 * max((error for error in errors if math.isfinite(error)), default=1.0))
    times.set_ylim(0.0, 1.15 * max(times.get_ylim()[1] / 1.05, 1.0))
    times.grid(visible=False)
    times.spines["right"].set_visible(True)
    axis.set_xticks(places, [textwrap.shorten(value, 12) for value in values])
    axis.set_xlabel(part)
    return handles

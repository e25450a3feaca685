"""The pictures of a run: all scenarios at a glance, and each as histogram and time series."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

from tools.jitter.compare import Comparison
from tools.jitter.result import CyclictestResult, ScenarioResult
from tools.jitter.spread import Spread
from tools.report.figures import drawing

WIDTH = 11.5
"""Of every picture [in]."""
_FLOOR_US = 1.0
_LEAST_US = 0.1
_BINS_A_DECADE = 20
_MARKS = (("p50", "o"), ("p99", "s"), ("p99_9", "D"), ("max", "|"))
_MARK_NAMES = {"p50": "p50", "p99": "p99", "p99_9": "p99.9", "max": "max"}


def draw_overview(
    results: Sequence[ScenarioResult], *, p99_9_limit: float, max_limit: float | None
) -> Figure:
    """Excess and lateness of every scenario as ranges from median to maximum."""
    names = [result.name.replace("+", " +\n") for result in results]
    has_excess = any(result.excess.samples for result in results)
    height = 1.75 + 0.52 * sum(1 + 0.7 * name.count("\n") for name in names)
    figure = Figure(figsize=(WIDTH, height), layout="constrained")
    panels = figure.subplots(1, 2 if has_excess else 1, sharey=True, squeeze=False)[0]
    if has_excess:
        _draw_ranges(panels[0], [result.excess for result in results], drawing.BLUE)
        panels[0].set_title("Excess over the canary: the loop's own lateness", loc="left")
        _draw_limit(panels[0], p99_9_limit, f"limit of p99.9, {p99_9_limit:g} µs", (5, 2))
        if max_limit is not None:
            _draw_limit(panels[0], max_limit, f"limit of max, {max_limit:g} µs", (1.2, 1.6))
    _draw_ranges(panels[-1], [result.lateness for result in results], drawing.ORANGE)
    panels[-1].set_title("Wake lateness: what the machine adds included", loc="left")
    panels[0].set_yticks(range(len(names)), names)
    panels[0].invert_yaxis()
    low, high = _range([s for r in results for s in (r.excess, r.lateness)])
    for axes in panels:
        axes.set_xlim(low, high)
        axes.set_xlabel("Time behind [µs]")
        axes.tick_params(axis="y", length=0)
    handles, labels = panels[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def draw_scenario(result: ScenarioResult) -> Figure:
    """The course of one scenario on the left, its distribution on the right."""
    figure = Figure(figsize=(WIDTH, 4.3), layout="constrained")
    course, share = figure.subplots(1, 2, width_ratios=(1.45, 1.0))
    _draw_course(course, result)
    kinds = [
        ("response", result.response, drawing.GREY, 1.6),
        ("wake lateness", result.lateness, drawing.ORANGE, 1.6),
        ("canary", result.canary, drawing.INK, 1.4),
        ("excess", result.excess, drawing.BLUE, 2.4),
    ]
    _draw_histograms(share, [kind for kind in kinds if kind[1].samples])
    return figure


def draw_cyclictest(sliced: CyclictestResult) -> Figure:
    """The loop beside cyclictest: shares of wake-ups that were later than a time."""
    figure = Figure(figsize=(WIDTH, 4.2), layout="constrained")
    axes = figure.add_subplot()
    lines = [
        ("cyclictest", sliced.cyclictest, drawing.INK, (0, (5, 2))),
        ("loop, spinning", sliced.spin, drawing.BLUE, "solid"),
        ("loop, not spinning", sliced.no_spin, drawing.RED, "solid"),
    ]
    for name, spread, colour, style in lines:
        values, shares = _tail(spread)
        axes.step(values, shares, where="post", color=colour, linestyle=style, linewidth=2.2, label=name)
    axes.axhline(1.0, color=drawing.GREY, linewidth=0.9, linestyle=(0, (2, 2)))
    axes.annotate("99th percentile", (1.0, 1.0), xycoords=("axes fraction", "data"), xytext=(-4, 4),
                  textcoords="offset points", ha="right", fontsize=11, color="#4d4d4d")  # fmt: skip
    _set_log_axes(axes, _range([sliced.cyclictest, sliced.spin, sliced.no_spin], _LEAST_US))
    axes.xaxis.set_major_formatter(FuncFormatter(_plain))
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.set_ylabel("Wake-ups later than that [%]")
    axes.set_title(f"Pooled over {sliced.slices} slices that took turns", loc="left")
    drawing.draw_legend(axes, loc="upper right")
    return figure


def draw_comparison(comparison: Comparison) -> Figure:
    """Ratios of the second run to the first, a row a scenario and quantity."""
    rows = [row for row in comparison.rows if row.ratios]
    figure = Figure(figsize=(WIDTH, 1.9 + 0.42 * max(1, len(rows))), layout="constrained")
    axes = figure.add_subplot()
    axes.axvspan(0.8, 1.25, color="#efefef", linewidth=0, zorder=0)
    axes.axvline(1.0, color=drawing.INK, linewidth=1.0, zorder=1)
    colours = (drawing.BLUE, drawing.GREEN, drawing.RED, drawing.PURPLE)
    for (name, mark), colour in zip(_MARKS, colours, strict=True):
        points = [(row.ratios[name], place) for place, row in enumerate(rows) if name in row.ratios]
        if points:
            x, y = zip(*points, strict=True)
            size = 150 if mark == "|" else 58
            axes.scatter(x, y, s=size, marker=mark, color=colour, label=_MARK_NAMES[name], zorder=3,
                         linewidths=2.6 if mark == "|" else 0.8)  # fmt: skip
    axes.set_yticks(range(len(rows)), [f"{row.scenario}: {row.quantity}" for row in rows])
    axes.invert_yaxis()
    axes.set_xscale("log")
    values = [ratio for row in rows for ratio in row.ratios.values() if ratio > 0.0] or [1.0]
    axes.set_xlim(min(0.45, min(values) / 1.3), max(2.2, max(values) * 1.3))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(FuncFormatter(_plain_minor))
    axes.grid(axis="x", which="both")
    axes.set_axisbelow(True)
    axes.tick_params(axis="y", length=0)
    axes.set_xlabel("Second run / first run; below 1 the second is better")
    handles, labels = axes.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=len(labels))
    return figure


def _draw_ranges(axes: Axes, spreads: Sequence[Spread], colour: str) -> None:
    for place, spread in enumerate(spreads):
        if not spread.samples:
            continue
        values = {name: max(_FLOOR_US, getattr(spread, name)) for name, _ in _MARKS}
        axes.plot([values["p50"], values["max"]], [place] * 2, color=colour, linewidth=1.6, zorder=2)
        axes.plot([values["p50"], values["p99"]], [place] * 2, color=colour, linewidth=5.0, zorder=2)
        for name, mark in _MARKS:
            is_bar = mark == "|"
            axes.plot(values[name], place, marker=mark, color=colour, zorder=3, linestyle="none",
                      markersize=13 if is_bar else 8.5, markeredgecolor=colour if is_bar else "white",
                      markeredgewidth=2.6 if is_bar else 0.9,
                      label=_MARK_NAMES[name] if place == 0 else None)  # fmt: skip
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter(FuncFormatter(_behind))
    axes.grid(axis="x")
    axes.set_axisbelow(True)
    axes.set_ylim(-0.6, len(spreads) - 0.4)


def _draw_limit(axes: Axes, limit: float, name: str, dashes: tuple[float, float]) -> None:
    axes.axvline(limit, color=drawing.RED, linewidth=1.6, linestyle=(0, dashes), zorder=1, label=name)


def _draw_course(axes: Axes, result: ScenarioResult) -> None:
    points = result.course
    time_s = [point.time_s for point in points]
    lines = [
        ("response, largest", [p.response_max for p in points], drawing.GREY, 1.2),
        ("canary, largest", [p.canary_max for p in points], drawing.INK, 1.0),
        ("excess, largest", [p.excess_max for p in points], drawing.BLUE, 1.9),
        ("wake lateness, median", [p.lateness_p50 for p in points], drawing.ORANGE, 2.0),
    ]
    for name, values, colour, width in lines:
        if any(value is not None for value in values):
            raised = [np.nan if value is None else max(_FLOOR_US, value) for value in values]
            axes.plot(time_s, raised, color=colour, linewidth=width, label=name)
    own = [point.time_s for point in points if point.own_missed]
    if own:
        axes.plot(own, [0.985] * len(own), transform=axes.get_xaxis_transform(), clip_on=False,
                  marker="v", color=drawing.RED, linestyle="none", markersize=7,
                  label=f"{result.own_missed} missed, no canary")  # fmt: skip
    low, high = _range([result.excess, result.lateness, result.response])
    axes.set_yscale("log")
    axes.set_ylim(low, high * 3.2)
    axes.yaxis.set_major_formatter(FuncFormatter(_behind))
    axes.set_xlim(0.0, result.duration_s)
    axes.grid(axis="y")
    axes.set_axisbelow(True)
    axes.set_xlabel("Time [s]")
    axes.set_ylabel("Behind the deadline [µs]")
    bin_s = result.duration_s / max(1, len(points))
    axes.set_title(f"Course, a point each {bin_s:.3g} s", loc="left")
    drawing.draw_legend(axes, loc="upper left", ncols=2, columnspacing=1.2, handlelength=1.6)


def _draw_histograms(axes: Axes, kinds: Sequence[tuple[str, Spread, str, float]]) -> None:
    """Counts in bins of equal width on the logarithmic axis, so that areas compare."""
    low, high = _range([kind[1] for kind in kinds])
    decades = np.log10(high / low)
    edges = np.geomspace(low, high, int(decades * _BINS_A_DECADE) + 1)
    for name, spread, colour, width in kinds:
        upper = np.array([max(_FLOOR_US, value) for value, _ in spread.bins])
        counts, _ = np.histogram(upper, edges, weights=[count for _, count in spread.bins])
        label = f"{name}, {_brief(spread.p50)} / {_brief(spread.p99_9)}"
        shown = np.where(counts > 0, counts, 0.5)
        axes.stairs(shown, edges, baseline=0.5, color=colour, linewidth=width, label=label,
                    fill=name == "excess", alpha=0.85 if name == "excess" else 1.0,
                    zorder=2 if name == "excess" else 3)  # fmt: skip
    _set_log_axes(axes, (low, high))
    axes.set_yscale("log")
    top = axes.get_ylim()[1]
    axes.set_ylim(0.5, top * 60.0)
    axes.yaxis.set_major_formatter(FuncFormatter(_plain))
    axes.set_ylabel("Cycles")
    axes.set_title("Distribution", loc="left")
    drawing.draw_legend(axes, loc="upper right", title="p50 / p99.9 [µs]", handlelength=1.4)


def _set_log_axes(axes: Axes, ends: tuple[float, float]) -> None:
    axes.set_xscale("log")
    axes.set_xlim(*ends)
    axes.xaxis.set_major_formatter(FuncFormatter(_behind))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.grid(which="major")
    axes.set_axisbelow(True)
    axes.set_xlabel("Behind the deadline [µs]")


def _range(spreads: Sequence[Spread], floor_us: float = _FLOOR_US) -> tuple[float, float]:
    """Ends of a logarithmic axis that holds all of it [µs]."""
    filled = [spread for spread in spreads if spread.samples]
    low = min((max(floor_us, spread.bins[0][0]) for spread in filled), default=1.0)
    high = max((spread.max for spread in filled), default=100.0)
    return low * 0.8, max(high * 1.6, low * 10.0)


def _tail(spread: Spread) -> tuple[list[float], list[float]]:
    """Durations [µs] and the share that was longer [%]."""
    values, shares, left = [], [], spread.samples
    for upper, count in spread.bins:
        left -= count
        if left > 0:
            values.append(max(_LEAST_US, upper))
            shares.append(100.0 * left / spread.samples)
    return values, shares


def _behind(value: float, _: object) -> str:
    return "≤ 1" if value == _FLOOR_US else _plain(value, _)


def _plain(value: float, _: object) -> str:
    return f"{value:g}" if value < 1e4 else f"{value / 1e3:g}k"


def _plain_minor(value: float, _: object) -> str:
    lead = f"{value:e}"[0]
    return f"{value:g}" if lead in "25" else ""


def _brief(value: float) -> str:
    return f"{value:.1f}" if value < 9.95 else f"{value:.0f}"

"""The Z-width of the emulated arm as a picture: ``python -m tools.bench.zwidth --output zwidth.svg``.

Takes about half a minute on one core and gives the same picture every time.
"""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from cyclopts import App

from tools.bench.stability import STIFFEST, Setting, quiet, stiffest_hand, stiffest_wall
from tools.cli.console import tell, write

if TYPE_CHECKING:
    from matplotlib.axes import Axes

MASSES = (0.1, 0.14, 0.2, 0.28, 0.4, 0.56, 0.8, 1.1, 1.6, 2.0, 2.8, 4.0, 5.6, 8.0)
"""Virtual masses [kg]."""
HANDS = (2e3, 10e3, 40e3)
"""Stiffness of the hands that press against the wall [N/m]: a firm grip, a clamp, a bench vice."""
DAMPING_RATIOS = (0.0, 0.2, 0.7, 1.5)
"""Of the wall."""
HAND_DAMPINGS = (5.0, 20.0, 50.0)
"""Of the hand that holds the arm without a wall [N·s/m]."""
LOWEST_MASS = 2.0
"""What the device accepts [kg]."""
STIFFEST_ACCEPTED = 200e3
"""Stiffest wall that the device accepts [N/m]."""

_LOOKS = (("#d55e00", "o", 4.6), ("#0072b2", "s", 3.4), ("#009e73", "^", 2.3), ("#000000", "D", 1.2))
"""Okabe and Ito's colours, a marker and a line width for each curve: where curves coincide all are seen."""
_GREY = "#e8e8e8"
_LIMIT: dict[str, Any] = {"color": "#404040", "linestyle": (0, (4, 3)), "linewidth": 1.8}


class Curve(NamedTuple):
    """Largest stable stiffness over the virtual mass."""

    label: str
    stiffness: tuple[float, ...]
    """For each mass [N/m]; infinity where everything tried is stable."""


class Panel(NamedTuple):
    """One diagram."""

    title: str
    what: str
    """What is as stiff as the vertical axis says."""
    curves: tuple[Curve, ...]


def measure(masses: Sequence[float] = MASSES) -> list[Panel]:
    """Bisect every point of the picture.

    Args:
        masses: Virtual masses [kg].
    """
    from emulator.parameters import load_parameters

    arm = quiet(load_parameters())
    panels = []
    for hand, name in zip(HANDS, ("a firm grip", "a clamp", "a vice"), strict=True):
        curves = []
        for ratio in DAMPING_RATIOS:
            settings = [Setting(mass=mass, hand_stiffness=hand, damping_ratio=ratio) for mass in masses]
            limits = tuple(stiffest_wall(arm, setting) for setting in settings)
            curves.append(Curve(f"damping ratio {ratio:g}", limits))
        panels.append(Panel(f"hand of {hand / 1e3:g} kN/m ({name})", "wall", tuple(curves)))
    curves = []
    for damping in HAND_DAMPINGS:
        settings = [Setting(mass=mass, hand_stiffness=1.0, hand_damping=damping) for mass in masses]
        limits = tuple(stiffest_hand(arm, setting) for setting in settings)
        curves.append(Curve(f"hand damping {damping:g} N·s/m", limits))
    return [*panels, Panel("no wall", "hand", tuple(curves))]


def draw(panels: Sequence[Panel], path: Path, masses: Sequence[float] = MASSES) -> None:
    """Draw the panels two by two.

    Args:
        panels: Four of them.
        path: File; its suffix says the format.
        masses: Those that the panels were measured at [kg].
    """
    import matplotlib as mpl
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    with mpl.rc_context({"svg.hashsalt": "zwidth", "svg.fonttype": "path", "font.size": 14}):
        figure = Figure(figsize=(11.0, 9.6), layout="constrained")
        for number, (axes, panel) in enumerate(zip(figure.subplots(2, 2).flat, panels, strict=True)):
            _draw_panel(axes, "abcd"[number], panel, masses)
            if number in (0, 3):
                axes.legend(loc="lower right", framealpha=1.0, edgecolor="#b0b0b0", fontsize=13)
        refused, accepted = Patch(color=_GREY), Line2D([], [], **_LIMIT)
        words = ["virtual mass that the device refuses", "stiffest wall that the device accepts"]
        figure.legend([refused, accepted], words, loc="outside lower center", ncols=2, frameon=False)
        metadata = {"Date": None} if path.suffix == ".svg" else None
        figure.savefig(path, metadata=metadata, dpi=110)


def table(panels: Sequence[Panel], masses: Sequence[float] = MASSES) -> list[str]:
    """The numbers of the picture, a line a curve."""
    lines = ["largest stable stiffness [kN/m] by virtual mass [kg]", _row("", [f"{m:g}" for m in masses])]
    for panel in panels:
        lines.append(f"{panel.what}, {panel.title}")
        lines.extend(_row(f"  {curve.label}", [_cell(k) for k in curve.stiffness]) for curve in panel.curves)
    return lines


def _draw_panel(axes: "Axes", letter: str, panel: Panel, masses: Sequence[float]) -> None:
    ceiling, floor = STIFFEST / 1e3, 1.0
    axes.axvspan(min(masses) / 1.3, LOWEST_MASS, color=_GREY, linewidth=0)
    if panel.what == "wall":
        axes.axhline(STIFFEST_ACCEPTED / 1e3, **_LIMIT)
    for (colour, marker, width), curve in zip(_LOOKS, panel.curves, strict=False):
        heights = [min(ceiling, k / 1e3) if k > 0.0 else floor for k in curve.stiffness]
        axes.plot(masses, heights, color=colour, linewidth=width, marker=marker, markersize=width + 4.0,
                  label=curve.label, clip_on=False, zorder=3)  # fmt: skip
    axes.set(xscale="log", yscale="log", xlim=(min(masses) / 1.12, max(masses) * 1.12))
    axes.set_ylim(floor, ceiling * 1.25)
    axes.set_xticks([0.1, 0.2, 0.5, 1, 2, 4, 8], ["0.1", "0.2", "0.5", "1", "2", "4", "8"])
    axes.set_yticks([1, 10, 100, 1000], ["none", "10", "100", "> 1000"])
    axes.minorticks_off()
    axes.grid(color="#c8c8c8", linewidth=0.7)
    axes.set_xlabel("virtual mass [kg]")
    axes.set_ylabel(f"stiffest stable {panel.what} [kN/m]")
    axes.set_title(f"{letter}  {panel.title}", loc="left", weight="bold", size=15)


def _cell(stiffness: float) -> str:
    if math.isinf(stiffness):
        return f">{STIFFEST / 1e3:.0f}"
    return f"{stiffness / 1e3:.3g}" if stiffness > 0.0 else "-"


def _row(name: str, cells: Sequence[str]) -> str:
    return f"{name:<28}" + "".join(f"{cell:>7}" for cell in cells)


app = App(name="zwidth", help="Bisect and draw the Z-width of the emulated arm.")


@app.default
def main(*, output: Path = Path("zwidth.svg")) -> None:
    """Measure, print the numbers, draw the picture.

    Args:
        output: File of the picture, .svg or .png.
    """
    panels = measure()
    for line in table(panels):
        write(line)
    draw(panels, output)
    tell(f"picture: {output}")


if __name__ == "__main__":
    app()

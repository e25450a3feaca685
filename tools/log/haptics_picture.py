"""What a hand felt as a picture: springs, spectra and energies."""

from typing import TYPE_CHECKING, Any

import numpy as np

from tools.log.cycles import AXES, FloatArray
from tools.log.energy import SOURCES
from tools.log.haptics import Haptics
from tools.log.spectrum import Spectrum

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_STROKES = ("-", "--", "-.", ":")
_BANDS = 250
_MARKERS = ("o", "s", "^")


def draw(haptics: Haptics, title: str) -> "Figure":
    """Draw the springs' characteristics, the spectra of force and position, and the works over the log."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11.5, 8.6), layout="constrained")
    springs, energy, force, position = figure.subplots(2, 2).ravel()
    _draw_springs(springs, haptics)
    _draw_energy(energy, haptics)
    _draw_spectrum(force, haptics.force, "Force", "N/√Hz", 1.0)
    _draw_spectrum(position, haptics.position, "Position", "mm/√Hz", 1e3)
    figure.suptitle(title, x=0.01, ha="left", fontsize=12.5, fontweight="bold")
    for axes in (springs, energy, force, position):
        axes.grid(visible=True)
        axes.set_axisbelow(True)
    return figure


def _draw_springs(axes: "Axes", haptics: Haptics) -> None:
    from tools.report.figures import drawing

    axes.set_title("Rendered springs", loc="left")
    axes.set_xlabel("Handle beside the spring's reference [mm]")
    axes.set_ylabel("Restoring force [N]")
    shown = [one for one in haptics.rendered if one.stiffness is not None]
    for number, one in enumerate(shown):
        if one.stiffness is None:
            continue
        colour, marker = drawing.COLOURS[number % len(drawing.COLOURS)], _MARKERS[AXES.index(one.axis)]
        dots: dict[str, Any] = {"linestyle": "", "marker": marker, "markersize": 4, "alpha": 0.4}
        axes.plot(1e3 * one.deflection, one.restoring, color=colour, **dots)
        ends = np.array([np.min(one.deflection), np.max(one.deflection)])
        label = f"{one.kind} {one.axis}: {one.stiffness.value:.0f} ± {one.stiffness.half:.0f} N/m"
        line: dict[str, Any] = {
            "color": colour,
            "linewidth": 2.0,
            "linestyle": _STROKES[number % len(_STROKES)],
        }
        axes.plot(1e3 * ends, one.stiffness.value * ends, label=label, **line)
    if shown:
        axes.legend(loc="upper left", fontsize=10, frameon=True, edgecolor="none", framealpha=0.85)
    else:
        _say_nothing(axes, "no spring was engaged for long enough")


def _draw_energy(axes: "Axes", haptics: Haptics) -> None:
    from tools.report.figures import drawing

    energy = haptics.energy
    axes.set_title("Work on the virtual mass", loc="left")
    axes.set_xlabel("Time since the beginning of the log [s]")
    axes.set_ylabel("Work since then [J]")
    for place, source in enumerate(SOURCES):
        if np.any(energy.work[:, place]):
            line: dict[str, Any] = {
                "color": drawing.COLOURS[place],
                "linestyle": _STROKES[place],
                "linewidth": 1.8,
            }
            axes.plot(energy.time_s, energy.work[:, place], label=source, **line)
    if energy.kinetic is not None:
        lost = energy.work.sum(axis=1) - energy.kinetic
        axes.plot(energy.time_s, lost, color=drawing.INK, linewidth=1.2, label="dissipated")
    axes.margins(x=0.01)
    if axes.get_lines():
        drawing.draw_legend(axes, loc="upper center", bbox_to_anchor=(0.5, -0.16), ncols=3)
    else:
        _say_nothing(axes, "nothing moved")


def _draw_spectrum(axes: "Axes", spectrum: Spectrum | None, name: str, unit: str, factor: float) -> None:
    from tools.report.figures import drawing

    axes.set_title(f"Spectrum of the {name.lower()}", loc="left")
    axes.set_xlabel("Frequency [Hz]")
    axes.set_ylabel(f"{name} [{unit}]")
    if spectrum is None:
        _say_nothing(axes, "too short a log for a spectrum")
        return
    frequency, densities = _gather(spectrum)
    for place, axis in enumerate(AXES):
        density = factor * np.sqrt(densities[:, place])
        if np.any(density > 0.0):
            line: dict[str, Any] = {
                "color": drawing.COLOURS[place],
                "linestyle": _STROKES[place],
                "linewidth": 1.5,
            }
            axes.plot(frequency, density, label=axis, **line)
    if not axes.get_lines():
        _say_nothing(axes, "nothing but zero")
        return
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.margins(x=0.01)
    drawing.draw_legend(axes, loc="lower left")


def _gather(spectrum: Spectrum) -> tuple[FloatArray, FloatArray]:
    """Means over bands of equal width on a logarithmic axis: single lines stay, noise becomes a line."""
    frequency = spectrum.frequency[1:]
    edges = np.unique(np.geomspace(1, len(frequency) + 1, _BANDS).astype(np.int64)) - 1
    sizes = np.diff(np.append(edges[:-1], len(frequency)))
    middles = np.add.reduceat(frequency, edges[:-1]) / sizes
    densities = np.add.reduceat(spectrum.density[1:], edges[:-1], axis=0) / sizes[:, None]
    return middles, densities


def _say_nothing(axes: "Axes", text: str) -> None:
    axes.annotate(text, (0.5, 0.5), xycoords="axes fraction", ha="center", va="center", style="italic")

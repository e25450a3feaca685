"""What a hand felt during a log: rendered stiffness and damping, spectra of force and position, energies."""

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hm_driver.errors import RecordingError
from hm_driver.recording.reader import Recording
from tools.log.cycles import AXES, read_cycles
from tools.log.energy import SOURCES, Energy, EnergyBalance
from tools.log.impedance import Asked, Estimate, Impedance, Rendered
from tools.log.spectrum import WINDOW, Spectrum, Welch

BANDS_HZ = ((0.2, 2.0), (2.0, 10.0), (10.0, 50.0), (50.0, math.inf))
"""Slow motion; a hand's own motion and tremor; contact and chatter; the device and noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Haptics:
    """What a hand felt."""

    log: str
    duration_s: float
    """Time of the cycles that are there [s]."""
    mass: float | None
    """Virtual mass by the configuration [kg]; None where the log does not say it."""
    rendered: tuple[Rendered, ...]
    force: Spectrum | None
    """Of the measured force, one signal an axis [N]; None where the log is too short."""
    position: Spectrum | None
    """Of the measured position [m]."""
    energy: Energy

    def as_dict(self) -> dict[str, object]:
        """For JSON: what is not known is null."""
        work = self.energy.work[-1] if len(self.energy.work) else np.zeros(len(SOURCES))
        return {
            "log": self.log,
            "duration_s": self.duration_s,
            "mass_kg": self.mass,
            "rendered": [_rendered(one) for one in self.rendered],
            "bands_hz": [[low, high if math.isfinite(high) else None] for low, high in BANDS_HZ],
            "force_rms_n": _by_axis(self.force),
            "position_rms_m": _by_axis(self.position),
            "work_j": dict(zip(SOURCES, map(float, work), strict=True)),
            "dissipated_j": self.energy.dissipated,
        }


def analyse(log: Path, start: float | None = None, end: float | None = None) -> Haptics:
    """Read the cycles of a log once, and judge them.

    Args:
        log: The log.
        start: First time, from the beginning of the log [s].
        end: Time at which to stop [s].

    Raises:
        RecordingError: It cannot be read, has no cycles of a loop, or the range lies outside.
    """
    with Recording(log) as recording:
        asked = asked_of(recording)
        impedance = Impedance(asked)
        balance = EnergyBalance(asked.mass, is_bias_a_spring=asked.is_bias_a_spring)
        force, position = Welch(), Welch()
        duration_s = 0.0
        for cycles in read_cycles(recording, start, end):
            impedance.add(cycles)
            balance.add(cycles)
            if len(cycles.time_s) >= WINDOW:
                rate_hz = 1.0 / float(np.median(np.diff(cycles.time_s)))
                force.add(cycles.force, rate_hz)
                position.add(cycles.position, rate_hz)
            duration_s += float(cycles.time_s[-1] - cycles.time_s[0])
        if not duration_s:
            raise RecordingError(f"{log} has no cycles of a loop in this range")
        return Haptics(
            log=str(log),
            duration_s=duration_s,
            mass=asked.mass,
            rendered=tuple(impedance.results()),
            force=force.spectrum(),
            position=position.spectrum(),
            energy=balance.energy(),
        )


def asked_of(recording: Recording) -> Asked:
    """What the configuration inside a log asks for; nothing where there is none that can be read."""
    try:
        modes = json.loads(recording.attachments["config.json"])["modes"]
        mass = float(modes["inertia"])
        return Asked(
            mass=mass,
            position_stiffness=float(modes["position_stiffness"]),
            position_damping=_damping(modes, "position", mass),
            position_force_max=float(modes["position_force_max"]),
            assist_stiffness=float(modes["assist_stiffness"]),
            assist_damping=_damping(modes, "assist", mass),
            assist_force_max=float(modes["assist_force_max"]),
            is_bias_a_spring=modes.get("position_control") == "bias_force",
        )
    except (KeyError, TypeError, ValueError):
        return Asked()


def as_rows(haptics: Haptics) -> list[tuple[str, str]]:
    """The numbers for a terminal: names and values."""
    rows = [("cycles", f"{haptics.duration_s:.1f} s"), ("virtual mass", _or_unknown(haptics.mass, "kg"))]
    for one in haptics.rendered:
        parts = [
            _estimate("K", one.stiffness, "N/m", one.asked_stiffness),
            _estimate("B", one.damping, "N·s/m", one.asked_damping),
            _estimate("m", one.mass, "kg", haptics.mass),
        ]
        text = ", ".join(part for part in parts if part)
        rows.append((f"{one.kind}, {one.axis}", f"{text}; R² {one.r2:.3f} over {one.time_s:.1f} s"))
    if not haptics.rendered:
        rows.append(("rendered", "no spring was engaged, and nothing moved, for long enough to tell"))
    for name, spectrum, factor, unit in (
        ("force", haptics.force, 1.0, "N"),
        ("position", haptics.position, 1e3, "mm"),
    ):
        if spectrum is None:
            rows.append((f"{name}, spectrum", f"too short: {WINDOW} cycles without a gap are needed"))
            continue
        for low, high in BANDS_HZ:
            values = factor * spectrum.rms(low, high)
            band = f"{low:g} to {high:g} Hz" if math.isfinite(high) else f"above {low:g} Hz"
            parts = [f"{axis} {value:.3g}" for axis, value in zip(AXES, values, strict=True)]
            rows.append((f"{name} rms, {band}", f"{', '.join(parts)} {unit}"))
    work = haptics.energy.work[-1] if len(haptics.energy.work) else np.zeros(len(SOURCES))
    rows += [(f"work of the {source}", f"{value:.3f} J") for source, value in zip(SOURCES, work, strict=True)]
    rows.append(("dissipated", _or_unknown(haptics.energy.dissipated, "J")))
    return rows


def _damping(modes: Mapping[str, Any], name: str, mass: float) -> float:
    return 2.0 * float(modes[f"{name}_damping_ratio"]) * math.sqrt(float(modes[f"{name}_stiffness"]) * mass)


def _rendered(one: Rendered) -> dict[str, object]:
    return {
        "kind": one.kind,
        "axis": one.axis,
        "time_s": one.time_s,
        "stiffness_n_per_m": _pair(one.stiffness),
        "damping_n_s_per_m": _pair(one.damping),
        "mass_kg": _pair(one.mass),
        "r2": one.r2 if math.isfinite(one.r2) else None,
        "asked_stiffness_n_per_m": one.asked_stiffness,
        "asked_damping_n_s_per_m": one.asked_damping,
    }


def _pair(estimate: Estimate | None) -> dict[str, float] | None:
    return None if estimate is None else estimate._asdict()


def _by_axis(spectrum: Spectrum | None) -> dict[str, list[float]] | None:
    if spectrum is None:
        return None
    bands = np.array([spectrum.rms(low, high) for low, high in BANDS_HZ])
    return {axis: bands[:, place].tolist() for place, axis in enumerate(AXES)}


def _estimate(symbol: str, estimate: Estimate | None, unit: str, asked: float | None) -> str:
    if estimate is None:
        return ""
    wanted = f" (asked {asked:.4g})" if asked is not None else ""
    return f"{symbol} {estimate.value:.4g} ± {estimate.half:.2g} {unit}{wanted}"


def _or_unknown(value: float | None, unit: str) -> str:
    return "not known: the log has no configuration" if value is None else f"{value:.3g} {unit}"

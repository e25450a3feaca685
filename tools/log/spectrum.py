"""The spectra of signals by Welch's method, over a log of any length."""

from dataclasses import dataclass

import numpy as np

from tools.log.cycles import FloatArray

WINDOW = 4096
"""Samples of a window: a quarter of a hertz apart at 1 kHz."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spectrum:
    """Power spectral densities of k signals."""

    frequency: FloatArray
    """Shape (n,) [Hz]."""
    density: FloatArray
    """Shape (n, k) [unit^2/Hz]."""

    def rms(self, low: float, high: float) -> FloatArray:
        """Root mean square of each signal's part between two frequencies [Hz], shape (k,)."""
        chosen = (self.frequency >= low) & (self.frequency < high)
        step = self.frequency[1] - self.frequency[0]
        total: FloatArray = np.sqrt(self.density[chosen].sum(axis=0) * step)
        return total

    def strongest(self, above: float) -> FloatArray:
        """Frequency at which each signal is strongest above one [Hz], shape (k,)."""
        chosen = self.frequency >= above
        peaks: FloatArray = self.frequency[chosen][np.argmax(self.density[chosen], axis=0)]
        return peaks


class Welch:
    """Averages the periodograms of windows with half overlap; each is freed of its mean."""

    def __init__(self) -> None:
        self._sum: FloatArray | None = None
        self._frequency: FloatArray = np.empty(0)
        self._windows = 0

    def add(self, values: FloatArray, rate_hz: float) -> None:
        """Take in values without a gap, shape (n, k); left out are fewer than a window, or not all finite."""
        from scipy.signal import welch

        if len(values) < WINDOW or not np.isfinite(values).all():
            return
        windows = (len(values) - WINDOW // 2) // (WINDOW // 2)
        self._frequency, density = welch(values, rate_hz, nperseg=WINDOW, axis=0)
        self._sum = windows * density + (0.0 if self._sum is None else self._sum)
        self._windows += windows

    def spectrum(self) -> Spectrum | None:
        """The spectrum; None where nothing was long enough."""
        if self._sum is None:
            return None
        return Spectrum(frequency=self._frequency, density=self._sum / self._windows)

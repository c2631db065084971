"""Spectra of records: where the power lies, and a cut-off to begin with."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import scipy.signal

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Spectrum:
    """Power spectral density of a record.

    Attributes
    ----------
    frequencies : In Hz, `(bins,)`, from 0 to the Nyquist frequency.
    density : In squared units of the record per Hz, `(bins, ny)`.
    """

    frequencies: Array
    density: Array

    def share_below(self, cutoff: float) -> float:
        """The share of the power, mean excluded, at or below `cutoff` in Hz; in 0..1."""
        total = self._power().sum()
        if not total:
            return 1.0
        return float(self._power()[self.frequencies <= cutoff].sum() / total)

    def peaks(self, count: int = 5) -> list[tuple[float, float]]:
        """The strongest local maxima: `(frequency in Hz, share of the power in its bin)`."""
        power = self._power()
        found = scipy.signal.find_peaks(np.concatenate([[0.0], power, [0.0]]))[0] - 1
        strongest = found[np.argsort(-power[found], kind="stable")][:count]
        total = power.sum()
        return [(float(self.frequencies[i]), float(power[i] / total)) for i in strongest]

    def _power(self) -> Array:
        """Power by bin, each channel weighing the same."""
        totals = self.density[1:].sum(axis=0)
        power = (self.density / np.where(totals > 0, totals, 1.0)).sum(axis=1)
        power[0] = 0.0
        return np.asarray(power)


def periodogram(y: Array, sampling_rate: float) -> Spectrum:
    """The periodogram of `y` `(time, ny)`, its mean removed, under a Hann window."""
    frequencies, density = scipy.signal.periodogram(
        y, sampling_rate, window="hann", detrend="constant", axis=0
    )
    return Spectrum(frequencies, density)


def default_cutoff(y: Array, sampling_rate: float, downsampling: int, share: float = 0.9) -> float:
    """A cut-off in Hz for a record nobody has looked at: `share` of the power lies below.

    It is kept under 0.8 of the Nyquist frequency after down-sampling, and above three cycles of
    the record, below which nothing could be learned.
    """
    spectrum = periodogram(y, sampling_rate)
    power = spectrum._power()
    if not power.any():
        raise ValueError("the record is constant: there is no band to split off")
    below = np.searchsorted(np.cumsum(power), share * power.sum())
    lowest, highest = 3 * sampling_rate / len(y), 0.8 * sampling_rate / downsampling / 2
    return float(np.clip(spectrum.frequencies[below], min(lowest, highest), highest))

"""Compute spectra of records, and their coherence with a simulator."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy

from splitband.filters import ComplementaryPair, butterworth
from splitband.metrics import rmse
from splitband.runtime.arrays import Array

LOBE = 2
"""Half the width of the Hann window's main lobe, in bins."""
MOST_PEAKS = 5
"""Largest number of peaks. Layout."""
LEAST_PEAK = 0.005
"""Least share of the power in a peak. Layout."""


@dataclass(frozen=True, eq=False)
class Spectrum:
    """The power spectral density of a record.

    frequencies : Frequencies in Hz, `(bins,)`, from 0 to the Nyquist frequency.
    density : Density in squared units of the record per Hz, `(bins, ny)`.
    """

    frequencies: Array
    density: Array

    def share_below(self, cutoff: float) -> float:
        """Return the share (0 to 1) of the power at or below `cutoff` in Hz, without the mean."""
        total = self._power().sum()
        if not total:
            return 1.0
        return float(self._power()[self.frequencies <= cutoff].sum() / total)

    def peaks(self) -> list[tuple[float, float]]:
        """Return the strongest maxima: `(frequency in Hz, share of the power in the main lobe)`.

        The window spreads a sinusoid over `LOBE` bins on either side of its maximum. Where two
        peaks overlap, these bins count for the stronger one.
        """
        power = self._power()
        total, left = power.sum(), power.copy()
        maxima = scipy.signal.find_peaks(np.concatenate([[0.0], power, [0.0]]))[0] - 1
        strongest: list[tuple[float, float]] = []
        for i in maxima[np.argsort(-power[maxima], kind="stable")]:
            if len(strongest) == MOST_PEAKS:
                break
            if left[i] > 0:  # otherwise bin i is part of a stronger peak
                lobe = slice(max(i - LOBE, 0), i + LOBE + 1)
                strongest.append((float(self.frequencies[i]), float(left[lobe].sum() / total)))
                left[lobe] = 0.0
        return [(frequency, share) for frequency, share in strongest if share >= LEAST_PEAK]

    def shares(self) -> Array:
        """Return the share of the power by bin, without the mean, `(bins,)`; 0 for a constant."""
        power = self._power()
        return np.asarray(power / (power.sum() or 1.0))

    def _power(self) -> Array:
        """Return the power by bin, `(bins,)`, each channel weighted equally."""
        totals = self.density[1:].sum(axis=0)
        power = (self.density / np.where(totals > 0, totals, 1.0)).sum(axis=1)
        power[0] = 0.0
        return np.asarray(power)


def periodogram(y: Array, sampling_rate: float) -> Spectrum:
    """Return the periodogram of `y` `(time,)` or `(time, ny)`, mean removed, with a Hann window."""
    y = y[:, None] if y.ndim == 1 else y
    y = y - y[:1]  # a constant becomes exactly zero, not the rounding of a mean
    frequencies, density = scipy.signal.periodogram(
        y, sampling_rate, window="hann", detrend="constant", axis=0
    )
    return Spectrum(frequencies, density)


def coherence(y: Array, y_sim: Array, sampling_rate: float) -> tuple[Array, Array]:
    """Return frequencies in Hz and the coherence of record and simulator, `(bins, ny)`, 0 to 1.

    Welch's estimate with half-overlapping segments of an eighth of the record.
    """
    segment = min(max(8, len(y) // 8), len(y))
    with np.errstate(invalid="ignore", divide="ignore"):
        frequencies, agreement = scipy.signal.coherence(
            y, y_sim, sampling_rate, nperseg=segment, axis=0
        )
    return frequencies, np.nan_to_num(agreement)  # 0 where there is no power, not NaN


@dataclass(frozen=True)
class Oracle:
    """The least RMSE of a hybrid at a cut-off (Ensinger et al. 2023, Sec. 4.4).

    cutoff : In Hz.
    perfect_network : RMSE of H(y) + L(y_sim), the hybrid with a perfect network.
    no_network : RMSE of L(y_sim) alone.
    """

    cutoff: float
    perfect_network: float
    no_network: float

    @property
    def nothing_to_learn(self) -> bool:
        """Return whether a perfect network has a larger error than a zero network.

        Training minimises the error, and then does not find the perfect network. This happens where
        the delay of the low-pass filter compensates for a simulator ahead of the record: L(y_sim)
        is then closer to y than L(y) is.
        """
        return self.perfect_network > self.no_network

    def describe(self) -> str:
        """Return a sentence for `nothing_to_learn`."""
        return (
            "nothing to learn: on the training samples the low-passed simulator alone has RMSE "
            f"{self.no_network:.3g}, with a network that is exactly right "
            f"{self.perfect_network:.3g}"
        )


def oracle(
    y: Array,
    y_sim: Array,
    sampling_rate: float,
    cutoff: float,
    order: int = 1,
    seen: Array | None = None,
) -> Oracle:
    """Run the oracle check of the paper's filter design, with the hybrid's one-way pair.

    Errors are computed against `seen`, the measurements with NaN in the gaps, by default `y`.
    """
    seen = y if seen is None else seen
    b, a = butterworth(cutoff, sampling_rate, order)
    pair = ComplementaryPair.perfect(b, a, sampling_rate)
    best = rmse(seen, pair.combine(low=y_sim, high=y))
    return Oracle(cutoff, best, rmse(seen, pair.lowpass(y_sim)))


def oracle_cutoffs(samples: int, sampling_rate: float) -> list[float]:
    """Return cut-offs in Hz for the oracle check, from two cycles per record to Nyquist / 2."""
    lowest, highest = 2 * sampling_rate / samples, sampling_rate / 4
    return [float(f"{f:.2g}") for f in np.geomspace(min(lowest, highest / 2), highest, 12)]

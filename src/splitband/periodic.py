"""Periodic regression: a Fourier series over the record's own period, and what dies out.

A naive baseline (see `splitband.naive`): what a system that is driven periodically does, once its
free vibrations are gone, whether it is linear or not. Seasonal-naive repeats one period and its
noise; this takes the mean of all, and a period that is no whole number of samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from splitband.harmonic import LONGEST, HarmonicRegression, Modes
from splitband.naive import SeasonalNaive, self_similar_lags

Array = npt.NDArray[np.float64]

MOST_HARMONICS = 30
VIBRATIONS = 4
"""That die out, at most."""
_WORTH = 0.5
"""A freer candidate must have less than this of the held-out error of the stiffer one: a period
that is a little off, and vibrations that are none, cost the more the longer the forecast."""
_CUTS = (0.75, 0.8, 0.85, 0.9)
"""Near the end, so that nearly as many periods are known as to the fit itself."""


@dataclass(frozen=True, eq=False)
class PeriodicRegression(HarmonicRegression):
    """A Fourier series for each channel, and vibrations that die out; use `fit_periodic`.

    Attributes
    ----------
    periods : In samples, by channel.
    vibrations : How many die out, by channel; they are the last of the sinusoids.
    """

    periods: tuple[float, ...] = ()
    vibrations: tuple[int, ...] = ()

    def __str__(self) -> str:
        periods = ", ".join(f"{period:.6g}" for period in self.periods)
        counts = "+".join(
            str(len(f) - v) for f, v in zip(self.frequencies, self.vibrations, strict=True)
        )
        dying = sum(self.vibrations)
        some = f", and {dying} vibration(s) that die out" if dying else ""
        return f"{counts} harmonic(s) of a period of {periods} samples{some}"


def fit_periodic(y: Array) -> PeriodicRegression:
    """Fit `y` `(time, ny)`, each channel by itself.

    A lag at which the channel resembles itself is the period, and as many harmonics are taken as
    the Bayesian information criterion pays for. The period may become a fraction of a sample, and
    vibrations that die out may be added, where that pays on what follows the samples that were
    fitted, for several cuts of `y`. Of a long record the last `harmonic.LONGEST` samples are used.
    """
    begin = max(len(y) - LONGEST, 0)
    channels = [_fit_channel(channel) for channel in y[begin:].T]
    found = HarmonicRegression.of(channels, begin)
    return PeriodicRegression(
        found.frequencies,
        found.coefficients,
        found.dampings,
        begin,
        tuple(1 / m.frequencies[0] if len(m.frequencies) else float(len(y)) for m in channels),
        tuple(len(m.frequencies) - m.harmonics if len(m.frequencies) else 0 for m in channels),
    )


def _fit_channel(y: Array) -> Modes:
    """In its units; found in units of its own range."""
    offset, scale = float(y.mean()), float(np.ptp(y)) or 1.0
    scaled = (y - offset) / scale
    best, *freer = _CANDIDATES
    least = _held_out(scaled, best)
    for candidate in freer:
        error = _held_out(scaled, candidate)
        if error < _WORTH * least:
            best, least = candidate, error
    return best(scaled).in_units(offset, scale)


def _held_out(y: Array, fit: Callable[[Array], Modes]) -> float:
    """RMSE of what follows the samples that were fitted."""
    errors = []
    for share in _CUTS:
        cut = max(int(share * len(y)), 1)
        error = y[cut:] - fit(y[:cut]).predict(np.arange(cut, len(y)))
        errors.append(np.sqrt(np.mean(error**2)) if len(error) else 0.0)
    return float(np.mean(errors))


def _whole_samples(y: Array, lags: int = 4) -> Modes:
    """A period of a whole number of samples."""
    if len(y) < 2:
        return _series(y, 1)
    channel = y[:, None]
    # Of multiples of a period that tie, seasonal-naive takes the shortest.
    periods = {SeasonalNaive.fit(channel).lag, *self_similar_lags(channel, lags)}
    found = [_series(y, lag) for lag in sorted(periods)]
    return min(found, key=lambda modes: modes.information(y))


def _any_period(y: Array) -> Modes:
    found = _whole_samples(y)
    return found.refined(y) if len(found.frequencies) else found


def _dying_out(y: Array) -> Modes:
    """With vibrations as long as they pay; the early samples show them best."""
    best = modes = _any_period(y)
    for _ in range(VIBRATIONS if len(best.frequencies) else 0):
        modes = modes.with_another(y, damping=3 / len(y), weight=3)
        if modes.information(y) < best.information(y):
            best = modes
    return best


_CANDIDATES: Sequence[Callable[[Array], Modes]] = (_whole_samples, _any_period, _dying_out)


def _series(y: Array, lag: int) -> Modes:
    """The Fourier series of a period, of as many harmonics as pay."""
    most = min((lag - 1) // 2, MOST_HARMONICS, max((len(y) - 2) // 4, 0))
    best = Modes.solved(np.empty(0), np.empty(0), y)
    if most < 1:
        return best
    index, order = np.arange(len(y)), np.arange(1, most + 1)
    phase = 2 * np.pi * np.outer(index, order) / lag
    pairs = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(y), 2 * most)
    directions = np.linalg.qr(np.hstack([np.ones((len(y), 1)), pairs]))[0]
    # What is left after each harmonic more.
    left = np.sum(y**2) - np.cumsum((directions.T @ y) ** 2)[2::2]
    left = np.maximum(left, 1e-16 * np.sum(y**2) + 1e-300)
    information = len(y) * np.log(left) + 2 * order * np.log(len(y))
    count = int(order[np.argmin(information)])
    return Modes.solved(order[:count] / lag, np.zeros(count), y, harmonics=count)

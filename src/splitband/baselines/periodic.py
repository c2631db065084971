"""Fit a Fourier series with an estimated period, a trend and free vibrations.

A baseline (see `baselines.common`). The response of a periodically driven system usually becomes
periodic once its free vibrations have decayed. Seasonal-naive repeats one period with its noise;
this averages over all periods, and the period need not be a whole number of samples.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from splitband.baselines.common import known, recent, units
from splitband.baselines.harmonic import HarmonicRegression
from splitband.baselines.modes import Modes
from splitband.baselines.origins import is_better, origins
from splitband.baselines.seasonal import all_around, last_period, seasons, self_similar_lags
from splitband.baselines.trend import Shape, described, find
from splitband.runtime.arrays import Array
from splitband.runtime.options import saved

MOST_HARMONICS = 30
"""Largest number of harmonics of a period. By eye."""
VIBRATIONS = 4
"""Largest number of decaying sinusoids. By eye."""
LAGS = 4
"""Number of lags at which a record resembles itself that are tried as periods. By eye."""


@saved
@dataclass(frozen=True, eq=False)
class PeriodicRegression:
    """Describe each channel by a Fourier series, a trend and decaying vibrations; use `fit`.

    Attributes
    ----------
    sinusoids : All sinusoids; those of the series come first.
    periods : Period in samples, by channel; 0 for a channel without one (offset and trend only).
    vibrations : Number of decaying sinusoids, by channel.
    """

    sinusoids: HarmonicRegression
    periods: tuple[float, ...]
    vibrations: tuple[int, ...]

    @classmethod
    def fit(cls, y: Array) -> PeriodicRegression:
        """Fit `y` `(time, ny)`, each channel separately, NaN in gaps.

        A trend is kept if it lowers the held-out error (`trend.find`). The period is a lag at which
        the channel resembles itself, or an integer fraction of it; the Bayesian information
        criterion selects the harmonics. The series itself, the refinement of its period, and
        additional decaying vibrations are each kept only if they lower the held-out error
        (`baselines.origins`). The last `common.LONGEST` samples of a long record are used.
        """
        begin, y = recent(y)
        channels = [_fit_channel(channel) for channel in y.T]
        return cls(
            HarmonicRegression(tuple(channels), begin),
            tuple(1 / m.frequencies[0] if len(m.frequencies) else 0.0 for m in channels),
            tuple(max(len(m.frequencies) - m.harmonics, 0) for m in channels),
        )

    def predict(self, start: float, steps: int) -> Array:
        """Return the samples from `start` on, `(steps, ny)`."""
        return self.sinusoids.predict(start, steps)

    def __str__(self) -> str:
        trends = described([modes.shape for modes in self.sinusoids.channels])
        if not any(self.periods):
            return f"no period found, a constant{trends}"
        frequencies = [modes.frequencies for modes in self.sinusoids.channels]
        periods = ", ".join(f"{period:.6g}" for period in self.periods)
        counts = "+".join(
            str(len(f) - v) for f, v in zip(frequencies, self.vibrations, strict=True)
        )
        dying = sum(self.vibrations)
        some = f", and {dying} vibration(s) that die out" if dying else ""
        return f"{counts} harmonic(s) of a period of {periods} samples{some}{trends}"


def _fit_channel(y: Array) -> Modes:
    """Fit one channel, scaled to its range.

    The result has no period if a Fourier series does not lower the held-out error. This is tested
    before the period is refined, which takes most of the time.
    """
    offset, scale = units(y)
    scaled, index = (y - offset) / scale, known(y)
    trend = find(scaled)
    shape = trend.shape if trend else None
    best = Modes.none(scaled, shape)
    if len(index) < 2:
        return best.in_units(offset, scale)
    held = [index[origin:] for origin in origins(len(index))]
    parts = [scaled[: later[0]] for later in held]

    def errors(fits: Sequence[Modes]) -> Array:
        """Return the held-out RMSE of the fit to each part."""
        left = (scaled[at] - fit.predict(at) for at, fit in zip(held, fits, strict=True))
        return np.array([np.sqrt(np.mean(error**2)) for error in left])

    least = errors([Modes.none(part, shape) for part in parts])
    series = [_best_series(part, shape) for part in (scaled, *parts)]
    if is_better(errors(series[1:]), least):
        choices = [_candidates(of, part) for of, part in zip(series, (scaled, *parts), strict=True)]
        for whole, *on_parts in zip(*choices, strict=True):
            if is_better(found := errors(on_parts), least):
                best, least = whole, found
    return best.in_units(offset, scale)


def _candidates(series: Modes, y: Array) -> tuple[Modes, Modes, Modes]:
    """Return the series itself, with refined period, and with decaying vibrations added."""
    if not len(series.frequencies):
        return series, series, series
    refined = dying = modes = series.refined(y)
    for _ in range(VIBRATIONS):
        # Early samples are weighted more, as vibrations are largest there.
        modes = modes.with_another(y, damping=3 / len(y), weight=3)
        if modes.information(y) < dying.information(y):
            dying = modes
    return series, refined, dying


def _best_series(y: Array, shape: Shape | None) -> Modes:
    """Return the best Fourier series over the lags at which the record resembles itself."""
    level = Modes.none(y, shape)
    if len(known(y)) < 2:
        return level
    channel = level.residual(y)[:, None]
    # Where multiples of a period tie, seasonal-naive takes the shortest one.
    periods = {len(last_period(channel)), *self_similar_lags(channel, LAGS)}
    candidates = [_series(y, lag, shape) for lag in sorted(periods)]
    return min(candidates, key=lambda modes: modes.information(y))


def _series(y: Array, lag: int, shape: Shape | None) -> Modes:
    """Return the Fourier series of a period, with the harmonics that lower the BIC."""
    none = Modes.none(y, shape)
    index = known(y)
    most = min(MOST_HARMONICS, (lag - 1) // 2, (len(index) - 2) // 4)
    complete = none.residual(y)[len(y) % lag :]
    if most < 1 or not len(known(complete)):
        return none
    by_season = seasons(complete[:, None], lag)
    with np.errstate(invalid="ignore"):  # 0 / 0 at a phase that was never measured
        mean_period = np.nansum(by_season, axis=0) / (~np.isnan(by_season)).sum(axis=0)
    mean_period = all_around(mean_period)[:, 0]
    strength = abs(np.fft.rfft(mean_period)[1 : (lag - 1) // 2 + 1])
    strongest = 1 + np.argsort(-strength, kind="stable")[:most]
    phase = 2 * np.pi * np.outer(index, strongest) / lag
    pairs = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(index), -1)
    level = none.basis(index)
    directions = np.linalg.qr(np.hstack([level, pairs]))[0]
    # The residual power after each further harmonic.
    power = np.nansum(y**2)
    left = power - np.cumsum((directions.T @ y[index]) ** 2)[level.shape[1] - 1 :: 2]
    left = np.maximum(left, 1e-16 * power + 1e-300)
    information = len(index) * np.log(left) + 2 * np.arange(len(left)) * np.log(len(index))
    kept = strongest[: int(np.argmin(information))]
    if not len(kept):
        return none
    # If all of them are harmonics of a fraction of the lag, that fraction is the period. Weak
    # harmonics between them are kept too.
    whole = int(np.gcd.reduce(kept))
    order = np.arange(1, min(kept.max() // whole, MOST_HARMONICS) + 1)
    return Modes.solved(order * whole / lag, np.zeros(len(order)), y, shape, len(order))

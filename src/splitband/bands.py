"""How sure a prediction is: a band around it that widens with the horizon.

Not in the paper. The band is fitted to what the same method left on a held-out part of the training
record: its errors there, by horizon, say how large they are and how fast they grow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
import scipy

Array = npt.NDArray[np.float64]


EXPECTED_GROWTH = 4.0
"""Of a band over a horizon as long as the training record, before any error has been seen."""
_BEGIN = ((0.0, 0.0), (-1.0, 1.0), (0.0, -3.0))


@dataclass(frozen=True)
class Band:
    """Half-widths of a band, by horizon: min(sqrt(base² + (growth * n)²), most) for each channel.

    Attributes
    ----------
    base : At the first sample, by channel, in the record's unit.
    growth : By sample of the horizon, in the long run.
    most : What it cannot exceed: a prediction that knows nothing but the record's range.
    share : Of the samples that lie inside, 0 to 1.
    """

    base: tuple[float, ...]
    growth: tuple[float, ...]
    most: tuple[float, ...]
    share: float = 0.9

    @classmethod
    def fit(cls, errors: Sequence[Array], y: Array, share: float = 0.9) -> Band:
        """Fit to the errors of forecasts.

        Parameters
        ----------
        errors : Of held-out samples by horizon, `(time, ny)` from the first after the warm-up, of
            one forecast or more; NaN where nothing was measured.
        y : The training record, `(time, ny)`, whose spread limits the band; NaN likewise.
        share : Of the samples that shall lie inside.
        """
        if not 0 < share < 1:
            raise ValueError(f"share must lie between 0 and 1, got {share}")
        horizon = np.concatenate([np.arange(len(e)) for e in errors]) if errors else np.empty(0)
        channels = np.concatenate(errors).T if errors else np.empty((1, 0))
        known = ~np.isnan(channels)
        if not known.any(axis=1).all():
            raise ValueError("errors must have a sample at least, in every channel")
        fitted = [
            _fit_channel(channel[seen], horizon[seen] / len(y), share)
            for channel, seen in zip(channels, known, strict=True)
        ]
        # Two signals of one range that know nothing of each other differ by this much.
        apart = float(np.sqrt(2) * scipy.stats.norm.ppf(0.5 + share / 2))
        # Rounding is no less than this, however exact the forecast.
        floor = 16 * np.finfo(np.float64).eps * np.nanmax(abs(y), axis=0)
        base = tuple(max(b, float(f)) for (b, _), f in zip(fitted, floor, strict=True))
        growth = tuple(g / len(y) for _, g in fitted)
        most = np.maximum(apart * np.nanstd(y, axis=0), base)
        return cls(base, growth, tuple(map(float, most)), share)

    def widened(self, change: Array, begin: int) -> Band:
        """For a method whose forecast changed since: it can be as wrong as that by now.

        `change` `(time, ny)` is by horizon, from `begin` on.
        """
        if not len(change):
            return self
        horizon = np.arange(begin, begin + len(change))[:, None]
        more = np.quantile(abs(change) / np.maximum(horizon, 1), self.share, axis=0)
        return replace(self, growth=tuple(map(float, np.hypot(self.growth, more))))

    def half_widths(self, steps: int) -> Array:
        """For the first `steps` samples of a horizon, `(steps, ny)`."""
        horizon = np.arange(steps)[:, None]
        widths = np.hypot(np.array(self.base), np.array(self.growth) * horizon)
        return np.asarray(np.minimum(widths, np.array(self.most)), dtype=np.float64)

    def coverage(self, errors: Array) -> float:
        """The share of errors `(time, ny)` by horizon that lie inside, 0 to 1; NaN is none."""
        inside = abs(errors) <= self.half_widths(len(errors))
        return float(inside[~np.isnan(errors)].mean())


def _fit_channel(errors: Array, horizon: Array, share: float) -> tuple[float, float]:
    """Base and growth of the half-width, by maximum likelihood and then scaled to the share.

    `horizon` is that of each error as a share of the training record, and so is the growth's unit.

    Laplace's distribution, as a few large errors should not set the width. The growth is a factor
    of the base over a horizon as long as the training record; a held-out part is short, so that it
    is held to `EXPECTED_GROWTH` where the errors do not say otherwise.
    """
    size = float(np.mean(abs(errors)))
    if size == 0:
        return 0.0, 0.0

    def widths(logarithms: Array) -> Array:
        base, growth = np.exp(logarithms)
        return np.asarray(size * base * np.hypot(1.0, growth * horizon))

    def misfit(logarithms: Array) -> float:
        scale = widths(logarithms)
        doubt = (logarithms[1] - np.log(EXPECTED_GROWTH)) ** 2 / 2
        return float(np.sum(np.log(scale) + abs(errors) / scale)) + float(doubt)

    limits = [(-7.0, 3.0), (-7.0, 5.0)]
    tried = [scipy.optimize.minimize(misfit, begin, bounds=limits) for begin in _BEGIN]
    best = np.asarray(min(tried, key=lambda result: result.fun).x)
    scale = float(np.quantile(abs(errors) / widths(best), share))
    base = size * scale * float(np.exp(best[0]))
    return base, base * float(np.exp(best[1]))

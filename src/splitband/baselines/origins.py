"""Say from where known samples are forecast, and what has to pay for itself there.

A fit to the beginning of a record forecasts the rest of it, from several origins. The same ones
decide on trends, periods and poles, give a method its held-out error and an interval its width.
"""

from __future__ import annotations

import numpy as np

from splitband.runtime.arrays import Array

HELD_OUT = (0.5, 0.375, 0.25, 0.2, 0.15, 0.1)
"""Shares of a record that are forecast by what is fitted to the samples before. Half a record shows
how errors grow; a tenth is forecast by nearly the final fit. By the regret of trends, periods and
poles on development records, also with the last four alone (docs/results/rules.md)."""
NEGLIGIBLE = 1e-8
"""RMSE, of a channel whose range is about 1, below which it is that of rounding. By eye."""


def origins(samples: int) -> list[int]:
    """Return how many of so many samples are fitted, for each of the shares that are held out."""
    return [max(samples - max(1, round(share * samples)), 1) for share in HELD_OUT]


def pays(more: Array, less: Array) -> bool:
    """Return whether a fit with more freedom is better than one with less, by one standard error.

    Both are RMSE of the forecasts from each origin; what is compared are their logarithms, so that
    a forecast counts as much as another one that is longer.
    """
    gain = np.log(np.maximum(less, NEGLIGIBLE)) - np.log(np.maximum(more, NEGLIGIBLE))
    if len(gain) < 2:
        return False
    return bool(gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)))

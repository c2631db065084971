"""Define rolling origins of held-out forecasts, and when a richer model is better on them.

From each origin, a fit to the samples before it forecasts the samples after it. The same origins
select trends, periods and poles, and give the held-out errors of methods and the width of
intervals.
"""

from __future__ import annotations

import numpy as np

from splitband.runtime.arrays import Array

HELD_OUT_SHARES = (0.5, 0.375, 0.25, 0.2, 0.15, 0.1)
"""Shares of a record that are held out, one for each origin. A long share shows how errors grow; a
short one is forecast by nearly the final fit. Chosen by the regret of trends, periods and poles on
development records, also with the last four alone (docs/results/rules.md)."""
NEGLIGIBLE = 1e-8
"""RMSE below which an error is rounding, for a channel with a range of about 1. By eye."""


def origins(samples: int) -> list[int]:
    """Return how many of `samples` samples are fitted, for each held-out share."""
    return [max(samples - max(1, round(share * samples)), 1) for share in HELD_OUT_SHARES]


def is_better(more: Array, less: Array) -> bool:
    """Return whether a richer model is better than a simpler one, by one standard error.

    `more` and `less` are their RMSE from each origin. Logarithms are compared, so that each
    forecast counts the same, however long it is.
    """
    gain = np.log(np.maximum(less, NEGLIGIBLE)) - np.log(np.maximum(more, NEGLIGIBLE))
    if len(gain) < 2:
        return False
    return bool(gain.mean() > gain.std(ddof=1) / np.sqrt(len(gain)))

"""Combine several trainings by the median of their predictions, sample by sample.

One training that goes astray, on inputs that it has not learned from, moves a mean as far as it
goes itself, and a median hardly (docs/results/rules.md).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from splitband.runtime.arrays import Array


def middle_members(totals: Sequence[Array]) -> Any:
    """Return the members whose mean is the median: one or two for each sample and channel.

    Parameters
    ----------
    totals : Predictions of the members, `(time, ny)`.

    Returns
    -------
    Indices of members, `(1 or 2, time, ny)`.
    """
    count = len(totals)
    return np.argsort(totals, axis=0, kind="stable")[(count - 1) // 2 : count // 2 + 1]


def mean_over(values: Sequence[Array], members: Any) -> Array:
    """Return the mean of `values`, one `(time, ny)` for each member, over `middle_members`."""
    return np.asarray(np.take_along_axis(np.asarray(values), members, axis=0).mean(axis=0))


def median(values: Sequence[Any], least: Callable[..., Any], most: Callable[..., Any]) -> Any:
    """Return the median by comparing pairs (odd-even sort), which an export can write down.

    Parameters
    ----------
    values : Arrays of equal shape.
    least, most : Functions that return the element-wise minimum and maximum of two of them.
    """
    ordered, count = [*values], len(values)
    for turn in range(count):
        for i in range(turn % 2, count - 1, 2):
            pair = ordered[i], ordered[i + 1]
            ordered[i], ordered[i + 1] = least(*pair), most(*pair)
    return (ordered[(count - 1) // 2] + ordered[count // 2]) / 2

"""Measure the errors of predictions. Arrays are NumPy, `(time,)` or `(time, ny)`.

Errors of several channels add up as a Euclidean norm, the paper's e_n; normalise channels of
different units first. NaN in y marks missing samples, which are excluded.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from splitband.runtime.errors import InputError

Array = npt.NDArray[np.float64]


def rmse(y: npt.ArrayLike, prediction: npt.ArrayLike) -> float:
    """Return the root mean squared error, in the unit of y: the last value of `cumulative_rmse`.

    Examples
    --------
    >>> sb.rmse([0.0, 0.0, 0.0, 0.0], [1.0, -1.0, 1.0, -1.0])
    1.0
    """
    squared = _squared_errors(y, prediction)
    if np.isnan(squared).any():
        return float(_cumulative(squared, np.asarray(y, float))[-1])
    return float(np.sqrt(np.mean(squared.sum(axis=1))))


def channel_rmse(y: npt.ArrayLike, prediction: npt.ArrayLike) -> Array:
    """Return the RMSE by channel, `(ny,)`; NaN for a channel without measurements."""
    y, prediction = np.asarray(y, float), np.asarray(prediction, float)
    return np.array([rmse(*channel) for channel in zip(y.T, prediction.T, strict=True)])


def cumulative_rmse(y: npt.ArrayLike, prediction: npt.ArrayLike) -> Array:
    """Return sqrt(sum_{k<=n} ||y_k - prediction_k||^2 / (n + 1)), `(time,)`."""
    return _cumulative(_squared_errors(y, prediction), np.asarray(y, float))


def nrmse(y: npt.ArrayLike, prediction: npt.ArrayLike) -> float:
    """Return the RMSE divided by the standard deviation of y; 1 for the mean of y."""
    error, y = rmse(y, prediction), np.asarray(y, float)
    if not _varies(y).any():
        raise InputError("y must not be constant: its standard deviation is 0")
    return error / rmse(y, np.broadcast_to(np.nanmean(y, axis=0), y.shape))


def fit_percent(y: npt.ArrayLike, prediction: npt.ArrayLike) -> Any:
    """Return the fit by output in percent, ``100 (1 - |y - prediction| / |y - mean(y)|)``.

    100 is perfect, 0 is the fit of the mean of y; MATLAB's `compare` prints the same number.

    Returns
    -------
    fit : `(ny,)`, of a 1-D y a float. NaN for a constant output, or one without measurements.

    Examples
    --------
    >>> round(sb.fit_percent([0.0, 1.0, 2.0, 3.0], [0.1, 0.9, 2.1, 2.9]), 2)
    91.06
    """
    squared, y = _squared_errors(y, prediction), np.asarray(y, float)
    columns = y.reshape(len(y), -1)
    measured = ~np.isnan(columns)
    with np.errstate(divide="ignore", invalid="ignore"):
        mean = np.nansum(columns, axis=0) / measured.sum(axis=0)
        error = np.where(measured, squared, 0.0).sum(axis=0)
        lost = error / np.nansum((columns - mean) ** 2, axis=0)
        fit = np.where(_varies(columns), 100 * (1 - np.sqrt(lost)), np.nan)
    return float(fit[0]) if y.ndim == 1 else fit


def spread(y: npt.ArrayLike) -> Array:
    """Return the standard deviation by channel, `(ny,)`, of `y` `(time, ny)`; 1 for a constant."""
    y = np.asarray(y, float)
    # A constant has a range of 0, but by rounding possibly a deviation above 0.
    return np.asarray(np.where(_varies(y), np.nanstd(y, axis=0), 1.0))


LOWEST_FIT = -999.0
"""Lowest fit in percent that is shown as a number. Layout."""


def tenths(value: float) -> str:
    """Return a fit in percent with one decimal place, or "< -999" below `LOWEST_FIT`."""
    return f"{round(value, 1) + 0.0:.1f}" if value >= LOWEST_FIT else f"< {LOWEST_FIT:.0f}"


DIVERGED = 3.0
"""Largest distance of a prediction from the middle of the training range, in multiples of half its
width. By eye."""


def leaves_range(training: Array, prediction: Array) -> int | None:
    """Return the number of samples of a prediction `(time, ny)` before it leaves the range.

    The range of a channel is `DIVERGED` times as wide as in training, about the same middle. A
    constant channel in training has no range, but its prediction must be finite. None for a
    prediction inside the range.
    """
    low, high = np.nanmin(training, axis=0), np.nanmax(training, axis=0)
    reach = np.where(high > low, (high - low) / 2, np.inf)
    outside = ~(abs(prediction - (low + high) / 2) <= DIVERGED * reach) | ~np.isfinite(prediction)
    rows_outside = np.flatnonzero(outside.any(axis=1))
    return int(rows_outside[0]) if len(rows_outside) else None


def leaving(samples: int) -> str:
    """Describe a prediction outside `DIVERGED` times the range of the training samples."""
    return (
        f"leaves {DIVERGED:g} times the range of the training samples after {samples} samples: do "
        "not rely on it beyond that"
    )


BEYOND = 0.1
"""Largest excess of a signal over its range in training, as a share of the range. By eye."""


class ExtrapolationWarning(UserWarning):
    """A prediction may be unreliable, for instance with inputs beyond their range."""


@dataclass(frozen=True)
class Extrapolation:
    """An input, or a measured output, outside its range in training.

    Attributes
    ----------
    channel : Index of the signal, counted from 0.
    low, high : Range of the signal in training.
    farthest : The value farthest outside the range.
    after : Number of samples before the first one outside the range.
    kind : Input or output.
    """

    channel: int
    low: float
    high: float
    farthest: float
    after: int
    kind: Literal["input", "output"] = "input"

    def describe(self, name: str = "", of: str = "") -> str:
        """Return a sentence with the signal's `name`; `of`, " of the record", follows a sample."""
        trained = f"{self.low:g} to {self.high:g}" if self.low < self.high else f"{self.low:g} only"
        return (
            f"{self.kind} {name or f'u{self.channel}'} is beyond its range in training ({trained}) "
            f"from sample {self.after}{of} on, {'down' if self.farthest < self.low else 'up'} to "
            f"{self.farthest:g}: predictions from there on are extrapolations"
        )


def extrapolations(low: Array, high: Array, u: Array) -> list[Extrapolation]:
    """Return the inputs of `u` `(time, nu)` beyond `low` to `high`, `(nu,)`, by over `BEYOND`.

    A constant input in training must stay constant, apart from rounding.
    """
    rounding = 1e-9 * np.maximum(abs(low), abs(high))
    with np.errstate(invalid="ignore"):  # inf - inf, for an unknown range
        margin = np.nan_to_num(np.maximum(BEYOND * (high - low), rounding), nan=0.0)
    beyond = np.maximum(low - margin - u, u - high - margin)
    extrapolated = []
    for i, of_input in enumerate(beyond.T):
        outside = np.flatnonzero(of_input > 0)
        if len(outside):
            farthest = float(u[outside[of_input[outside].argmax()], i])
            trained = float(low[i]), float(high[i])
            extrapolated.append(Extrapolation(i, *trained, farthest, int(outside[0])))
    return extrapolated


def input_range(inputs: Sequence[Array]) -> tuple[Array, Array]:
    """Return the lowest and highest values by input, `(nu,)`, of records `(time, nu)`."""
    together = np.concatenate(inputs)
    return together.min(axis=0), together.max(axis=0)


def _varies(y: Array) -> npt.NDArray[np.bool_]:
    """Return a mask of the varying channels; one without measurements counts as constant."""
    y = np.asarray(y)
    # The first samples mostly tell; on a million of them the whole takes as long as an error.
    few, varies = y[:1000], np.zeros(y.shape[1:], bool)
    for part in (few, y):
        if not varies.all():
            varies = np.asarray(np.fmax.reduce(part, axis=0) > np.fmin.reduce(part, axis=0))
    return varies


def _squared_errors(y: npt.ArrayLike, prediction: npt.ArrayLike) -> Array:
    """Return the squared errors, `(time, ny)`."""
    y, prediction = np.asarray(y, float), np.asarray(prediction, float)
    if y.shape != prediction.shape or y.ndim not in (1, 2) or not len(y):
        raise InputError(
            f"y and prediction must have one shape, (time,) or (time, ny), "
            f"got {y.shape} and {prediction.shape}"
        )
    return ((y - prediction) ** 2).reshape(len(y), -1)


def _cumulative(squared: Array, y: Array) -> Array:
    """Return the cumulative RMSE, `(time,)`, with means over measured samples by channel."""
    missing = np.isnan(y).reshape(squared.shape)
    if not missing.any():
        return np.asarray(np.sqrt(np.cumsum(squared.sum(axis=1)) / np.arange(1, len(y) + 1)))
    total = np.cumsum(np.where(missing, 0.0, squared), axis=0)
    with np.errstate(invalid="ignore"):
        means = total / np.cumsum(~missing, axis=0)
    return np.asarray(np.sqrt(means.sum(axis=1)))

"""How far a prediction is from the truth. Arrays are `(time,)` or `(time, ny)`, NumPy.

Errors of several channels add up as a Euclidean norm, as in the paper's e_n; normalise channels
of different units first.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

Array = npt.NDArray[np.float64]


def rmse(y: npt.ArrayLike, prediction: npt.ArrayLike) -> float:
    """Root of the mean squared error, in the unit of y: the last value of `cumulative_rmse`."""
    return float(np.sqrt(np.mean(_squared_errors(y, prediction))))


def cumulative_rmse(y: npt.ArrayLike, prediction: npt.ArrayLike) -> Array:
    """e_n = sqrt(sum_{k<=n} ||y_k - prediction_k||^2 / (n + 1)), `(time,)` (paper, Sec. 5)."""
    squared = _squared_errors(y, prediction)
    return np.sqrt(np.cumsum(squared) / np.arange(1, len(squared) + 1))


def nrmse(y: npt.ArrayLike, prediction: npt.ArrayLike) -> float:
    """RMSE over the standard deviation of y: 1 is as good as the mean."""
    error, y = rmse(y, prediction), np.asarray(y, float)
    if not np.ptp(y, axis=0).any():
        raise ValueError("y must not be constant: its standard deviation is 0")
    return error / rmse(y, np.broadcast_to(y.mean(axis=0), y.shape))


def fit_percent(y: npt.ArrayLike, prediction: npt.ArrayLike) -> float:
    """100 (1 - NRMSE): 100 is perfect, 0 is as good as the mean; system identification's "fit"."""
    return 100 * (1 - nrmse(y, prediction))


def spread(y: npt.ArrayLike) -> Array:
    """The standard deviation of each channel of `y` `(time, ny)`; 1 for a constant one, `(ny,)`."""
    y = np.asarray(y, float)
    # Rounding gives a constant a tiny deviation, so that its range decides.
    return np.asarray(np.where(np.ptp(y, axis=0) > 0, y.std(axis=0), 1.0))


def _squared_errors(y: npt.ArrayLike, prediction: npt.ArrayLike) -> Array:
    y, prediction = np.asarray(y, float), np.asarray(prediction, float)
    if y.shape != prediction.shape or y.ndim not in (1, 2) or not len(y):
        raise ValueError(
            f"y and prediction must have one shape, (time,) or (time, ny), "
            f"got {y.shape} and {prediction.shape}"
        )
    squared: Array = (y - prediction) ** 2
    return squared if y.ndim == 1 else squared.sum(axis=1)

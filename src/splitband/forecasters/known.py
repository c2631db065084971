"""Define the data that a forecaster may use for a forecast."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from splitband.data import Grid
from splitband.runtime.arrays import Array


@dataclass(frozen=True, eq=False)
class Known:
    """Hold the data that a forecaster may use for a forecast.

    Attributes
    ----------
    y : Measured samples up to the origin, `(time, ny)`, NaN in gaps.
    steps : Number of samples to forecast.
    begin : Index of the first sample of `y`, counted from the first one of the training record;
        None for a record with an unrelated time.
    u : The inputs of history and forecast, `(time + steps, nu)`, where there are any.
    y_sim : A simulator's output over the same samples, `(time + steps or more, ny)`, if any.
    grid : The times of `y`, by the clock of its record.
    own : Whether `y` is the training record or its end, to which the model is already fitted.
    since : First row of a trajectory that is used; the rows before it may hold any values.
    """

    y: Array
    steps: int
    begin: float | None = 0.0
    u: Array | None = None
    y_sim: Array | None = None
    grid: Grid | None = None
    own: bool = False
    since: int = 0


def continued(
    name: str,
    past: Array,
    beyond: npt.ArrayLike | None,
    given: npt.ArrayLike | None,
    steps: int,
    more: bool = False,
) -> Array:
    """Return a signal up to the origin and its next `steps` samples; with `more`, all after it.

    Parameters
    ----------
    name : For errors.
    past : `(time, channels)`.
    beyond, given : Samples after the origin that the history brings, and that a user gives in their
        place, `(steps or more, channels)`, or `(steps or more,)` for a single channel.

    Raises
    ------
    ValueError
        For too few samples ahead, another number of channels, and given samples that begin with
        those of the history.
    """
    n, channels = past.shape
    ahead = beyond if given is None else given
    values = None if ahead is None else np.asarray(ahead, dtype=np.float64)
    if values is not None and values.ndim == 1:
        values = values[:, None]
    if values is None or len(values) < steps or values.shape[1] != channels:
        shape = "none" if values is None else values.shape
        raise ValueError(
            f"{name} must hold the {steps} samples to come in {channels} channel(s), got {shape}"
        )
    whole = given is not None and len(values) >= n + steps and np.array_equal(values[:n], past)
    if whole and n and np.ptp(past):
        raise ValueError(
            f"{name} must hold the {steps} samples to come alone, got the {n} of the history first"
        )
    return np.concatenate([past, values if more else values[:steps]])

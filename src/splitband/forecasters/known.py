"""Define what a forecaster may know when it is asked."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from splitband.data import Grid
from splitband.runtime.arrays import Array


@dataclass(frozen=True, eq=False)
class Known:
    """Hold what a forecaster may know when it is asked.

    Attributes
    ----------
    y : What was measured up to the origin, `(time, ny)`; NaN where nothing was.
    steps : How many samples after it are asked for.
    begin : How many samples after the first one of the training record `y` begins; None for
        another record, whose time has nothing to do with that.
    u : The inputs over both, `(time + steps, nu)`, where there are any.
    y_sim : A simulator's output over both, `(time + steps or more, ny)`, where there is one.
    grid : When `y` was measured, by the clock of its record.
    own : Whether `y` is the training record, or its end: nothing is to be learned from it again.
    since : The row from which on a trajectory over both is used; before it anything may stand.
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
    name: str, past: Array, ahead: npt.ArrayLike | None, steps: int, more: bool = False
) -> Array:
    """Return a signal up to the origin and its next `steps` samples, or with `more` all given.

    Parameters
    ----------
    name : For errors.
    past : `(time, channels)`.
    ahead : `(steps or more, channels)`, or without the latter for a single one.

    Raises
    ------
    ValueError
        For too few samples ahead, or other channels.
    """
    channels = past.shape[1]
    values = None if ahead is None else np.asarray(ahead, dtype=np.float64)
    if values is not None and values.ndim == 1:
        values = values[:, None]
    if values is None or len(values) < steps or values.shape[1] != channels:
        shape = "none" if values is None else values.shape
        raise ValueError(
            f"{name} must hold the {steps} samples to come in {channels} channel(s), got {shape}"
        )
    return np.concatenate([past, values if more else values[:steps]])

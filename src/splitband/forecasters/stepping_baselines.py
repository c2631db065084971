"""Run baselines sample by sample: held values, functions of time, a repeated period."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from splitband.forecasters.prediction import Known
from splitband.forecasters.stepping import Part, State
from splitband.runtime.arrays import Array

ByTime = Callable[[float, int], Array]
"""Maps the time of the first sample and the number of samples to values, `(steps, ny)`."""


class Constant(Part):
    """Return the same value for every sample."""

    def __init__(self, level: Array) -> None:
        self.level = level

    def initial(self, known: Known | None) -> State:
        """Return an empty state."""
        return {}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the value."""
        return state, np.tile(self.level[:, None], (1 + ahead, 1, 1))


class Held(Part):
    """Hold the last measured value of each channel."""

    def __init__(self, ny: int) -> None:
        self.ny = ny

    def initial(self, known: Known | None) -> State:
        """Return a state without a measured value."""
        return {"last": np.full(self.ny, np.nan)}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return rows that read the held value: 0, with a derivative of 1 by it."""
        return state, np.tile([0.0, 1.0], (1 + ahead, self.ny, 1))

    def learn(self, state: State, row: Array, y: Array) -> State:
        """Return the state with the new values of the channels that were measured."""
        return {"last": np.where(np.isnan(y), state["last"], y)}

    def settle(self, state: State) -> Array:
        """Return the last measured values."""
        return state["last"][:, None]


class InTime(Part):
    """Follow a function of time."""

    def __init__(self, predict: ByTime) -> None:
        self.predict = predict

    def initial(self, known: Known | None) -> State:
        """Return the time of the first sample."""
        begin = 0.0 if known is None or known.begin is None else known.begin
        return {"time": np.array(float(begin))}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the values of the function at a sample and at `ahead` more."""
        values = self.predict(state["time"], 1 + ahead)
        return {"time": state["time"] + 1}, values[..., None]


class Repeated(Part):
    """Repeat a period `(lag, ny)`, which ended before the time `end`, plus a trend."""

    def __init__(self, period: Array, end: int, trend: ByTime) -> None:
        self.period, self.end, self.trend = period, end, trend

    def initial(self, known: Known | None) -> State:
        """Return the time of the first sample, and the period from there on."""
        begin = 0 if known is None or known.begin is None else round(known.begin)
        rolled = np.roll(self.period, (self.end - begin) % len(self.period), axis=0)
        return {"time": np.array(float(begin)), "period": rolled}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the first sample of the period plus the trend, and rotate the period by one."""
        period = state["period"]
        following = np.concatenate([period[1:], period[:1]]) if len(period) > 1 else period
        both = np.concatenate([period[:1], following[:1]])[: 1 + ahead]
        values = both + self.trend(state["time"], 1 + ahead)
        return {"time": state["time"] + 1, "period": following}, values[..., None]

"""Forecast with baselines, which need no training."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Protocol, final

import numpy as np

from splitband.baselines.seasonal import LastPeriod, periodic
from splitband.baselines.sinusoids import harmonic
from splitband.data import Record
from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import first_only
from splitband.forecasters.prediction import ForecastContext
from splitband.forecasters.stepping import Part, State
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

DISAGREEMENT_RATIO = 3.0
"""A function of time disagrees with a history if its error exceeds this multiple of the training
error. By eye."""
_EXACT = 1e-6
"""Share of a channel's range: a smaller training error is due to rounding. By eye."""


class ByTime(Protocol):
    """Define the interface of functions of the time since the training record began."""

    def predict(self, start: float, steps: int) -> Array:
        """Return the samples `start`..`start + steps - 1`, `(steps, ny)`; 0 is the first fitted."""


@final
class Mean(Forecaster):
    """Forecast the mean of the training samples, the best forecast of unpredictable signals."""

    affine = True
    name = "mean"

    def learn(self, records: Sequence[Record], **_: Any) -> None:
        """Compute the mean of all records."""
        self.level = np.nanmean(np.concatenate([record.y_with_gaps for record in records]), axis=0)

    def extrapolate(self, known: ForecastContext) -> Array:
        """Return the mean."""
        return np.tile(self.level, (known.steps, 1))

    def _part(self, outside: bool = False) -> Part:
        """Return the mean as a constant part."""
        return Constant(self.level)

    _words = "mean of the training samples"

    def describe(self) -> str:
        """Return a description."""
        return "the mean of the training samples"


class Constant(Part):
    """Return the same value for every sample."""

    def __init__(self, level: Array) -> None:
        self.level = level

    def initial(self, known: ForecastContext | None) -> State:
        """Return an empty state."""
        return {}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the value."""
        return state, np.tile(self.level[:, None], (1 + ahead, 1, 1))


@final
class Persistence(Forecaster):
    """Hold the last measured sample, as if nothing changed."""

    affine = True
    name = "persistence"

    def extrapolate(self, known: ForecastContext) -> Array:
        """Return the last sample; raises ValueError where a channel has not been measured yet."""
        measured = ~np.isnan(known.y)
        if not measured.any(axis=0).all():
            raise InputError("history must have a measured sample in every channel")
        last = len(known.y) - 1 - measured[::-1].argmax(axis=0)
        return np.tile(np.take_along_axis(known.y, last[None], axis=0), (known.steps, 1))

    def _part(self, outside: bool = False) -> Part:
        """Return the part that holds the last measured sample."""
        return Held(self.require_fitted().record.ny)

    _words = "last measured value, held"

    def describe(self) -> str:
        """Return a description."""
        return "the last measured sample, held"


class Held(Part):
    """Hold the last measured value of each channel."""

    def __init__(self, ny: int) -> None:
        self.ny = ny

    def initial(self, known: ForecastContext | None) -> State:
        """Return a state without a measured value."""
        return {"last": np.full(self.ny, np.nan)}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return rows that read the held value: 0, with a derivative of 1 by it."""
        return state, np.tile([0.0, 1.0], (1 + ahead, self.ny, 1))

    def correct(self, state: State, row: Array, y: Array) -> State:
        """Return the state with the new values of the channels that were measured."""
        return {"last": np.where(np.isnan(y), state["last"], y)}

    def settle(self, state: State) -> Array:
        """Return the last measured values."""
        return state["last"][:, None]


class _ByTime(Forecaster):
    """Fit a function of the time since the training record began."""

    baseline: ByTime
    error: Array
    """RMSE of each channel in training, `(ny,)`."""

    anchored = True
    affine = True

    @abstractmethod
    def fitted_function(self, y: Array) -> ByTime:
        """Return the function that fits the samples `(time, ny)`, NaN in gaps."""

    def learn(self, records: Sequence[Record], **_: Any) -> None:
        """Fit the function to the first of several records."""
        seen = records[0].y_with_gaps
        self.baseline = self.fitted_function(seen)
        self.error = _rmse_of_channels(seen - self.baseline.predict(0, len(seen)))

    def extrapolate(self, known: ForecastContext) -> Array:
        """Return the values of the function after the history."""
        return self.baseline.predict(_whole(known.begin) + len(known.y), known.steps)

    def trajectory(self, known: ForecastContext) -> Array:
        """Return the values of the function over history and forecast, `(time + steps, ny)`."""
        return self.baseline.predict(_whole(known.begin), len(known.y) + known.steps)

    def _part(self, outside: bool = False) -> Part:
        """Return the function of time."""
        return InTime(self.baseline)

    def doubts(self, known: ForecastContext) -> list[str]:
        """Return a warning where it disagrees with the history, unless that is `known.own`."""
        if known.own:
            return []
        found = _rmse_of_channels(known.y - self.trajectory(replace(known, steps=0)))
        usual = np.maximum(self.error, _EXACT * np.ptp(self.require_fitted().y_range, axis=0))
        worst = int(np.argmax(found - DISAGREEMENT_RATIO * usual))
        if found[worst] <= DISAGREEMENT_RATIO * usual[worst]:
            return []
        return [
            f"{self.name} disagrees with the history, RMSE {found[worst]:.3g} where it was "
            f"{self.error[worst]:.3g} in training: its periods and trends count from the training "
            "record on, which the history does not seem to continue"
        ]

    def describe(self) -> str:
        """Return the fitted periods and trends."""
        return str(self.baseline) + first_only(self.require_fitted())


class InTime(Part):
    """Follow a function of time."""

    def __init__(self, function: ByTime) -> None:
        self.function = function

    def initial(self, known: ForecastContext | None) -> State:
        """Return the time of the first sample."""
        begin = 0.0 if known is None or known.begin is None else known.begin
        return {"time": np.array(float(begin))}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the values of the function at a sample and at `ahead` more."""
        values = self.function.predict(state["time"], 1 + ahead)
        return {"time": state["time"] + 1}, values[..., None]


@final
class SeasonalNaive(_ByTime):
    """Repeat the last period, on a trend where there is one."""

    name = "seasonal-naive"
    baseline: LastPeriod

    _words = "last period, repeated"

    def fitted_function(self, y: Array) -> LastPeriod:
        """Return the last period and the trend."""
        return LastPeriod.fit(y)

    def _part(self, outside: bool = False) -> Part:
        """Return the part that repeats the period."""
        return Repeated(self.baseline)


class Repeated(Part):
    """Repeat the last period of a record on its trend."""

    def __init__(self, last: LastPeriod) -> None:
        self.last = last

    def initial(self, known: ForecastContext | None) -> State:
        """Return the time of the first sample, and the period from there on."""
        begin = 0 if known is None or known.begin is None else round(known.begin)
        rolled = np.roll(self.last.period, (self.last.end - begin) % self.last.lag, axis=0)
        return {"time": np.array(float(begin)), "period": rolled}

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the first sample of the period on the trend, and rotate the period by one."""
        period = state["period"]
        following = np.concatenate([period[1:], period[:1]]) if len(period) > 1 else period
        both = np.concatenate([period[:1], following[:1]])[: 1 + ahead]
        values = both + self.last.trend.predict(state["time"], 1 + ahead)
        return {"time": state["time"] + 1, "period": following}, values[..., None]


@final
class Harmonic(_ByTime):
    """Fit sinusoids that may decay, and a trend (`baselines.sinusoids`)."""

    name = "harmonic"

    _slow_part = "sinusoids"
    _words = "sinusoids and a trend, fitted"

    def fitted_function(self, y: Array) -> ByTime:
        """Return the sum of sinusoids."""
        return harmonic(y)


@final
class Periodic(_ByTime):
    """Fit a Fourier series with the period of the record, and a trend (`baselines.seasonal`)."""

    name = "periodic"

    _slow_part = "periodic waveform"
    _words = "periodic waveform, fitted"

    def fitted_function(self, y: Array) -> ByTime:
        """Return the sum of harmonics and vibrations."""
        return periodic(y)


def _rmse_of_channels(errors: Array) -> Array:
    """Return the RMSE of each channel, `(ny,)`; 0 where nothing was measured."""
    return np.sqrt(np.nansum(errors**2, axis=0) / np.maximum((~np.isnan(errors)).sum(axis=0), 1))


def _whole(begin: float | None) -> float:
    """Return the time as an integer where it is one, so that times are equal to the bit."""
    assert begin is not None, "what depends on the time is not asked about other records"
    return int(begin) if begin == int(begin) else begin

"""Forecast with baselines, which need no training."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Protocol, final

import numpy as np

from splitband.baselines.seasonal import LastPeriod, nearest, periodic
from splitband.baselines.sinusoids import SinusoidRegression, harmonic
from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import first_only
from splitband.forecasters.prediction import ForecastContext
from splitband.forecasters.steps import State, Steps
from splitband.metrics import channel_rmse
from splitband.records import Record
from splitband.runtime.arrays import Array, check_shape
from splitband.runtime.errors import InputError

DISAGREEMENT_RATIO = 3.0
"""A function of time disagrees with a history if its error exceeds this multiple of the training
error. By eye."""
_EXACT = 1e-6
"""Share of a channel's range: a smaller training error is due to rounding. Rounding."""


class ByTime(Protocol):
    """Define the interface of functions of the time since the training record began."""

    def predict(self, start: float, steps: int) -> Array:
        """Return the samples `start`..`start + steps - 1`, `(steps, ny)`; 0 is the first fitted."""


@final
class Mean(Forecaster):
    """The mean of the training samples, the best forecast of unpredictable signals."""

    affine = forgets = True
    name = "mean"
    at_once = True
    state_types: ClassVar[Mapping[str, Any]] = {"level": Array}

    def learn(self, records: Sequence[Record], **_: Any) -> None:
        self.level = np.nanmean(np.concatenate([record.y_with_gaps for record in records]), axis=0)

    def complete(self) -> None:
        super().complete()
        check_shape("level", self.level, self.require_fitted().record.ny)

    def extrapolate(self, known: ForecastContext) -> Array:
        return np.tile(self.level, (known.steps, 1))

    def step_form(self) -> Steps:
        return ConstantSteps(self.level)

    _words = "mean"

    def describe(self) -> str:
        return "the mean of the training samples"


@final
class Persistence(Forecaster):
    """The last measured sample, as if nothing changed."""

    affine = forgets = True
    name = "persistence"
    at_once = True

    def extrapolate(self, known: ForecastContext) -> Array:
        """Return the last sample; raises ValueError where a channel has not been measured yet."""
        if np.isnan(last := _last(known.y)).any():
            raise InputError("history must have a measured sample in every channel")
        return np.tile(last, (known.steps, 1))

    def step_form(self) -> Steps:
        return LastSteps(self.require_fitted().record.ny)

    _words = "last value held"

    def describe(self) -> str:
        return "the last measured sample, held"


class _ByTime(Forecaster):
    """Fit a function of the time since the training record began."""

    baseline: ByTime
    error: Array
    """RMSE of each channel in training, `(ny,)`."""
    _fitted_to: ClassVar[staticmethod[[Array], ByTime]]
    """Returns the function that fits samples `(time, ny)`, NaN in gaps."""

    anchored = True
    affine = forgets = True
    state_types: ClassVar[Mapping[str, Any]] = {"baseline": SinusoidRegression, "error": Array}

    def learn(self, records: Sequence[Record], **_: Any) -> None:
        """Fit the function to the first of several records."""
        seen = records[0].y_with_gaps
        self.baseline = self._fitted_to(seen)
        self.error = _errors(seen, self.baseline.predict(0, len(seen)))

    def complete(self) -> None:
        super().complete()
        ny = self.require_fitted().record.ny
        check_shape("error", self.error, ny)
        check_shape("baseline", self.baseline.predict(0, 1), 1, ny)

    def extrapolate(self, known: ForecastContext) -> Array:
        return self.baseline.predict(_begin(known) + len(known.y), known.steps)

    def trajectory(self, known: ForecastContext) -> Array:
        return self.baseline.predict(_begin(known), len(known.y) + known.steps)

    def step_form(self) -> Steps:
        return TimeSteps(self.baseline)

    def doubts(self, known: ForecastContext) -> list[str]:
        """Return a warning where it disagrees with the history, unless that is `known.own`."""
        if known.own:
            return []
        found = _errors(known.y, self.trajectory(replace(known, steps=0)))
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
        return str(self.baseline) + first_only(self.require_fitted())


@final
class SeasonalNaive(_ByTime):
    """The last period, repeated, on a trend where there is one."""

    name = "seasonal-naive"
    baseline: LastPeriod
    state_types: ClassVar[Mapping[str, Any]] = {"baseline": LastPeriod, "error": Array}

    _words = "last period repeated"

    _fitted_to = staticmethod(LastPeriod.fit)

    def step_form(self) -> Steps:
        """Return the period, of which a sample moves from the beginning to the end at each step."""
        return PeriodSteps(self.baseline)


@final
class Harmonic(_ByTime):
    """Sinusoids that may decay, and a trend (`baselines.sinusoids`)."""

    name = "harmonic"

    slow_part = "sinusoids"
    _words = "sinusoids and trend"
    _fitted_to = staticmethod(harmonic)


@final
class Periodic(_ByTime):
    """A Fourier series with the period of the record, and a trend (`baselines.seasonal`)."""

    name = "periodic"

    slow_part = "periodic waveform"
    _words = "periodic waveform"
    _fitted_to = staticmethod(periodic)


BASELINES: tuple[Callable[[], Forecaster], ...] = (
    Mean,
    Persistence,
    SeasonalNaive,
    Harmonic,
    Periodic,
)
"""All baselines of this file."""


@final
class ConstantSteps(Steps):
    """Predict the same value at every sample."""

    def __init__(self, level: Array) -> None:
        self.level = level

    def begin(self, history: ForecastContext | None) -> State:
        return {}

    def run(self, state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        return state, self.level


@final
class LastSteps(Steps):
    """Predict the last measured value of each channel."""

    def __init__(self, ny: int) -> None:
        self.ny = ny

    def begin(self, history: ForecastContext | None) -> State:
        return {"last": np.full(self.ny, np.nan) if history is None else _last(history.y)}

    def run(self, state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        return state, state["last"]

    def correct(self, state: State, y: Array) -> State:
        return {"last": np.where(np.isnan(y), state["last"], y)}


@final
class TimeSteps(Steps):
    """Predict the values of a function of the time since the training record began."""

    def __init__(self, function: ByTime) -> None:
        self.function = function

    def begin(self, history: ForecastContext | None) -> State:
        return {"time": np.array(float(_end(history)))}

    def run(self, state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        return {"time": state["time"] + 1}, self.function.predict(state["time"], 1)[0]


@final
class PeriodSteps(Steps):
    """Predict the samples of a period in turn, on a trend."""

    def __init__(self, last: LastPeriod) -> None:
        self.last = last

    def begin(self, history: ForecastContext | None) -> State:
        """Return the period from the next sample on, and its time in samples."""
        time = nearest(_begin(history)) + (0 if history is None else len(history.y))
        period = np.roll(self.last.period, (self.last.end - time) % self.last.lag, axis=0)
        return {"time": np.array(float(time)), "period": period}

    def run(self, state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        period = state["period"]
        following = np.concatenate([period[1:], period[:1]]) if len(period) > 1 else period
        y = period[0] + self.last.trend.predict(state["time"], 1)[0]
        return {"time": state["time"] + 1, "period": following}, y


def _last(y: Array) -> Array:
    """Return the last measured value of each channel, `(ny,)`; NaN where there is none."""
    at = len(y) - 1 - np.argmax(~np.isnan(y)[::-1], axis=0)
    return np.asarray(np.take_along_axis(y, at[None], axis=0)[0])


def _errors(y: Array, predicted: Array) -> Array:
    """Return the RMSE of each channel, `(ny,)`; 0 where nothing was measured."""
    return np.nan_to_num(channel_rmse(y, predicted))


def _begin(known: ForecastContext | None) -> float:
    """Return the time of a history's first sample, 0 for another record; whole where it can be."""
    begin = 0.0 if known is None or known.begin is None else known.begin
    return int(begin) if begin == int(begin) else begin


def _end(known: ForecastContext | None) -> float:
    """Return the time of the sample after a history; see `_begin`."""
    return _begin(known) + (0 if known is None else len(known.y))

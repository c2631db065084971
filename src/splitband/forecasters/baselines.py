"""Forecast with baselines, which need no training."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Protocol, final

import numpy as np

from splitband.baselines.seasonal import LastPeriod, nearest, periodic
from splitband.baselines.sinusoids import SinusoidRegression, harmonic
from splitband.data import Record
from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import first_only
from splitband.forecasters.prediction import ForecastContext
from splitband.forecasters.stepping import Part, State
from splitband.metrics import channel_rmse
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
    """Forecast the mean of the training samples, the best forecast of unpredictable signals."""

    affine = forgets = True
    name = "mean"
    at_once = True
    state_types: ClassVar[Mapping[str, Any]] = {"level": Array}

    def learn(self, records: Sequence[Record], **_: Any) -> None:
        """Compute the mean of all records."""
        self.level = np.nanmean(np.concatenate([record.y_with_gaps for record in records]), axis=0)

    def complete(self) -> None:
        """Check the mean as well; see `Forecaster.complete`."""
        super().complete()
        check_shape("level", self.level, self.require_fitted().record.ny)

    def extrapolate(self, known: ForecastContext) -> Array:
        """Return the mean."""
        return np.tile(self.level, (known.steps, 1))

    def stepped_part(self, outside: bool = False) -> Part:
        """Return the mean as a constant part."""
        level = self.level[:, None]
        return Part(lambda state, u, y_sim, ahead: (state, np.tile(level, (1 + ahead, 1, 1))))

    _words = "mean"

    def describe(self) -> str:
        """Return a description."""
        return "the mean of the training samples"


@final
class Persistence(Forecaster):
    """Hold the last measured sample, as if nothing changed."""

    affine = forgets = True
    name = "persistence"
    at_once = True

    def extrapolate(self, known: ForecastContext) -> Array:
        """Return the last sample; raises ValueError where a channel has not been measured yet."""
        measured = ~np.isnan(known.y)
        if not measured.any(axis=0).all():
            raise InputError("history must have a measured sample in every channel")
        last = len(known.y) - 1 - measured[::-1].argmax(axis=0)
        return np.tile(np.take_along_axis(known.y, last[None], axis=0), (known.steps, 1))

    def stepped_part(self, outside: bool = False) -> Part:
        """Return the part that holds the last measured value of each channel."""
        ny = self.require_fitted().record.ny
        return Part(
            # What is held is estimated: the value is 0, and its derivative by it 1.
            row=lambda state, u, y_sim, ahead: (state, np.tile([0.0, 1.0], (1 + ahead, ny, 1))),
            initial=lambda known: {"last": np.full(ny, np.nan)},
            correct=lambda state, row, y: {"last": np.where(np.isnan(y), state["last"], y)},
            settle=lambda state: state["last"][:, None],
        )

    _words = "last value held"

    def describe(self) -> str:
        """Return a description."""
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
        """Check the function as well; see `Forecaster.complete`."""
        super().complete()
        ny = self.require_fitted().record.ny
        check_shape("error", self.error, ny)
        check_shape("baseline", self.baseline.predict(0, 1), 1, ny)

    def extrapolate(self, known: ForecastContext) -> Array:
        """Return the values of the function after the history."""
        return self.baseline.predict(_begin(known) + len(known.y), known.steps)

    def trajectory(self, known: ForecastContext) -> Array:
        """Return the values of the function over history and forecast, `(time + steps, ny)`."""
        return self.baseline.predict(_begin(known), len(known.y) + known.steps)

    def stepped_part(self, outside: bool = False) -> Part:
        """Return the function of time."""

        def row(state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
            values = self.baseline.predict(state["time"], 1 + ahead)
            return {"time": state["time"] + 1}, values[..., None]

        return Part(row, lambda known: {"time": np.array(float(_begin(known)))})

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
        """Return the fitted periods and trends."""
        return str(self.baseline) + first_only(self.require_fitted())


@final
class SeasonalNaive(_ByTime):
    """Repeat the last period, on a trend where there is one."""

    name = "seasonal-naive"
    baseline: LastPeriod
    state_types: ClassVar[Mapping[str, Any]] = {"baseline": LastPeriod, "error": Array}

    _words = "last period repeated"

    _fitted_to = staticmethod(LastPeriod.fit)

    def stepped_part(self, outside: bool = False) -> Part:
        """Return the part that rotates the period by a sample at each sample."""
        last = self.baseline

        def initial(known: ForecastContext | None) -> State:
            begin = nearest(_begin(known))
            period = np.roll(last.period, (last.end - begin) % last.lag, axis=0)
            return {"time": np.array(float(begin)), "period": period}

        def row(state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
            period = state["period"]
            following = np.concatenate([period[1:], period[:1]]) if len(period) > 1 else period
            both = np.concatenate([period[:1], following[:1]])[: 1 + ahead]
            values = both + last.trend.predict(state["time"], 1 + ahead)
            return {"time": state["time"] + 1, "period": following}, values[..., None]

        return Part(row, initial)


@final
class Harmonic(_ByTime):
    """Fit sinusoids that may decay, and a trend (`baselines.sinusoids`)."""

    name = "harmonic"

    slow_part = "sinusoids"
    _words = "sinusoids and trend"
    _fitted_to = staticmethod(harmonic)


@final
class Periodic(_ByTime):
    """Fit a Fourier series with the period of the record, and a trend (`baselines.seasonal`)."""

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


def _errors(y: Array, predicted: Array) -> Array:
    """Return the RMSE of each channel, `(ny,)`; 0 where nothing was measured."""
    return np.nan_to_num(channel_rmse(y, predicted))


def _begin(known: ForecastContext | None) -> float:
    """Return the time of a history's first sample; 0 for another record, or none.

    It is an integer where it can be, so that times are equal to the bit.
    """
    begin = 0.0 if known is None or known.begin is None else known.begin
    return int(begin) if begin == int(begin) else begin

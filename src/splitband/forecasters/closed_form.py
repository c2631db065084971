"""Forecast with baselines, which need no training."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, ClassVar, final

import numpy as np

from splitband.baselines.common import ByTime
from splitband.baselines.harmonic import HarmonicRegression
from splitband.baselines.periodic import PeriodicRegression
from splitband.baselines.seasonal import LastPeriod
from splitband.data import Record
from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import first_only
from splitband.forecasters.prediction import Known
from splitband.forecasters.stepping import Part
from splitband.forecasters.stepping_baselines import Constant, Held, InTime, Repeated
from splitband.runtime.arrays import Array

DISAGREEMENT_RATIO = 3.0
"""A function of time disagrees with a history if its error exceeds this multiple of the training
error. By eye."""
_EXACT = 1e-6
"""Share of a channel's range: a smaller training error is due to rounding. By eye."""


@final
class Mean(Forecaster):
    """Forecast the mean of the training samples, the best forecast of unpredictable signals."""

    affine = True
    name = "mean"

    def learn(self, records: Sequence[Record], **_: Any) -> None:
        """Compute the mean of all records."""
        self.level = np.nanmean(np.concatenate([record.seen for record in records]), axis=0)

    def extrapolate(self, known: Known) -> Array:
        """Return the mean."""
        return np.tile(self.level, (known.steps, 1))

    def _part(self, outside: bool = False) -> Part:
        """Return the mean as a constant part."""
        return Constant(self.level)

    _words = "mean of the training samples"

    def describe(self) -> str:
        """Return a description."""
        return "the mean of the training samples"


@final
class Persistence(Forecaster):
    """Hold the last measured sample, as if nothing changed."""

    affine = True
    name = "persistence"

    def extrapolate(self, known: Known) -> Array:
        """Return the last sample; raises ValueError where a channel has not been measured yet."""
        measured = ~np.isnan(known.y)
        if not measured.any(axis=0).all():
            raise ValueError("history must have a measured sample in every channel")
        last = len(known.y) - 1 - measured[::-1].argmax(axis=0)
        return np.tile(np.take_along_axis(known.y, last[None], axis=0), (known.steps, 1))

    def _part(self, outside: bool = False) -> Part:
        """Return the part that holds the last measured sample."""
        return Held(self.require_fitted().record.ny)

    _words = "last measured value, held"

    def describe(self) -> str:
        """Return a description."""
        return "the last measured sample, held"


class _ByTime(Forecaster):
    """Fit a function of the time since the training record began."""

    baseline: ByTime
    error: Array
    """RMSE of each channel in training, `(ny,)`."""

    fits: ClassVar[type[ByTime]]
    """The class of the fitted function."""
    anchored = True
    affine = True

    def learn(self, records: Sequence[Record], **_: Any) -> None:
        """Fit the function to the first of several records."""
        seen = records[0].seen
        self.baseline = self.fits.fit(seen)
        self.error = _rmse_of_channels(seen - self.baseline.predict(0, len(seen)))

    def extrapolate(self, known: Known) -> Array:
        """Return the values of the function after the history."""
        return self.baseline.predict(_whole(known.begin) + len(known.y), known.steps)

    def trajectory(self, known: Known) -> Array:
        """Return the values of the function over history and forecast, `(time + steps, ny)`."""
        return self.baseline.predict(_whole(known.begin), len(known.y) + known.steps)

    def _part(self, outside: bool = False) -> Part:
        """Return the function of time."""
        return InTime(self.baseline.predict)

    def doubts(self, known: Known) -> list[str]:
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


@final
class SeasonalNaive(_ByTime):
    """Repeat the last period, plus a trend where there is one."""

    name = "seasonal-naive"
    baseline: LastPeriod

    _words = "last period, repeated"
    fits = LastPeriod

    def _part(self, outside: bool = False) -> Part:
        """Return the part that repeats the period, plus its trend."""
        return Repeated(self.baseline.period, self.baseline.end, self.baseline.trend)


@final
class Harmonic(_ByTime):
    """Fit sinusoids that may decay, and a trend (`baselines.harmonic`)."""

    name = "harmonic"

    _slow_part = "sinusoids"
    _words = "sinusoids and a trend, fitted"
    fits = HarmonicRegression


@final
class Periodic(_ByTime):
    """Fit a Fourier series with the period of the record, and a trend (`baselines.periodic`)."""

    name = "periodic"

    _slow_part = "periodic waveform"
    _words = "periodic waveform, fitted"
    fits = PeriodicRegression


def _rmse_of_channels(errors: Array) -> Array:
    """Return the RMSE of each channel, `(ny,)`; 0 where nothing was measured."""
    return np.sqrt(np.nansum(errors**2, axis=0) / np.maximum((~np.isnan(errors)).sum(axis=0), 1))


def _whole(begin: float | None) -> float:
    """Return the time as an integer where it is one, so that times are equal to the bit."""
    assert begin is not None, "what depends on the time is not asked about other records"
    return int(begin) if begin == int(begin) else begin

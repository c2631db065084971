"""Baselines as forecasters: fitted in closed form, with nothing to train."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Sequence
from typing import Any, final

import numpy as np
import numpy.typing as npt

from splitband.baselines.harmonic import HarmonicRegression
from splitband.baselines.linear import OutputError
from splitband.baselines.naive import ByTime
from splitband.baselines.periodic import PeriodicRegression
from splitband.baselines.seasonal import SeasonalNaive as LastPeriod
from splitband.data import Trajectory
from splitband.forecasters.base import Forecaster
from splitband.forecasters.known import Known

Array = npt.NDArray[np.float64]


@final
class Mean(Forecaster):
    """The mean of the training samples, the best forecast where nothing can be foreseen."""

    name = "mean"

    def learn(self, records: Sequence[Trajectory], **_: Any) -> None:
        """See `Forecaster`."""
        self.level = np.nanmean(records[0].seen, axis=0)

    def extrapolate(self, known: Known) -> Array:
        """See `Forecaster`."""
        return np.tile(self.level, (known.steps, 1))

    def describe(self) -> str:
        """See `Forecaster`."""
        return "the mean of the training samples"


@final
class Persistence(Forecaster):
    """Nothing changes: the last measured sample, held."""

    name = "persistence"

    def extrapolate(self, known: Known) -> Array:
        """See `Forecaster`; raises ValueError where a channel has not been measured yet."""
        measured = ~np.isnan(known.y)
        if not measured.any(axis=0).all():
            raise ValueError("history must have a measured sample in every channel")
        last = len(known.y) - 1 - measured[::-1].argmax(axis=0)
        return np.tile(np.take_along_axis(known.y, last[None], axis=0), (known.steps, 1))

    def describe(self) -> str:
        """See `Forecaster`."""
        return "the last measured sample, held"


class _ByTime(Forecaster):
    """A function of the time since the training record began, fitted to its measured samples."""

    baseline: ByTime

    @abstractmethod
    def fit_to(self, y: Array) -> ByTime:
        """Fit to measured samples `(time, ny)`, NaN in gaps."""

    @property
    def anchored(self) -> bool:
        """See `Forecaster`."""
        return True

    def learn(self, records: Sequence[Trajectory], **_: Any) -> None:
        """See `Forecaster`; of several records the first one is fitted."""
        self.baseline = self.fit_to(records[0].seen)

    def extrapolate(self, known: Known) -> Array:
        """See `Forecaster`."""
        return self.baseline.predict(_whole(known.begin) + len(known.y), known.steps)

    def trajectory(self, known: Known) -> Array:
        """Over the history, too, `(time + steps, ny)`."""
        return self.baseline.predict(_whole(known.begin), len(known.y) + known.steps)

    def describe(self) -> str:
        """See `Forecaster`."""
        return str(self.baseline)


@final
class SeasonalNaive(_ByTime):
    """The last period, repeated, on top of a trend where there is one."""

    name = "seasonal-naive"

    def fit_to(self, y: Array) -> ByTime:
        """See `baselines.seasonal`."""
        return LastPeriod.fit(y)


@final
class Harmonic(_ByTime):
    """Sinusoids that may decay, and a trend (`baselines.harmonic`)."""

    name = "harmonic"

    def fit_to(self, y: Array) -> ByTime:
        """See `baselines.harmonic`."""
        return HarmonicRegression.fit(y)


@final
class Periodic(_ByTime):
    """A Fourier series of the record's own period, and a trend (`baselines.periodic`)."""

    name = "periodic"

    def fit_to(self, y: Array) -> ByTime:
        """See `baselines.periodic`."""
        return PeriodicRegression.fit(y)


@final
class Linear(Forecaster):
    """An output-error model of the known inputs (`baselines.linear`)."""

    name = "linear"
    needs = frozenset({"inputs"})

    def learn(self, records: Sequence[Trajectory], **_: Any) -> None:
        """See `Forecaster`; of several records the first one is fitted."""
        self.u = _inputs(records[0].u)
        self.model = OutputError.fit(records[0].seen, self.u)

    def extrapolate(self, known: Known) -> Array:
        """See `Forecaster`."""
        return self.trajectory(known)[len(known.y) :]

    def trajectory(self, known: Known) -> Array:
        """Over the history, too, `(time + steps, ny)`, simulated from the training record's start.

        Where what the inputs were since then is not known, of another record for instance, the
        history tells the initial state.
        """
        begin = -1 if known.begin is None or known.begin % 1 else int(known.begin)
        if not 0 <= begin <= len(self.u):
            return self.model.simulate(_inputs(known.u), known.y)
        return self.model.simulate(np.concatenate([self.u[:begin], _inputs(known.u)]))[begin:]

    def describe(self) -> str:
        """See `Forecaster`."""
        return str(self.model)


def _whole(begin: float | None) -> float:
    """As an integer where it is one, so that times are the same to the bit."""
    assert begin is not None, "what depends on the time is not asked about other records"
    return int(begin) if begin == int(begin) else begin


def _inputs(u: Array | None) -> Array:
    if u is None:
        raise ValueError("linear needs known inputs")
    return u

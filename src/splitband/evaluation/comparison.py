"""Comparing forecasters on a record, under both protocols.

*From the start*: warm up on the first R samples, simulate to the end; the error counts everything
after the warm-up. *Forecast*: warm up on the last R training samples, simulate beyond them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from splitband.data import Trajectory
from splitband.evaluation.runs import Asked, Failure, Work, run_all
from splitband.evaluation.setup import Setup
from splitband.forecasters.backtest import Backtest, Origin, first_origin
from splitband.forecasters.base import FitReport, Forecaster
from splitband.forecasters.prediction import Prediction
from splitband.metrics import Extrapolation, extrapolations, input_range, leaves_range, rmse

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Run:
    """One forecaster with one seed, under both protocols.

    Attributes
    ----------
    method : The forecaster's name.
    total_rmse, forecast_rmse : Of the two protocols, in the record's unit.
    from_start, forecast : The predictions, to the end of the record.
    leaves : Samples of the forecast before it leaves the range of the training part, see
        `leaves_range`; None where it does not.
    fit : What the fit did.
    description : What it has settled on, and what went wrong.
    unfiltered : What the filters of a model were fed with, from the start.
    """

    method: str
    total_rmse: float
    forecast_rmse: float
    from_start: Prediction
    forecast: Prediction
    leaves: int | None = None
    fit: FitReport = field(default_factory=FitReport)
    description: str = ""
    unfiltered: Mapping[str, Array] = field(default_factory=dict)

    @property
    def seed(self) -> int:
        """It was fitted with."""
        return self.fit.seed


class Runs(dict[str, list[Run]]):
    """The runs of each method, in the order of the seeds, without those that failed.

    A method of which every run failed is not among the keys.

    Attributes
    ----------
    failures : The runs that failed.
    """

    def __init__(
        self, runs: Mapping[str, list[Run]] | None = None, failures: Sequence[Failure] = ()
    ) -> None:
        super().__init__(runs or {})
        self.failures = tuple(failures)

    @property
    def failed(self) -> dict[str, str]:
        """Why, of each method that has no run."""
        return {f.method: f.reason for f in self.failures[::-1] if f.method not in self}

    def __missing__(self, method: str) -> list[Run]:
        raise KeyError(f"{method}: {self.failed.get(method, 'not among the methods')}")


def compare_methods(
    record: Trajectory,
    forecasters: Sequence[Forecaster],
    setup: Setup,
    seeds: Sequence[int] = (0,),
    work: Work | None = None,
    others: Sequence[Trajectory] = (),
) -> Runs:
    """Fit every forecaster with every seed and predict under both protocols.

    What diverges, or cannot be fitted for another reason, is among the result's `failures` and
    does not keep the others from running.

    Parameters
    ----------
    record : Training part and the rest; both protocols end where it ends.
    forecasters : With settings and bands, see `Setup.forecaster`; their names must differ.
    setup : How many samples are trained on, and the warm-up of what has none of its own.
    seeds : Each gives one run of each forecaster that draws something.
    work : How it is computed.
    others : Further records of the same system that networks train on too.

    Raises
    ------
    ValueError
        Before anything is computed, for what `check` finds; and where every method fails.
    """
    check(record, forecasters, setup, others)
    shared = setup.settings.warmup
    forecast = Origin(setup.train, setup.train)
    first = {f.name: first_origin(record, setup.train, f.warmup or shared) for f in forecasters}
    origins = {name: [at, forecast] for name, at in first.items()}
    asked = Asked(record, origins, len(record), others)
    found, failures = run_all(forecasters, asked, seeds, work or Work())
    runs = {}
    for forecaster in forecasters:
        name = forecaster.name
        if done := found[name].values():
            runs[name] = [
                as_run(name, record, setup.train, first[name], forecast, each) for each in done
            ]
    for f in failures:
        if f.method in runs:
            one, *rest = runs[f.method]
            said = "; ".join(filter(None, [one.description, f"seed {f.seed} failed: {f.reason}"]))
            runs[f.method] = [replace(one, description=said), *rest]
    return Runs(runs, failures)


def as_run(
    name: str, record: Trajectory, train: int, first: Origin, forecast: Origin, done: Backtest
) -> Run:
    """What a forecaster has said, with its errors."""
    from_start, ahead = done.predictions[first], done.predictions[forecast]
    return Run(
        name,
        *errors_of(record, train, from_start.y, ahead.y),
        from_start,
        ahead,
        leaves_range(done.y_range, ahead.y),
        done.report,
        done.description,
        done.unfiltered.get(first, {}),
    )


def errors_of(
    record: Trajectory, train: int, from_start: Array, forecast: Array
) -> tuple[float, float]:
    """The RMSE of both protocols against the truth where it is known."""
    truth = record.truth
    return rmse(truth[-len(from_start) :], from_start), rmse(truth[train:], forecast)


def mean_run(runs: Sequence[Run], record: Trajectory, train: int) -> Run:
    """The mean of the predictions of several seeds, with its own errors."""
    first = runs[0]
    if len(runs) == 1:
        return first
    from_start, forecast = (
        replace(getattr(first, name), y=np.mean([getattr(r, name).y for r in runs], axis=0))
        for name in ("from_start", "forecast")
    )
    errors = errors_of(record, train, from_start.y, forecast.y)
    fit = replace(first.fit, seconds=sum(run.fit.seconds for run in runs))
    return Run(first.method, *errors, from_start, forecast, fit=fit)


def by_channel(record: Trajectory, predicted: Array) -> list[float]:
    """The RMSE of each channel by itself, of a prediction `(time, ny)` that ends with the record.

    NaN for a channel that was not measured there.
    """
    truth = record.truth[len(record) - len(predicted) :]
    return [rmse(y, x) for y, x in zip(truth.T, predicted.T, strict=True)]


def inputs_beyond(training: Sequence[Trajectory], u: Array | None) -> list[Extrapolation]:
    """Which inputs `u` `(time, nu)` ahead go beyond those of the training records."""
    seen = [record.u for record in training if record.u is not None]
    return [] if u is None or not seen else extrapolations(*input_range(seen), u)


def check_train(record: Trajectory, train: int, ahead: int = 1) -> None:
    """Check that there is something to train on and `ahead` samples to predict."""
    if not 2 <= train <= len(record) - ahead:
        raise ValueError(
            f"train must be between 2 and {len(record) - ahead} for a record of {len(record)} "
            f"samples, got {train}"
        )


def check(
    record: Trajectory,
    forecasters: Sequence[Forecaster],
    setup: Setup,
    others: Sequence[Trajectory] = (),
    ahead: int = 1,
) -> None:
    """Find what is wrong with a comparison before anything is computed.

    `ahead` samples at least must follow the training part.
    """
    if not forecasters:
        raise ValueError("methods must be one or several, got none")
    names = [forecaster.name for forecaster in forecasters]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise ValueError(
            f"methods must have names that differ, two are {twice}; a forecaster takes another "
            "one as `name`"
        )
    check_train(record, setup.train, ahead)
    if setup.settings.warmup >= setup.train:
        raise ValueError(
            f"warmup must be shorter than the {setup.train} training samples, "
            f"got {setup.settings.warmup}"
        )
    for name, part in (("training", slice(setup.train)), ("predicted", slice(setup.train, None))):
        predicted = record.truth[part]
        if len(predicted) and np.isnan(predicted).all(axis=0).any():
            raise ValueError(f"the {name} part must have a measured sample in every channel")
    if others and not any(forecaster.random for forecaster in forecasters):
        raise ValueError(f"further records are for networks, got {', '.join(names)}")
    for forecaster in forecasters:
        forecaster.check(record[: setup.train], *(others if forecaster.random else ()))

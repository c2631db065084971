"""Comparing forecasters on a record, under both protocols.

*From the start*: warm up on the first R samples, simulate to the end; the error counts everything
after the warm-up. *Forecast*: warm up on the last R training samples, simulate beyond them. *Test
record*: warm up on the first R samples of a record that nothing was fitted to, simulate to its end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from splitband.data import Record, check_alike
from splitband.data.gaps import first_after
from splitband.evaluation.runs import Failure, Work, run_all
from splitband.evaluation.setup import Setup
from splitband.forecasters.backtest import Backtest, Origin, Question, first_origin
from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.prediction import Prediction, mean_of
from splitband.metrics import (
    Extrapolation,
    extrapolations,
    fit_percent,
    input_range,
    leaves_range,
    rmse,
)
from splitband.runtime.arguments import whole

Array = npt.NDArray[np.float64]

TRAINING_SHARE = 0.75
"""The share of a record to train on, where no number of samples is given."""


@dataclass(frozen=True)
class Errors:
    """RMSE of predictions, in the record's unit.

    Attributes
    ----------
    total : From the start.
    forecast : Of the forecast; None where the training part is the whole record.
    tests : Of each test record; none for what has nothing to say about other records.
    """

    total: float
    forecast: float | None
    tests: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class Run:
    """One forecaster with one seed, under every protocol.

    Attributes
    ----------
    method : The forecaster's name.
    errors : Of the predictions.
    from_start, forecast : To the end of the record; no forecast without samples after the training
        part.
    tests : Of the test records, to their ends.
    leaves : Samples of the forecast before it leaves the range of the training part, see
        `leaves_range`; None where it does not.
    fit : What the fit did.
    description : What it has settled on, and what went wrong.
    unfiltered : What the filters of a model were fed with, from the start.
    """

    method: str
    errors: Errors
    from_start: Prediction
    forecast: Prediction | None
    tests: tuple[Prediction, ...] = ()
    leaves: int | None = None
    fit: FitReport = field(default_factory=FitReport)
    description: str = ""
    unfiltered: Mapping[str, Array] = field(default_factory=dict)

    @property
    def seed(self) -> int:
        """It was fitted with."""
        return self.fit.seed

    @property
    def total_rmse(self) -> float:
        """From the start."""
        return self.errors.total

    @property
    def forecast_rmse(self) -> float:
        """Of the forecast; NaN where there is none."""
        return np.nan if self.errors.forecast is None else self.errors.forecast

    @property
    def ahead(self) -> Array:
        """The values of the forecast, `(time, ny)`, none where there is none."""
        return self.from_start.y[:0] if self.forecast is None else self.forecast.y


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
    def ahead(self) -> dict[str, list[Array]]:
        """What each seed of the methods forecast, see `Run.ahead`."""
        return {method: [run.ahead for run in runs] for method, runs in self.items()}

    @property
    def failed(self) -> dict[str, str]:
        """Why, of each method that has no run."""
        return {f.method: f.reason for f in self.failures[::-1] if f.method not in self}

    def __missing__(self, method: str) -> list[Run]:
        raise KeyError(f"{method}: {self.failed.get(method, 'not among the methods')}")


def compare_methods(
    record: Record,
    forecasters: Sequence[Forecaster],
    setup: Setup,
    seeds: Sequence[int] | Mapping[str, Sequence[int]] = (0,),
    work: Work | None = None,
    others: Sequence[Record] = (),
    tests: Sequence[Record] = (),
) -> Runs:
    """Fit every forecaster with every seed and predict under every protocol.

    What diverges, or cannot be fitted for another reason, is among the result's `failures` and
    does not keep the others from running.

    Parameters
    ----------
    record : Training part and the rest; both protocols end where it ends.
    forecasters : With settings and bands, see `Setup.forecaster`; their names must differ.
    setup : How many samples are trained on, and the warm-up of what has none of its own.
    seeds : Each gives one run of each forecaster that draws something; by name where these differ.
    work : How it is computed.
    others : Further records of the same system to train on.
    tests : Records that nothing is fitted to, to be simulated from their first samples.

    Raises
    ------
    ValueError
        Before anything is computed, for what `check` finds; and where every method fails.
    """
    check(record, forecasters, setup, others, tests)
    return run_methods(record, forecasters, setup, seeds, work or Work(), others, tests)


def run_methods(
    record: Record,
    forecasters: Sequence[Forecaster],
    setup: Setup,
    seeds: Sequence[int] | Mapping[str, Sequence[int]],
    work: Work,
    others: Sequence[Record] = (),
    tests: Sequence[Record] = (),
    need_one: bool = True,
) -> Runs:
    """Do what `compare_methods` does, for what has been checked; `need_one` as in `run_all`."""
    questions = {
        f.name: Question(
            record, _origins(f, record, setup), len(record), others, tests, setup.settings.warmup
        )
        for f in forecasters
    }
    backtests, failures = run_all(forecasters, questions, seeds, work, need_one)
    runs = {
        name: [as_run(name, questions[name], setup.train, each) for each in done.values()]
        for name, done in backtests.items()
        if done
    }
    for f in failures:
        if f.method in runs:
            one, *rest = runs[f.method]
            said = "; ".join(filter(None, [one.description, f"seed {f.seed} failed: {f.reason}"]))
            runs[f.method] = [replace(one, description=said), *rest]
    return Runs(runs, failures)


def _origins(forecaster: Forecaster, record: Record, setup: Setup) -> list[Origin]:
    """Of the two protocols; there is nothing to forecast where all of the record is trained on."""
    warmup = forecaster.warmup or setup.settings.warmup
    first = first_origin(record, setup.train, warmup)
    return [first, Origin(setup.train, setup.train)][: 1 + (setup.train < len(record))]


def as_run(name: str, question: Question, train: int, done: Backtest) -> Run:
    """What a forecaster has said, with its errors."""
    ahead = Origin(train, train)
    # The first warm-up without a gap may lie after the training part.
    first = next((origin for origin in question.origins if origin != ahead), ahead)
    from_start = done.predictions[first]
    forecast = done.predictions.get(ahead) if train < question.end else None
    run = Run(
        name,
        Errors(np.nan, None),
        from_start,
        forecast,
        tuple(done.tests),
        None if forecast is None else leaves_range(done.y_range, forecast.y),
        done.report,
        done.description,
        done.unfiltered.get(first, {}),
    )
    return replace(run, errors=errors_of(run, question.record, train, question.tests))


def errors_of(run: Run, record: Record, train: int, tests: Sequence[Record] = ()) -> Errors:
    """The RMSE of a run's predictions against the truth where it is known."""
    truth, from_start = record.truth, run.from_start.y
    return Errors(
        rmse(truth[-len(from_start) :], from_start),
        None if run.forecast is None else rmse(truth[train:], run.forecast.y),
        tuple(
            rmse(test.truth[-len(prediction) :], prediction.y)
            for test, prediction in zip(tests if run.tests else (), run.tests, strict=True)
        ),
    )


def mean_run(runs: Sequence[Run], record: Record, train: int, tests: Sequence[Record] = ()) -> Run:
    """The mean of the predictions of several seeds, with its own errors."""
    first = runs[0]
    if len(runs) == 1:
        return first
    forecasts = [run.forecast for run in runs if run.forecast is not None]
    mean = Run(
        first.method,
        first.errors,
        mean_of([run.from_start for run in runs]),
        mean_of(forecasts) if forecasts else None,
        tuple(mean_of(of_test) for of_test in zip(*(run.tests for run in runs), strict=True)),
        fit=replace(first.fit, seconds=sum(run.fit.seconds for run in runs)),
    )
    return replace(mean, errors=errors_of(mean, record, train, tests))


def by_channel(record: Record, predicted: Array) -> list[float]:
    """The RMSE of each channel by itself, of a prediction `(time, ny)` that ends with the record.

    NaN for a channel that was not measured there.
    """
    truth = record.truth[len(record) - len(predicted) :]
    return [rmse(y, x) for y, x in zip(truth.T, predicted.T, strict=True)]


def fit_by_channel(record: Record, predicted: Array) -> list[float]:
    """Return the fit in percent of each output, of a prediction that ends with the record.

    NaN where it is constant, or was not measured.
    """
    truth = record.truth[len(record) - len(predicted) :]
    return [float(fit) for fit in np.atleast_1d(fit_percent(truth, predicted))]


def inputs_beyond(training: Sequence[Record], u: Array | None) -> list[Extrapolation]:
    """Which inputs `u` `(time, nu)` ahead go beyond those of the training records."""
    seen = [record.u for record in training if record.u is not None]
    return [] if u is None or not seen else extrapolations(*input_range(seen), u)


def check_train(record: Record, train: int, ahead: int = 1) -> None:
    """Check that there is something to train on and `ahead` samples to predict."""
    if not 2 <= whole("train", train, None) <= len(record) - ahead:
        raise ValueError(
            f"train must be between 2 and {len(record) - ahead} for a record of {len(record)} "
            f"samples, got {train}"
        )


def check(
    record: Record,
    forecasters: Sequence[Forecaster],
    setup: Setup,
    others: Sequence[Record] = (),
    tests: Sequence[Record] = (),
    beyond: bool = False,
) -> None:
    """Find what is wrong with a comparison before anything is computed.

    Samples to predict must follow the training part, unless there are test records or what lies
    `beyond` the record is asked for. A method that cannot be fitted does not keep the others from
    it: its reason is raised only where none can be, and is in its row otherwise.
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
    check_train(record, setup.train, 0 if beyond or tests else 1)
    for other in others:
        check_alike(other, record, other.name or "another record")
    for test in tests:
        check_alike(test, record, test.name or "a test record")
        warmup = max(setup.settings.warmup, *(f.warmup for f in forecasters))
        begin = first_after(test.complete, warmup)
        if begin in (None, len(test)):
            raise ValueError(
                f"warmup must fit into the test record {test.name} of {len(test)} samples, with "
                f"samples to predict after it, got {warmup}"
            )
        if np.isnan(test.truth[begin:]).all(axis=0).any():
            raise ValueError(
                f"every channel of the test record {test.name} must be measured somewhere after "
                f"its first {begin} samples, on which methods warm up"
            )
    if setup.settings.warmup >= setup.train:
        raise ValueError(
            f"warmup must be shorter than the {setup.train} training samples, "
            f"got {setup.settings.warmup}"
        )
    for name, part in (("training", slice(setup.train)), ("predicted", slice(setup.train, None))):
        predicted = record.truth[part]
        if len(predicted) and np.isnan(predicted).all(axis=0).any():
            raise ValueError(f"the {name} part must have a measured sample in every channel")
    wrong: list[ValueError] = []
    for forecaster in forecasters:
        try:
            forecaster.check(record[: setup.train], *others)
        except ValueError as error:
            wrong.append(error)
    if len(wrong) == len(forecasters):
        raise wrong[0]

"""Compare forecasters on a record, under three protocols.

*From the start*: warm up on the first R samples, simulate to the end; the error counts everything
after the warm-up. *Forecast*: warm up on the last R training samples, simulate beyond them. *Test
record*: warm up on the first R samples of a record that nothing was fitted to, simulate to its end.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import numpy.typing as npt

from splitband.data import Record
from splitband.evaluation.jobs import Failure, failed_seeds, reasons
from splitband.evaluation.plan import Plan
from splitband.forecasters.backtest import Backtest, Origin, Question, first_origin
from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.prediction import Prediction, median_of
from splitband.forecasters.simulation import with_simulators_of
from splitband.metrics import leaves_range, rmse, spread

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Errors:
    """Hold the RMSE of predictions, in the record's unit.

    Attributes
    ----------
    total : From the start.
    forecast : Of the forecast; None where the training part is the whole record.
    tests : Of each test record; empty for methods that cannot simulate other records.
    """

    total: float
    forecast: float | None
    tests: tuple[float, ...] = ()

    @classmethod
    def of(
        cls,
        plan: Plan,
        from_start: Prediction,
        forecast: Prediction | None,
        tests: Sequence[Prediction],
    ) -> Errors:
        """Return the errors of predictions, against the noise-free truth where it is known."""
        truth = plan.record.truth
        total = rmse(truth[-len(from_start) :], from_start.y)
        ahead = None if forecast is None else rmse(truth[plan.train :], forecast.y)
        of_tests = zip(plan.tests if tests else (), tests, strict=True)
        return cls(total, ahead, tuple(rmse(t.truth[-len(p) :], p.y) for t, p in of_tests))


@dataclass(frozen=True, eq=False)
class Run:
    """Hold the predictions of one forecaster with one seed under every protocol, and their errors.

    Attributes
    ----------
    method : The forecaster's name.
    errors : Errors of the predictions.
    from_start, forecast : Predictions to the end of the record; no forecast without samples after
        the training part.
    tests : Simulations of the test records, to their ends.
    leaves : Samples of the forecast before it leaves the range of the training part, see
        `leaves_range`; None where it does not.
    fit : Report of the fit.
    description : What the fit has chosen, and what went wrong, in words.
    unfiltered : Signals before a model's filters, in the simulation from the start.
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
        """Return the seed that it was fitted with."""
        return self.fit.seed

    @property
    def total_rmse(self) -> float:
        """Return the error from the start."""
        return self.errors.total

    @property
    def forecast_rmse(self) -> float:
        """Return the error of the forecast; NaN where there is none."""
        return np.nan if self.errors.forecast is None else self.errors.forecast

    @property
    def ahead(self) -> Array:
        """Return the values of the forecast, `(time, ny)`; empty without a forecast."""
        return self.from_start.y[:0] if self.forecast is None else self.forecast.y


class Runs(dict[str, list[Run]]):
    """Map each method to its runs, in the order of the seeds, without those that failed.

    A method of which every run failed is not among the keys.

    Attributes
    ----------
    failures : The runs that failed.
    models : The fitted forecasters of each method, one per run.
    """

    def __init__(
        self,
        runs: Mapping[str, list[Run]] | None = None,
        failures: Sequence[Failure] = (),
        models: Mapping[str, Sequence[Forecaster]] | None = None,
    ) -> None:
        super().__init__(runs or {})
        self.failures, self.models = tuple(failures), {**(models or {})}

    @property
    def ahead(self) -> dict[str, list[Array]]:
        """Return the forecasts of all seeds by method, see `Run.ahead`."""
        return {method: [run.ahead for run in runs] for method, runs in self.items()}

    @property
    def failed(self) -> dict[str, str]:
        """Return the reasons why methods have no run, by name."""
        return reasons(self.failures, self)

    def __missing__(self, method: str) -> list[Run]:
        raise KeyError(f"{method}: {self.failed.get(method, 'not among the methods')}")


def question_of(plan: Plan, forecaster: Forecaster) -> Question:
    """Return the predictions that all protocols need; no forecast without a horizon."""
    record, train, warmup = plan.record, plan.train, plan.setup.settings.warmup
    first = first_origin(record, train, forecaster.warmup or warmup)
    origins = [first, Origin(train, train)][: 1 + (plan.horizon > 0)]
    end = train + plan.horizon
    return Question(record, origins, end, plan.others, plan.tests, warmup, True, plan.setup.initial)


def runs_of(
    plan: Plan,
    questions: Mapping[str, Question],
    backtests: Mapping[str, Mapping[int, Backtest]],
    failures: Sequence[Failure],
    notes: Mapping[str, Sequence[str]] | None = None,
) -> Runs:
    """Return the predictions and their errors by method and seed.

    `notes` by method are added to the description of its first run.
    """
    runs = {
        name: [as_run(plan, name, questions[name], each) for each in done.values()]
        for name, done in backtests.items()
        if done
    }
    for f in failures:
        if f.method in runs:
            runs[f.method] = _noted(runs[f.method], f"seed {f.seed} failed: {f.reason}")
    for name, said in (notes or {}).items():
        runs[name] = _noted(runs[name], *said)
    return Runs(runs, failures, models_of(plan, backtests))


def as_run(plan: Plan, name: str, question: Question, done: Backtest) -> Run:
    """Return the predictions of one fit with their errors."""
    ahead = Origin(plan.train, plan.train)
    # The first warm-up without a gap may lie after the training part.
    first = next((origin for origin in question.origins if origin != ahead), ahead)
    from_start = done.predictions[first]
    forecast = done.predictions.get(ahead) if plan.train < question.end else None
    said = from_start, forecast, tuple(done.tests)
    errors = Errors.of(plan, *said)
    leaves = None if forecast is None else leaves_range(done.y_range, forecast.y)
    return Run(name, errors, *said, leaves, done.report, done.description, done.unfiltered)


def models_of(
    plan: Plan, backtests: Mapping[str, Mapping[int, Backtest]]
) -> dict[str, list[Forecaster]]:
    """Return the fitted forecasters by method; all of them share the plan's records."""
    methods = {method.name: method for method in plan.methods}
    models: dict[str, list[Forecaster]] = {}
    for name, of_seeds in backtests.items():
        models[name] = [each.model for each in of_seeds.values() if each.model is not None]
        for model in models[name]:
            fitted = model.require_fitted()
            training = plan.record[: len(fitted.record)]
            model.fitted = replace(fitted, record=training, others=plan.others)
            if name in methods:
                with_simulators_of(model, methods[name])
    return models


def median_run(plan: Plan, runs: Sequence[Run]) -> Run:
    """Return the median prediction over several seeds, with its errors."""
    first = runs[0]
    if len(runs) == 1:
        return first
    forecasts = [run.forecast for run in runs if run.forecast is not None]
    said = (
        median_of([run.from_start for run in runs]),
        median_of(forecasts) if forecasts else None,
        tuple(median_of(of_test) for of_test in zip(*(run.tests for run in runs), strict=True)),
    )
    fit = replace(first.fit, seconds=sum(run.fit.seconds for run in runs))
    return Run(first.method, Errors.of(plan, *said), *said, fit=fit)


def without_failed(
    training: Record, backtests: Mapping[str, Mapping[int, Backtest]]
) -> tuple[dict[str, dict[int, Backtest]], dict[str, list[str]]]:
    """Return the fits by method and seed without the seeds that failed, and notes by method.

    A seed fails if it is unstable, or by its error in simulating the training record from the
    start, see `failed_seeds`. The notes name the seeds left out.
    """
    kept: dict[str, dict[int, Backtest]] = {}
    notes: dict[str, list[str]] = {}
    for name, done in backtests.items():
        errors = {seed: error_from_start(each, training) for seed, each in done.items()}
        failed = failed_seeds({seed: each.report for seed, each in done.items()}, errors)
        kept[name] = {seed: each for seed, each in done.items() if seed not in failed}
        said = [f"seed {seed} left out: {why}" for seed, why in failed.items()]
        if done and not any(each.report.stable for each in kept[name].values()):
            said.append("unstable: a simulation may grow without bound")
        if said:
            notes[name] = said
    return kept, notes


def error_from_start(done: Backtest, training: Record) -> float:
    """Return the RMSE of the simulation of the training record, channels scaled; 0 if empty."""
    first = min(done.predictions, key=lambda origin: origin.at)
    y = done.predictions[first].y[: max(len(training) - first.at, 0)]
    scale = spread(training.seen)
    return rmse(training.seen[first.at :] / scale, y / scale) if len(y) else 0.0


def _noted(runs: Sequence[Run], *notes: str) -> list[Run]:
    """Return the runs of a method, with notes added to the description of the first one."""
    if not notes:
        return [*runs]
    first, *rest = runs
    said = "; ".join(filter(None, (first.description, *notes)))
    return [replace(first, description=said), *rest]

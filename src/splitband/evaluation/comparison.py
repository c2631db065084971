"""Comparing with everything decided for the user who does not say otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from splitband.data import Record
from splitband.evaluation.budget import TimeBudget
from splitband.evaluation.choosing import (
    as_trained,
    choose,
    handed_out,
    last_stages,
    last_trainings,
    refitted,
    timed,
    without_failed,
)
from splitband.evaluation.plan import Plan, plan
from splitband.evaluation.protocols import Run, Runs, inputs_beyond, mean_run, run_methods
from splitband.evaluation.runs import Work
from splitband.evaluation.search import SearchAttempt, SearchResult
from splitband.evaluation.selection import LEVEL, Trial
from splitband.evaluation.setup import Setup
from splitband.forecasters.base import Forecaster
from splitband.forecasters.checking import LAGS, ResidualTests, residual_tests
from splitband.forecasters.prediction import Prediction
from splitband.metrics import Extrapolation

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Comparison:
    """What forecasters did on a record, and which of them is recommended.

    Attributes
    ----------
    plan : What was asked: record, methods, setup.
    runs : Of each method, one for each seed.
    trial : What they did on held-out training samples; None where none has been made.
    attempts : What has been tried to find out how networks are trained.
    forecasters : The methods with all that has been chosen for them, by name, not fitted.
    time : The time that it took, and what was left out for want of time.
    refit : The recommended method fitted to the whole record, where that was asked for.
    """

    plan: Plan
    runs: Runs
    trial: Trial | None = None
    attempts: tuple[SearchAttempt, ...] = ()
    forecasters: Mapping[str, Forecaster] = field(default_factory=dict)
    time: TimeBudget = field(default_factory=TimeBudget)
    refit: Forecaster | None = None

    @property
    def record(self) -> Record:
        """The whole of it."""
        return self.plan.record

    @property
    def setup(self) -> Setup:
        """What the methods shared."""
        return self.plan.setup

    @property
    def others(self) -> tuple[Record, ...]:
        """Further records that were trained on."""
        return self.plan.others

    @property
    def tests(self) -> tuple[Record, ...]:
        """Records that nothing was fitted to, simulated from their first samples."""
        return self.plan.tests

    @property
    def recommended(self) -> str:
        """The method to use, chosen by training samples alone."""
        return self.require_trial().recommended

    @cached_property
    def model(self) -> Forecaster:
        """The recommended method as it was trained here, ready to predict and to be saved.

        It is fitted to the training part, with `refit` to the whole record. Of what is random it is
        the mean over the seeds.
        """
        return self.refit or self.trained()

    def trained(self, name: str | None = None) -> Forecaster:
        """Return a method as it was trained on the training part; by default the recommended one.

        Raises
        ------
        ValueError
            For a method that is not among those compared, or could not be fitted.
        """
        name = self.recommended if name is None else name
        if not self.runs.models.get(name):
            raise ValueError(f"name must be one of {', '.join(self.runs.models)}, got {name}")
        return handed_out(self.runs.models[name], self.require_trial())

    def forecaster(self, name: str | None = None) -> Forecaster:
        """A method as it has been trained here, not fitted: to be fitted to a record and saved.

        Of what is random it is the mean of the same seeds. Fitted with seed 0 to the training part,
        it says what it has said here.

        Parameters
        ----------
        name : By default that of the recommended method.

        Raises
        ------
        ValueError
            For a method that is not among those compared, or could not be fitted.
        """
        name = self.recommended if name is None else name
        if name not in self.forecasters:
            raise ValueError(f"name must be one of {', '.join(self.forecasters)}, got {name}")
        return as_trained(self.forecasters[name], [run.seed for run in self.runs[name]])

    @cached_property
    def means(self) -> dict[str, Run]:
        """The mean over seeds of each method, which is what is handed out."""
        train = self.setup.train
        return {
            name: mean_run(runs, self.record, train, self.tests) for name, runs in self.runs.items()
        }

    @property
    def left_out(self) -> list[str]:
        """Methods that have nothing to say about the test records."""
        return [name for name, mean in self.means.items() if self.tests and not mean.tests]

    @cached_property
    def predictions(self) -> dict[str, Prediction]:
        """The forecast of each method beyond the training part, with its interval."""
        intervals = {} if self.trial is None else self.trial.intervals
        predictions = {}
        for name, run in self.means.items():
            if run.forecast is None:
                continue
            y, predictions[name] = run.forecast.y, run.forecast
            if name in intervals:
                half = intervals[name].half_widths(len(y))
                predictions[name] = replace(
                    run.forecast, lower=y - half, upper=y + half, level=LEVEL
                )
        return predictions

    @cached_property
    def table(self) -> pd.DataFrame:
        """A row for each method, with the columns that `splitband compare` shows.

        Errors are of the mean of the seeds' predictions, each channel by itself; columns that end
        in "spread" hold the standard deviation of the seeds' errors.
        """
        # The module of the table imports this one, so that it is imported only here.
        report = import_module("splitband.report.table")
        notes = report.remarks(self)
        columns: dict[str, Mapping[str, object]] = {}
        for column in report.columns(self):
            columns[column.title] = column.values
            if column.spreads:
                columns[f"{column.title}, spread"] = column.spreads
        columns["note"] = notes
        if self.trial is not None:
            columns["recommended"] = {name: name == self.recommended for name in self.runs}
        return pd.DataFrame(columns, index=[*notes]).rename_axis("method")

    def covers(self, name: str) -> float:
        """The share of the measured samples that a method's interval holds, 0 to 1.

        NaN where there is no forecast.
        """
        errors = self.record.seen[self.setup.train :] - self.means[name].ahead
        return self.require_trial().intervals[name].coverage(errors) if len(errors) else np.nan

    def coverages(self, name: str) -> tuple[float, ...]:
        """Return `covers` of each channel by itself."""
        errors = self.record.seen[self.setup.train :] - self.means[name].ahead
        return self.require_trial().intervals[name].coverages(errors)

    def residual_tests(self, name: str | None = None) -> tuple[ResidualTests, ...]:
        """Test the residuals of a method on samples that nothing was fitted to.

        That is on the first test record, or else on the forecast; none where there is neither.

        Parameters
        ----------
        name : By default that of the recommended method.
        """
        mean = self.means[self.recommended if name is None else name]
        record, y = (self.tests[0], mean.tests[0].y) if mean.tests else (self.record, mean.ahead)
        if len(y) < 2 * LAGS:
            return ()
        left = record.seen[len(record) - len(y) :] - y
        u = None if record.u is None else record.u[len(record) - len(y) :]
        return residual_tests(left, u, record.columns, record.inputs)

    @property
    def inputs_beyond_training(self) -> list[Extrapolation]:
        """Which inputs after the training part go beyond those that were trained on."""
        train, u = self.setup.train, self.record.u
        training = [self.record[:train], *self.others]
        return inputs_beyond(training, None if u is None else u[train:])

    def require_trial(self) -> Trial:
        """The trial; raises ValueError where none has been made."""
        if self.trial is None:
            raise ValueError("nothing has been tried on held-out samples in this comparison")
        return self.trial

    def __repr__(self) -> str:
        best = "" if self.trial is None else f", recommended: {self.recommended}"
        return f"<Comparison of {len(self.runs)} methods on {self.record!r}{best}>"

    def __str__(self) -> str:
        """Return the recommendation and the table, which is at most 100 characters wide."""
        text: str = import_module("splitband.report.table").as_text(self)
        return text

    def _repr_html_(self) -> str:
        """Return the recommendation and the table, for notebooks."""
        html: str = import_module("splitband.report.table").as_html(self)
        return html

    def plot(self) -> Figure:
        """Every method's predictions over the record, with intervals."""
        # The module of pictures imports this one, so that it is imported only here.
        return import_module("splitband.report.pictures").rollouts(self)

    def save(self, folder: str | Path) -> None:
        """Write all files of `splitband compare`: results, predictions, pictures, the page."""
        import_module("splitband.report.results").save(self, Path(folder))

    def report(self, path: str | Path) -> None:
        """Write one HTML file with summary, table, plots to zoom into and settings, to send on."""
        import_module("splitband.report.page").write(self, path)


def compare(
    record: Record,
    train: int | None = None,
    methods: Sequence[Forecaster | str] | str | None = None,
    *,
    work: Work | None = None,
    **options: Any,
) -> Comparison:
    """Compare forecasters on a record, as `splitband compare` does: `run(plan(record, ...))`.

    Each is fitted to the first `train` samples, and for the recommendation to three quarters of
    them.

    Parameters
    ----------
    record, train, methods : See `plan`.
    work : Processes, progress and checkpoints.
    options : Further arguments of `plan`: others, tests, seeds, setup, horizon.

    Raises
    ------
    ValueError
        For what `plan` finds, before anything is computed; where no method can be fitted.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(400)), 0.1)
    >>> result = sb.compare(record, 300, [sb.Mean(), sb.Persistence(), sb.Harmonic()])
    >>> result.recommended
    'harmonic'
    >>> list(result.table["forecast fit %"].round(1))
    [100.0, -0.3, -77.9]
    """
    return run(plan(record, train, methods, **options), work)


def run(plan: Plan, work: Work | None = None) -> Comparison:
    """Compute what has been planned.

    Parameters
    ----------
    plan : Of `splitband.plan`.
    work : Processes, progress and checkpoints.

    Raises
    ------
    ValueError
        Where no method can be fitted.
    """
    with timed(work or Work(), plan.setup.search).staffed() as staff:
        trial, searched = choose(plan, staff)
        runs = _last_runs(plan, searched, trial, staff)
        comparison = Comparison(
            plan,
            runs,
            attempts=searched.attempts,
            forecasters={m.name: m for m in searched.forecasters if m.name in runs},
            time=staff.time,
        )
        trial = replace(trial, left_out=frozenset(comparison.left_out))
        trial = trial.settled(runs.ahead, staff.time.left_out | runs.failed)
        comparison = replace(comparison, trial=trial)
        if plan.refit:
            model = refitted(plan, comparison.trained(), trial, staff)
            comparison = replace(comparison, refit=model)
    return comparison


def _last_runs(plan: Plan, searched: SearchResult, trial: Trial, work: Work) -> Runs:
    """The methods on the whole training part: what needs no training, then networks."""
    methods = [method for method in searched.forecasters if method.name in trial.errors]
    asked = plan.horizon + len(plan.record) + sum(map(len, plan.tests))
    of_quick, of_slow = last_stages(plan, work, asked)
    with work.time.phase("final trainings"):
        quick = [f for f in methods if not f.random]
        runs = run_methods(plan, quick, (0,), of_quick, need_one=len(quick) == len(methods))
        networks = [f for f in methods if f.random]
        wanted = last_trainings(plan, networks, searched, trial, of_slow)
        if not wanted:
            return runs
        slow = [next(f for f in methods if f.name == name) for name in wanted]
        trained = run_methods(plan, slow, wanted, of_slow, need_one=not runs)
    if plan.seeds is None:
        trained = without_failed(trained, plan.training)
    every = {**runs, **trained}
    ordered = {f.name: every[f.name] for f in methods if f.name in every}
    models = {**runs.models, **trained.models}
    return Runs(ordered, (*runs.failures, *trained.failures), models)

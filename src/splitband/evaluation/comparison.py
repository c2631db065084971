"""Comparing with everything decided for the user who does not say otherwise."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from splitband.data import Record
from splitband.evaluation.choosing import (
    as_trained,
    candidates,
    choose,
    last_stages,
    last_trainings,
    timed,
)
from splitband.evaluation.plan import Plan
from splitband.evaluation.protocols import (
    TRAINING_SHARE,
    Run,
    Runs,
    check,
    check_train,
    inputs_beyond,
    mean_run,
    run_methods,
)
from splitband.evaluation.runs import Work
from splitband.evaluation.search import SearchAttempt, SearchResult
from splitband.evaluation.selection import LEVEL, Trial, check_trial
from splitband.evaluation.setup import Setup, default_setup
from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import Prediction
from splitband.metrics import Extrapolation

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Comparison:
    """What forecasters did on a record, and which of them is recommended.

    Attributes
    ----------
    record : The whole of it.
    setup : What they shared.
    runs : Of each method, one for each seed.
    trial : What they did on held-out training samples; None where none has been made.
    others : Further records that were trained on.
    tests : Records that nothing was fitted to, simulated from their first samples.
    attempts : What has been tried to find out how networks are trained.
    forecasters : The methods with all that has been chosen for them, by name, not fitted.
    plan : The time that it took, and what was left out for want of time.
    """

    record: Record
    setup: Setup
    runs: Runs
    trial: Trial | None = None
    others: tuple[Record, ...] = ()
    tests: tuple[Record, ...] = ()
    attempts: tuple[SearchAttempt, ...] = ()
    forecasters: Mapping[str, Forecaster] = field(default_factory=dict)
    plan: Plan = field(default_factory=Plan)

    @property
    def recommended(self) -> str:
        """The method to use, chosen by training samples alone."""
        return self.require_trial().recommended

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
    methods: Sequence[Forecaster | str] | None = None,
    *,
    others: Sequence[Record] = (),
    tests: Sequence[Record] = (),
    seeds: int | None = None,
    setup: Setup | None = None,
    work: Work | None = None,
) -> Comparison:
    """Compare forecasters on a record, as `splitband compare` does.

    Each is fitted to the first `train` samples, and for the recommendation to three quarters of
    them.

    Parameters
    ----------
    record : What was measured, and known beside it.
    train : Samples to train on, by default three quarters; with `tests` all.
    methods : Forecasters, or names of those that have one (`splitband methods`); what they leave
        open is as in `setup`. By default what is worth comparing on such a record. How the first
        network is trained is searched most thoroughly.
    others : Further records of the same system, to train on.
    tests : Records of the same system that nothing is fitted to: each is simulated to its end by
        what warms up on its first samples.
    seeds : Trainings of each network; by default as many as the budget of `setup.search` pays for,
        and `SEEDS` of what is not searched.
    setup : Settings, bands and sizes; by default chosen by the training samples, and how networks
        are trained by trials on the last quarter of them (`Setup.search`), within two minutes.
    work : Processes, progress and checkpoints.

    Raises
    ------
    ValueError
        For what `check` finds, before anything is computed; where no method can be fitted.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(400)), 0.1)
    >>> result = sb.compare(record, 300, [sb.Mean(), sb.Persistence(), sb.Harmonic()])
    >>> result.recommended
    'harmonic'
    >>> list(result.table["forecast fit %"].round(1))
    [100.0, -0.3, -77.9]
    """
    methods = [methods] if isinstance(methods, str) else methods
    if setup is None:
        usual = len(record) if tests else int(TRAINING_SHARE * len(record))
        train = usual if train is None else train
        check_train(record, train, 0 if tests else 1)
        setup = default_setup(record, train, methods=methods)
    elif train not in (None, setup.train):
        raise ValueError(f"train must be that of setup, {setup.train}, got {train}")
    work = work or Work()
    chosen, setup = candidates(record, setup, methods)
    check(record, chosen, setup, others, tests)
    check_trial(record, chosen, setup, others)
    tests = _called_apart(tests)
    training, ahead = record[: setup.train], len(record) - setup.train
    with timed(work, setup).staffed() as staff:
        trial, searched = choose(training, chosen, ahead, setup, seeds, staff, others, bool(tests))
        fitted = [method for method in searched.forecasters if method.name in trial.errors]
        run = partial(run_methods, record, setup=setup, others=others, tests=tests)
        asked = ahead + len(record) + sum(map(len, tests))
        stages = last_stages(staff, asked, setup.train, ahead)
        runs = _last_runs(run, fitted, searched, trial, seeds, stages)
    comparison = Comparison(
        record,
        setup,
        runs,
        others=tuple(others),
        tests=tuple(tests),
        attempts=searched.attempts,
        forecasters={method.name: method for method in fitted if method.name in runs},
        plan=staff.plan,
    )
    trial = replace(trial, left_out=frozenset(comparison.left_out))
    failed = staff.plan.left_out | runs.failed
    return replace(comparison, trial=trial.settled(runs.ahead, failed))


def _last_runs(
    run: Callable[..., Runs],
    methods: Sequence[Forecaster],
    searched: SearchResult,
    trial: Trial,
    seeds: int | None,
    stages: tuple[Work, Work],
) -> Runs:
    """The methods on the whole training part: what needs no training, then networks."""
    of_quick, of_slow = stages
    with of_quick.plan.phase("final trainings"):
        quick = [f for f in methods if not f.random]
        runs = run(
            forecasters=quick, seeds=(0,), work=of_quick, need_one=len(quick) == len(methods)
        )
        wanted = last_trainings([f for f in methods if f.random], searched, trial, seeds, of_slow)
        if not wanted:
            return runs
        slow = [next(f for f in methods if f.name == name) for name in wanted]
        trained = run(forecasters=slow, seeds=wanted, work=of_slow, need_one=not runs)
    every = {**runs, **trained}
    ordered = {f.name: every[f.name] for f in methods if f.name in every}
    return Runs(ordered, (*runs.failures, *trained.failures))


def _called_apart(tests: Sequence[Record]) -> list[Record]:
    """The test records, each with a name of its own: those that share one are counted."""
    names: list[str] = []
    for i, test in enumerate(tests):
        name, count = test.name or str(i + 1), 1
        while name in names:
            count += 1
            name = f"{test.name} ({count})"
        names.append(name)
    return [replace(test, name=name) for test, name in zip(tests, names, strict=True)]

"""Forecasting with everything decided for the user who does not say otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from html import escape
from importlib import import_module
from pathlib import Path
from typing import Any

from splitband.data import Record
from splitband.evaluation.budget import TimeBudget
from splitband.evaluation.choosing import choose, handed_out, last_stages, last_trainings, timed
from splitband.evaluation.plan import Plan, plan
from splitband.evaluation.protocols import inputs_beyond, models_of
from splitband.evaluation.runs import Failure, Work, run_all
from splitband.evaluation.search import SearchResult
from splitband.evaluation.selection import LEVEL, Trial
from splitband.forecasters.backtest import Backtest, Origin, Question
from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import Prediction, mean_of
from splitband.metrics import Extrapolation, leaves_range
from splitband.runtime.arguments import whole


@dataclass(frozen=True, eq=False, repr=False)
class Forecast:
    """What comes after the end of a record.

    Attributes
    ----------
    plan : What was asked: record, methods, setup.
    model : The recommended method, fitted to the whole record: to predict and to be saved.
    prediction : Its forecast, the mean over seeds, with the interval.
    trial : What was tried, and how it did.
    description : What its fit has settled on.
    leaves : Samples before the forecast leaves the range of the training samples by far.
    inputs_beyond_training : Which inputs to come go beyond those that were trained on.
    time : See `Comparison`.
    """

    plan: Plan
    model: Forecaster
    prediction: Prediction
    trial: Trial
    description: str
    leaves: int | None
    inputs_beyond_training: list[Extrapolation]
    time: TimeBudget = field(default_factory=TimeBudget)

    @property
    def forecaster(self) -> Forecaster:
        """The recommended method, not fitted: to be fitted again."""
        return self.model.clone()

    @property
    def record(self) -> Record:
        """It goes on from."""
        return self.plan.record

    @property
    def seeds(self) -> tuple[int, ...]:
        """Of the recommended method."""
        return self.model.seeds

    @property
    def method(self) -> str:
        """The name of the recommended method."""
        return self.model.name

    def __repr__(self) -> str:
        steps = len(self.prediction)
        return f"<Forecast of {steps} samples after {self.record!r}, by {self.method}>"

    def _repr_html_(self) -> str:
        """Return the first and last rows of the prediction as a table, for notebooks."""
        return f"<p>{escape(repr(self))}</p>{self.prediction._repr_html_()}"

    def report(self, path: str | Path) -> None:
        """Write one HTML file with the forecast, what was tried and settings, to send on."""
        import_module("splitband.report.page").write(self, path)


def forecast(
    record: Record,
    steps: int,
    methods: Sequence[Forecaster | str] | str | None = None,
    *,
    work: Work | None = None,
    **options: Any,
) -> Forecast:
    """What comes after the end of a record, by the method that its own last quarter recommends.

    Parameters
    ----------
    record : All of it is trained on. Its known inputs, and its simulator's output, must reach
        `steps` samples beyond it (`u_beyond`, `beyond`).
    steps : How many samples.
    methods, work : See `compare`.
    options : Further arguments of `plan`: others, seeds, setup.

    Raises
    ------
    ValueError
        As `compare`, and where inputs or simulator do not reach so far.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(400)), 0.1)
    >>> found = sb.forecast(record, 50, [sb.Mean(), sb.Harmonic()])
    >>> found.method, found.prediction.y.shape, found.prediction.lower.shape
    ('harmonic', (50, 1), (50, 1))
    """
    whole("steps", steps)
    return run_forecast(plan(record, len(record), methods, horizon=steps, **options), work)


def run_forecast(plan: Plan, work: Work | None = None) -> Forecast:
    """Forecast what lies beyond the record of a plan, all of which is trained on."""
    record, steps = plan.record, plan.horizon
    with timed(work or Work(), plan.setup.search).staffed() as staff:
        trial, searched = choose(plan, staff)
        # Training is slow: of the networks, only the best one is trained on all of the record.
        fitted = [m for m in searched.forecasters if m.name in trial.errors]
        fitted = [m for m in fitted if not m.random or m.name == trial.best_network]
        backtests, failures = _last_fits(plan, fitted, searched, trial, staff)
    origin = Origin(len(record), len(record))
    means = {
        name: mean_of([backtest.predictions[origin] for backtest in of_method.values()])
        for name, of_method in backtests.items()
        if of_method
    }
    failed = {f.method: f.reason for f in failures[::-1] if f.method not in means}
    failed = staff.time.left_out | failed
    final = {
        name: [backtest.predictions[origin].y for backtest in backtests[name].values()]
        for name in means
    }
    trial = trial.settled(final, failed)
    best = trial.recommended
    half, mean, done = trial.intervals[best].half_widths(steps), means[best], backtests[best]
    left = [leaves_range(each.y_range, each.predictions[origin].y) for each in done.values()]
    u = record.u_beyond
    return Forecast(
        plan,
        handed_out(models_of(plan, backtests)[best], trial),
        replace(mean, lower=mean.y - half, upper=mean.y + half, level=LEVEL),
        trial,
        next(iter(done.values())).description,
        min((samples for samples in left if samples is not None), default=None),
        inputs_beyond([record, *plan.others], None if u is None else u[:steps]),
        staff.time,
    )


def _last_fits(
    plan: Plan,
    fitted: Sequence[Forecaster],
    searched: SearchResult,
    trial: Trial,
    work: Work,
) -> tuple[dict[str, dict[int, Backtest]], list[Failure]]:
    """The forecasts of methods fitted to all of the record: what needs no training first."""
    origin = Origin(plan.train, plan.train)
    question = Question(plan.record, [origin], plan.train + plan.horizon, plan.others, keep=True)
    stages = last_stages(plan, work, plan.horizon)
    quick, networks = ([m for m in fitted if m.random == random] for random in (False, True))
    seeds = last_trainings(plan, networks, searched, trial, stages[1])
    backtests: dict[str, dict[int, Backtest]] = {}
    failures: list[Failure] = []
    with work.time.phase("final trainings"):
        for part, stage in zip((quick, networks), stages, strict=True):
            asked = {method.name: question for method in part}
            need_one = part == fitted or (part == networks and not any(backtests.values()))
            found, lost = run_all(part, asked, seeds, stage, need_one and bool(part))
            backtests |= found
            failures += lost
    return {method.name: backtests[method.name] for method in fitted}, failures

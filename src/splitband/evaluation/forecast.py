"""Forecast beyond the end of a record with the recommended method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from splitband.data import Record
from splitband.evaluation.budget import TimeBudget
from splitband.evaluation.choosing import choose
from splitband.evaluation.jobs import reasons
from splitband.evaluation.plan import Plan, plan
from splitband.evaluation.protocols import models_of, question_of, without_failed
from splitband.evaluation.recommendation import Trial
from splitband.evaluation.run import final_fits, with_limits
from splitband.evaluation.work import Work
from splitband.forecasters.backtest import Origin
from splitband.forecasters.base import Forecaster
from splitband.forecasters.ensemble import fitted_ensemble
from splitband.forecasters.prediction import Prediction, median_of
from splitband.metrics import Extrapolation, leaves_range
from splitband.runtime.arguments import whole
from splitband.runtime.provided import provided


@dataclass(frozen=True, eq=False, repr=False)
class Forecast:
    """Hold a forecast beyond the end of a record.

    Attributes
    ----------
    plan : Record, methods and setup of the forecast.
    model : The recommended method, fitted to the whole record, ready to predict and to be saved.
    prediction : Its forecast, the median over seeds, with the interval.
    trial : Results of all methods on held-out samples.
    description : What its fit has chosen, in words.
    leaves : Samples before a seed's forecast leaves the range of `metrics.leaves_range`; None if it
        does not.
    inputs_beyond_training : Future inputs that exceed their range in training.
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
        """Return the recommended method, not fitted, for further fits."""
        return self.model.clone()

    @property
    def record(self) -> Record:
        """Return the record that is continued."""
        return self.plan.record

    @property
    def seeds(self) -> tuple[int, ...]:
        """Return the seeds of the recommended method."""
        return self.model.seeds

    @property
    def method(self) -> str:
        """Return the name of the recommended method."""
        return self.model.name

    def __repr__(self) -> str:
        steps = len(self.prediction)
        return f"<Forecast of {steps} samples after {self.record!r}, by {self.method}>"

    def _repr_html_(self) -> str:
        """Return the first and last rows of the prediction as a table, for notebooks."""
        return f"<p>{escape(repr(self))}</p>{self.prediction._repr_html_()}"

    def report(self, path: str | Path) -> None:
        """Write one self-contained HTML file with the forecast, the trial and the settings."""
        provided("page of a forecast")(self, path)


def forecast(
    record: Record,
    steps: int,
    methods: Sequence[Forecaster | str] | str | None = None,
    *,
    work: Work | None = None,
    **options: Any,
) -> Forecast:
    """Forecast beyond the end of a record with the method that does best on its last quarter.

    Parameters
    ----------
    record : The training record, all of it. Its known inputs and its simulator's output must reach
        `steps` samples beyond it (`u_beyond`, `beyond`).
    steps : Number of samples to forecast.
    methods, work : See `compare`.
    options : Further arguments of `plan`: others, seeds, setup.

    Raises
    ------
    ValueError
        As `compare`, and if inputs or the simulator's output end too early.

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
    """Forecast beyond the record of a plan that trains on all of it."""
    record, steps = plan.record, plan.horizon
    origin = Origin(plan.train, plan.train)
    with with_limits(plan, work).staffed() as staff:
        trial, searched = choose(plan, staff)
        # Training is slow: only the best network is trained on the whole record.
        fitted = [m for m in searched.forecasters if m.name in trial.errors]
        fitted = [m for m in fitted if not m.random or m.name == trial.best_network]
        questions = {method.name: question_of(plan, method) for method in fitted}
        backtests, failures = final_fits(plan, questions, searched, trial, staff)
    done, notes = (backtests, {}) if plan.seeds else without_failed(plan.training, backtests)
    forecasts = {
        name: [each.predictions[origin] for each in of_seeds.values()]
        for name, of_seeds in done.items()
        if of_seeds
    }
    final = {name: [each.y for each in of_seeds] for name, of_seeds in forecasts.items()}
    trial = trial.settled(final, staff.time.left_out | reasons(failures, forecasts))
    best = trial.recommended
    fits = [*done[best].values()]
    left = [leaves_range(each.y_range, each.predictions[origin].y) for each in fits]
    model = fitted_ensemble(models_of(plan, done)[best], trial.held_out.get(best))
    u = record.u_beyond
    return Forecast(
        plan,
        model,
        trial.intervals[best].around(median_of(forecasts[best])),
        trial,
        "; ".join(filter(None, [fits[0].description, *notes.get(best, [])])),
        min((samples for samples in left if samples is not None), default=None),
        model.require_fitted().inputs_beyond(None if u is None else u[:steps]),
        staff.time,
    )

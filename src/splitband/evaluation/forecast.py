"""Forecast beyond the end of a record with the recommended method."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, field
from html import escape
from pathlib import Path
from typing import Any

from splitband.data import Record
from splitband.evaluation.clock import Clock
from splitband.evaluation.jobs import Runner
from splitband.evaluation.plan import Plan, plan
from splitband.evaluation.recommendation import Trial
from splitband.evaluation.run import Watch, finished
from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import Prediction
from splitband.metrics import Extrapolation
from splitband.runtime.arguments import whole


@dataclass(frozen=True, eq=False, repr=False)
class Forecast:
    """Hold a forecast beyond the end of a record.

    Attributes
    ----------
    plan : Record, methods and settings of the forecast.
    model : The recommended method, fitted to the whole record, ready to predict and to be saved.
    prediction : Its forecast, the median over its trainings, with the interval.
    trial : Results of all methods on held-out samples.
    description : What its fit has chosen, in words.
    leaves : Samples before a training's forecast leaves the range of `metrics.leaves_range`; None
        if it does not.
    inputs_beyond_training : Future inputs that exceed their range in training.
    clock : See `Comparison`.
    """

    plan: Plan
    model: Forecaster
    prediction: Prediction
    trial: Trial
    description: str
    leaves: int | None
    inputs_beyond_training: list[Extrapolation]
    clock: Clock = field(default_factory=Clock)

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

    @property
    def interrupted(self) -> bool:
        """Return whether Ctrl-C ended it early."""
        return self.clock.interrupted

    def __repr__(self) -> str:
        steps = len(self.prediction)
        return f"<Forecast of {steps} samples after {self.record!r}, by {self.method}>"

    def _repr_html_(self) -> str:
        """Return the first and last rows of the prediction as a table, for notebooks."""
        return f"<p>{escape(repr(self))}</p>{self.prediction._repr_html_()}"

    def report(self, path: str | Path) -> None:
        """Write one self-contained HTML file with the forecast, the trial and the settings."""
        from splitband.report.page.document import of_forecast  # noqa: PLC0415  of a higher layer

        of_forecast(self, path)


def forecast(
    record: Record,
    steps: int,
    methods: Sequence[Forecaster | str] | str | None = None,
    *,
    cores: int = 1,
    executor: Executor | None = None,
    watch: Watch | None = None,
    **options: Any,
) -> Forecast:
    """Forecast beyond the end of a record with the method that does best on its last quarter.

    Parameters
    ----------
    record : The training record, all of it. Its known inputs and its simulator's output must reach
        `steps` samples beyond it (`u_beyond`, `beyond`).
    steps : Number of samples to forecast.
    methods, cores, executor, watch : See `compare`.
    options : Further arguments of `plan`.

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
    planned = plan(record, len(record), methods, horizon=steps, **options)
    return run_forecast(planned, cores=cores, executor=executor, watch=watch)


def run_forecast(
    plan: Plan,
    *,
    cores: int = 1,
    executor: Executor | None = None,
    watch: Watch | None = None,
    clock: Clock | None = None,
) -> Forecast:
    """Forecast beyond the record of a plan that trains on all of it; see `run`."""
    with Runner(cores, executor) as runner:
        found = finished(plan, runner, watch, clock).comparison()
    best, u = found.recommended, found.record.u_beyond
    return Forecast(
        found.plan,  # with a network on the best baseline
        found.model,
        found.predictions[best],
        found.require_trial(),
        found.fits[best][0].description,
        found.leaves(best),
        found.model.require_fitted().inputs_beyond(None if u is None else u[: plan.horizon]),
        found.clock,
    )

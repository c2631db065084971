"""Forecasting with everything decided for the user who does not say otherwise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from importlib import import_module
from pathlib import Path

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
from splitband.evaluation.protocols import check, inputs_beyond
from splitband.evaluation.runs import Failure, Work, run_all
from splitband.evaluation.selection import LEVEL, Trial, check_trial
from splitband.evaluation.setup import Setup, default_setup
from splitband.forecasters.backtest import Backtest, Origin, Question
from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import Prediction, mean_of
from splitband.metrics import Extrapolation, leaves_range
from splitband.runtime.arguments import whole


@dataclass(frozen=True, eq=False)
class Forecast:
    """What comes after the end of a record.

    Attributes
    ----------
    record : It goes on from.
    forecaster : The recommended method, not fitted: to be fitted again, and saved.
    prediction : Its forecast, the mean over seeds, with the interval.
    trial : What was tried, and how it did.
    seeds : Of the recommended method.
    description : What its fit has settled on.
    leaves : Samples before the forecast leaves the range of the training samples by far.
    inputs_beyond_training : Which inputs to come go beyond those that were trained on.
    plan : See `Comparison`.
    """

    record: Record
    forecaster: Forecaster
    prediction: Prediction
    trial: Trial
    seeds: tuple[int, ...]
    description: str
    leaves: int | None
    inputs_beyond_training: list[Extrapolation]
    plan: Plan = field(default_factory=Plan)

    @property
    def method(self) -> str:
        """The name of the recommended method."""
        return self.forecaster.name

    def report(self, path: str | Path) -> None:
        """Write one HTML file with the forecast, what was tried and settings, to send on."""
        import_module("splitband.report.page").write(self, path)


def forecast(
    record: Record,
    steps: int,
    methods: Sequence[Forecaster | str] | None = None,
    *,
    others: Sequence[Record] = (),
    seeds: int | None = None,
    setup: Setup | None = None,
    work: Work | None = None,
) -> Forecast:
    """What comes after the end of a record, by the method that its own last quarter recommends.

    Parameters
    ----------
    record : All of it is trained on. Its known inputs, and its simulator's output, must reach
        `steps` samples beyond it (`u_beyond`, `beyond`).
    steps : How many samples.
    methods, others, seeds, setup, work : See `compare`.

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
    _check_ahead(record, steps)
    methods = [methods] if isinstance(methods, str) else methods
    if setup is None:
        setup = default_setup(record, len(record), methods=methods)
    elif setup.train != len(record):
        raise ValueError(
            f"train of setup must be all {len(record)} samples of the record, got {setup.train}"
        )
    work = work or Work()
    chosen, setup = candidates(record, setup, methods)
    check(record, chosen, setup, others, beyond=True)
    check_trial(record, chosen, setup, others)
    with timed(work, setup).staffed() as staff:
        trial, searched = choose(record, chosen, steps, setup, seeds, staff, others)
        # Training is slow: of the networks, only the best one is trained on all of the record.
        fitted = [m for m in searched.forecasters if m.name in trial.errors]
        fitted = [m for m in fitted if not m.random or m.name == trial.best_network]
        origin = Origin(len(record), len(record))
        question = Question(record, [origin], len(record) + steps, others)
        stages = last_stages(staff, steps, len(record), steps)
        networks = [m for m in fitted if m.random]
        all_seeds = last_trainings(networks, searched, trial, seeds, stages[1])
        backtests: dict[str, dict[int, Backtest]] = {}
        failures: list[Failure] = []
        with staff.plan.phase("final trainings"):
            quick = [m for m in fitted if not m.random]
            for part, stage in zip((quick, networks), stages, strict=True):
                asked = {method.name: question for method in part}
                need_one = part == fitted or (part == networks and not any(backtests.values()))
                found, lost = run_all(part, asked, all_seeds, stage, need_one and bool(part))
                backtests |= found
                failures += lost
    backtests = {method.name: backtests[method.name] for method in fitted}
    means = {
        name: mean_of([backtest.predictions[origin] for backtest in of_method.values()])
        for name, of_method in backtests.items()
        if of_method
    }
    failed = {f.method: f.reason for f in failures[::-1] if f.method not in means}
    failed = staff.plan.left_out | failed
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
        record,
        as_trained(next(f for f in fitted if f.name == best), [*done]),
        replace(mean, lower=mean.y - half, upper=mean.y + half, level=LEVEL),
        trial,
        tuple(done),
        next(iter(done.values())).description,
        min((samples for samples in left if samples is not None), default=None),
        inputs_beyond([record, *others], None if u is None else u[:steps]),
        staff.plan,
    )


def _check_ahead(record: Record, steps: int) -> None:
    whole("steps", steps)
    for what, known, ahead in (
        ("known inputs", record.u, record.u_beyond),
        ("the simulator", record.y_sim, record.beyond),
    ):
        reach = 0 if ahead is None else len(ahead)
        if known is not None and reach < steps:
            raise ValueError(f"{what} must reach {steps} samples beyond the record, got {reach}")

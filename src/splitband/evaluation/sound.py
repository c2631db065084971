"""Which seeds count: a training that has failed does not move the mean that is handed out."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from splitband.data import Record
from splitband.evaluation.protocols import Run, Runs
from splitband.forecasters.fitted import FitReport
from splitband.metrics import rmse, spread

FAILED = 2.0
"""A seed whose error is above this multiple of the lowest seed's has failed."""


def without_failed(runs: Runs, training: Record) -> Runs:
    """Return the runs and the models of the seeds that count."""
    kept = {}
    models = dict(runs.models)
    for name, of_method in runs.items():
        fitted = {m.require_fitted().report.seed: m for m in models.get(name, ())}
        unstable = {seed for seed, model in fitted.items() if not model.stable}
        bounded = _without(of_method, unstable, "it is unstable, and may grow without bound")
        kept[name] = sound_runs(bounded, training)
        seeds = {run.seed for run in kept[name]}
        models[name] = [model for seed, model in fitted.items() if seed in seeds]
    return Runs(kept, runs.failures, models)


def sound_runs(runs: Sequence[Run], training: Record) -> list[Run]:
    """Return the runs of a method without the seeds that failed on the training record.

    What counts is the last training loss, of windows, and the error of a free run from the first
    samples to the end of the training record, which shows a model that grows without bound. The
    description of the first run says which seeds have been left out.
    """
    errors = [(training_loss(run.fit), _from_start(run, training)) for run in runs]
    lowest = [min(of_kind) for of_kind in zip(*errors, strict=True)]
    worst = [max(e / least if least else 1.0 for e, least in zip(each, lowest, strict=True))
             for each in errors]  # fmt: skip
    failed = {run.seed for run, ratio in zip(runs, worst, strict=True) if ratio > FAILED}
    return _without(runs, failed, f"training error up to {max(worst):.3g} times the lowest")


def _without(runs: Sequence[Run], failed: Collection[int], why: str) -> list[Run]:
    """Return the other runs, the first of which says what was left out; all, if none is left."""
    kept = [run for run in runs if run.seed not in failed]
    if not kept or len(kept) == len(runs):
        return [*runs]
    seeds = [str(run.seed) for run in runs if run.seed in failed]
    said = f"seed{'s' * (len(seeds) > 1)} {', '.join(seeds)} left out: {why}"
    first = replace(kept[0], description="; ".join(filter(None, [kept[0].description, said])))
    return [first, *kept[1:]]


def training_loss(report: FitReport) -> float:
    """Return the last training loss of all networks of a forecaster together; 0 without any."""
    return sum(losses[-1] ** 2 for losses in report.losses.values() if len(losses)) ** 0.5


def _from_start(run: Run, training: Record) -> float:
    """Return the RMSE of the simulation of the training record, channels scaled; 0 if empty."""
    begin = len(training) - len(run.from_start.y)
    begin = max(begin, 0) if run.forecast is None else max(begin + len(run.forecast.y), 0)
    y = run.from_start.y[: len(training) - begin]
    scale = spread(training.seen)
    return rmse(training.seen[begin : begin + len(y)] / scale, y / scale) if len(y) else 0.0

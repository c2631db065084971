"""Which seeds count: a training that has failed does not move the mean that is handed out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from splitband.evaluation.protocols import Run, Runs
from splitband.forecasters.fitted import FitReport

FAILED = 2.0
"""A seed whose error is above this multiple of the lowest seed's has failed."""


def without_failed(runs: Runs) -> Runs:
    """Return the runs and the models of the seeds that count."""
    kept = {name: sound_runs(each) for name, each in runs.items()}
    models = {}
    for name, of_method in runs.models.items():
        seeds = {run.seed for run in kept[name]}
        models[name] = [m for m in of_method if m.require_fitted().report.seed in seeds]
    return Runs(kept, runs.failures, models)


def sound_runs(runs: Sequence[Run]) -> list[Run]:
    """Return the runs of a method without the seeds whose training error is far from the lowest.

    The description of the first run says which have been left out.
    """
    losses = {run.seed: training_error(run.fit) for run in runs}
    lowest = min(losses.values(), default=0.0)
    kept = [run for run in runs if losses[run.seed] <= FAILED * lowest]
    failed = [seed for seed, loss in losses.items() if loss > FAILED * lowest]
    if not failed or not kept:
        return [*runs]
    seeds = f"seed{'s' if len(failed) > 1 else ''} {', '.join(map(str, failed))}"
    worst = max(losses[seed] for seed in failed) / lowest
    said = f"{seeds} left out: training error up to {worst:.1f} times the lowest"
    first = replace(kept[0], description="; ".join(filter(None, [kept[0].description, said])))
    return [first, *kept[1:]]


def training_error(report: FitReport) -> float:
    """Return the last training loss of all networks of a forecaster together; 0 without any."""
    return sum(losses[-1] ** 2 for losses in report.losses.values() if len(losses)) ** 0.5

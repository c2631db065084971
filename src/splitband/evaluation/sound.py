"""Which seeds count: a training that has failed does not move the mean that is handed out.

That is told by the training record alone, and in the same way for the seeds of a trial, so that
what is held out is no luckier than what is handed out.
"""

from __future__ import annotations

from collections.abc import Mapping

from splitband.forecasters.fitted import FitReport

FAILED = 2.0
"""A seed whose error is above this multiple of the lowest seed's has failed."""


def failed_seeds(
    reports: Mapping[int, FitReport], errors: Mapping[int, float] | None = None
) -> dict[int, str]:
    """Return the seeds of a method that failed in training, and why; never all of them.

    Parameters
    ----------
    reports : Of their fits, by seed.
    errors : Of their simulations of the training record; by default their last training losses,
        which can be compared where all are trained alike.
    """
    stable = [seed for seed, report in reports.items() if report.stable]
    failed = dict.fromkeys(reports.keys() - stable, "it is unstable, and may grow without bound")
    if not stable:
        failed, stable = {}, [*reports]
    if errors is None:
        errors = {seed: training_loss(report) for seed, report in reports.items()}
    least = min((errors[seed] for seed in stable), default=0.0)
    for seed in stable:
        if least and errors[seed] > FAILED * least:
            failed[seed] = f"training error {errors[seed] / least:.3g} times the lowest"
    return failed if len(failed) < len(reports) else {}


def training_loss(report: FitReport) -> float:
    """Return the last training loss of all networks of a forecaster together; 0 without any."""
    return sum(losses[-1] ** 2 for losses in report.losses.values() if len(losses)) ** 0.5

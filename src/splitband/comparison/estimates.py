"""Estimate how long the rest of a comparison takes, by what its parts have taken so far."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from splitband.comparison.backtest import Fit
from splitband.comparison.jobs import GRACE
from splitband.comparison.plan import Plan
from splitband.forecasters.held_out import MOST_ORIGINS
from splitband.runtime.deadlines import Deadline


def forecasting(plan: Plan, trials: Iterable[Sequence[Fit]]) -> float:
    """Return the seconds that the forecasts of a final training take, by those of the trial."""
    took = [
        fit.seconds - fit.report.seconds for fits in trials for fit in fits if fit.fitted.random
    ]
    if not took:
        return 0.0
    # There, three forecasts have together twice the length of the held-out part (1 + 2/3 + 1/3),
    # and three horizons.
    samples, tried = 2 * len(plan.record) + sum(map(len, plan.tests)), plan.train / 2
    tried += 3 * plan.horizon
    if plan.ahead is not None:
        tried = plan.ahead * MOST_ORIGINS
        samples += tried * (1 + len(plan.tests))
    # The least one, as the first forecasts of a process also load or compile what they need.
    return min(took) * samples / tried


def patience(until: Deadline, end: Deadline, forecast: float) -> Deadline:
    """Return when trainings `until` a deadline are ended that have not forecast yet.

    `forecast` is the seconds that this takes. Of the first trainings it is 0: not known, so that
    they are ended at the comparison's `end`.
    """
    least = until.earlier(-max(GRACE, 2 * forecast))
    return least if forecast else max(least, end)

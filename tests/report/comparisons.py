"""Comparisons of what needs no training, with what networks would add to them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pandas as pd

from splitband import Record, TrainingSettings
from splitband.comparison.backtest import Fit
from splitband.comparison.result import Comparison
from splitband.comparison.run import compare
from splitband.comparison.search import Attempt
from splitband.forecasters.bands import Bands
from splitband.forecasters.fitted import FitReport

DT, LENGTH, TRAIN, WARMUP = 0.1, 300, 200, 10
NASTY = "<script>alert(1)</script> $$x^2$$ & \"quoted\" 'single'"
"""A name that would be a script, a formula that would be loaded, and the end of an attribute."""


def record(length: int = LENGTH, ny: int = 1, nu: int = 0, **others: Any) -> Record:
    rng = np.random.default_rng(0)
    t = DT * np.arange(length)[:, None]
    y = np.sin(2 * np.pi * 0.2 * t + np.arange(ny)) + 0.1 * rng.standard_normal((length, ny))
    u = np.cos(t + np.arange(nu)) if nu else None
    return Record(y, DT, u=u, **{"name": "rig", **others})


def compared(
    r: Record,
    methods: Sequence[str] = ("mean", "persistence", "seasonal-naive"),
    train: int = TRAIN,
    tests: Sequence[Record] = (),
) -> Comparison:
    """Compared for real; of other methods than these the colours would be others."""
    found = compare(
        r,
        train,
        [*methods],
        settings=TrainingSettings.paper(30, WARMUP, 1),
        bands=Bands(0.5, 1, 2),
        tests=tests,
    )
    return replace(found, attempts=(Attempt(1, "gru", "8 hidden units", 0, 0.25),))


def with_report(fit: Fit, report: FitReport, **changes: Any) -> Fit:
    """A fit with other predictions, and another report of its training."""
    model = fit.fitted.clone()
    vars(model).update(vars(fit.fitted))
    model.fitted = replace(fit.fitted.require_fitted(), report=report)
    return replace(fit, seed=report.seed, model=model, **changes)


def as_if_trained(found: Comparison, method: str = "persistence") -> Comparison:
    """With training losses of two seeds, and two parts, as a model of two bands has them."""
    (fit,) = found.fits[method]
    y, first = fit.from_start.y, next(iter(fit.forecasts))
    parts = replace(fit.from_start, components={"low band": 0.75 * y, "high band": 0.25 * y})
    losses = {"low band": [1.0, 0.4, 0.2], "high band": [1.0, 0.9]}
    reports = [FitReport(seed, 1.0, losses, ("high band: a note",)) for seed in (0, 1)]
    said = {**fit.forecasts, first: parts}
    fits = [with_report(fit, report, forecasts=said) for report in reports]
    return replace(found, fits={**found.fits, method: fits})


@cache
def everything() -> Comparison:
    """Two channels, an input, a simulator, gaps, dates, a test record and names that are traps."""
    plain = record(ny=2, nu=1)
    y = plain.y.copy()
    y[50:60, 0] = np.nan
    r = Record.with_gaps(y, DT, plain.u, y_sim=0.9 * plain.y, name=NASTY, inputs=("force",))
    start, columns = pd.Timestamp("2024-03-01 08:00"), ("angle (rad)", NASTY)
    r = replace(r, start=start, columns=columns)
    test = replace(plain, name="later", columns=r.columns, inputs=r.inputs)
    methods = "mean", "persistence", "seasonal-naive", "simulator"
    return as_if_trained(compared(r, methods, tests=[test]))


def of_all() -> Comparison:
    """Trained on the whole of a record without time stamps whose samples are counted."""
    r = replace(record(), sampling_time=1.0)
    settings, bands = TrainingSettings.paper(30, WARMUP, 1), Bands(0.05, 1, 2)
    return compare(r, len(r), ["mean", "persistence"], settings=settings, bands=bands)

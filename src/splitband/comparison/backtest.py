"""Forecast known samples from several origins.

All protocols of a comparison and the trial on held-out training samples use these forecasts.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.held_out import (
    Origin,
    after,
    first_held_out,
    forecasts,
    held_out_errors,
    many_origins,
    refitted,
    root_mean_square,
)
from splitband.forecasters.prediction import Prediction
from splitband.forecasters.simulation import simulations
from splitband.metrics import ExtrapolationWarning, spread
from splitband.records import Record
from splitband.records.signals import first_after
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import now
from splitband.runtime.errors import InputError
from splitband.runtime.threads import without_warnings
from splitband.training import Progress

WORTH_TRAINING = 0.1
"""Share of its score by which a network must beat a baseline. By eye."""


@dataclass(frozen=True, eq=False)
class BacktestSpec:
    """Specify forecasts of a record.

    Attributes
    ----------
    record : The measured record. No prediction sees a measured sample after its origin.
    origins : Of the forecasts, the most important first. The forecaster is fitted once for each
        number of samples `fitted`; origins with the same number must be adjacent.
    others : Further training records.
    tests : Other records, each simulated to its end from its first samples, by the model that was
        fitted to the most samples.
    warmup : Length of the history at the beginning of a test record, for a forecaster without a
        warm-up (`Forecaster.warmup` is 0).
    initial : Length of that history for all forecasters: overrides every warm-up on test records.
    ahead : Test records are also forecast so many samples ahead from many origins; None: they
        are not.
    components : Whether forecasts keep their components; scores need none.
    """

    record: Record
    origins: Sequence[Origin]
    others: Sequence[Record] = ()
    tests: Sequence[Record] = ()
    warmup: int = 1
    initial: int | None = None
    ahead: int | None = None
    components: bool = True

    def __post_init__(self) -> None:
        """Check that the origins are inside the record."""
        for origin in self.origins:
            if origin.fitted < 1 or not 0 < origin.at <= len(self.record):
                raise InputError(
                    f"origins must have fitted > 0 and 0 < at <= {len(self.record)}, the record's "
                    f"samples, got {origin}"
                )


@dataclass(frozen=True, eq=False)
class Fit:
    """Hold what one fit of a method gave: the fitted model, and its predictions.

    Attributes
    ----------
    method : The forecaster's name.
    seed : Of the fit.
    model : The forecaster that was fitted to the most samples; None where the fit failed.
    forecasts : By origin, in the order of the spec's.
    tests : Simulations of the test records, to their ends; empty where one of them is impossible.
    tests_ahead : Forecasts of each test record from many origins; empty where there are no `tests`.
    seconds : Of the whole job, forecasts included.
    began : When the job began, by the clock of `runtime.deadlines.now`; infinite where it did not.
    notes : What the fit has chosen and what went wrong, in words.
    failure : Why there is no model, in words; empty where there is one.
    cut : Whether a deadline ended the job early; without a model: whether that is the reason.
    """

    method: str
    seed: int = 0
    model: Forecaster | None = None
    forecasts: Mapping[Origin, Prediction] = field(default_factory=dict)
    tests: Sequence[Prediction] = ()
    tests_ahead: Sequence[Mapping[Origin, Prediction]] = ()
    seconds: float = 0.0
    began: float = math.inf
    notes: tuple[str, ...] = ()
    failure: str = ""
    cut: bool = False

    @property
    def fitted(self) -> Forecaster:
        """Return the model; raises ValueError where the fit failed."""
        if self.model is None:
            raise InputError(f"{self.method}: {self.failure}")
        return self.model

    @property
    def report(self) -> FitReport:
        """Return the report of the fit."""
        return self.fitted.require_fitted().report

    @property
    def description(self) -> str:
        """Return what the fit has chosen, and what went wrong, in words."""
        return "; ".join(filter(None, [self.fitted.describe(), *self.notes]))

    @property
    def from_start(self) -> Prediction:
        """Return the forecast of the first origin: in a comparison, from the start."""
        return next(iter(self.forecasts.values()))

    @property
    def forecast(self) -> Prediction | None:
        """Return the forecast that begins where the training part ends; None without one."""
        first = next(iter(self.forecasts))
        return self.forecasts.get(Origin(first.fitted, first.fitted))

    @property
    def ahead(self) -> Array:
        """Return the values of that forecast, `(time, ny)`; empty without one."""
        return self.from_start.y[:0] if self.forecast is None else self.forecast.y


def backtest(
    forecaster: Forecaster,
    spec: BacktestSpec,
    seed: int = 0,
    start: Forecaster | None = None,
    progress: Callable[[Progress], None] | None = None,
    bases: Sequence[Forecaster] = (),
) -> Fit:
    """Forecast a record from several origins, with copies of a forecaster.

    The copies are fitted in the order of the origins. If the deadline of the job comes before the
    last fit, the result holds the forecasts so far; DeadlineError is raised where there are none.

    `seed`, `start` and `progress` are those of `Forecaster.fit`; `bases` are fitted forecasters, of
    which it, or a part of it, may be one for some of the origins.
    """
    began, found = now(), Fit(forecaster.name, seed)
    how: dict[str, Any] = {"seed": seed, "start": start, "progress": progress, "bases": bases}
    for model, origins in refitted(forecaster, spec.record, spec.origins, spec.others, **how):
        found = _with_forecasts(found, model, spec, origins)
    if found.model is None:
        raise InputError("origins must be one or several, got none")
    cut = found.report.cut or len(found.forecasts) < len(spec.origins)
    return _finished(replace(found, cut=cut), spec, began)


def as_it_is(model: Forecaster, spec: BacktestSpec, seed: int) -> Fit:
    """Forecast a record with a model that was fitted to fewer samples, without another fit."""
    began = now()
    found = _with_forecasts(Fit(model.name, seed), model, spec, spec.origins)
    return _finished(found, spec, began, "trained on three quarters of the training samples")


def _with_forecasts(
    found: Fit, model: Forecaster, spec: BacktestSpec, origins: Sequence[Origin]
) -> Fit:
    """Return a fit with a model's forecasts from more origins; the model of most samples stays."""
    made = forecasts(model, spec.record, origins)
    if not spec.components:
        made = {origin: replace(said, components={}) for origin, said in made.items()}
    if found.model is not None and _samples(found.model) >= _samples(model):
        model = found.model
    return replace(found, model=model, forecasts={**found.forecasts, **made})


def _samples(model: Forecaster) -> int:
    return len(model.require_fitted().record)


def _finished(found: Fit, spec: BacktestSpec, began: float, *notes: str) -> Fit:
    """Return a fit with simulations of the test records from their first samples.

    There are none for a model that cannot simulate them; a note says what went wrong with one.
    """
    model, tests = found.fitted, list[Prediction]()
    from_many = list[Mapping[Origin, Prediction]]()
    simulated = "simulator" not in model.needs or all(t.y_sim is not None for t in spec.tests)
    # Recorded output without dates is of the training record: other records begin at 0 s, too.
    simulated &= not any(
        part.simulator is not None
        and part.simulator.own_times
        and not isinstance(part.simulator.start, pd.Timestamp)
        for part in simulations(model)
    )
    for test in spec.tests if simulated and not model.anchored else ():
        try:
            at = first_origin(test, 0, spec.initial or model.warmup or spec.warmup).at
            with without_warnings(ExtrapolationWarning):
                tests.append(model.predict(**after(test, at), other_record=True))
            if spec.ahead is not None:
                many = many_origins(0, at, len(test), spec.ahead)
                from_many.append(forecasts(model, test, many, other_record=True))
        except ValueError as error:
            tests, from_many, notes = (
                [],
                [],
                (f"not tested on {test.name or 'a test record'}: {error}", *notes),
            )
            break
    done: dict[str, Any] = {"tests": tests, "tests_ahead": from_many, "seconds": now() - began}
    return replace(found, notes=notes, **done)


def first_origin(record: Record, train: int, warmup: int) -> Origin:
    """Return the first origin with `warmup` measured samples right before it (as in the paper).

    The history has at least 2 samples, as every record.
    """
    start = first_after(record.y_with_gaps, max(warmup, 2))
    if start is None:
        raise InputError(f"warmup must fit between the gaps of the record, got {warmup} samples")
    return Origin(train, start)


def median_forecasts(fits: Sequence[Fit]) -> dict[Origin, Array]:
    """Return the median forecast over several fits of a method, by origin."""
    first, *others = fits
    return {
        origin: np.median([p.y, *(fit.forecasts[origin].y for fit in others)], axis=0)
        if others
        else p.y
        for origin, p in first.forecasts.items()
    }


def held_out_score(record: Record, fits: Sequence[Fit]) -> float:
    """Return the RMSE of the fits' median forecast of a record's last quarter, channels scaled."""
    held_out = record.y_with_gaps[first_held_out(len(record)) :]
    for column, channel in zip(record.columns, held_out.T, strict=True):
        if np.isnan(channel).all():
            raise InputError(
                f"{column} must have a measured sample among the last {len(channel)} training "
                "samples, on which methods are tried out"
            )
    errors, scale = held_out_errors(record, median_forecasts(fits)), spread(record.y_with_gaps)
    return root_mean_square([error / scale for error in errors])

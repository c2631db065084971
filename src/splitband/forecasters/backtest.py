"""Forecast known samples from several origins.

All protocols of a comparison, the trial on held-out training samples, and the calibration of
intervals use these forecasts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby

import numpy as np

from splitband.data import Record
from splitband.data.signals import first_after
from splitband.forecasters.base import (
    AnyForecaster,
    Forecaster,
    fitted_like,
    with_parts_changed,
)
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.intervals import HeldOut
from splitband.forecasters.network import Network
from splitband.forecasters.prediction import Prediction
from splitband.metrics import ExtrapolationWarning, rmse, spread
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import Deadline, DeadlineError, current, now, within
from splitband.runtime.errors import InputError
from splitband.runtime.threads import without_warnings
from splitband.training import Progress
from splitband.training.settings import SHORTEST_WINDOW, longest_window

HELD_OUT_SHARE = 0.25
"""Share of the training part that is held out for a trial, while models are fitted to the rest. A
convention; longer parts chose no better (docs/results/rules.md)."""
HELD_OUT_SHARES = (0.5, 0.375, 0.25, 0.2, 0.15, 0.1)
"""Shares of a record that methods which are quickly fitted forecast from the samples before them,
one for each origin: a long share shows how errors grow, a short one is forecast by nearly the final
fit. By eye."""
FEWEST_FITTED = 20
"""An earlier origin, for the intervals, needs this many measured samples of each channel before it.
By eye."""
FAILED_FIT_RATIO = 5.0
"""A fit to few samples has failed if the error of its first forecast samples is above this multiple
of the method's error over as many first samples of the forecasts that are scored. By eye."""


@dataclass(frozen=True, order=True)
class Origin:
    """Define where a forecast begins.

    Attributes
    ----------
    fitted : Number of samples at the beginning of the record to which the forecaster is fitted.
    at : Index of the first forecast sample; the warm-up is before it.
    """

    fitted: int
    at: int


@dataclass(frozen=True, eq=False)
class BacktestSpec:
    """Specify forecasts of a record.

    Attributes
    ----------
    record : The measured record. No prediction sees a measured sample after its origin.
    origins : Of the forecasts, the most important first. The forecaster is fitted once for each
        number of samples `fitted`; origins with the same number must be adjacent.
    end : End of the forecasts, exclusive. It may lie beyond the record, as far as its inputs and
        its simulator's output are known (`u_beyond`, `beyond`).
    others : Further training records.
    tests : Other records, each simulated to its end from its first samples, by the model that was
        fitted to the most samples.
    warmup : Length of the history at the beginning of a test record, for a forecaster without a
        warm-up (`Forecaster.warmup` is 0).
    initial : Length of that history for all forecasters: overrides every warm-up on test records.
    components : Whether forecasts keep their components; scores need none.
    """

    record: Record
    origins: Sequence[Origin]
    end: int
    others: Sequence[Record] = ()
    tests: Sequence[Record] = ()
    warmup: int = 1
    initial: int | None = None
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
    forecasts : By origin, in the order of the spec's, all up to the same last sample.
    tests : Simulations of the test records, to their ends; empty where one of them is impossible.
    unfiltered : Signals before a model's filters, for the forecast that begins inside the training
        part; empty for a model without filters, and without such a forecast.
    seconds : Of the whole job, forecasts included.
    notes : What the fit has chosen and what went wrong, in words.
    failure : Why there is no model, in words; empty where there is one.
    cut : Whether a deadline ended the job early.
    """

    method: str
    seed: int = 0
    model: Forecaster | None = None
    forecasts: Mapping[Origin, Prediction] = field(default_factory=dict)
    tests: Sequence[Prediction] = ()
    unfiltered: Mapping[str, Array] = field(default_factory=dict)
    seconds: float = 0.0
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
    left = len({origin.fitted for origin in spec.origins})
    for samples, of_fit in groupby(spec.origins, key=lambda origin: origin.fitted):
        try:
            with within(Deadline.after(current().left / left)):  # each fit has its share
                records = [spec.record[:samples], *spec.others]
                fitted = fitted_like(forecaster, records, bases)
                if fitted is None:
                    fitted = forecaster.clone()._fit(records, seed, start, progress, bases)
        except DeadlineError:
            if found.model is None:
                raise
            found = replace(found, cut=True)
            break
        found, left = _with_forecasts(found, fitted, spec, [*of_fit]), left - 1
        if current().over and len(found.forecasts) < len(spec.origins):
            found = replace(found, cut=True)
            break
    if found.model is None:
        raise InputError("origins must be one or several, got none")
    return _finished(replace(found, cut=found.cut or found.report.cut), spec, began)


def as_it_is(model: Forecaster, spec: BacktestSpec, seed: int) -> Fit:
    """Forecast a record with a model that was fitted to fewer samples, without another fit."""
    began = now()
    found = _with_forecasts(Fit(model.name, seed), model, spec, spec.origins)
    return _finished(found, spec, began, "trained on three quarters of the training samples")


def _with_forecasts(
    found: Fit, model: Forecaster, spec: BacktestSpec, origins: Sequence[Origin]
) -> Fit:
    """Return a fit with a model's forecasts from more origins; the model of most samples stays."""
    forecasts, unfiltered = {**found.forecasts}, found.unfiltered
    for origin in origins:
        history = spec.record[: origin.at]
        with without_warnings(ExtrapolationWarning):  # the prediction holds them
            forecasts[origin] = model.predict(spec.end - origin.at, history)
        if not spec.components:
            forecasts[origin] = replace(forecasts[origin], components={})
        if origin.at < origin.fitted and isinstance(model, Network):
            unfiltered = model._unfiltered(spec.end - origin.at, history)
    if found.model is not None and _samples(found.model) >= _samples(model):
        model = found.model
    return replace(found, model=model, forecasts=forecasts, unfiltered=unfiltered)


def _samples(model: Forecaster) -> int:
    return len(model.require_fitted().record)


def _finished(found: Fit, spec: BacktestSpec, began: float, *notes: str) -> Fit:
    """Return a fit with simulations of the test records from their first samples.

    There are none for a model that cannot simulate them; a note says what went wrong with one.
    """
    model, tests = found.fitted, list[Prediction]()
    simulated = "simulator" not in model.needs or all(t.y_sim is not None for t in spec.tests)
    for test in spec.tests if simulated and not model.anchored else ():
        try:
            at = first_origin(test, 0, spec.initial or model.warmup or spec.warmup).at
            with without_warnings(ExtrapolationWarning):
                tests.append(model.predict(len(test) - at, test[:at], other_record=True))
        except ValueError as error:
            tests, notes = [], (f"not tested on {test.name or 'a test record'}: {error}", *notes)
            break
    return replace(found, tests=tests, notes=notes, seconds=now() - began)


def first_origin(record: Record, train: int, warmup: int) -> Origin:
    """Return the first origin with `warmup` measured samples right before it (as in the paper).

    The history has at least 2 samples, as every record.
    """
    start = first_after(record.complete, max(warmup, 2))
    if start is None:
        raise InputError(f"warmup must fit between the gaps of the record, got {warmup} samples")
    return Origin(train, start)


def first_held_out(samples: int) -> int:
    """Return the first sample of the held-out part, the last quarter of `samples`."""
    return samples - max(1, round(HELD_OUT_SHARE * samples))


def for_trial(forecaster: AnyForecaster, samples: int) -> AnyForecaster:
    """Return the forecaster adapted to `samples` without their held-out part.

    Long windows shrink with the part that is left, but stay as long as the default recipe's
    shortest one, and beyond the warm-up.
    """
    fewer = first_held_out(samples)

    def changed(part: Forecaster) -> Forecaster:
        settings = part.settings
        if settings is None or not isinstance(part, Network):
            return part
        least = max(min(SHORTEST_WINDOW, longest_window(fewer)), settings.warmup + 1)
        shorter = max(round(settings.window * fewer / samples), least)
        return part._trained_as(replace(settings, window=min(settings.window, shorter)))

    return with_parts_changed(forecaster, changed)


def held_out_origins(forecaster: Forecaster, record: Record) -> list[Origin]:
    """Return the origins of forecasts of a record's last quarter.

    A network is trained once, and forecasts from the beginning of that quarter, from a third and
    from two thirds of it, as a method may be lucky from a single origin: persistence is, for
    instance, if the last sample happens to equal the mean. A linear model is fitted once more, to
    the first half, which shows how errors grow. A method that is quicker to fit is refitted for
    each of several origins, some of them earlier.
    """
    samples = len(record)
    held_out = [max(1, round(share * samples)) for share in HELD_OUT_SHARES]
    fitted, ends = first_held_out(samples), dict.fromkeys(max(samples - n, 1) for n in held_out)
    measured = np.cumsum(~np.isnan(record.y_with_gaps), axis=0)
    early = [end for end in ends if end < fitted and (measured[end - 1] >= FEWEST_FITTED).all()]
    if not forecaster._refits:
        held = samples - fitted
        once = sorted({Origin(fitted, fitted + i * held // 3) for i in range(3)})
        quick = not forecaster.random and not forecaster._fits_simulator
        return [*once, *(Origin(end, end) for end in early[:1] if quick)]
    return [Origin(end, end) for end in (*(end for end in ends if end >= fitted), *early)]


def held_out_errors(
    record: Record, forecasts: Mapping[Origin, Array], earlier: bool = False
) -> list[Array]:
    """Return the errors of forecasts that begin in a record's last quarter, or `earlier`.

    They are in the order of origins, `(time, ny)` each, by horizon.
    """
    seen, first = record.y_with_gaps, first_held_out(len(record))
    return [
        seen[origin.at :] - y[: len(record) - origin.at]
        for origin, y in sorted(forecasts.items(), key=lambda pair: pair[0].at)
        if (origin.at < first) == earlier
    ]


def interval_errors(record: Record, forecasts: Mapping[Origin, Array]) -> HeldOut:
    """Return the held-out errors of a record, from which intervals beyond it follow."""
    scored = held_out_errors(record, forecasts)
    near, scale = min(map(len, scored)), spread(record.y_with_gaps)

    def first_samples(errors: Sequence[Array]) -> float:
        return root_mean_square([error[:near] / scale for error in errors])

    kept, most = [*scored], FAILED_FIT_RATIO * first_samples(scored)
    for error in held_out_errors(record, forecasts, earlier=True)[::-1]:
        # A fit to too few samples, such as less than a period, is wrong from its first forecast
        # samples on, and one to even fewer is no better.
        if not first_samples([error]) <= most:
            break
        kept.append(error)
    return HeldOut.of(kept, record.y_with_gaps)


def held_out_of(forecaster: Forecaster) -> HeldOut:
    """Return the held-out errors of a fitted forecaster, by copies fitted to less of its record.

    They are kept with it. Raises ValueError for a loaded forecaster without them, which does not
    have all of its training records.
    """
    if forecaster.held_out is not None:
        return forecaster.held_out
    fitted = forecaster.require_fitted()
    record = fitted.record
    if fitted.begin or not fitted.whole:
        raise InputError(
            "level must be left out for a model that was saved without held-out errors: request an "
            "interval before it is saved, or fit it with --intervals"
        )
    shorter = for_trial(forecaster, len(record))
    origins = held_out_origins(forecaster, record)
    spec = BacktestSpec(record, origins, len(record), fitted.others)
    done = backtest(shorter, spec, fitted.report.seed)
    forecaster.held_out = interval_errors(record, {at: p.y for at, p in done.forecasts.items()})
    return forecaster.held_out


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


def root_mean_square(errors: Sequence[Array]) -> float:
    """Return the RMS of the errors `(time, ny)` of several forecasts together, ignoring NaN."""
    every = np.concatenate(errors)
    return rmse(every, np.zeros_like(every))

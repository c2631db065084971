"""Forecast known samples from several origins.

All protocols of a comparison, the trial on held-out training samples, and the calibration of
intervals use these forecasts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import TYPE_CHECKING, TypeVar

import numpy as np

from splitband.baselines.origins import origins
from splitband.data import Record
from splitband.data.gaps import first_after
from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.intervals import HeldOut
from splitband.forecasters.prediction import Prediction
from splitband.metrics import ExtrapolationWarning, rmse, spread
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import DeadlineError, current
from splitband.runtime.threads import without_warnings
from splitband.training import Checkpoint, Progress

if TYPE_CHECKING:
    from torch import Tensor

AnyForecaster = TypeVar("AnyForecaster", bound=Forecaster)

HELD_OUT_SHARE = 0.25
"""Share of the training part that is held out for a trial, while models are fitted to the rest. A
convention; longer parts chose no better (docs/results/rules.md)."""
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
class Question:
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
    keep : Whether to return the model that was fitted to the most samples.
    """

    record: Record
    origins: Sequence[Origin]
    end: int
    others: Sequence[Record] = ()
    tests: Sequence[Record] = ()
    warmup: int = 1
    keep: bool = False
    initial: int | None = None


@dataclass(frozen=True, eq=False)
class Backtest:
    """Hold the forecasts of one forecaster with one seed from several origins.

    Attributes
    ----------
    predictions : By origin, all up to the same last sample.
    tests : Simulations of the test records, to their ends; empty where one of them is impossible.
    report : Of the fit to the most samples.
    y_range : Lowest and highest training value of each channel, `(2, ny)`.
    description : Of the fitted forecaster.
    unfiltered : Signals before a model's filters, for the forecast that begins inside the training
        part; empty for a model without filters, and without such a forecast.
    weights : The state dict of a network's model.
    model : The model that was fitted to the most samples, if requested.
    """

    predictions: Mapping[Origin, Prediction]
    tests: Sequence[Prediction]
    report: FitReport
    y_range: Array
    description: str
    unfiltered: Mapping[str, Array] = field(default_factory=dict)
    weights: Mapping[str, Tensor] = field(default_factory=dict)
    model: Forecaster | None = None


def backtest(
    forecaster: Forecaster,
    question: Question,
    seed: int = 0,
    progress: Callable[[Progress], None] | None = None,
    checkpoint: Checkpoint | None = None,
) -> Backtest:
    """Forecast a record from several origins, with copies of a forecaster.

    The copies are fitted in the order of the origins. If the deadline of the job comes before the
    last fit, the result holds the forecasts so far.

    `seed`, `progress` and `checkpoint` are those of `Forecaster.fit`.
    """
    record, end, one = question.record, question.end, forecaster.for_seed(seed)
    predictions: dict[Origin, Prediction] = {}
    unfiltered: Mapping[str, Array] = {}
    cut = False
    last: Forecaster | None = None
    for samples, of_fit in groupby(question.origins, key=lambda origin: origin.fitted):
        try:
            fitted = one.clone().fit(
                record[:samples],
                *question.others,
                seed=seed,
                progress=progress,
                checkpoint=checkpoint,
            )
        except DeadlineError:
            if last is None:
                raise
            cut = True
            break
        for origin in of_fit:
            history = record[: origin.at]
            with without_warnings(ExtrapolationWarning):  # the prediction holds them
                predictions[origin] = fitted.predict(end - origin.at, history)
            if origin.at < samples:
                unfiltered = fitted.unfiltered(end - origin.at, history)
        if last is None or len(fitted.require_fitted().record) > len(last.require_fitted().record):
            last = fitted
        if current().over and len(predictions) < len(question.origins):
            cut = True
            break
    if last is None:
        raise ValueError("origins must be one or several, got none")
    fitted = last
    tests, untested = _tested(fitted, question)
    known, said = fitted.require_fitted(), [fitted.describe(), untested]
    description = "; ".join(filter(None, said))
    report = replace(known.report, cut=known.report.cut or cut)
    model = fitted if question.keep else None
    said_of = predictions, tests, report, known.y_range, description
    return Backtest(*said_of, unfiltered, fitted.state(), model)


def _tested(fitted: Forecaster, question: Question) -> tuple[list[Prediction], str]:
    """Return simulations of the test records from their first samples; or none, with the reason."""
    predictions: list[Prediction] = []
    simulated = "simulator" not in fitted.needs or all(t.y_sim is not None for t in question.tests)
    if fitted.anchored or not simulated:
        return predictions, ""
    for test in question.tests:
        try:
            at = first_origin(test, 0, question.initial or fitted.warmup or question.warmup).at
            with without_warnings(ExtrapolationWarning):
                history = test[:at]
                predictions.append(fitted.predict(len(test) - at, history, other_record=True))
        except ValueError as error:
            return [], f"not tested on {test.name or 'a test record'}: {error}"
    return predictions, ""


def first_origin(record: Record, train: int, warmup: int) -> Origin:
    """Return the first origin with `warmup` measured samples right before it (as in the paper).

    The history has at least 2 samples, as every record.
    """
    start = first_after(record.complete, max(warmup, 2))
    if start is None:
        raise ValueError(f"warmup must fit between the gaps of the record, got {warmup} samples")
    return Origin(train, start)


def first_held_out(samples: int) -> int:
    """Return the first sample of the held-out part, the last quarter of `samples`."""
    return samples - max(1, round(HELD_OUT_SHARE * samples))


def check_held_out(record: Record) -> None:
    """Raise ValueError for a channel without a measured sample in a record's last quarter."""
    held_out = record.seen[first_held_out(len(record)) :]
    for column, channel in zip(record.columns, held_out.T, strict=True):
        if np.isnan(channel).all():
            raise ValueError(
                f"{column} must have a measured sample among the last {len(channel)} training "
                "samples, on which methods are tried out"
            )


def for_trial(forecaster: AnyForecaster, samples: int) -> AnyForecaster:
    """Return the forecaster adapted to `samples` without their held-out part."""
    return forecaster.for_samples(first_held_out(samples), samples)


def held_out_origins(forecaster: Forecaster, record: Record) -> list[Origin]:
    """Return the origins of forecasts of a record's last quarter.

    A network is trained once, and forecasts from the beginning of that quarter, from a third and
    from two thirds of it, as a method may be lucky from a single origin: persistence is, for
    instance, if the last sample happens to equal the mean. A method that is quick to fit is
    refitted for each of several origins, some of them earlier.
    """
    samples = len(record)
    fitted = first_held_out(samples)
    if not forecaster.refits:
        held = samples - fitted
        return sorted({Origin(fitted, fitted + i * held // 3) for i in range(3)})
    measured = np.cumsum(~np.isnan(record.seen), axis=0)
    ends = dict.fromkeys(origins(samples))
    early = [end for end in ends if end < fitted and (measured[end - 1] >= FEWEST_FITTED).all()]
    return [Origin(end, end) for end in (*(end for end in ends if end >= fitted), *early)]


def held_out_errors(
    record: Record, forecasts: Mapping[Origin, Array], earlier: bool = False
) -> list[Array]:
    """Return the errors of forecasts that begin in a record's last quarter, for a score.

    They are in the order of origins, `(time, ny)` each, by horizon: row h is the error of the
    forecast sample h + 1. With `earlier`, return the errors of the forecasts that begin before that
    quarter instead.
    """
    seen, first = record.seen, first_held_out(len(record))
    return [
        seen[origin.at :] - y[: len(record) - origin.at]
        for origin, y in sorted(forecasts.items(), key=lambda pair: pair[0].at)
        if (origin.at < first) == earlier
    ]


def interval_errors(record: Record, forecasts: Mapping[Origin, Array]) -> HeldOut:
    """Return the held-out errors of a record, from which intervals beyond it follow."""
    scored = held_out_errors(record, forecasts)
    longer = held_out_errors(record, forecasts, earlier=True)[::-1]
    return HeldOut.of(_sound(scored, longer, spread(record.seen)), record.seen)


def interval_errors_of(forecaster: Forecaster) -> HeldOut:
    """Return the held-out errors of a fitted forecaster, by copies fitted to less of its record.

    Raises ValueError for a loaded forecaster, which does not have all of its training records.
    """
    fitted = forecaster.require_fitted()
    record = fitted.record
    if fitted.begin or not fitted.whole:
        raise ValueError(
            "level must be left out for a model that was saved without held-out errors: request an "
            "interval before it is saved, or fit it with --intervals"
        )
    shorter = for_trial(forecaster, len(record))
    origins = held_out_origins(forecaster, record)
    question = Question(record, origins, len(record), fitted.others)
    done = backtest(shorter, question, fitted.report.seed)
    return interval_errors(record, {at: p.y for at, p in done.predictions.items()})


def median_forecasts(done: Sequence[Backtest]) -> dict[Origin, Array]:
    """Return the median forecast over the seeds, by origin."""
    return {
        origin: np.median([backtest.predictions[origin].y for backtest in done], axis=0)
        for origin in done[0].predictions
    }


def root_mean_square(errors: Sequence[Array]) -> float:
    """Return the RMS of the errors `(time, ny)` of several forecasts together, ignoring NaN."""
    every = np.concatenate(errors)
    return rmse(every, np.zeros_like(every))


def _sound(scored: Sequence[Array], longer: Sequence[Array], scale: Array) -> list[Array]:
    """Return all errors, except those in `longer` from fits to too few samples.

    `longer` begins with the fit to the most samples. A fit to too few samples, such as less than a
    period, is wrong from its first forecast samples on, where errors that merely grow with the
    horizon are still small.
    """
    near = min(map(len, scored))
    usual = root_mean_square([e[:near] / scale for e in scored])
    # A fit to even fewer samples is no better: all are discarded from the first failed fit on.
    sound = [root_mean_square([e[:near] / scale]) <= FAILED_FIT_RATIO * usual for e in longer]
    return [*scored, *longer[: [*sound, False].index(False)]]

"""Ask a forecaster about samples that are known, from several origins.

Both protocols of a comparison, the trial on held-out training samples and the interval around a
forecast are made of these forecasts.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import groupby
from typing import TypeVar

import numpy as np
from torch import Tensor

from splitband.baselines.origins import origins
from splitband.data import Record
from splitband.data.gaps import first_after
from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.intervals import HeldOut
from splitband.forecasters.prediction import Prediction
from splitband.metrics import ExtrapolationWarning, rmse, spread
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import OverError, current
from splitband.runtime.threads import without_warnings
from splitband.training import Checkpoint, Progress

AnyForecaster = TypeVar("AnyForecaster", bound=Forecaster)

HELD_OUT = 0.25
"""Share of the training part that is forecast, for a trial, by what is fitted to the rest. A
convention; longer parts chose no better (docs/results/rules.md)."""
FEWEST_FITTED = 20
"""Measured samples of each channel that a baseline is fitted to for the intervals. By eye."""
FAILED_FIT_RATIO = 5.0
"""A fit has failed, and tells nothing about the errors of others, if the error of its first
forecast samples is above this multiple of the method's usual one. By eye."""


@dataclass(frozen=True, order=True)
class Origin:
    """Say where a forecast begins.

    Attributes
    ----------
    fitted : How many samples from the beginning of the record the forecaster is fitted to.
    at : The index of the first sample that is forecast; it warms up on those before.
    """

    fitted: int
    at: int


@dataclass(frozen=True, eq=False)
class Question:
    """Ask a forecaster for forecasts of a record.

    Attributes
    ----------
    record : What is known. No prediction sees a measured sample after its origin.
    origins : From where it is to be forecast, what matters most first. The forecaster is fitted to
        the beginning of the record, once for each number of samples among them; those that share
        one stand together.
    end : To which sample, exclusively. It may lie beyond the record, as far as its inputs and its
        simulator's output are known (`u_beyond`, `beyond`).
    others : Further training records.
    tests : Other records, each to be simulated to its end from its first samples, by what has been
        fitted to the most samples.
    warmup : Samples at the beginning of a test record that are the history of what has no warm-up
        of its own (`Forecaster.warmup` is 0).
    keep : Whether what has been fitted to the most samples is handed back with its forecasts.
    initial : Samples at the beginning of a test record that are known to all, in place of these.
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
    """Keep what one forecaster with one seed says from several origins.

    Attributes
    ----------
    predictions : From each origin on, up to the same last sample.
    tests : Of each test record, to its end; none where it has nothing to say about one of them.
    report : What the fit did; of several fits the one to the most samples.
    y_range : Lowest and highest value of each channel that it was fitted to, `(2, ny)`.
    description : What it has settled on.
    unfiltered : What a model's filters are fed with from the origin in the samples that it was
        fitted to; empty for a model without filters, and without such an origin.
    weights : Of a network, the state of its model.
    model : What has been fitted to the most samples, where it was asked for.
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
    """Forecast a record from several origins on, with copies of a forecaster.

    It is fitted for one origin after the other, in their order. Where the deadline of the job comes
    before the last fit, what has been forecast so far is the result.

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
        except OverError:
            if last is None:
                raise
            cut = True
            break
        for origin in of_fit:
            history = record[: origin.at]
            with without_warnings(ExtrapolationWarning):  # they are kept with the prediction
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
    """Return each test record, simulated to its end from its first samples; or none, and why."""
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
    """Return the first sample with `warmup` measured ones right before it (the paper's protocol).

    There are two at least, as a history is a record, which has no fewer.
    """
    start = first_after(record.complete, max(warmup, 2))
    if start is None:
        raise ValueError(f"warmup must fit between the gaps of the record, got {warmup} samples")
    return Origin(train, start)


def held_out_from(samples: int) -> int:
    """Return the first sample of the last quarter of so many, which is held out."""
    return samples - max(1, round(HELD_OUT * samples))


def check_held_out(record: Record) -> None:
    """Check that something was measured in each channel of a record's last quarter."""
    held_out = record.seen[held_out_from(len(record)) :]
    for column, channel in zip(record.columns, held_out.T, strict=True):
        if np.isnan(channel).all():
            raise ValueError(
                f"{column} must have a measured sample among the last {len(channel)} training "
                "samples, on which methods are tried out"
            )


def for_trial(forecaster: AnyForecaster, samples: int) -> AnyForecaster:
    """Return the forecaster as it is fitted to all but the held-out part of so many samples."""
    return forecaster.for_samples(held_out_from(samples), samples)


def held_out_origins(forecaster: Forecaster, record: Record) -> list[Origin]:
    """Return from where forecasts of a record's own last quarter are tried.

    A network is trained once, and forecasts from the beginning of that quarter, from a third and
    from two thirds of it, as a method may be lucky from a single origin: persistence is, for
    instance, where the last sample happens to equal the mean. What is fitted quickly is fitted
    again for each of several origins, some of them earlier.
    """
    samples = len(record)
    fitted = held_out_from(samples)
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
    """Return the errors of forecasts from a record's last quarter on, which count in a score.

    They are by horizon, in the order of their origins; with `earlier`, those of the forecasts that
    begin before that quarter.
    """
    seen, first = record.seen, held_out_from(len(record))
    return [
        seen[origin.at :] - y[: len(record) - origin.at]
        for origin, y in sorted(forecasts.items(), key=lambda pair: pair[0].at)
        if (origin.at < first) == earlier
    ]


def held_out(record: Record, forecasts: Mapping[Origin, Array]) -> HeldOut:
    """Return what intervals beyond a record follow from: how well its last part was forecast."""
    scored = held_out_errors(record, forecasts)
    longer = held_out_errors(record, forecasts, earlier=True)[::-1]
    return HeldOut.of(_sound(scored, longer, spread(record.seen)), record.seen)


def held_out_by(forecaster: Forecaster) -> HeldOut:
    """Return the same of a fitted forecaster: copies are tried on its training record's end.

    Raises ValueError for one that was loaded and has not kept all of its training records.
    """
    fitted = forecaster.require_fitted()
    record = fitted.record
    if fitted.begin or not fitted.whole:
        raise ValueError(
            "level must have been asked for before the forecaster was saved (by fit, with "
            "--intervals); not all of its training records are left"
        )
    shorter = for_trial(forecaster, len(record))
    origins = held_out_origins(forecaster, record)
    question = Question(record, origins, len(record), fitted.others)
    done = backtest(shorter, question, fitted.report.seed)
    return held_out(record, {at: p.y for at, p in done.predictions.items()})


def mean_forecasts(done: Sequence[Backtest]) -> dict[Origin, Array]:
    """Return, by origin, the mean over the seeds of what was forecast."""
    return {
        origin: np.mean([backtest.predictions[origin].y for backtest in done], axis=0)
        for origin in done[0].predictions
    }


def root_mean_square(errors: Sequence[Array]) -> float:
    """Return that of all errors `(time, ny)` of several forecasts; NaN does not count."""
    every = np.concatenate(errors)
    return rmse(every, np.zeros_like(every))


def _sound(scored: Sequence[Array], longer: Sequence[Array], scale: Array) -> list[Array]:
    """Return all errors, without the `longer` ones of fits to too few samples.

    `longer` begins with the fit to the most samples. A fit to too few samples, less than a period
    of the record for instance, is wrong from its first forecast samples on; errors that merely grow
    with the horizon are still small there.
    """
    near = min(map(len, scored))
    usual = root_mean_square([e[:near] / scale for e in scored])
    sound = [root_mean_square([e[:near] / scale]) <= FAILED_FIT_RATIO * usual for e in longer]
    return [*scored, *longer[: [*sound, False].index(False)]]

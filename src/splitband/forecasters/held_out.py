"""Forecast known samples from many origins: held-out ones give methods scores and intervals.

A method is judged by one long forecast from each of a few origins or, for predictive control, by
forecasts of some samples ahead from many. Forecasters are passed to these functions, on which
`Forecaster.predict` is built.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from splitband.forecasters.intervals import HeldOut
from splitband.forecasters.prediction import Prediction, total
from splitband.forecasters.steps import NotSteppedError
from splitband.metrics import ExtrapolationWarning, fit_percent, rmse, spread
from splitband.records import Record
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import Deadline, DeadlineError, current, within
from splitband.runtime.errors import InputError
from splitband.runtime.threads import without_warnings

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster

TRAINING_SHARE = 0.75
"""Default share of a record to train on."""
HELD_OUT_SHARE = 0.25
"""Share of the training part that is held out for a trial, while models are fitted to the rest. A
convention; longer parts chose no better (docs/developers/rules.md)."""
HELD_OUT_SHARES = (0.5, 0.375, 0.25, 0.2, 0.15, 0.1)
"""Shares of a record that methods which are quickly fitted forecast from the samples before them,
one for each origin: a long share shows how errors grow, a short one is forecast by nearly the final
fit. By eye."""
FEWEST_FITTED = 20
"""An earlier origin, for the intervals, needs this many measured samples of each channel before it.
By eye."""
MOST_ORIGINS = 100
"""Largest number of origins of forecasts some samples ahead. Bounds the time."""
GOLDEN = (math.sqrt(5) - 1) / 2
"""Golden ratio: the multiples of no number are spread more evenly between whole ones."""
FAILED_FIT_RATIO = 5.0
"""A fit to few samples has failed if the error of its first forecast samples is above this multiple
of the method's error over as many first samples of the forecasts that are scored. By eye."""


@dataclass(frozen=True, order=True)
class Origin:
    """Define where a forecast begins.

    fitted : Number of samples at the beginning of the record to which the forecaster is fitted.
    at : Index of the first forecast sample; the warm-up is before it.
    steps : Number of samples to forecast; 0: to the end of the record.
    """

    fitted: int
    at: int
    steps: int = 0


def first_held_out(samples: int) -> int:
    """Return the first sample of the held-out part, the last quarter of `samples`."""
    return samples - max(1, round(HELD_OUT_SHARE * samples))


def beginning(record: Record, samples: int) -> Record:
    """Return the first samples of a record; its simulator's output goes on, for calibrations."""
    part = record[:samples]
    # A copy with another signal is checked again, sample by sample.
    return part if record.y_sim is None else replace(part, y_sim=record.y_sim)


def after(record: Record, at: int, steps: int | None = None) -> dict[str, Any]:
    """Return the arguments of `predict` for samples of a record, by default all, from `at` on."""
    steps = steps or len(record) - at
    u = None if record.u is None else record.u[at : at + steps]
    return {"steps": steps, "history": beginning(record, at), "u": u}


def refitted(
    forecaster: Forecaster,
    record: Record,
    origins: Sequence[Origin],
    others: Sequence[Record] = (),
    **how: Any,
) -> Iterator[tuple[Forecaster, list[Origin]]]:
    """Yield copies that are fitted for these origins, each with those from which it forecasts.

    None follows after the deadline of the job; DeadlineError is raised if it comes before the first
    copy is fitted. `how` are arguments of `Forecaster.fit`, and `bases`: fitted forecasters, of
    which the forecaster, or a part of it, may be one.
    """
    groups = [[*same] for _, same in groupby(origins, key=lambda origin: origin.fitted)]
    for done, group in enumerate(groups):
        try:
            with within(Deadline.after(current().left / (len(groups) - done))):  # a share each
                records = [beginning(record, group[0].fitted), *others]
                fitted = forecaster.fitted_copy(records, **how)
        except DeadlineError:
            if not done:
                raise
            return
        yield fitted, group
        if current().over:
            return


def many_origins(fitted: int, first: int, end: int, ahead: int) -> list[Origin]:
    """Return origins, spread evenly, of forecasts `ahead` that lie between two samples.

    There are at most `MOST_ORIGINS`, and none where the samples are too few. Each lies somewhere in
    a part of its own: at even distances all of them might meet a period at one phase, or miss the
    samples of a slower output.
    """
    samples = max(end - ahead - first + 1, 0)
    count = min(MOST_ORIGINS, samples)
    parts = samples * np.arange(count + 1) // max(count, 1)
    within = (GOLDEN * np.arange(count) % 1 * np.diff(parts)).astype(int)
    return [Origin(fitted, first + int(at), ahead) for at in parts[:-1] + within]


def so_far_ahead(samples: int) -> str:
    """Return a number of samples ahead in words."""
    return f"{samples} sample{'s' if samples > 1 else ''} ahead"


def horizons(ahead: int) -> list[int]:
    """Return the samples ahead for which fits are shown: 1, a tenth of `ahead`, and `ahead`."""
    return sorted({1, max(ahead // 10, 1), ahead})


def held_out_origins(
    forecaster: Forecaster, record: Record, ahead: int | None = None
) -> list[Origin]:
    """Return the origins of forecasts of a record's last quarter.

    With `ahead`, these are `many_origins` of a single fit. Without it, a network is trained once,
    and forecasts from the beginning of that quarter, from a third and from two thirds of it, as a
    method may be lucky from a single origin: persistence is, for instance, if the last sample
    happens to equal the mean. A linear model is fitted once more, to the first half, which shows
    how errors grow. A method that is quicker to fit is refitted for each of several origins, some
    of them earlier.
    """
    samples = len(record)
    if ahead is not None:
        fitted = first_held_out(samples)
        return many_origins(fitted, fitted, samples, ahead)
    held_out = [max(1, round(share * samples)) for share in HELD_OUT_SHARES]
    fitted, ends = first_held_out(samples), dict.fromkeys(max(samples - n, 1) for n in held_out)
    measured = np.cumsum(~np.isnan(record.y_with_gaps), axis=0)
    early = [end for end in ends if end < fitted and (measured[end - 1] >= FEWEST_FITTED).all()]
    if not forecaster.refits:
        held = samples - fitted
        once = sorted({Origin(fitted, fitted + i * held // 3) for i in range(3)})
        quick = not forecaster.random and not forecaster.fits_simulator
        return [*once, *(Origin(end, end) for end in early[:1] if quick)]
    return [Origin(end, end) for end in (*(end for end in ends if end >= fitted), *early)]


def held_out_errors(
    record: Record, forecasts: Mapping[Origin, Array], earlier: bool = False
) -> list[Array]:
    """Return the errors by horizon of forecasts in the last quarter, or `earlier`."""
    seen, first = record.y_with_gaps, first_held_out(len(record))
    return [
        seen[origin.at :][: len(y)] - y[: len(record) - origin.at]
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
    return HeldOut.of(kept, record.y_with_gaps, distinct_samples(forecasts))


def distinct_samples(origins: Iterable[Origin]) -> int | None:
    """Return how many samples several forecasts have in all, if all have as many; else None."""
    every = [*origins]
    if not all(origin.steps for origin in every):
        return None
    return len({n for origin in every for n in range(origin.at, origin.at + origin.steps)})


def forecasts(
    model: Forecaster, record: Record, origins: Sequence[Origin], other_record: bool = False
) -> dict[Origin, Prediction]:
    """Return a model's forecasts of a record, each with the measured samples before its origin.

    Those of a model whose forecasts filter the whole history are made by a stream, which is
    corrected by every sample, and copied at each origin.
    """
    found, many = dict[Origin, Prediction](), [each for each in origins if each.steps]
    with without_warnings(ExtrapolationWarning):  # the predictions hold them
        if model.filters_history and many:
            found |= _in_one_run(model, record, many, other_record)
        for origin in origins:
            if origin not in found:
                known = after(record, origin.at, origin.steps)
                found[origin] = model.predict(**known, other_record=other_record)
    return {origin: found[origin] for origin in origins}


def fit_ahead(record: Record, made: Mapping[Origin, Prediction], steps: int) -> Array:
    """Return the fit in percent of each output, `(ny,)`, so many samples ahead of the origins."""
    truth = np.stack([record.truth[origin.at + steps - 1] for origin in made])
    return np.asarray(fit_percent(truth, np.stack([said.y[steps - 1] for said in made.values()])))


def _in_one_run(
    model: Forecaster, record: Record, origins: Sequence[Origin], other_record: bool
) -> dict[Origin, Prediction]:
    """Return forecasts by a stream; none without a step form, and of one that needs a simulator."""
    now, measured = origins[0].at, record.y_with_gaps
    try:
        stream = model.stream(beginning(record, now), other_record)
    except NotSteppedError:
        return {}
    if stream.steps.simulated:
        return {}
    found, u = dict[Origin, Prediction](), [None] * len(record) if record.u is None else record.u
    for origin in origins:
        for n in range(now, origin.at):
            stream.observe(measured[n], u[n])
        now, going = origin.at, stream.copy()
        y = np.stack([going.step(u[n]) for n in range(now, now + origin.steps)])
        grid = replace(record.grid, samples=now).after(origin.steps)
        found[origin] = Prediction(total([y]), grid, record.columns)
    return found


def held_out_of(forecaster: Forecaster, ahead: int | None = None) -> HeldOut:
    """Return the held-out errors of a fitted forecaster, by copies fitted to less of its record.

    They are kept with it. `ahead` : See `held_out_origins`; by default as far as forecasts of an
    unstable model reach. Raises ValueError for a loaded forecaster without them, which does not
    have all of its training records.
    """
    if forecaster.held_out is not None:
        return forecaster.held_out
    fitted = forecaster.require_fitted()
    record = fitted.record
    if fitted.begin or not fitted.whole:
        raise InputError(
            "level must be left out for a model that was saved without held-out errors: request an "
            "interval before it is saved, also in the command (--intervals)"
        )
    shorter = forecaster.for_trial(len(record))
    origins = held_out_origins(forecaster, record, ahead or fitted.report.reach)
    origins = origins or held_out_origins(forecaster, record)
    found, seed = dict[Origin, Array](), fitted.report.seed
    for model, group in refitted(shorter, record, origins, fitted.others, seed=seed):
        found |= {origin: said.y for origin, said in forecasts(model, record, group).items()}
    forecaster.held_out = interval_errors(record, found)
    return forecaster.held_out


def root_mean_square(errors: Sequence[Array]) -> float:
    """Return the RMS of the errors `(time, ny)` of several forecasts together, ignoring NaN."""
    every = np.concatenate(errors)
    return rmse(every, np.zeros_like(every))

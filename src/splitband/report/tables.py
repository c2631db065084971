"""Make the tables of comparisons, trials, step responses and poles."""

from __future__ import annotations

import math
import statistics
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from splitband.checks.model import ModelCheck
from splitband.checks.responses import Responses
from splitband.checks.simulator import SimulatorCheck
from splitband.comparison.methods import NAMES
from splitband.comparison.recommendation import COVERAGE, RULE, Trial
from splitband.comparison.result import Comparison
from splitband.forecasters.base import Forecaster, titled
from splitband.forecasters.held_out import fit_ahead, horizons
from splitband.forecasters.linear import Linear
from splitband.linear.uncertainty import NORMAL
from splitband.metrics import channel_rmse, fit_percent, leaving
from splitband.records import Record
from splitband.report.numbers import complex_in_words, number, percent
from splitband.report.predictions import Protocol, predicted, run_of, what_was_known
from splitband.report.table import RANKED, Column, Table, Unit
from splitband.runtime.arrays import Array


def _called(record: Record) -> str:
    return record.name or "a record"


def of_comparison(comparison: Comparison) -> Table:
    """Return the table of a comparison: one row per method, the recommended one first."""
    record, train, trial = comparison.record, comparison.plan.train, comparison.trial
    truth = " Errors are against the noise-free signal." if record.y_true is not None else ""
    after = len(record) - train
    ahead = f"; each method then predicted the next {after:,} in one {run_of(record)}"
    tests = f"; each method then simulated {' and '.join(t.name for t in comparison.tests)}"
    others = len(comparison.others)
    more = f" The training part includes {others} more record(s), none held out." if others else ""
    title = (
        f"{_called(record)}: the training part has {train:,} samples"
        + (ahead if after and _simulates(comparison) else "")
        + (tests if comparison.tests else "")
        + f". {what_was_known(comparison)}{truth}{_from_origins(comparison)}{more}"
    )
    missing = {} if trial is None else trial.without_result
    ranked = ordered(trial, comparison.fits)
    rows = {name: missing.get(name, "") for name in (*ranked, *missing)}
    details = {
        name: "; ".join(filter(None, [leaving_range(comparison, name), fits[0].description]))
        for name, fits in comparison.fits.items()
        if name not in missing
    }
    called = labels_of(comparison)
    return _ranked(Table(title, columns(comparison), rows, labels=called, details=details), trial)


def _simulates(comparison: Comparison) -> bool:
    """Return whether a free run tells anything: that of an unstable plant leaves the record."""
    return comparison.plan.ahead is None or comparison.plan.reach is None


def _from_origins(comparison: Comparison) -> str:
    """Return a sentence on forecasts from many origins, if there are any."""
    found = comparison.judging(next(iter(comparison.fits)))
    if not found or comparison.plan.ahead is None:
        return ""
    counts = " and ".join(str(len(forecasts)) for _, forecasts in found)
    steps = ", ".join(map(str, _horizons(comparison).values()))
    return (
        f" Fits {steps} samples ahead are from {counts} origins, each with all measurements before "
        "it."
    )


def _horizons(comparison: Comparison) -> dict[str, int]:
    """Return the samples ahead for which fits are shown, by their names; empty for a free run."""
    if (ahead := comparison.plan.ahead) is None:
        return {}
    return {{1: "1", ahead: "N"}.get(samples, "N/10"): samples for samples in horizons(ahead)}


def of_trial(trial: Trial, record: Record, methods: Mapping[str, Forecaster], title: str) -> Table:
    """Return the table of a trial: one row per method, the recommended one first."""
    rows = dict.fromkeys(ordered(trial, trial.errors), "") | trial.without_result
    listed = tried(trial, record, [*trial.errors])
    return _ranked(Table(title, listed, rows, labels=labels(rows, methods)), trial)


def _ranked(table: Table, trial: Trial | None) -> Table:
    """Return the table with the recommended method marked, and simple ones folded away.

    A recommended baseline and the best of the others stay, as the reference.
    """
    if trial is None:
        return table
    best = trial.recommended
    others = trial.trained | trial.failed.keys() | {best}
    simple = [name for name in table.rows if name not in others]
    return replace(table, recommended=best, minor=frozenset(simple[1:]))


def columns(comparison: Comparison, *headings: str) -> list[Column]:
    """Return the columns of a comparison, by default all: fit and error first.

    Errors are by output, of the median of the seeds' predictions, which is the method's prediction.
    Their spread is the standard deviation of the single seeds' errors.
    """
    return [column for heading in headings or COLUMNS for column in _shown(comparison, heading)]


def _shown(comparison: Comparison, heading: str) -> list[Column]:
    """Return the columns under a heading, computed once: a long record takes seconds."""
    if heading not in comparison.shown:
        comparison.shown[heading] = _under(heading, COLUMNS[heading].of(comparison))
    return comparison.shown[heading]


def _under(heading: str, found: Iterable[Column]) -> list[Column]:
    """Return these columns under a heading, with its unit."""
    unit, note, _ = COLUMNS[heading]
    known: dict[str, Any] = {"heading": heading, "unit": unit, "ranked": unit in RANKED}
    return [replace(column, note=note, **known) for column in found if column.values]


def _over_all(values: Mapping[str, float]) -> list[Column]:
    """Return the column of numbers over all outputs."""
    return [Column("", "record", values)]


def _by_output(
    record: Record,
    values: Mapping[str, Any],
    spreads: Mapping[str, Any] = MappingProxyType({}),
    marks: Mapping[str, Sequence[str]] = MappingProxyType({}),
    test: str = "",
    ahead: int = 0,
) -> list[Column]:
    """Return a column for each output of a record, of numbers by method and output."""

    def of(i: int, numbers: Mapping[str, Any]) -> dict[str, float]:
        return {name: float(by_output[i]) for name, by_output in numbers.items()}

    return [
        Column(
            "",
            "record",
            of(i, values),
            name if record.ny > 1 else "",
            test,
            of(i, spreads),
            measure=measure,
            marks={name: by_output[i] for name, by_output in marks.items() if by_output[i]},
            ahead=ahead,
        )
        for i, (name, measure) in enumerate(zip(record.columns, record.units, strict=True))
    ]


def ordered(trial: Trial | None, methods: Iterable[str]) -> list[str]:
    """Return the methods sorted by score, the recommended one first."""
    return [*methods] if trial is None else trial.ranked(methods)


def tried(trial: Trial, record: Record, methods: Sequence[str]) -> list[Column]:
    """Return the columns of a trial: score and held-out error."""
    held_out = _held_out(trial, record, methods)
    return [*_under("score", _scores(trial, methods)), *_under("held-out RMSE", held_out)]


def leaving_range(comparison: Comparison, name: str) -> str:
    """Return a phrase on a forecast that leaves the training range; else empty."""
    left = comparison.leaves(name)
    return "" if left is None else leaving(left)


def labels(names: Iterable[str], methods: Mapping[str, Forecaster]) -> dict[str, str]:
    """Return methods in words, by name, or the name of a user's method without a description.

    Equal words are followed by names in brackets.
    """
    known = NAMES | dict(methods)
    described = {n: (known[n].in_words() if n in known else "") or n for n in names}
    count = Counter(described.values())
    return {n: titled(n, words) if count[words] > 1 else words for n, words in described.items()}


def labels_of(comparison: Comparison) -> dict[str, str]:
    """Return the methods of a comparison in words; fitted ones with their cut-off."""
    fitted = {name: fits[0].fitted for name, fits in comparison.fits.items()}
    failed = () if comparison.trial is None else comparison.trial.failed
    names = dict.fromkeys([*comparison.fits, *comparison.methods, *failed])
    return labels(names, comparison.methods | fitted)


def _errors(
    protocol: Protocol, measure: Callable[[Array, Array], Array], comparison: Comparison
) -> Iterator[Column]:
    """Yield the fits or errors of predictions, errors with their spread over the seeds."""
    every = predicted(comparison) if _simulates(comparison) else []
    for i, shown in enumerate((runs for runs in every if runs.protocol == protocol), 1):
        values, spreads = {}, {}
        for name, median in shown.predictions.items():
            truth = shown.truth(median)
            values[name] = measure(truth, median.y)
            by_seed = [measure(truth, run.y) for run in shown.trainings[name]]
            if measure is channel_rmse and len(by_seed) > 1:
                spreads[name] = [statistics.stdev(errors) for errors in zip(*by_seed, strict=True)]
        test = (shown.record.name or str(i)) if protocol == "test" else ""
        yield from _by_output(shown.record, values, spreads, test=test)


def _ahead(name: str, comparison: Comparison) -> Iterator[Column]:
    """Yield the fits of forecasts from many origins, so many samples ahead, by record."""
    if (steps := _horizons(comparison).get(name)) is None:
        return
    for record in (*comparison.tests, comparison.record):
        fits = {
            method: fit_ahead(record, forecasts, steps)
            for method in comparison.fits
            for own, forecasts in comparison.judging(method)
            if own is record
        }
        test = "" if record is comparison.record else record.name
        yield from _by_output(record, fits, test=test, ahead=steps)


def _scores(trial: Trial, methods: Iterable[str]) -> list[Column]:
    scored = trial.final or trial.scores
    return _over_all({name: trial.penalized_score(name) for name in methods if name in scored})


def _held_out(trial: Trial, record: Record, methods: Iterable[str]) -> list[Column]:
    return _by_output(record, {name: trial.errors[name] for name in methods})


def _intervals(comparison: Comparison) -> list[Column]:
    known = comparison.fits if comparison.trial is not None else ()
    methods = [name for name in known if comparison.steps_of_interval(name)]
    held = {name: comparison.coverages(name) for name in methods}
    marks = {name: comparison.misfits(name) for name in methods}
    return _by_output(comparison.record, held, marks=marks)


class Quantity(NamedTuple):
    """A column of comparisons: unit, explanation, and the function of its numbers."""

    unit: Unit
    note: str
    of: Callable[[Comparison], Iterable[Column]]  # without heading, unit and note


_FIT = "100 (1 - |y - prediction| / |y - mean(y)|) of the"
_OF_AHEAD = (
    f"{_FIT} predictions this far ahead from many origins, each with all measurements before it: "
    "100 is perfect, 0 is as good as the mean"
)
_OF_TEST = f"{_FIT} simulation of this test record: 100 is perfect, 0 is as good as its mean"
_AHEAD = (
    f"{_FIT} samples after the training part, which are simulated where inputs are known and "
    "forecast where there are none: 100 is perfect, 0 is as good as their mean"
)
_INSIDE = (
    "share of the measured samples after the training part, or of those ahead, in the "
    f"interval; {percent(COVERAGE)} is ideal; narrow or wide: it differs by more than chance"
)
_HELD_OUT = "error of models trained on three quarters of the training samples, on the last one"
_RMSE = "root mean squared error of the"
_TESTS, _FORECASTS = partial(_errors, "test"), partial(_errors, "forecast")
COLUMNS = {
    **{
        f"{name} ahead fit %": Quantity("percent", _OF_AHEAD, partial(_ahead, name))
        for name in ("1", "N/10", "N")
    },
    "test fit %": Quantity("percent", _OF_TEST, partial(_TESTS, fit_percent)),
    "forecast fit %": Quantity("percent", _AHEAD, partial(_FORECASTS, fit_percent)),
    "score": Quantity("deviation", RULE, lambda c: _scores(c.trial, c.fits) if c.trial else []),
    "test RMSE": Quantity(
        "record", f"{_RMSE} simulation of this test record", partial(_TESTS, channel_rmse)
    ),
    "forecast RMSE": Quantity(
        "record", f"{_RMSE} samples after the training part", partial(_FORECASTS, channel_rmse)
    ),
    "in interval": Quantity("share", _INSIDE, _intervals),
    "held-out RMSE": Quantity(
        "record", _HELD_OUT, lambda c: _held_out(c.trial, c.record, c.fits) if c.trial else []
    ),
}
"""The columns of comparisons by heading."""


def of_checks(checks: Mapping[str, ModelCheck]) -> Table:
    """Return the table of checks of several models on one record, by the names of the models."""
    record = next(iter(checks.values())).record
    horizons = dict.fromkeys(h for each in checks.values() for h in each.fits)
    columns = [
        Column(
            f"{horizon} fit %",
            "percent",
            {n: each.fits[horizon][i] for n, each in checks.items() if horizon in each.fits},
            channel if record.ny > 1 else "",
        )
        for horizon in sorted(horizons, key="simulation".__ne__)  # unstable models have none
        for i, channel in enumerate(record.columns)
    ]
    rows = {name: " ".join(each.in_words()) for name, each in checks.items()}
    labels = {name: titled(name, each.title) for name, each in checks.items()}
    title = f"{_called(record)}: models on {len(record):,} samples"
    return Table(title, columns, rows, "model", labels=labels)


def of_gains(responses: Sequence[Responses]) -> list[Table]:
    """Return a table of a model's final responses; see `respond_over_range`."""
    if not responses:
        return []
    first = responses[0]
    pairs = {
        f"{u} to {y}": (j, i)
        for i, u in enumerate(first.inputs)
        for j, y in enumerate(first.columns)
    }
    listed = []
    for response in sorted(responses, key=lambda r: 0.5 if r.share is None else r.share):
        gains = {name: float(response.gains[at]) for name, at in pairs.items()}
        listed.append(Column(f"at {response.place}", "gain", gains, ranked=False))
    title = "Static gains: the settled change of the output for a step of 1"
    if len(responses) > 1:
        title += ", with all inputs at these shares of their training ranges"
    return [Table(title, listed, dict.fromkeys(pairs, ""), "step")]


@np.errstate(divide="ignore", invalid="ignore")
def of_poles(fitted: Linear) -> Table:
    """Return the table of a linear model's poles: one row per real pole or pair.

    The numbers are those of MATLAB's `damp`, with the 95 % interval of the absolute value.
    """
    step, uncertainty = fitted.require_fitted().record.sampling_time, fitted.model.uncertainty
    poles = fitted.poles() if uncertainty is None else uncertainty.poles
    rows = [int(i) for i in np.argsort(-np.abs(poles), kind="stable") if poles[i].imag >= 0]
    names = {i: f"{n}. {complex_in_words(poles[i])}" for n, i in enumerate(rows, 1)}
    rates = np.log(poles.astype(np.complex128)) / step  # in the s plane

    def of(values: Array) -> dict[str, float]:
        finite = np.where(np.isfinite(values), values, np.nan)
        return {names[i]: float(finite[i]) for i in rows}

    error = (
        np.full(len(poles), np.nan)
        if uncertainty is None
        else NORMAL * uncertainty.pole_errors[:, 2]
    )
    errors = {name: size for name, size in of(error).items() if math.isfinite(size) and size}
    listed = [
        Column("absolute value", "record", of(np.abs(poles)), spreads=errors, ranked=False),
        Column("time constant (s)", "record", of(-1 / rates.real), ranked=False),
        Column("frequency (rad/s)", "record", of(np.abs(rates)), ranked=False),
        Column("frequency (Hz)", "record", of(np.abs(rates) / (2 * np.pi)), ranked=False),
        Column("damping ratio", "record", of(-rates.real / np.abs(rates)), ranked=False),
    ]
    title = "Poles in the z plane; ± is half of the 95 % interval"
    return Table(title, listed, dict.fromkeys(names.values(), ""), "pole")


def of_oracle(found: SimulatorCheck) -> Table:
    """Return the table of the oracle check at each cut-off."""
    of = {f"{check.cutoff:g} Hz": check for check in found.oracle}
    perfect = {name: check.perfect_network for name, check in of.items()}
    without = {name: check.no_network for name, check in of.items()}
    columns = [
        Column("perfect network", "record", perfect, ranked=False),
        Column("no network", "record", without, ranked=False),
    ]
    title = (
        "Oracle check: RMSE of a hybrid with a perfect network (measured high band, simulated low "
        f"band) and without any. The simulator alone has RMSE {number(found.total_rmse)}."
    )
    return Table(title, columns, dict.fromkeys(of, ""), "cut-off", f"{found.cutoff:g} Hz")

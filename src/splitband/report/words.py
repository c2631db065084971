"""Describe the results of a comparison in sentences, for the terminal and the page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from splitband.checks.model import MOST_ONE_AHEAD, runs_free
from splitband.comparison.backtest import WORTH_TRAINING
from splitband.comparison.checks import repeats_training
from splitband.comparison.methods import GREY_BOX, HYBRIDS
from splitband.comparison.plan import UNFITTED_SIMULATOR, WITHOUT_TERMS
from splitband.comparison.recommendation import Trial, by_reason
from splitband.comparison.result import Comparison
from splitband.forecasters.base import titled
from splitband.forecasters.held_out import HELD_OUT_SHARE, first_held_out, so_far_ahead
from splitband.forecasters.linear import Linear
from splitband.metrics import Extrapolation
from splitband.records import Record
from splitband.report.numbers import number, percent
from splitband.report.predictions import run_of
from splitband.report.table import Column
from splitband.report.tables import columns, labels_of, leaving_range

MIN_HELD_OUT = 20
"""Least number of held-out samples without a warning. By eye."""


def lead(record: Record) -> str:
    """Return a line about the record."""
    every = f"{record.sampling_time:.6g} s"
    line = f"{len(record):,} samples every {every}, measured: {', '.join(record.columns)}"
    return line + (f"; known inputs: {', '.join(record.inputs)}" if record.nu else "")


def sentence(text: str) -> str:
    """Return a text with a capital and a full stop; a leading name stays unchanged."""
    first = text.split(maxsplit=1)[0] if text else ""
    capital = text[:1].upper() if first.isalpha() else text[:1]
    return capital + text[1:] + ("" if text.endswith((".", ".)")) else ".")


def headline(comparison: Comparison) -> list[tuple[str, list[str]]]:
    """Return predicted outputs and records, with fit and error of the recommended method.

    The records are the test records, or else the samples after the training part. Without either,
    the error is the held-out one. With `Plan.ahead`, forecasts from many origins come first; of an
    unstable plant there is nothing else.
    """
    plan, best, record = comparison.plan, comparison.recommended, comparison.record
    lines = list[tuple[str, list[str]]]()

    def add(fit: Column, of: str, facts: list[str], own: bool) -> None:
        """Add a line, with the interval if the fit is that of the record's `own` samples."""
        held = {c.channel: c.entry(best) for c in columns(comparison, "in interval")}
        if own and fit.channel in held:
            share = percent(comparison.require_trial().intervals[best].share)
            facts = [*facts, f"inside the {share} interval: {held[fit.channel]}"]
        lines.append((", ".join(filter(None, [fit.channel, of])), facts))

    judged = plan.ahead is not None and bool(comparison.steps_of_interval(best))
    nearer = columns(comparison, "1 ahead fit %", "N/10 ahead fit %")
    for fit in columns(comparison, "N ahead fit %") if judged else ():
        alike = [c for c in nearer if (c.channel, c.record) == (fit.channel, fit.record)]
        also = ", ".join(f"{so_far_ahead(c.ahead)}: {c.entry(best)} %" for c in alike)
        of = so_far_ahead(fit.ahead) + (f" in test record {fit.record}" if fit.record else "")
        facts = [f"fit {fit.entry(best)} %" + (f" ({also})" if also else "")]
        add(fit, of, facts, len(lines) < record.ny)
    if not (comparison.tests or comparison.predictions):
        for error in columns(comparison, "held-out RMSE"):
            facts = [f"held-out RMSE {error.entry(best)} {error.measure}".rstrip()]
            lines.append((error.channel or record.columns[0], facts))
        return lines
    side = "test" if comparison.medians[best].tests else "forecast"
    fits, errors = (columns(comparison, f"{side} {what}") for what in ("fit %", "RMSE"))
    run = f"{run_of(record)} of {len(record) - plan.train:,} samples"
    for fit, error in zip(fits, errors, strict=True):
        of = f"test record {fit.record}" if fit.record else run
        facts = [f"fit {fit.entry(best)} %", f"RMSE {error.entry(best)} {error.measure}".rstrip()]
        add(fit, of, facts, side == "forecast" and plan.ahead is None)
    return lines


def why(trial: Trial, train: int, called: Mapping[str, str], ahead: int | None = None) -> list[str]:
    """Return sentences on the reason for the recommendation; `called` are methods in words.

    `ahead` : See `Plan.ahead`.
    """
    best = trial.recommended
    if len(trial.errors) == 1:
        return [
            "No other method was tried. For its held-out error it was trained on the first "
            f"{percent(1 - HELD_OUT_SHARE)} of the {train:,} training samples and predicted the "
            "rest."
        ]
    ranked = trial.ranked(trial.final)
    able = [name for name in ranked if name not in trial.left_out] or ranked
    chosen = f"Its score is the lowest, {number(trial.penalized_score(best))}"
    if 1 < len(able) < len(ranked):
        chosen += ", of the methods that may be recommended"
    if len(able) > 1:
        second = number(trial.penalized_score(able[1]))
        chosen += f"; that of {called.get(able[1], able[1])} is {second}"
    chosen += (
        ". The score is the error in standard deviations: every method was trained on the first "
        f"{percent(1 - HELD_OUT_SHARE)} of the {train:,} training samples and predicted the rest"
    )
    chosen += f", up to {ahead} samples ahead from many origins." if ahead else "."
    if trial.trained and set(trial.errors) - trial.trained:
        chosen += f" Networks carry a penalty of {percent(WORTH_TRAINING)}."
    if trial.drifting:
        names = ", ".join(called.get(name, name) for name in trial.drifting)
        chosen += (
            f" The score of {names}, which drifts, is the larger error of its simulation of "
            "the training samples."
        )
    return [chosen]


def afterwards(comparison: Comparison) -> list[str]:
    """Return a sentence on methods with a better fit than the recommended one on unseen samples."""
    best = comparison.recommended
    fits = _decisive(comparison)
    if not any(np.isfinite(c.values.get(best, np.nan)) for c in fits) or len(comparison.fits) == 1:
        return []
    better = [
        c
        for c in fits
        if c.best
        and c.values[c.best] > c.values[best] + c.spreads.get(best, 0.0)
        and c.entry(c.best) != c.entry(best)
    ]
    if not better:
        others = "method with a result" if without_result(comparison) else "method"
        return [f"No other {others} had a better fit."]
    called = labels_of(comparison)
    names = ", ".join(
        f"{called[c.best]} {c.entry(c.best)} %"
        + (f" ({of})" if (of := c.record or c.channel) else "")
        for c in better
    )
    return [f"In hindsight, another method had a better fit: {names}."]


def _decisive(comparison: Comparison) -> list[Column]:
    """Return the fits on unseen samples by which a method is wanted to do well."""
    every = (f"{kind} fit %" for kind in ("N ahead", "test", "forecast"))
    return next(filter(None, (columns(comparison, heading) for heading in every)), [])


def without_result(comparison: Comparison) -> list[str]:
    """Return the names of the methods without a result, possibly so far."""
    failed = comparison.require_trial().failed
    names = dict.fromkeys([*comparison.plan.names, *failed])
    return [name for name in names if name not in comparison.fits]


def findings(comparison: Comparison) -> list[str]:
    """Return the findings of the residual tests of the recommended method."""
    found = [test.finding() for test in comparison.residual_tests]
    fit = comparison.medians[comparison.recommended]
    if found and fit.tests:
        record = f"test record {comparison.tests[0].name or 1}"
        if not runs_free(fit.fitted, fit.tests[0].y):
            record += (
                f", predicted one sample ahead, as the model is unstable (at most the last "
                f"{MOST_ONE_AHEAD:,} samples)"
            )
        found.append(f"These are residuals of {record}.")
    return found


def answer(comparison: Comparison) -> list[str]:
    """Return sentences on the fit of the recommended method, and on what it does not explain."""
    fits = "; ".join(f"{of}: {facts[0]}" for of, facts in headline(comparison))
    found = findings(comparison)
    begin = [" ".join([sentence(fits), *found])]
    if comparison.record.ny > 1:  # begins with a name
        begin = [f"{fits}.", " ".join(found)]
    return [*begin, *afterwards(comparison)]


def warnings(comparison: Comparison) -> list[str]:
    """Return warnings about the numbers, the gravest first."""
    tests = comparison.residual_tests
    doubtful = [test.finding() for test in tests if test.unrelated or not test.accepted]
    return [*dict.fromkeys((*pressing(comparison), *doubtful, *further(comparison)))]


def pressing(comparison: Comparison) -> list[str]:
    """Return the warnings that are always said: the gravest, and why methods have no numbers."""
    return [*gravest(comparison), *_missing(comparison), *_untested(comparison)]


def gravest(comparison: Comparison) -> list[str]:
    """Return warnings that a reader of the answer must know."""
    return [
        *map(sentence, comparison.clock.notes),
        *_unstable(comparison),
        *map(sentence, of_inputs(comparison.inputs_beyond_training, comparison.record)),
        *_seen(comparison),
        *_worse_than_mean(comparison),
        *_useless_term(comparison),
    ]


def further(comparison: Comparison) -> list[str]:
    """Return the other notes of a page, whose table says why a method has no result."""
    return [
        *_integrates(comparison),
        *(_left_range(comparison) if comparison.plan.reach is None else []),
        *_wide_interval(comparison),
        *_few_held_out(comparison.plan.train),
        *_notes(comparison),
        *_untested(comparison),
        *_useless_simulator(comparison),
    ]


def _worse_than_mean(comparison: Comparison) -> list[str]:
    """Return a sentence on a recommended method worse than the mean on unseen samples."""
    best = comparison.recommended
    fits = _decisive(comparison)
    worse = [c for c in fits if c.values.get(best, 0.0) < 0]
    if not worse:
        return []
    what = "The recommended method does not predict"
    if all(max(c.values.values()) < 0 for c in worse):
        what = "No method predicts"
    named = " and ".join(filter(None, (f"{c.channel} {c.record}".strip() for c in worse)))
    finding = f"{what} {named or 'this record'} better than the mean of the predicted samples"
    return [f"{finding} (fit 0 %), although that mean is not known beforehand."]


def _unstable(comparison: Comparison) -> list[str]:
    """Return a sentence on a recommended model that is unstable, or drifts in a simulation."""
    name = comparison.recommended
    fits, drifts = comparison.fits[name], name in comparison.require_trial().drifting
    said = [fit.report.unstable() for fit in fits if drifts or fit.report.reach is not None]
    return [f"The recommended model is {each}." for each in [*filter(None, said)][:1]]


def _integrates(comparison: Comparison) -> list[str]:
    """Return a sentence on a recommended model that integrates."""
    fits = comparison.fits[comparison.recommended]
    if not any(isinstance(fit.fitted, Linear) and fit.fitted.model.integrators for fit in fits):
        return []
    return ["The recommended model integrates: a constant input makes it grow steadily."]


def _seen(comparison: Comparison) -> list[str]:
    """Return sentences on test records among the training samples."""
    return [
        f"The test record {test.name} contains training samples, so its fit is not one on new data."
        for test in comparison.tests
        if repeats_training(test, (comparison.plan.training, *comparison.others))
    ]


def _useless_term(comparison: Comparison) -> list[str]:
    """Return a sentence on unknown terms that are left out, or help less than another method."""
    scores, simulator = comparison.require_trial().scores, comparison.plan.simulator
    without = WITHOUT_TERMS if WITHOUT_TERMS in scores else UNFITTED_SIMULATOR
    names = GREY_BOX, without, comparison.recommended
    if simulator is None or not simulator.terms or not {*names} <= scores.keys():
        return []
    found, alone, best = (scores[name] for name in names)
    if np.isclose(found, alone, rtol=1e-6):
        return [
            "The unknown terms are left out of the model: they did not help on held-out samples, "
            "or the time was over before they were trained; then budget (--budget) must be longer."
        ]
    if found * (1 + WORTH_TRAINING) < alone or best >= found:
        return []
    return [
        f"The unknown terms help little (held-out RMSE {number(found)}, without them "
        f"{number(alone)}): what the equation lacks does not depend on their arguments alone, as "
        "where a state is missing. A hybrid learns it outside of the equation."
    ]


def _left_range(comparison: Comparison) -> list[str]:
    """Return a sentence on a recommended method that leaves the training range."""
    left = leaving_range(comparison, comparison.recommended)
    return [f"The recommended model {left}."] if left else []


def _wide_interval(comparison: Comparison) -> list[str]:
    """Return a sentence on an interval as wide as one around the record's mean."""
    best, trial, record = comparison.recommended, comparison.require_trial(), comparison.record
    ahead = comparison.steps_of_interval(best)
    if not ahead or best not in trial.held_out:
        return []
    interval = trial.intervals[best]
    half = interval.half_widths(ahead).mean(axis=0)
    usual = trial.held_out[best].around_mean(interval.share)
    widths = [
        f"± {number(float(width))} {unit}".rstrip() + (f" for {column}" if record.ny > 1 else "")
        for width, most, unit, column in zip(half, usual, record.units, record.columns, strict=True)
        if width >= most
    ]
    if not widths:
        return []
    return [
        f"The {percent(interval.share)} interval is as wide as the record itself "
        f"({' and '.join(widths)} on average): the held-out errors do not show that the model has "
        "any skill."
    ]


def _missing(comparison: Comparison) -> list[str]:
    """Return sentences on the methods without a result."""
    why, called = comparison.require_trial().without_result, labels_of(comparison)
    missing = without_result(comparison)
    reasons = {
        titled(n, called[n]): why.get(n, "no result: it is not trained yet") for n in missing
    }
    return [*map(sentence, by_reason(reasons))]


def _few_held_out(train: int) -> list[str]:
    """Return a sentence on a choice by few samples."""
    held_out = train - first_held_out(train)
    if held_out >= MIN_HELD_OUT:
        return []
    return [
        f"The method was chosen by only {held_out} held-out samples, which are too few to tell "
        "methods apart: a longer record may lead to another choice."
    ]


def _notes(comparison: Comparison) -> list[str]:
    """Return the doubts of predictions and the notes of fits, with their methods."""
    called = {name: titled(name, words) for name, words in labels_of(comparison).items()}
    doubts = dict[str, list[str]]()
    recommended = (fit.report for fit in comparison.fits[comparison.recommended])
    general = [*comparison.warnings, *(report.unstable() for report in recommended)]
    for name, runs in comparison.fits.items():
        remarks = [run.fitted.parameters.get("doubt") for run in runs]
        if name in comparison.predictions:
            remarks += comparison.predictions[name].doubts
        for doubt in dict.fromkeys(filter(None, remarks)):
            doubts.setdefault(doubt, []).append(called[name])
    best, tests = comparison.medians[comparison.recommended], comparison.tests
    notes = {
        name: dict.fromkeys(
            note for run in runs for note in run.report.notes if note not in general
        )
        for name, runs in comparison.fits.items()
    }
    return [
        *(f"{', '.join(names)}: {doubt}" for doubt, names in doubts.items()),
        *(f"{t.name}: {m}" for t, p in zip(tests, best.tests, strict=False) for m in p.warnings),
        *(f"{called[name]}: {note}" for name, of in notes.items() for note in of),
    ]


def _untested(comparison: Comparison) -> list[str]:
    """Return a sentence on methods that cannot simulate the test records."""
    if not comparison.left_out:
        return []
    return [
        f"Not tested: {', '.join(comparison.left_out)}. Such methods continue the training record, "
        "or need a simulation of the test record: its y_sim (--test-simulator), or one more in "
        "also (--also)."
    ]


def _useless_simulator(comparison: Comparison) -> list[str]:
    """Return a sentence on hybrids left out for a useless simulator."""
    plan, choice = comparison.plan, comparison.plan.bands.choice
    if not choice or choice.simulator_helps is not False or set(plan.names) & set(HYBRIDS):
        return []
    return [
        "The simulator helps at no cut-off frequency, so hybrid models were left out. To compare "
        "them all the same, methods (--methods) must name them."
    ]


def of_inputs(beyond: Sequence[Extrapolation], record: Record) -> list[str]:
    """Return sentences on inputs that leave their training ranges."""
    return [
        u.describe(record.inputs[u.channel] if u.channel < record.nu else "", " of the prediction")
        for u in beyond
    ]


def of_gaps(record: Record) -> list[str]:
    """Return sentences on samples that are not as they were logged, or missing, if any."""
    missing, said = int((~record.complete).sum()), record.reading.sentences
    gaps = (
        f"{missing:,} of {len(record):,} samples are masked, as an output is missing, or an input "
        "there or just before. Curves have gaps there, and errors exclude them."
    )
    read = f"The record was read with {'; '.join(said)}."
    return [*([read] if said else []), *([gaps] if missing else [])]

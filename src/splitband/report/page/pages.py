"""Lay out the pages of comparisons, checks and inspections."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from datetime import datetime
from itertools import product
from pathlib import Path

import numpy as np
import numpy.typing as npt

from splitband.checks.inspection import Inspection
from splitband.checks.model import ModelCheck
from splitband.checks.residuals import CONFIDENCE, ResidualTests
from splitband.checks.responses import Responses, respond_over_range
from splitband.comparison.result import Comparison
from splitband.forecasters.base import Forecaster, all_parts, titled
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.held_out import fit_ahead, forecasts, many_origins
from splitband.forecasters.linear import Linear
from splitband.forecasters.network import Network
from splitband.metrics import fit_percent
from splitband.records import Record
from splitband.report import tables, words
from splitband.report.environment import environment
from splitband.report.numbers import complex_in_words, number
from splitband.report.page import frequency, model, over_time
from splitband.report.page.over_time import Run
from splitband.report.page.parts import Key, Page, Section, Usage, looks
from splitband.report.predictions import predicted
from splitband.report.table import Column, Table
from splitband.report.tables import columns, ordered
from splitband.runtime.arrays import Array
from splitband.runtime.files import sha256_of

MAX_BODE = 4
"""Largest number of pairs of input and output with gain and phase, too. Layout."""
NEAR = 1, 10
"""Samples ahead for which fits are shown. Layout."""
NEAR_SAMPLES = 2_000
"""First samples after the training part in which these forecasts lie. Bounds the time."""


def of_comparison(result: Comparison, used: Usage) -> Page:
    """Return the page of a comparison: the answer, the record, the methods, then the model."""
    record, train, best = result.record, result.plan.train, result.recommended
    listed = tables.of_comparison(result)
    labels = {name: listed.label(name) for name in ordered(result.trial, result.fits)}
    needed = [n for n, m in result.methods.items() if "simulator" in m.needs and not m.random]
    drawn = looks(labels, listed.minor, [*needed, *result.plan.also])
    runs = over_time.runs_of(result, drawn)
    names = ["time", *[""] * len(runs)]
    plots = [p for r, n in zip(runs, names, strict=False) for p in over_time.over_time(r, drawn, n)]
    at, views = plots[0].axis.values, {}
    if runs[0].record is record and train < len(record):
        views = {"Whole record": (at[0], at[-1]), "Test": (at[train], at[-1])}
    warned = (*result.warnings, *words.further(result), *words.of_gaps(record))
    items = [*map(words.sentence, warned)]
    answer = f"Recommended: {titled(best, labels[best])}"
    sections = [
        Section("answer", answer, words.answer(result), plots, warnings=words.gravest(result)),
        *([Section("notes", "To keep in mind", items=items)] if items else []),
        *_by_band(runs[0], drawn, _cutoff(result, drawn)),
        _methods(result, listed, drawn),
        *_residuals(result.residual_tests, words.findings(result)),
        *_responses(result.model),
        *_linear(result.model),
        *_unknown([fits[0].fitted for fits in result.fits.values()]),
        *_seeds(result, listed),
        *_made(used),
    ]
    return Page(record.name or "a record", words.lead(record), sections, views)


def _cutoff(result: Comparison, names: Iterable[str]) -> float | None:
    """Return the cut-off in Hz of the first of these methods that has one."""
    models = (part for name in names for part in all_parts(result.fits[name][0].fitted.untrained()))
    bands = (part.bands for part in models if isinstance(part, Network))
    return next((each.cutoff for each in bands if each is not None and each.cutoff), None)


def _by_band(run: Run, drawn: Mapping[str, Key], cutoff: float | None) -> list[Section]:
    """Return the section of errors over frequency."""
    plots = frequency.errors_by_band(run, drawn, cutoff)
    text = (
        "Each curve is the spectrum of a method's error over that of the record, as a ratio of "
        "amplitudes. At 100 % a method predicts a band no better than the mean does. A band with "
        "little power counts little."
    )
    if cutoff is not None:
        text += f" The dashed line is the cut-off at {number(cutoff)} Hz between two models."
    if not run.scored and "training" in run.parts:
        text += " The methods were trained on these samples."
    return [Section("bands", "Error by frequency band", [text], plots)] if plots else []


def _methods(result: Comparison, listed: Table, drawn: Iterable[str]) -> Section:
    """Return the section of the table of methods."""
    plan, best = result.plan, result.recommended
    fits = columns(result, *_AHEAD, "test fit %", "forecast fit %")
    named = [name for name in result.fits if name in drawn or name in listed.minor]
    near = _near(result, named) if plan.ahead is None else []
    errors = columns(result, "test RMSE", "forecast RMSE", *[] if fits else ["held-out RMSE"])
    shown = [*fits, *near, *errors, *columns(result, "in interval")]
    chosen = filter(None, [titled(best, listed.label(best)), result.fits[best][0].description])
    text = [words.sentence(f"Recommended: {', '.join(chosen)}")]
    text += words.why(result.require_trial(), plan.train, listed.labels, plan.ahead)
    table = replace(listed, columns=shown, details={})
    return Section("methods", "All methods", [" ".join(text)], tables=[table])


_AHEAD = "1 ahead fit %", "N/10 ahead fit %", "N ahead fit %"


def _near(result: Comparison, names: Iterable[str]) -> list[Column]:
    """Return the fits of these methods a few samples ahead of origins on unseen samples."""
    record, first = result.record, result.plan.train
    if result.tests:
        record, names = result.tests[0], [name for name in names if result.medians[name].tests]
        lengths = (len(result.medians[name].tests[0]) for name in names)
        first = len(record) - max(lengths, default=0)
    end = min(len(record), first + NEAR_SAMPLES)
    origins = many_origins(first, first, end, NEAR[-1])[::2]
    fits = dict[str, list[Array]]()
    for name in names if origins else ():
        trained = result.trained(name)
        other = bool(result.tests) and not trained.anchored
        try:
            made = forecasts(trained, record, origins, other)
        except ValueError:  # for want of a simulator, as in the table
            continue
        fits[name] = [fit_ahead(record, made, ahead) for ahead in NEAR]
    note = (
        f"fit of predictions this far ahead from {len(origins)} origins, each with all "
        "measurements before it"
    )
    return [
        Column(
            "near fit %",
            "percent",
            {name: float(of[k][i]) for name, of in fits.items()},
            column if record.ny > 1 else "",
            record.name if result.tests else "",
            note=note,
            ahead=ahead,
        )
        for k, ahead in enumerate(NEAR)
        for i, column in enumerate(record.columns if fits else ())
    ]


def _residuals(tests: Sequence[ResidualTests], findings: Sequence[str]) -> list[Section]:
    """Return the section of the residual tests."""
    text = (
        "The plots show correlations as they are tested. For correlations with inputs, residuals "
        "and inputs are prewhitened by an autoregressive model of the residuals. Lags reach twice "
        f"the slowest period. By chance, {100 * CONFIDENCE:.0f} % of the values lie in the shaded "
        "area. Values outside it show an effect of the input that the model misses (at positive "
        "lags), or feedback from the output to the input (at negative lags). The F test takes all "
        "lags and inputs together, and powers of the output: it detects small effects that no "
        "single lag shows."
    )
    plots = [model.correlation(t.output, c) for t in tests for c in (t.whiteness, *t.inputs)]
    words_of = [" ".join(findings), text]
    return [Section("residuals", "Residual tests", words_of, plots)] if tests else []


def _responses(recommended: Forecaster) -> list[Section]:
    """Return the section of the step and Bode responses of a model, if it has inputs."""
    title = "Step and Bode responses"
    if "simulator" in recommended.needs and recommended.require_fitted().record.nu:
        text = "The model needs the output of its simulator: it has no responses by itself."
        return [Section("responses", title, [text])]
    every = respond_over_range(recommended)
    if not every:
        return []
    first = every[0]
    text = (
        "The plots show how an output changes for a step of 1 of one input, computed by small "
        f"steps around the mean of the training inputs, {first.operating_point}."
    )
    if len(every) > 1:
        text += (
            " Dashed and dotted curves are for other points of their ranges. If the curves differ, "
            "the gain depends on the operating point. Gain and phase are at the mean."
        )
    bode = len(first.inputs) * len(first.columns) <= MAX_BODE
    plots = model.responses(recommended, every, bode)
    return [Section("responses", title, [text, *first.remarks], plots)]


def _linear(fitted: Forecaster) -> list[Section]:
    """Return the section of the poles and zeros of a linear model."""
    if not isinstance(fitted, Linear):
        return []
    record, of = fitted.require_fitted().record, fitted.model
    pairs = product(enumerate(record.inputs), enumerate(record.columns))
    zeros = [(f"zeros, {u} to {y}", _roots(fitted.zeros(j, i))) for (i, u), (j, y) in pairs]
    poles = [tables.of_poles(fitted)] if of.order else []
    text = [fitted.describe() + "."]
    return [Section("linear", "Poles and zeros", text, tables=poles, facts=zeros)]


def _roots(roots: npt.NDArray[np.complex128]) -> str:
    """Return zeros in a line, with conjugate pairs as one."""
    return ", ".join(complex_in_words(root) for root in roots if root.imag >= 0) or "none"


def _unknown(models: Sequence[Forecaster]) -> list[Section]:
    """Return the section of the unknown terms of an equation, of the first model with any."""
    for each in (part for whole in models for part in all_parts(whole)):
        if isinstance(each, GreyBox) and (drawn := model.unknown(each)):
            text = (
                "These curves take the place of the unknown terms of the equation, over the ranges "
                "of their arguments in training. Beyond, a term continues as a straight line. "
                "Shaded: the range of all trainings that fit as well."
            )
            return [Section("unknown", "Unknown terms", [text], plots=drawn)]
    return []


def _seeds(result: Comparison, listed: Table) -> list[Section]:
    """Return the section of the spread over the seeds of methods with several trainings."""
    every = next(runs for runs in predicted(result) if runs.predictions)
    found = list[Column]()
    for i, column in enumerate(every.record.columns):
        fits = {
            name: [float(fit_percent(every.truth(p), p.y)[i]) for p in of]
            for name, of in every.trainings.items()
            if len(of) > 1
        }
        for what, measure in (("lowest", min), ("median", statistics.median), ("highest", max)):
            values = {name: float(measure(of)) for name, of in fits.items()}
            channel = column if every.record.ny > 1 else ""
            found.append(Column(f"{what} fit %", "percent", values, channel, ranked=False))
    counts = {n: float(len(result.fits[n])) for n in listed.rows if len(result.fits.get(n, ())) > 1}
    if not counts:
        return []
    found.append(Column("trainings", "count", counts, ranked=False))
    title = (
        f"Fits of single trainings, which differ in their seed: {every.says}. The prediction of a "
        "method is the median of its trainings, and usually has a better fit."
    )
    table = Table(title, found, dict.fromkeys(counts, ""), labels=listed.labels)
    return [Section("seeds", "Spread over seeds", tables=[table])]


def of_check(
    result: ModelCheck, checked: Forecaster, responses: Sequence[Responses], used: Usage
) -> Page:
    """Return the page of a check of a model."""
    record, name = result.record, result.method
    label = checked.in_words() or name
    says = (
        "simulation" if result.free else f"the last {len(result.simulation):,} samples, one ahead"
    )
    run = Run(record, says, {name: _placed(result.simulation.y, record)})
    drawn = looks({name: label})
    answer = f"{result.title or name}: {result.summary()}"
    fits = f"{'; '.join(result.fits_in_words())}."
    said = [fits, *result.in_words()]
    plots = over_time.over_time(run, drawn)
    sections = [
        Section("answer", answer[:1].upper() + answer[1:], said, plots),
        *_by_band(run, drawn, None),
        *_residuals(result.tests, [test.finding() for test in result.tests]),
        *(_responses(checked) if responses else []),
        *_linear(checked),
        *_unknown([checked]),
        *_made(used),
    ]
    return Page(f"{name} on {record.name or 'a record'}", words.lead(record), sections)


def of_checks(checks: Mapping[str, ModelCheck], used: Usage) -> Page:
    """Return the page of checks of several models, by their folders, on one record."""
    record = next(iter(checks.values())).record
    drawn = looks({name: titled(name, check.title) for name, check in checks.items()})
    simulated = {name: _placed(checks[name].simulation.y, record) for name in drawn}
    run = Run(record, "simulation", simulated, alike=True)
    title = f"{len(checks)} models on {record.name or 'a record'}"
    plots, table = over_time.over_time(run, drawn), tables.of_checks(checks)
    listed = [replace(table, rows=dict.fromkeys(table.rows, ""))]
    sections = [
        Section("answer", "Simulations", plots=plots, tables=listed, items=table.remarks()),
        *_by_band(run, drawn, None),
        *_made(used),
    ]
    return Page(title, words.lead(record), sections)


def _placed(predicted: Array, record: Record) -> Array:
    """Return a prediction of the last samples of a record on all of them, NaN before."""
    y = np.full(record.y.shape, np.nan)
    y[len(y) - len(predicted) :] = predicted
    return y


def of_inspection(found: Inspection, used: Usage) -> Page:
    """Return the page of an inspection of a record."""
    record = found.record
    facts = [(c.name, f"{c.role}: {c.range}; {', '.join(c.reasons)}") for c in found.columns]
    warned, gaps = [*map(words.sentence, found.warnings)], words.of_gaps(record)
    drawn = frequency.spectrum(record, found.bands.cutoff)
    listed = [] if found.simulator is None else [tables.of_oracle(found.simulator)]
    said = [words.sentence(text) for text in found.in_words()]
    answer = Section("answer", "What it holds", said, drawn, listed, warned, gaps, facts=facts)
    return Page(record.name or "a record", words.lead(record), [answer, *_made(used)])


def _made(used: Usage) -> list[Section]:
    """Return the sections of commands for the model, and of how the page was made."""
    use = [Section("next", "Use it", code=used.commands)] if used.commands else []
    made = environment()
    facts = [("date", f"{datetime.now().astimezone():%Y-%m-%d %H:%M %Z}"), ("command", used.asked)]
    facts += [
        (f"SHA-256 of {Path(each).name}", sha256_of(each))
        for each in used.files
        if Path(each).is_file()
    ]
    facts += [("versions", ", ".join(f"{name} {v}" for name, v in made["versions"].items()))]
    facts += [("machine", made["machine"]), ("commit", made["commit"])]
    return [*use, Section("made", "How it was made", facts=[(n, v) for n, v in facts if v])]

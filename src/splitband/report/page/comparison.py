"""The page of a comparison."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from splitband.evaluation.comparison import Comparison
from splitband.evaluation.selection import Trial
from splitband.forecasters.configurable import parts_of
from splitband.report.numbers import number
from splitband.report.page import horizon, tables, time_plots, usage, words
from splitband.report.page.about import lead, settings
from splitband.report.page.ahead import BEFORE, Ahead
from splitband.report.page.checked import residuals
from splitband.report.page.parts import Code, MethodStyles, Page, Section, View
from splitband.report.page.spectra import spectrum
from splitband.report.page.training import training
from splitband.report.page.usage import Usage
from splitband.report.table import ordered

Array = npt.NDArray[np.float64]

SHOWN = 3
"""Methods drawn at first beside the recommended one: the next best on held-out samples."""


def page(comparison: Comparison, used: Usage) -> Page:
    """Return the whole page: the answer first, then the other methods, then what experts ask."""
    record, trial = comparison.record, comparison.require_trial()
    styles = method_styles(ordered(trial, comparison.runs), trial)
    most = time_plots.most_points(comparison)
    frame = time_plots.Frame.of(record, styles, most, "time")
    train = comparison.setup.train
    if comparison.predictions:
        first = max(train - (len(record) - train) // BEFORE, 0)
        frame.x_range.update(start=frame.axis.values[first], end=frame.axis.values[-1])
    why = words.why(trial, train)
    sections = [
        _answer(comparison, styles, used),
        Section("methods", "All methods", [" ".join(why)], tables=[tables.methods(comparison)]),
        *_over_time(comparison, frame, most),
        *([residuals(tested, folded=True)] if (tested := comparison.residual_tests()) else []),
        _bands(comparison),
        *_trained(comparison, styles),
        usage.section(
            comparison.forecaster(), record, used, max(len(record) // 4, 1), bool(comparison.others)
        ),
        _settings(comparison, used),
    ]
    return Page(
        record.name or "a record",
        lead(record),
        sections,
        styles.methods,
        _views(comparison, frame),
        intervals=bool(comparison.predictions),
    )


def method_styles(names: list[str], trial: Trial) -> MethodStyles:
    """The methods, the recommended one and the next best drawn at first."""
    ranked = [name for name in sorted(trial.scores, key=lambda n: trial.scores[n]) if name in names]
    others = [name for name in ranked if name != trial.recommended]
    return MethodStyles(names, trial.recommended, frozenset([trial.recommended, *others[:SHOWN]]))


def _answer(comparison: Comparison, styles: MethodStyles, used: Usage) -> Section:
    best = comparison.recommended
    kind = words.in_words(best, comparison.forecasters)
    text = [" ".join([f"Short name: {best}." if kind else "", *words.afterwards(comparison)])]
    plots = [plot for each in _achieved(comparison, styles) for plot in each.plots()]
    return Section(
        "answer", f"Recommended: {kind or best}", text, words.warnings(comparison),
        facts=words.headline(comparison),
        plots=plots, code=[Code(caption, command) for caption, command in used.commands],
    )  # fmt: skip


def _achieved(comparison: Comparison, styles: MethodStyles) -> list[Ahead]:
    """Return what the recommended method predicted of samples that nothing was fitted to."""
    best, train = styles.of(comparison.recommended), comparison.setup.train
    mean = comparison.means[best.name]
    if mean.tests:
        return [
            Ahead(test, len(test) - len(y), y, best, f"simulation of the test record {test.name}")
            for test, y in zip(comparison.tests, mean.tests, strict=True)
        ]
    if best.name in comparison.predictions:
        forecast = comparison.predictions[best.name]
        return [Ahead(comparison.record, train, forecast, best, "forecast after the training part")]
    start = len(comparison.record) - len(mean.from_start)
    return [Ahead(comparison.record, start, mean.from_start, best, "simulation")]


def _over_time(comparison: Comparison, frame: time_plots.Frame, most: int) -> list[Section]:
    """Return the sections of forecasts, test records, errors, simulations and components."""
    text = ["These plots zoom together. Shaded: the warm-up; dashed: the end of the training part."]
    if frame.size > 1:
        text.append(
            f"The record is longer than a screen is wide: of every {frame.size} samples each line "
            "shows the lowest and the highest, so that no peak is lost."
        )
    sections = []
    if comparison.predictions:
        plots = time_plots.free_runs(comparison, frame, "forecast")
        sections.append(Section("forecasts", "Forecasts of all methods", text, plots=plots))
    if comparison.tests:
        text = ["Simulated from their first samples; nothing was fitted to them."]
        plots = time_plots.test_runs(comparison, frame.styles, most)
        sections.append(Section("tests", "Test records, all methods", text, plots=plots))
    plots = time_plots.free_runs(comparison, frame, "from the start")
    title = "Simulations from the start of the record"
    sections.append(Section("runs", title, text[:1], plots=plots, folded=True))
    text = [
        "RMSE of each output up to each horizon: the error of a model that does not drift stays "
        "flat. Lines: the mean of the seeds' predictions; shaded: the range of single seeds."
    ]
    plots = horizon.errors(comparison, frame.styles, most)
    sections.append(Section("errors", "Error over horizon", text, plots=plots, folded=True))
    parts = time_plots.components(comparison, frame)
    if parts:
        text = ["The parts of which a model's output is the sum, each less its mean, and the "
                "measurement likewise; for the methods that are switched on."]  # fmt: skip
        title = "Components of hybrid and split models"
        sections.append(Section("components", title, text, plots=parts, folded=True))
    return sections


def _bands(comparison: Comparison) -> Section:
    """Return the spectrum, and the cut-off between the bands."""
    bands = comparison.setup.bands
    part = comparison.record[: comparison.setup.train]
    text = []
    if bands.cutoff is not None:
        text.append(
            f"Models of two bands split the signal at {number(bands.cutoff)} Hz, with filters of "
            f"order {bands.order}; the low band keeps one of {bands.downsampling} samples."
            + (f" {_sentence(bands.choice.reason)}" if bands.choice else "")
        )
    plots = spectrum(part, bands.cutoff, bands.choice, _bases(comparison))
    return Section("spectrum", "Spectrum and cut-off", text, plots=plots, folded=True)


def _bases(comparison: Comparison) -> dict[str, Array]:
    """What holds the slow part of a hybrid model in a simulator's place, over the training part.

    Its first samples, which are a warm-up, are the record's own.
    """
    train, record = comparison.setup.train, comparison.record
    found: dict[str, Array] = {}
    for name, method in comparison.forecasters.items():
        run = comparison.runs[name][0]
        parts: Mapping[str, Array] = run.unfiltered or run.from_start.components
        slow = [part.as_base for part in parts_of(method).values()]
        for label in [base.label for base in slow if base.before and base.label in parts]:
            whole = record.y.copy()
            whole[len(whole) - len(parts[label]) :] = parts[label]
            found.setdefault(label, whole[:train])
    return found


def _trained(comparison: Comparison, styles: MethodStyles) -> list[Section]:
    """Training curves and what the search has tried."""
    sections = []
    plots = training(comparison.runs, styles)
    if plots:
        text = ["The training loss of each epoch and seed, of the networks that are switched on; a "
                "line that still falls at its end would gain from a longer training."]  # fmt: skip
        sections.append(Section("training", "Training", text, plots=plots, folded=True))
    if comparison.attempts:
        tried = [tables.attempts(comparison.attempts)]
        text = ["How networks are trained was found on the last quarter of the training samples."]
        sections.append(Section("search", "What was tried", text, tables=tried, folded=True))
    return sections


def _settings(comparison: Comparison, used: Usage) -> Section:
    facts = comparison.setup.as_json()
    facts.pop("choice", None)
    return settings(tables.flat(facts), used)


def _views(comparison: Comparison, frame: time_plots.Frame) -> list[View]:
    values, train = frame.axis.values, comparison.setup.train
    views = [View("Whole record", *frame.axis.whole)]
    if train < len(values):
        views += [
            View("Training part", values[0], values[train - 1]),
            View("After it", values[train], values[-1]),
        ]
    return views


def _sentence(text: str) -> str:
    return text[:1].upper() + text[1:] + ("" if text.endswith(".") else ".")

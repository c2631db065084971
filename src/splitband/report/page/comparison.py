"""The page of a comparison."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.selection import Trial
from splitband.forecasters.base import parts_of
from splitband.report.numbers import number
from splitband.report.page import horizon, tables, time_plots, usage, words
from splitband.report.page.parts import MethodStyles, Page, Section, View
from splitband.report.page.spectra import spectrum
from splitband.report.page.training import training
from splitband.report.page.usage import Usage
from splitband.report.results import environment
from splitband.report.table import columns

Array = npt.NDArray[np.float64]

SHOWN = 3
"""Methods drawn at first beside the recommended one: the next best on held-out samples."""


def page(comparison: Comparison, used: Usage) -> Page:
    """All of it."""
    record, trial = comparison.record, comparison.require_trial()
    styles = method_styles([*comparison.runs], trial)
    most = time_plots.most_points(comparison)
    frame = time_plots.Frame.of(record, styles, most, "time")
    sections = [
        _answer(comparison),
        Section("methods", "All methods", tables=[tables.methods(comparison)]),
        *_over_time(comparison, frame, most),
        _bands(comparison),
        *_trained(comparison, styles),
        usage.section(
            comparison.forecaster(), record, used, max(len(record) // 4, 1), bool(comparison.others)
        ),
        _settings(comparison, used),
    ]
    name = record.name or "a record"
    return Page(
        f"{name}: which model to use",
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


def lead(record: Record) -> str:
    """The record in a line."""
    every = f"{record.sampling_time:.6g} s"
    said = f"{len(record):,} samples every {every}, measured: {', '.join(record.columns)}"
    return said + (f"; known inputs: {', '.join(record.inputs)}" if record.nu else "")


def _answer(comparison: Comparison) -> Section:
    best, record = comparison.recommended, comparison.record
    kind = words.in_words(best, comparison.forecasters)
    text = [f"{best} is {kind}."] if kind else []
    train = comparison.setup.train
    text += [" ".join(words.why(comparison.require_trial(), train, len(record) - train))]
    text += [" ".join(words.afterwards(comparison))]
    facts = [
        (column.title, column.entry(best))
        for column in columns(comparison)
        if column.unit in ("record", "share") and best in column.values
    ]
    return Section("answer", f"Recommended: {best}", text, words.warnings(comparison), facts=facts)


def _over_time(comparison: Comparison, frame: time_plots.Frame, most: int) -> list[Section]:
    """Free runs, test records, errors and components."""
    ahead = " and forecasts" if comparison.predictions else ""
    text = ["These plots zoom together. Shaded: the warm-up; dashed: the end of the training part."]
    if frame.size > 1:
        text.append(
            f"The record is longer than a screen is wide: of every {frame.size} samples each line "
            "shows the lowest and the highest, so that no peak is lost."
        )
    sections = [
        Section("runs", f"Free runs{ahead}", text, plots=time_plots.free_runs(comparison, frame))
    ]
    if comparison.tests:
        text = ["Simulated from their first samples; nothing was fitted to them."]
        plots = time_plots.test_runs(comparison, frame.styles, most)
        sections.append(Section("tests", "Test records", text, plots=plots))
    text = [
        "The RMSE of each channel up to each horizon: a model whose error stays flat does not "
        "drift. Lines: the mean of the seeds' predictions; shaded: the range of the single seeds, "
        "whose errors may all be larger."
    ]
    plots = horizon.errors(comparison, frame.styles, most)
    sections.append(Section("errors", "Error over horizon", text, plots=plots))
    parts = time_plots.components(comparison, frame)
    if parts:
        text = ["What the models of several parts add up, for the methods that are switched on."]
        sections.append(Section("components", "Components", text, plots=parts))
    return sections


def _bands(comparison: Comparison) -> Section:
    """The spectrum, and where the bands part."""
    bands = comparison.setup.bands
    part = comparison.record[: comparison.setup.train]
    text = []
    if bands.cutoff is not None:
        text.append(
            f"Models of two bands part them at {number(bands.cutoff)} Hz, with filters of order "
            f"{bands.order}; the low band keeps one of {bands.downsampling} samples."
            + (f" {_sentence(bands.choice.reason)}" if bands.choice else "")
        )
    plots = spectrum(part, bands.cutoff, bands.choice, _bases(comparison))
    return Section("spectrum", "Spectrum and cut-off", text, plots=plots)


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
        sections.append(Section("training", "Training", text, plots=plots))
    if comparison.attempts:
        tried = [tables.attempts(comparison.attempts)]
        text = ["How networks are trained was found on the last quarter of the training samples."]
        sections.append(Section("search", "What was tried", text, tables=tried, folded=True))
    return sections


def _settings(comparison: Comparison, used: Usage) -> Section:
    facts = comparison.setup.as_json()
    facts.pop("choice", None)
    return settings(tables.flat(facts), used)


def settings(facts: list[tuple[str, str]], used: Usage) -> Section:
    """What the numbers were made with."""
    made = environment()
    pairs = [("command", used.asked)] if used.asked else []
    versions = ", ".join(f"{name} {v}" for name, v in made["versions"].items())
    pairs += [*facts, ("versions", versions), ("machine", made["machine"])]
    pairs += [("commit", made["commit"])] if made["commit"] else []
    return Section("settings", "Settings and versions", facts=pairs, folded=True)


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

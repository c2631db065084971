"""Make the page of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import asdict

from splitband.evaluation.comparison import Comparison
from splitband.forecasters.backtest import Fit
from splitband.forecasters.base import parts_of
from splitband.forecasters.prediction import Prediction
from splitband.models.labels import SLOW
from splitband.report import words
from splitband.report.numbers import number
from splitband.report.page import linear, tables
from splitband.report.page.check import residual_tests
from splitband.report.page.curves import losses, spectrum
from splitband.report.page.parts import Method, Page, Plot, Section, Usage, View, method_styles
from splitband.report.page.predicted import Predicted
from splitband.report.table import of_test, ordered
from splitband.runtime.arrays import Array


def page(comparison: Comparison, used: Usage) -> Page:
    """Return the whole page: the answer first, then the other methods, then details."""
    record, trial, best = comparison.record, comparison.require_trial(), comparison.recommended
    styles = method_styles(ordered(trial, comparison.fits), best)
    answer, errors = _predicted(comparison, styles)
    kind = words.in_words(best, comparison.methods)
    sections = [
        Section(
            "answer", f"Recommended: {words.named(best, kind)}", words.afterwards(comparison),
            [words.sentence(w) for w in (*words.warnings(comparison), *words.of_gaps(record))],
            facts=[(of, "\n".join(said)) for of, said in words.headline(comparison)],
            plots=[plot for each in answer for plot in (*each.outputs(), *each.inputs())],
        ),
        *tables.next_steps(used),
        Section("methods", "All methods", [" ".join(words.why(trial, comparison.plan.train))],
                tables=[tables.methods(comparison)]),
        _residuals(comparison, answer),
        *_linear(comparison),
        Section("errors", "Error over horizon", [_HORIZON], plots=errors, folded=True),
        *_further(comparison, styles),
        _bands(comparison),
        *_trained(comparison, styles),
        tables.settings(tables.flat(_shared(comparison)), used),
    ]  # fmt: skip
    views = _views(comparison, answer[0])
    return Page(record.name or "a record", words.lead(record), sections, [*styles.values()], views)


def _shared(comparison: Comparison) -> dict[str, object]:
    """Return the settings that all methods share, without those that a search found for each."""
    plan = comparison.plan
    facts = {**plan.as_json(), "choice": None}
    if not plan.searched:
        return facts
    found = {"settings", *asdict(plan.sizes)}
    kept = {name: value for name, value in facts.items() if name not in found}
    return kept | {"warmup": plan.settings.warmup}


_HORIZON = (
    "RMSE up to each horizon: the error of a model that does not drift stays flat. Lines: the "
    "median of a method's trainings, which is its prediction; shaded: the range of all of them."
)


def _predicted(
    comparison: Comparison, styles: Mapping[str, Method]
) -> tuple[list[Predicted], list[Plot]]:
    """Return the predictions that are shown first, with plots of their errors.

    They are those of the test records, else the forecast, else the simulation of the record.
    """
    record, medians = comparison.record, comparison.medians
    takes: list[tuple[Callable[[Fit], Prediction | None], Predicted]] = []
    for i, test in enumerate(comparison.tests):
        tested = {name: run.tests[i] for name, run in medians.items() if run.tests}
        says = f"simulation of the test record {test.name}"
        if tested:
            takes.append(
                (of_test(i), Predicted.of(test, tested, styles, says, name="" if i else "time"))
            )
    if not takes and comparison.predictions:
        says = "forecast after the training part"
        found = Predicted.of(record, comparison.predictions, styles, says, name="time")
        takes.append((lambda run: run.forecast, found))
    if not takes:
        whole = {name: run.from_start for name, run in medians.items()}
        found = Predicted.of(record, whole, styles, "simulation", name="time")
        takes.append((lambda run: run.from_start, found))
    plots = []
    for take, shown in takes:
        each = {n: [p for r in comparison.fits[n] if (p := take(r))] for n in shown.predictions}
        plots += shown.errors(each)
    return [shown for _, shown in takes], plots


def _residuals(comparison: Comparison, answer: list[Predicted]) -> Section:
    """Return the section of residuals over time and of the recommended method's residual tests."""
    tested = residual_tests(comparison.residual_tests())
    plots = [*tested.plots, *(plot for each in answer for plot in each.residuals())]
    return Section("residuals", "Residuals", tested.words, plots=plots, folded=True)


def _linear(comparison: Comparison) -> list[Section]:
    """Return the section of the linear model, if it is one of the methods."""
    fitted = [fit.fitted for fits in comparison.fits.values() for fit in fits]
    return [linear.section(each, model) for each in fitted if (model := each._linear_model())]


def _further(comparison: Comparison, styles: Mapping[str, Method]) -> list[Section]:
    """Return the sections of the forecast (if test records come first), simulations, components."""
    sections = []
    if comparison.tests and comparison.predictions:
        forecast = Predicted.of(comparison.record, comparison.predictions, styles, "forecast")
        sections.append(Section("forecast", "Forecast", plots=forecast.outputs(), folded=True))
    whole = {name: run.from_start for name, run in comparison.medians.items()}
    says = "simulation from the first samples"
    simulated = Predicted.of(comparison.record, whole, styles, says)
    title = "Simulation from the start of the record"
    sections.append(Section("runs", title, plots=simulated.outputs(), folded=True))
    parts = simulated.components()
    if parts:
        names = ", ".join(name for name, y in whole.items() if y.components)
        text = ["A model's output is the sum of these parts. All curves are without their means. "
                f"Switch on a method to see its parts: {names}."]  # fmt: skip
        title = "Components of hybrid and split models"
        sections.append(Section("components", title, text, plots=parts, folded=True))
    return sections


def _bands(comparison: Comparison) -> Section:
    """Return the section of the spectrum and the cut-off between the bands."""
    bands = comparison.plan.bands
    part = comparison.record[: comparison.plan.train]
    text = []
    if bands.cutoff is not None:
        text.append(
            f"Models of two bands split the signal at {number(bands.cutoff)} Hz, with filters of "
            f"order {bands.order}; the low band keeps one of {bands.downsampling} samples."
            + (f" {words.sentence(bands.choice.reason)}" if bands.choice else "")
        )
    plots = spectrum(part, bands.cutoff, _bases(comparison))
    return Section("spectrum", "Spectrum and cut-off", text, plots=plots, folded=True)


def _bases(comparison: Comparison) -> dict[str, Array]:
    """Return the training-part outputs of fitted models that replace a simulator in hybrids.

    Their first samples, the warm-up, are the record's.
    """
    train, record = comparison.plan.train, comparison.record
    found: dict[str, Array] = {}
    for fits in comparison.fits.values():
        run, method = fits[0], fits[0].fitted
        parts: Mapping[str, Array] = run.unfiltered or run.from_start.components
        slow = [part._slow_label for part in parts_of(method)]
        for label in [each for each in slow if each in parts and each != SLOW]:
            whole = record.y.copy()
            whole[len(whole) - len(parts[label]) :] = parts[label]
            found.setdefault(label, whole[:train])
    return found


def _trained(comparison: Comparison, styles: Mapping[str, Method]) -> list[Section]:
    """Return the sections of training curves and of the search."""
    sections = []
    plots = losses(comparison.fits, styles)
    if plots:
        text = ["Loss over the epochs of each training, for the networks that are switched on. A "
                "line that still falls at its end would gain from a longer training."]  # fmt: skip
        sections.append(Section("training", "Training", text, plots=plots, folded=True))
    if comparison.attempts:
        tried = [tables.attempts(comparison.attempts)]
        text = ["How networks are trained was found on the last quarter of the training samples."]
        sections.append(Section("search", "What was tried", text, tables=tried, folded=True))
    return sections


def _views(comparison: Comparison, shown: Predicted) -> list[View]:
    """Return the time ranges of the first plots that have a button."""
    values, train = shown.axis.values, comparison.plan.train
    views = [View("Whole record", values[0], values[-1])]
    if shown.record is comparison.record and train < len(values):
        views += [
            View("Training part", values[0], values[train - 1]),
            View("After it", values[train], values[-1]),
        ]
    return views

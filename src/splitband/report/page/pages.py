"""Lay out the pages of comparisons, checks and inspections."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from itertools import product

import numpy as np
import numpy.typing as npt

from splitband.checks.inspection import Inspection
from splitband.checks.model import ModelCheck
from splitband.checks.residuals import CONFIDENCE, ResidualTests
from splitband.checks.responses import SHARE, Responses, respond_over_range
from splitband.comparison.result import Comparison
from splitband.forecasters.base import Forecaster, all_parts, parts_of, titled
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.linear import Linear
from splitband.forecasters.network import Network
from splitband.metrics import tenths
from splitband.models.labels import SIMULATOR
from splitband.report import tables, words
from splitband.report.environment import environment
from splitband.report.numbers import complex_in_words, percent
from splitband.report.page import plots
from splitband.report.page.charts import Chart
from splitband.report.page.parts import Method, Page, Section, Usage, method_styles
from splitband.report.predictions import Predicted, predicted, what_was_known
from splitband.report.tables import ordered
from splitband.runtime.arrays import Array

MAX_BODE = 4
"""Largest number of pairs of input and output with gain and phase, too. Bounds the time."""


def of_comparison(result: Comparison, used: Usage) -> Page:
    """Return the page of a comparison: the answer, its plot, the other methods, then details."""
    record, trial, best = result.record, result.require_trial(), result.recommended
    listed = tables.of_comparison(result)
    answer = f"Recommended: {titled(best, listed.label(best))}"
    called = {name: listed.label(name) for name in ordered(trial, result.fits)}
    leaving = {name for name in called if name != best and tables.leaving_range(result, name)}
    styles = method_styles(called, best, {*listed.minor, *leaving})
    every = [runs for runs in predicted(result) if runs.predictions]
    first = [runs for runs in every if runs.protocol == every[0].protocol]
    shown = [plots.OverTime(p, styles, "" if i else "time") for i, p in enumerate(first)]
    curves = [plot for over_time in shown for plot in (*over_time.outputs(), *over_time.inputs())]
    left, errors = [p for s in shown for p in s.residuals()], [p for s in shown for p in s.errors()]
    warnings = (*result.warnings, *words.warnings(result), *words.of_gaps(record))
    warned = [*map(words.sentence, warnings)]
    plan = result.plan
    why = " ".join(words.why(trial, plan.train, listed.labels, plan.ahead))
    headline = [(of, "\n".join(facts)) for of, facts in words.headline(result)]
    ahead = plots.errors_ahead(result, styles)
    sections = [
        Section("answer", answer, words.afterwards(result), warned, facts=headline),
        Section("plot", "Measured and predicted", [what_was_known(result)], plots=curves),
        Section("methods", "All methods", [why], tables=[listed]),
        *([Section("ahead", "Error by samples ahead", [_AHEAD], plots=ahead)] if ahead else []),
        _residuals([*words.verdicts(result)], result.residual_tests, "Residuals", left),
        *_responses(result, styles),
        *_next_steps(used),
        *map(_of_linear, _linear_of(result)),
        *_unknown([fits[0].fitted for fits in result.fits.values()]),
        Section("errors", "Error over horizon", [_HORIZON], plots=errors, folded=True),
        *_further([p for p in every if p not in first or p.protocol == "start"], styles),
        _bands(result),
        *_trained(result, styles),
        _settings(_flat(_shared(result)), used),
    ]
    title, at, train = record.name or "a record", shown[0].axis.values, plan.train
    views = {"Whole record": (at[0], at[-1])}
    if first[0].protocol != "test" and train < len(at):
        views |= {"Training part": (at[0], at[train - 1]), "After it": (at[train], at[-1])}
    return Page(title, words.lead(record), sections, [*styles.values()], views)


_AHEAD = (
    "RMSE of forecasts from many origins, each with the measurements until then. Methods are "
    "chosen by such forecasts of held-out samples."
)
_HORIZON = (
    "RMSE up to each horizon: the error of a model that does not drift stays flat. Lines: the "
    "median of a method's trainings, which is its prediction; shaded: the range of all of them."
)


def _shared(result: Comparison) -> dict[str, object]:
    """Return the common settings of all methods, without those of a search."""
    plan = result.plan
    facts = {**plan.as_json(), "choice": None}
    if not plan.searched:
        return facts
    searched = {"settings", *asdict(plan.sizes)}
    common = {name: value for name, value in facts.items() if name not in searched}
    return common | {"warmup": plan.settings.warmup}


def _residuals(
    verdicts: Sequence[str], tests: Sequence[ResidualTests], title: str, further: Sequence[Chart]
) -> Section:
    """Return the section of the residual tests with their verdicts, and further plots."""
    text = [
        " ".join(verdicts),
        f"Shaded: the band that holds {100 * CONFIDENCE:.0f} % of the values by chance. Residuals "
        "that depend on an input show dynamics that the model misses; residuals that depend on "
        "their own past show a disturbance, or such dynamics.",
    ]
    stems = [plots.correlation(t.output, c) for t in tests for c in (t.whiteness, *t.inputs)]
    return Section("residuals", title, text if tests else (), plots=[*stems, *further])


def _responses(result: Comparison, styles: Mapping[str, Method]) -> list[Section]:
    """Return the section of the responses of the recommended and of the linear model."""
    models = {result.recommended: result.model}
    for linear in _linear_of(result):
        models.setdefault(linear.name, linear)
    every = {name: respond_over_range(model) for name, model in models.items()}
    by_model = {name: responses for name, responses in every.items() if responses}
    if not by_model:
        return []
    outside = [styles[name].label for name, model in models.items() if "simulator" in model.needs]
    shown = " and ".join(styles[name].label for name in by_model)
    remark = f"Of {shown}: {outside[0]} needs its simulator's output." if outside else ""
    few = result.record.nu * result.record.ny <= MAX_BODE
    return [_responses_of(by_model, styles, remark, few)]


def _responses_of(
    by_model: Mapping[str, Sequence[Responses]],
    styles: Mapping[str, Method],
    remark: str = "",
    bode: bool = True,
) -> Section:
    """Return the section of step and Bode responses at the operating points of the models."""
    most = max(by_model.values(), key=len)
    text = (
        "Change of the output for a step of 1, from small steps of one input at a time around the "
        f"mean of the training inputs, {most[0].operating_point}"
    )
    slope = "; gain and phase are the Fourier transform of its slope. The upper axis is in rad/s."
    text += slope if bode else ". Gain and phase: splitband check."
    if len(most) > 1:
        text += (
            f" Dashed and dotted: all inputs at {percent(SHARE)} and {percent(1 - SHARE)} of their "
            "ranges in training. Where the curves differ, the model is nonlinear: its gain depends "
            "on the operating point."
        )
    remarks = dict.fromkeys(sentence for of in by_model.values() for sentence in of[0].remarks)
    drawn = plots.responses(by_model, styles, bode)
    title = "Step and Bode responses" if bode else "Step responses"
    return Section("responses", title, [remark, text, *remarks], (), tables.of_gains(most), drawn)


def _linear_of(result: Comparison) -> list[Linear]:
    """Return the fitted linear model, if among the methods."""
    every = (fit.fitted for fits in result.fits.values() for fit in fits)
    return [fitted for fitted in every if isinstance(fitted, Linear)][:1]


def _of_linear(fitted: Linear) -> Section:
    """Return the section of a linear model: poles, zeros, order, gain."""
    record, model = fitted.require_fitted().record, fitted.model
    over_order, gains = plots.orders(model), plots.gains(record, model)
    text = [fitted.describe() + "."]
    if over_order:
        text.append(
            "Singular values are the correlations of the past with the future of the outputs: "
            "a state for each that stands out. The order is the smallest whose held-out "
            "simulation error is at most one standard error above the least."
        )
    if gains:
        text.append("Shaded: the 95 % interval of the gain, by its standard error.")
    pairs = product(enumerate(record.inputs), enumerate(record.columns))
    zeros = [(f"zeros, {u} to {y}", _roots(fitted.zeros(j, i))) for (i, u), (j, y) in pairs]
    poles = [tables.of_poles(fitted)] if model.order else []
    drawn, title = [*over_order, *gains], "Linear model: poles, zeros, order, gain"
    return Section("linear", title, text, (), poles, drawn, facts=zeros, folded=True)


def _unknown(models: Sequence[Forecaster]) -> list[Section]:
    """Return the section of the unknown terms of an equation, of the first model with any."""
    for model in (part for each in models for part in all_parts(each)):
        if isinstance(model, GreyBox) and (drawn := plots.unknown(model)):
            text = (
                "What was found in place of the unknown terms of the equation, over the ranges of "
                "their quantities in training. Outside of them, a term is held. Shaded: the range "
                "of all trainings that fit as well."
            )
            return [Section("unknown", "Unknown terms", [text], plots=drawn)]
    return []


def _roots(roots: npt.NDArray[np.complex128]) -> str:
    """Return zeros in a line, with conjugate pairs as one."""
    return ", ".join(complex_in_words(root) for root in roots if root.imag >= 0) or "none"


def _further(every: Sequence[Predicted], styles: Mapping[str, Method]) -> list[Section]:
    """Return the sections of a second forecast, of simulations, of components."""
    sections = []
    for runs in every:
        drawn = plots.OverTime(runs, styles)
        ahead = runs.protocol == "forecast"
        caption = runs.says[:1].upper() + runs.says[1:]
        title = caption if ahead else "Simulation from the start of the record"
        name = "forecast" if ahead else "runs"
        sections.append(Section(name, title, plots=drawn.outputs(), folded=True))
        if parts := [] if ahead else drawn.components():
            names = ", ".join(styles[n].label for n, y in runs.predictions.items() if y.components)
            text = (
                "A model's output is the sum of these parts. All curves are without their means. "
                f"Switch on a method to see its parts: {names}."
            )
            title = "Components of hybrid and split models"
            sections.append(Section("components", title, [text], plots=parts, folded=True))
    return sections


def _bands(result: Comparison) -> Section:
    """Return the section of the spectrum and the cut-offs between the bands."""
    bands, part = result.plan.bands, result.record[: result.plan.train]
    text, choices = [words.of_bands(bands, part)], [bands.choice if bands.cutoff else None]
    for name, fits in result.fits.items():
        fitted = fits[0].fitted
        trained = fitted._trained_in if isinstance(fitted, Network) else None
        if trained is not None and trained.cutoff != bands.cutoff:
            text.append(f"{name}: {words.of_bands(trained, part)}")
            choices.append(trained.choice)
    drawn = plots.spectrum(part, bands.cutoff, _bases(result))
    drawn += [plots.cutoffs(choice) for choice in dict.fromkeys(choices) if choice is not None]
    return Section("spectrum", "Spectrum and cut-off", text, plots=drawn, folded=True)


def _bases(result: Comparison) -> dict[str, Array]:
    """Return the training-part outputs of fitted models in place of a simulator in hybrids.

    The first samples, the warm-up, are the record's.
    """
    train, record = result.plan.train, result.record
    bases: dict[str, Array] = {}
    for fits in result.fits.values():
        run, method = fits[0], fits[0].fitted
        parts: Mapping[str, Array] = run.unfiltered or run.from_start.components
        slow = [part.slow_label for part in parts_of(method)]
        for label in [name for name in slow if name in parts and name != SIMULATOR]:
            whole = record.y.copy()
            whole[len(whole) - len(parts[label]) :] = parts[label]
            bases.setdefault(label, whole[:train])
    return bases


def _trained(result: Comparison, styles: Mapping[str, Method]) -> list[Section]:
    """Return the sections of training curves and of the search."""
    sections = []
    if drawn := plots.losses(result.fits, styles):
        text = (
            "Loss over the epochs of each training, for the networks that are switched on. A line "
            "that still falls at its end would gain from a longer training."
        )
        sections.append(Section("training", "Training", [text], plots=drawn, folded=True))
    if result.attempts:
        listed = [tables.of_attempts(result.attempts)]
        text = (
            "Networks were trained on three quarters of the training samples, and scored on the "
            "rest. The best trainings then went on, on all training samples: the table of methods "
            "has their steps, too."
        )
        sections.append(Section("search", "What was tried", [text], tables=listed, folded=True))
    return sections


def of_check(
    result: ModelCheck, model: Forecaster, responses: Sequence[Responses], used: Usage
) -> Page:
    """Return the page of a check of a model."""
    record, name = result.record, result.method
    stable = model.require_fitted().report.stable
    said = "simulation" if stable else "predictions one sample ahead"
    shown = Predicted("start", said, record, {name: result.simulation})
    styles = {name: Method(name, label=model.in_words() or name)}
    drawn = plots.OverTime(shown, styles)
    facts = []
    for i, column in enumerate(record.columns):
        fits = [f"fit {tenths(of[i])} %, {horizon}" for horizon, of in result.fits.items()]
        facts.append((column, "\n".join(fits)))
    findings, title = [test.finding() for test in result.tests], "Is the model good? Residual tests"
    answer = f"{result.outcome.capitalize()}: {result.title or name}"
    curves = [*drawn.outputs(), *drawn.inputs()]
    sections = [
        Section("answer", answer, result.in_words(), plots=curves, facts=facts),
        _residuals(findings, result.tests, title, []),
    ]
    if responses:
        sections.append(_responses_of({name: responses}, styles))
    if isinstance(model, Linear):
        sections.append(_of_linear(model))
    sections += [*_unknown([model]), _settings([], used)]
    return Page(f"{name} on {record.name or 'a record'}", words.lead(record), sections)


def of_checks(checks: Mapping[str, ModelCheck], used: Usage) -> Page:
    """Return the page of checks of several models, by their folders, on one record."""
    record = next(iter(checks.values())).record
    simulated = {name: check.simulation for name, check in checks.items()}
    styles = method_styles({n: titled(n, c.title) for n, c in checks.items()}, next(iter(checks)))
    drawn = plots.OverTime(Predicted("start", "simulation", record, simulated), styles)
    curves, listed = [*drawn.outputs(), *drawn.inputs()], [tables.of_checks(checks)]
    title = f"{len(checks)} models on {record.name or 'a record'}"
    answer = Section("answer", title, plots=curves, tables=listed)
    return Page(title, words.lead(record), [answer, _settings([], used)], [*styles.values()])


def of_inspection(found: Inspection, used: Usage) -> Page:
    """Return the page of an inspection of a record."""
    record, bands = found.record, found.bands
    facts = [(c.name, f"{c.role}: {c.range}; {', '.join(c.reasons)}") for c in found.columns]
    items = [words.sentence(text) for text in (*found.warnings, *words.of_gaps(record))]
    drawn = plots.spectrum(record, bands.cutoff, {})
    drawn += [plots.cutoffs(bands.choice)] if bands.choice else []
    listed = [] if found.simulator is None else [tables.of_oracle(found.simulator)]
    said = [words.sentence(text) for text in found.in_words()]
    answer = Section("answer", "What it holds", said, items, listed, drawn, facts=facts)
    sections = [answer, *_next_steps(used), _settings([], used)]
    return Page(record.name or "a record", words.lead(record), sections)


def _next_steps(used: Usage) -> list[Section]:
    """Return the section of commands for the model, if any."""
    return [Section("next", "What to do next", code=used.commands)] if used.commands else []


def _settings(facts: Sequence[tuple[str, str]], used: Usage) -> Section:
    """Return the section of settings and versions."""
    made = environment()
    versions = ", ".join(f"{name} {v}" for name, v in made["versions"].items())
    pairs = [("command", used.asked), *facts, ("versions", versions)]
    pairs += [("machine", made["machine"]), ("commit", made["commit"])]
    shown = [(name, value) for name, value in pairs if value]
    return Section("settings", "Settings and versions", facts=shown, folded=True)


def _flat(facts: Mapping[str, object], before: str = "") -> list[tuple[str, str]]:
    """Return nested facts as pairs of a name and a text, without empty ones."""
    pairs: list[tuple[str, str]] = []
    for name, value in facts.items():
        if isinstance(value, Mapping):
            pairs += _flat(value, f"{before}{name} ")
        elif value not in (None, "", (), [], {}):
            text = ", ".join(map(str, value)) if isinstance(value, list | tuple) else str(value)
            pairs.append((f"{before}{name}".replace("_", " "), text))
    return pairs

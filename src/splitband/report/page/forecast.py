"""The page of a forecast."""

from __future__ import annotations

from splitband.evaluation.forecast import Forecast
from splitband.metrics import leaving
from splitband.report.numbers import number, percent
from splitband.report.page import tables, usage, words
from splitband.report.page.about import lead, settings
from splitband.report.page.ahead import Ahead
from splitband.report.page.comparison import method_styles
from splitband.report.page.parts import Code, Page, Plot, Section
from splitband.report.page.spectra import spectrum
from splitband.report.page.usage import Usage
from splitband.report.table import ordered, tried


def page(result: Forecast, used: Usage) -> Page:
    """Return the whole page."""
    record, steps = result.record, len(result.prediction)
    styles = method_styles(ordered(result.trial, result.trial.errors), result.trial)
    ahead = Ahead(record, len(record), result.prediction, styles.of(result.method), "forecast")
    why = words.why(result.trial, len(record))
    sections = [
        _answer(result, ahead.plots(), used),
        Section("methods", "What was tried", [" ".join(why)],
                tables=[tables.tried(result.trial, record)]),
        Section("spectrum", "Spectrum of the record", plots=spectrum(record, None, None, {}),
                folded=True),
        usage.section(result.forecaster, record, used, steps),
        settings([("seeds", ", ".join(map(str, result.seeds)))], used),
    ]  # fmt: skip
    title = f"{record.name or 'a record'}: {steps:,} samples ahead"
    return Page(title, lead(record), sections)


def _answer(result: Forecast, plots: list[Plot], used: Usage) -> Section:
    method, trial, record = result.method, result.trial, result.record
    interval = trial.intervals[method]
    kind = result.forecaster.in_words()
    text = [f"Short name: {method}."] if kind else []
    text += [result.description] if result.description else []
    items = [f"{method}: {leaving(result.leaves)}"] if result.leaves is not None else []
    items += words.of_inputs(result.inputs_beyond_training, record)
    items += [*result.prediction.warnings, *words.of_gaps(record)]
    items += [f"{name} could not be fitted: {why}" for name, why in trial.failed.items()]
    half = interval.half_widths(len(result.prediction)).mean(axis=0)
    held_out = [c for c in tried(trial, record, [method]) if c.heading == "held-out RMSE"]
    facts = [
        (
            name,
            f"± {number(float(width))} {unit}".rstrip()
            + f"\nmean {percent(interval.share)} interval"
            + f"\nheld-out RMSE {column.entry(method)} {unit}".rstrip(),
        )
        for name, width, unit, column in zip(
            record.columns, half, record.units, held_out, strict=True
        )
    ]
    code = [Code(caption, command) for caption, command in used.commands]
    title = f"Forecast by {kind or method}"
    return Section("answer", title, text, items, plots=plots, code=code, facts=facts)

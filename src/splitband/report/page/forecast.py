"""Make the page of a forecast."""

from __future__ import annotations

from splitband.evaluation.forecast import Forecast
from splitband.metrics import leaving
from splitband.report import words
from splitband.report.numbers import number, percent
from splitband.report.page import tables
from splitband.report.page.curves import spectrum
from splitband.report.page.parts import Method, Page, Section, Usage
from splitband.report.page.predicted import Predicted
from splitband.report.table import tried


def page(result: Forecast, used: Usage) -> Page:
    """Return the whole page."""
    record, steps = result.record, len(result.prediction)
    sections = [
        _answer(result),
        *tables.next_steps(used),
        Section("methods", "What was tried", [" ".join(words.why(result.trial, len(record)))],
                tables=[tables.tried(result.trial, record)]),
        Section("spectrum", "Spectrum of the record", plots=spectrum(record, None, {}),
                folded=True),
        tables.settings([("seeds", ", ".join(map(str, result.seeds)))], used),
    ]  # fmt: skip
    title = f"{record.name or 'a record'}: {steps:,} samples ahead"
    return Page(title, words.lead(record), sections)


def _answer(result: Forecast) -> Section:
    method, trial, record = result.method, result.trial, result.record
    interval, steps = trial.intervals[method], len(result.prediction)
    kind = result.model.in_words()
    text = [words.sentence(result.description)] if result.description else []
    items = [f"{method}: {leaving(result.leaves)}"] if result.leaves is not None else []
    items += words.of_inputs(result.inputs_beyond_training, record)
    items += [*result.prediction.warnings, *words.of_gaps(record)]
    items += [f"{name}: {why}" for name, why in trial.without_result.items()]
    half = interval.half_widths(steps).mean(axis=0)
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
    styles = {method: Method(method)}
    ahead = Predicted.of(record, {method: result.prediction}, styles, "forecast", steps)
    plots = [*ahead.outputs(), *ahead.inputs()]
    title = f"Forecast by {words.named(method, kind)}"
    return Section("answer", title, text, items, plots=plots, facts=facts)

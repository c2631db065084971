"""The page of a forecast."""

from __future__ import annotations

from splitband.evaluation.forecast import Forecast
from splitband.metrics import leaving
from splitband.report.numbers import number, percent
from splitband.report.page import figures, tables, usage, words
from splitband.report.page.comparison import lead, method_styles, settings
from splitband.report.page.figures import TALL, TimeAxis
from splitband.report.page.parts import Method, Page, Plot, Section, View
from splitband.report.page.spectra import spectrum
from splitband.report.page.thinning import bin_size, envelope, places, thinned
from splitband.report.page.time_plots import MOST
from splitband.report.page.usage import Usage
from splitband.report.table import tried

CONTEXT = 3
"""Times the forecast: how much of the record is seen before it at first."""


def page(result: Forecast, used: Usage) -> Page:
    """All of it."""
    record, steps = result.record, len(result.prediction)
    axis = TimeAxis.of(record, steps)
    end, first = len(record), max(len(record) - CONTEXT * steps, 0)
    styles = method_styles([*result.trial.errors], result.trial)
    views = [
        View("Whole record", *axis.whole),
        View("Its end and the forecast", axis.values[first], axis.values[-1]),
        View("Forecast", axis.values[end], axis.values[-1]),
    ]
    plots = _forecasts(result, axis, styles.of(result.method), (views[1].start, views[1].end))
    sections = [
        _answer(result),
        Section("forecast", "Forecast", _thinning(end + steps), plots=plots),
        Section("methods", "What was tried", tables=[tables.tried(result.trial, record)]),
        Section("spectrum", "Spectrum of the record", plots=spectrum(record, None, None, {})),
        usage.section(result.forecaster, record, used, steps),
        settings([("seeds", ", ".join(map(str, result.seeds)))], used),
    ]
    title = f"{record.name or 'a record'}: {steps:,} samples ahead"
    return Page(title, lead(record), sections, views=views)


def _answer(result: Forecast) -> Section:
    method, trial, record = result.method, result.trial, result.record
    interval = trial.intervals[method]
    kind = result.forecaster.in_words()
    text = [f"{method} is {kind}."] if kind else []
    text.append(" ".join(words.why(trial, len(record), len(result.prediction))))
    text += [result.description] if result.description else []
    items = [f"{method}: {leaving(result.leaves)}"] if result.leaves is not None else []
    items += words.of_inputs(result.inputs_beyond_training, record)
    items += [*result.prediction.warnings, *words.of_gaps(record)]
    items += [f"{name} could not be fitted: {why}" for name, why in trial.failed.items()]
    half = interval.half_widths(len(result.prediction)).mean(axis=0)
    facts = [
        (column.title, column.entry(method))
        for column in tried(trial, record, [method])
        if column.unit == "record"
    ]
    facts.append(("seeds", str(len(result.seeds))))
    facts += [
        (f"{column}: half the {percent(interval.share)} interval, on average", number(float(width)))
        for column, width in zip(record.columns, half, strict=True)
    ]
    return Section("answer", f"Forecast by {method}", text, items, facts=facts)


def _forecasts(
    result: Forecast, axis: TimeAxis, method: Method, seen: tuple[float, float]
) -> list[Plot]:
    """Each channel's record and forecast; they zoom together."""
    record, predicted = result.record, result.prediction
    end, steps = len(record), len(predicted)
    x_range = figures.time_range(*axis.whole, "time")
    x_range.update(start=seen[0], end=seen[1])
    size, plots = bin_size(end, MOST), []
    for i, column in enumerate(record.columns):
        parts = [record.seen[:, i], predicted.y[:, i]]
        y_range = figures.between(*figures.limits(parts))
        shown = figures.plain(
            column, axis.label, TALL, axis.dates, x_range=x_range, y_range=y_range
        )
        past = figures.source(
            axis.values[:end][places(end, size)], {"y": thinned(record.seen[:, i], size)}
        )
        figures.line(shown, past, "y", "measured", "measured", line_width=1.0)
        own = bin_size(steps, MOST)
        ahead = figures.source(
            axis.values[end:][places(steps, own)], {"y": thinned(predicted.y[:, i], own)}
        )
        if predicted.lower is not None and predicted.upper is not None:
            edges = envelope(predicted.lower[:, i], predicted.upper[:, i], own)
            for edge, values in zip(("lower", "upper"), edges, strict=True):
                ahead.data[edge] = values
            figures.method_band(shown, ahead, "lower", "upper", method)
        figures.method_line(shown, ahead, "y", method)
        figures.mark(shown, axis.values[end])
        figures.hover(shown, axis.label, axis.dates)
        first, last = predicted.y[0, i], predicted.y[-1, i]
        plots.append(
            Plot(
                shown,
                f"{column}: the record and what comes next",
                f"Line plot of {column} over {axis.label}: in grey what was measured, in colour "
                f"the forecast of {steps:,} samples, from {number(first)} to {number(last)}, with "
                "its interval shaded.",
                key=[("measured", "measured"), (f"c{method.color}", method.name)],
            )
        )
    return plots


def _thinning(samples: int) -> list[str]:
    size = bin_size(samples, MOST)
    if size == 1:
        return ["The dashed line is the end of the record."]
    return [
        "The dashed line is the end of the record, which is longer than a screen is wide: of every "
        f"{size} samples the line shows the lowest and the highest, so that no peak is lost."
    ]

"""The page of a check, and what the page of a comparison shows of one."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from bokeh.models.annotations import BoxAnnotation

from splitband.forecasters.checking import LEVEL, Correlation, ResidualTests
from splitband.forecasters.responses import Responses
from splitband.report.checked import CheckReport
from splitband.report.numbers import number
from splitband.report.page import figures
from splitband.report.page.about import lead, settings
from splitband.report.page.ahead import Ahead
from splitband.report.page.parts import Method, Page, Plot, Section
from splitband.report.page.usage import Usage


def page(report: CheckReport) -> Page:
    """Return the whole page."""
    check = report.check
    record = check.record
    start = len(record) - len(check.simulation)
    method = Method(check.method, 0, False, True, True)
    ahead = Ahead(record, start, check.simulation, method, "simulation")
    facts = [
        (column, "\n".join(f"fit {of[i]:.1f} %, {horizon}" for horizon, of in check.fits.items()))
        for i, column in enumerate(record.columns)
    ]
    title = f"{'Accepted' if check.accepted else 'Rejected'}: {report.kind or check.method}"
    sections = [
        Section("answer", title, check.in_words(), plots=ahead.plots(), facts=facts),
        residuals(check.tests),
        *([] if report.responses is None else [responses(report.responses)]),
        settings([], Usage(asked=report.asked)),
    ]
    return Page(f"{check.method} on {record.name or 'a record'}", lead(record), sections)


def residuals(tests: Sequence[ResidualTests], folded: bool = False) -> Section:
    """Return the section of the residual tests."""
    text = [
        " ".join(test.verdict() for test in tests),
        f"Shaded: the band that holds {100 * LEVEL:.0f} % of the values by chance. Residuals that "
        "depend on an input show dynamics that the model misses; residuals that depend on their "
        "own past show a disturbance, or such dynamics.",
    ]
    plots = [_stems(test.output, each) for test in tests for each in (test.whiteness, *test.inputs)]
    title = "Is the model good? Residual tests"
    return Section("residuals", title, text, plots=plots, folded=folded)


def _stems(output: str, correlation: Correlation) -> Plot:
    first = 1 if correlation.of == "residuals" else 0
    values = np.array(correlation.values)
    lags = first + np.arange(len(values), dtype=float)
    most = max(2 * correlation.band, 1.1 * float(abs(values).max()))
    shown = figures.plain(
        "correlation", "lag (samples)", figures.SMALL,
        x_range=figures.time_range(0.0, float(lags[-1])), y_range=figures.between(-most, most),
    )  # fmt: skip
    shown.min_border_left = 55
    band = BoxAnnotation(
        bottom=-correlation.band, top=correlation.band, fill_alpha=0.2, tags=["c0"]
    )
    shown.add_layout(band)
    data = figures.source(lags, {"value": values, "zero": np.zeros(len(values))})
    drawn = shown.segment(figures.X, "zero", figures.X, "value", source=data, line_width=2)
    drawn.update(tags=["c0"])
    figures.mark(shown, 0.0, "zero", "width")
    what = "its own past" if correlation.of == "residuals" else correlation.of
    outside = int((abs(values) > correlation.band).sum())
    says = (
        f"Correlation of the residuals of {output} with {what} by lag: {outside} of {len(values)} "
        f"values are outside the band of {number(correlation.band)}; p = {number(correlation.p)}."
    )
    return Plot(shown, f"{output} with {what}, p = {number(correlation.p)}", says, small=True)


def responses(found: Responses) -> Section:
    """Return the section of step and frequency responses."""
    plots = []
    frequencies, gains = found.frequency_response()
    for i, name in enumerate(found.inputs):
        for j, column in enumerate(found.columns):
            y, gain = found.y[:, j, i], np.maximum(abs(gains[:, j, i]), 1e-12)
            phase = np.degrees(np.unwrap(np.angle(gains[:, j, i])))
            said = f"{name} to {column}"
            plots.append(_curve(found.time, y, "time (s)", "change", f"Step response, {said}"))
            for values, label in ((gain, "gain"), (phase, "phase (degrees)")):
                title = f"{label.split(' ')[0].capitalize()}, {said}"
                plots.append(_curve(frequencies, values, "frequency (Hz)", label, title))
    pairs = zip(found.inputs, found.at, strict=True)
    held = ", ".join(f"{name} = {number(float(value))}" for name, value in pairs)
    text = [
        f"Small steps of one input at a time, from an operating point: {held}. Change of the "
        "output for a step of 1, and its Fourier transform."
    ]
    return Section("responses", "What has it learned? Responses to its inputs", text, plots=plots)


def _curve(x: figures.Array, y: figures.Array, x_label: str, y_label: str, title: str) -> Plot:
    logarithmic: dict[str, Any] = {"x_axis_type": "log"} if x_label.startswith("frequency") else {}
    low, high = figures.limits([y], 0.1)
    if y_label == "gain":
        logarithmic["y_axis_type"] = "log"
        low, high = 0.7 * float(y.min()), 1.5 * float(y.max())
    x_range = figures.along if logarithmic else figures.time_range
    shown = figures.plain(
        y_label, x_label, figures.SMALL, x_range=x_range(float(x[0]), float(x[-1])),
        y_range=figures.between(low, high), **logarithmic,
    )  # fmt: skip
    shown.min_border_left = 55
    figures.line(shown, figures.source(x, {"y": y}), "y", "c0", title, line_width=1.5)
    figures.hover(shown, x_label)
    says = (
        f"{title}: line plot over {x_label}, from {number(float(y[0]))} to {number(float(y[-1]))}."
    )
    return Plot(shown, title, says, small=True)

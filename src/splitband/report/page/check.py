"""Make the page of a check, and the residual tests that the page of a comparison also shows."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from bokeh.models import Segment
from bokeh.models.annotations import BoxAnnotation

from splitband.forecasters.checking import LEVEL, Correlation, ModelCheck, ResidualTests, Responses
from splitband.report import words
from splitband.report.numbers import number
from splitband.report.page import tables
from splitband.report.page.charts import SMALL, Axis, Chart, X, limits
from splitband.report.page.parts import Method, Page, Plot, Section, Usage
from splitband.report.page.predicted import Predicted
from splitband.runtime.arrays import Array


def page(check: ModelCheck, kind: str, responses: Responses | None, used: Usage) -> Page:
    """Return the whole page; `kind` describes the model in words."""
    record, name = check.record, check.method
    shown = Predicted.of(record, {name: check.simulation}, {name: Method(name)}, "simulation")
    facts = [
        (column, "\n".join(f"fit {of[i]:.1f} %, {horizon}" for horizon, of in check.fits.items()))
        for i, column in enumerate(record.columns)
    ]
    title = f"{'Accepted' if check.accepted else 'Rejected'}: {kind or name}"
    plots = [*shown.outputs(), *shown.inputs()]
    sections = [
        Section("answer", title, check.in_words(), plots=plots, facts=facts),
        residual_tests(check.tests),
        *([] if responses is None else [_responses(responses)]),
        tables.settings([], used),
    ]
    return Page(f"{name} on {record.name or 'a record'}", words.lead(record), sections)


def residual_tests(tests: Sequence[ResidualTests]) -> Section:
    """Return the section of the residual tests."""
    text = [
        " ".join(test.verdict() for test in tests),
        f"Shaded: the band that holds {100 * LEVEL:.0f} % of the values by chance. Residuals that "
        "depend on an input show dynamics that the model misses; residuals that depend on their "
        "own past show a disturbance, or such dynamics.",
    ]
    plots = [_stems(test.output, each) for test in tests for each in (test.whiteness, *test.inputs)]
    return Section(
        "residuals", "Is the model good? Residual tests", text * bool(tests), plots=plots
    )


def _stems(output: str, correlation: Correlation) -> Plot:
    own = correlation.of == "residuals"
    values, band = np.array(correlation.values), correlation.band
    lags = own + np.arange(len(values), dtype=float)
    most = max(2 * band, 1.1 * float(abs(values).max()))
    chart = Chart(Axis.over(lags, "lag (samples)"), "correlation", (-most, most), SMALL)
    shaded = BoxAnnotation(bottom=-band, top=band, fill_alpha=0.2, tags=["c0"])
    chart.figure.add_layout(shaded)
    stems = Segment(x0=X, x1=X, y0=chart.column(0 * values), y1=chart.column(values), line_width=2)
    chart.add(stems, output, ["c0"])
    chart.mark(0.0, "zero", "width")
    chance = f"p = {number(correlation.p)}" if correlation.p >= 0.001 else "p < 0.001"
    what = "its own past" if own else correlation.of
    outside = int((abs(values) > band).sum())
    says = (
        f"Correlation of the residuals of {output} with {what} by lag: {outside} of {len(values)} "
        f"values are outside the band of {number(band)}; {chance}."
    )
    return chart.plot(f"{output} with {what}, {chance}", says, small=True)


def _responses(found: Responses) -> Section:
    """Return the section of step and frequency responses."""
    plots = []
    frequencies, gains = found.frequency_response()
    for i, name in enumerate(found.inputs):
        for j, column in enumerate(found.columns):
            gain = np.maximum(abs(gains[:, j, i]), 1e-12)
            phase = np.degrees(np.unwrap(np.angle(gains[:, j, i])))
            time, bode = Axis.over(found.time, "time (s)"), Axis.over_frequency(frequencies, "Hz")
            said = f"{name} to {column}"
            plots += [
                _curve(time, found.y[:, j, i], "change", f"Step response, {said}"),
                _curve(bode, gain, "gain", f"Gain, {said}", log=True),
                _curve(bode, phase, "phase (degrees)", f"Phase, {said}"),
            ]
    pairs = zip(found.inputs, found.at, strict=True)
    held = ", ".join(f"{name} = {number(float(value))}" for name, value in pairs)
    text = [
        f"Small steps of one input at a time, from an operating point: {held}. Change of the "
        "output for a step of 1, and its Fourier transform."
    ]
    return Section("responses", "What has it learned? Responses to its inputs", text, plots=plots)


def _curve(axis: Axis, y: Array, label: str, title: str, log: bool = False) -> Plot:
    within = (0.7 * float(y.min()), 1.5 * float(y.max())) if log else limits([y])
    chart = Chart(axis, label, within, SMALL, log)
    chart.line(y, "c0", title, line_width=1.5)
    ends = f"from {number(float(y[0]))} to {number(float(y[-1]))}"
    return chart.plot(title, f"{title}: line plot over {axis.label}, {ends}.", small=True)

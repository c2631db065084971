"""Plot a record with predictions over time, and what they leave."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from splitband.comparison.result import Comparison
from splitband.forecasters.held_out import Origin, first_held_out
from splitband.forecasters.prediction import Prediction
from splitband.metrics import DIVERGED
from splitband.records import Record
from splitband.records.signals import unit_of
from splitband.report.numbers import percent
from splitband.report.page.charts import LOW, SMALL, TALL, Axis, Chart, limits
from splitband.report.page.parts import Key
from splitband.report.predictions import run_of
from splitband.runtime.arrays import Array

MAX_TALL_CHANNELS = 2
"""Largest number of outputs or inputs with plots of full size. Layout."""
MEASURED = "measured"
PARTS = {"training": "training", "held-out": "held", "test": "test"}
"""Parts of a record, with their colours in the page's style."""

Pieces = list[tuple[int, Prediction]]
"""Predictions of a record, with the index of their first samples."""


@dataclass(frozen=True, eq=False)
class Run:
    """A record, with the predictions by which methods are judged.

    Attributes
    ----------
    record : The measured record.
    says : What is predicted, in words.
    curves : By method, `(time, ny)`, NaN where nothing is predicted; the recommended one first.
    scored : The first sample of those that nothing was fitted to.
    half : Half-widths of the interval of the first method, `(time, ny)`, NaN where there is none.
    level : Of this interval, 0 to 1.
    parts : First and last sample of each part of the record.
    alike : Whether no method is recommended: all are seen at first, with their residuals.
    """

    record: Record
    says: str
    curves: Mapping[str, Array]
    scored: int = 0
    half: Array | None = None
    level: float = 0.0
    parts: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    alike: bool = False


def runs_of(found: Comparison, names: Collection[str]) -> list[Run]:
    """Return the predictions that judge methods: of test records, then of the record itself.

    These are simulations or, with `Plan.ahead`, forecasts from many origins that do not overlap.
    Before the end of the training part, the record is simulated from its start.
    """
    by_record: dict[Record, dict[str, Pieces]] = {each: {} for each in (*found.tests, found.record)}
    ahead = found.plan.ahead if any(found.judging(name) for name in names) else None
    for name in names:
        for record, pieces in _pieces(found, name, ahead):
            by_record[record][name] = pieces
    return [_run(found, record, of, ahead) for record, of in by_record.items() if of]


def _pieces(found: Comparison, name: str, ahead: int | None) -> list[tuple[Record, Pieces]]:
    """Return the predictions of a method, by record."""
    fit = found.medians[name]
    if ahead is not None:
        return [(record, _apart(made)) for record, made in found.judging(name)]
    tests = zip(found.tests, fit.tests, strict=False)
    of_tests = [(test, [(len(test) - len(said), said)]) for test, said in tests]
    own = [(next(iter(fit.forecasts)).at, fit.from_start)]
    own += [] if fit.forecast is None else [(found.plan.train, fit.forecast)]
    return [*of_tests, (found.record, own)]


def _apart(made: Mapping[Origin, Prediction]) -> Pieces:
    """Return forecasts that do not overlap, the first ones in time."""
    kept, end = Pieces(), 0
    for origin in sorted(made):
        if origin.at >= end:
            kept.append((origin.at, made[origin]))
            end = origin.at + len(made[origin])
    return kept


def _run(found: Comparison, record: Record, of: Mapping[str, Pieces], ahead: int | None) -> Run:
    """Return the predictions of a record."""
    plan, own, curves = found.plan, record is found.record, {}
    half = np.full(record.y.shape, np.nan)
    interval = found.require_trial().intervals.get(found.recommended)
    for name, pieces in of.items():
        curves[name] = np.full(record.y.shape, np.nan)
        for at, said in pieces:
            curves[name][at : at + len(said)] = said.y
            bounded = name == found.recommended and (ahead or (own and at == plan.train))
            if bounded and interval is not None:
                half[at : at + len(said)] = interval.half_widths(len(said))
    held, end = first_held_out(plan.train), len(record)
    ends = [held, plan.train, end] if own else [0, 0, end]
    parts = dict(zip(PARTS, zip([0, *ends], [e - 1 for e in ends], strict=False), strict=True))
    says = f"forecasts {ahead} samples ahead" if ahead else run_of(record)
    says += (" after" if plan.train < end else " of") + " the training part" if own else ""
    says += "" if own else f" {'in' if ahead else 'of'} the test record {record.name}"
    level = 0.0 if interval is None or np.isnan(half).all() else interval.share
    scored = plan.train if own and plan.train < end else 0
    parts = {name: (a, b) for name, (a, b) in parts.items() if a < b}
    return Run(record, says, curves, scored, half if level else None, level, parts)


def over_time(run: Run, looks: Mapping[str, Key], name: str = "") -> list[Chart]:
    """Return the plots of a record: each output and its residuals, then the inputs.

    They zoom together; the buttons of the page move the axis with the `name` "time".
    """
    axis = Axis.over_time(run.record, name)
    outputs = [chart for i in range(run.record.ny) for chart in _output(run, looks, axis, i)]
    return [*outputs, *_inputs(run.record, axis)]


def _output(run: Run, looks: Mapping[str, Key], axis: Axis, i: int) -> list[Chart]:
    """Return the plots of an output: measured and predicted, and the residuals below."""
    record, column, (best, *others) = run.record, run.record.columns[i], run.curves
    measured = record.y_with_gaps[:, i]
    predicted, height = run.curves[best][:, i], TALL if record.ny <= MAX_TALL_CHANNELS else LOW
    scale = limits([measured, np.clip(predicted, *limits([measured], DIVERGED))])
    caption = f"{column}, measured and predicted: {run.says}"
    if np.isfinite(predicted[: run.scored]).any():
        caption += "; before it, from the first samples"
    chart = Chart(axis, record.units[i] or column, scale, caption, height)
    for part, (first, last) in run.parts.items():
        ends = {"left": float(axis.values[first]), "right": float(axis.values[last])}
        chart.shade(Key(part, PARTS[part], shaded=True), **ends)
    for name in reversed(others):
        chart.line(run.curves[name][:, i], replace(looks[name], hidden=not run.alike))
    chart.line(predicted, looks[best], line_width=4.0, line_alpha=0.8)
    chart.line(measured, Key(MEASURED, MEASURED), line_width=0.9)
    shown = {name: looks[name] for name in run.curves if run.alike or name == best}
    return [chart, _residuals(run, shown, axis, i)]


def _residuals(run: Run, shown: Mapping[str, Key], axis: Axis, i: int) -> Chart:
    """Return the plot of what methods leave of an output, with the interval of a single one."""
    measured, (look, *others) = run.record.y_with_gaps[:, i], shown.values()
    left = {name: measured - run.curves[name][:, i] for name in shown}
    half = np.full(len(measured), np.nan) if run.half is None else run.half[:, i]
    low, high = limits([*(of[run.scored :] for of in left.values()), half, -half])
    reach = DIVERGED * float(np.ptp(limits([measured])))
    caption = "Residual: measured minus predicted"
    caption += "" if others else f", {look.name}"
    caption += "" if run.half is None else f"; shaded: {percent(run.level)} interval"
    label, scale = run.record.units[i] or "residual", (max(low, -reach), min(high, reach))
    chart = Chart(axis, label, scale, caption, SMALL)
    for name in reversed([*shown]):
        key = shown[name] if others else Key("residual", MEASURED)
        chart.line(left[name], key, line_width=0.9)
    if run.half is not None:  # in front of noise, which hides it
        chart.band(-half, half, Key("interval", look.color, shaded=True))
    return chart


def _inputs(record: Record, axis: Axis) -> list[Chart]:
    """Return the plots by input."""
    plots = []
    u = np.zeros((len(record), 0)) if record.u is None else record.u
    for name, values in zip(record.inputs, u.T, strict=True):
        small = record.nu > MAX_TALL_CHANNELS
        label = unit_of(name) or name
        chart = Chart(axis, label, limits([values]), f"Input {name}", SMALL, small=small)
        chart.line(values, Key(name, "truth"), stepped=True, line_width=1.0)
        plots.append(chart)
    return plots

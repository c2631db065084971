"""Plot records and predictions: over time, horizon, frequency, epochs and lags."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import numpy as np
from bokeh.models.annotations import BoxAnnotation

from splitband.checks.residuals import Correlation
from splitband.checks.responses import SHARE, Responses
from splitband.comparison.backtest import Fit
from splitband.comparison.result import Comparison
from splitband.filters.cutoff import LEAST_PASSED, Choice
from splitband.filters.spectrum import coherence, periodogram
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.prediction import Prediction
from splitband.linear.model import LinearModel
from splitband.linear.uncertainty import NORMAL
from splitband.metrics import DIVERGED, cumulative_rmse, fit_percent, tenths
from splitband.records import Record
from splitband.report.colors import PALETTE
from splitband.report.numbers import number, percent, squared
from splitband.report.page.charts import (
    FAINT,
    LOW,
    SMALL,
    TALL,
    Axis,
    Chart,
    dash,
    limits,
    log_limits,
    padded,
)
from splitband.report.page.parts import Method
from splitband.report.predictions import Predicted
from splitband.runtime.arrays import Array

MAX_TALL_CHANNELS = 2
"""Largest number of outputs or inputs with plots of full size. Layout."""
TRANSIENT = 10
"""First samples of a prediction, with errors too variable for the scale. Layout."""


class OverTime:
    """Plots of a record and predictions over a common time axis, with the predicted part visible.

    The buttons of the page move the plots with the `name` "time".
    """

    def __init__(self, shown: Predicted, styles: Mapping[str, Method], name: str = "") -> None:
        self.shown, self.record, self.styles = shown, shown.record, styles
        self.axis = Axis.over_time(shown.record, name)
        self.axis.shown.update(start=self.axis.values[shown.first], end=self.axis.values[-1])
        self._length = len(self.axis.values)

    def outputs(self) -> list[Chart]:
        """Return the plots by output."""
        return [self._output(i) for i in range(self.record.ny)]

    def _output(self, i: int) -> Chart:
        record, shown, column = self.record, self.shown, self.record.columns[i]
        measured = record.y_with_gaps[:, i]
        recommended = next(m for m in self.styles.values() if m.recommended)
        best = shown.predictions.get(recommended.name)
        scale = [measured[shown.first :]]
        if best is not None and np.isfinite(measured).any():
            scale.append(np.clip(best.y[:, i], *limits([measured], DIVERGED)))
        caption = f"{column}: {shown.says}"
        if best is not None and best.level is not None:
            caption += f"; shaded: {percent(best.level)} interval"
        height = TALL if record.ny <= MAX_TALL_CHANNELS else LOW
        chart = Chart(self.axis, column, limits(scale, 0.2), caption, height)
        if best is not None and best.lower is not None and best.upper is not None:
            lower, upper = (padded(edge[:, i], self._length) for edge in (best.lower, best.upper))
            chart.band(lower, upper, recommended.name, recommended.tags)
        for name in self._best_last():
            style, y = self.styles[name], shown.predictions[name].y[:, i]
            # The recommended method's curve is wide, to be visible behind the measurement.
            text, look = self._legend(name, i), _look(style, 3.5)
            chart.method(padded(y, self._length), style, text, **look)
        if record.y_true is not None:
            chart.line(record.y_true[:, i], "noise-free", ["truth"], line_width=1.0)
        chart.line(measured, "measured", ["measured"], line_width=1.2)
        if 0 < shown.begin < self._length:
            chart.mark(self.axis.values[shown.begin])
        return chart

    def _best_last(self) -> list[str]:
        """Return the methods in drawing order: the recommended one above the others."""
        return [name for name in reversed([*self.styles]) if name in self.shown.predictions]

    def _legend(self, name: str, i: int) -> str:
        """Return a method in words, with the fit of a measured output."""
        prediction, label = self.shown.predictions[name], self.styles[name].label or name
        fit = float(fit_percent(self.shown.truth(prediction), prediction.y)[i])
        return f"{label}: {tenths(fit)} %" if np.isfinite(fit) else label

    def inputs(self) -> list[Chart]:
        """Return the plots by input, which zoom together with those of the outputs."""
        record, plots = self.record, []
        u = np.zeros((len(record), 0)) if record.u is None else record.u
        for name, values in zip(record.inputs, u.T, strict=True):
            scale, small = limits([values[self.shown.first :]]), record.nu > MAX_TALL_CHANNELS
            chart = Chart(self.axis, name, scale, f"Input {name}", SMALL, small=small)
            chart.line(values, name, ["truth"], stepped=True, line_width=1.0)
            plots.append(chart)
        return plots

    def residuals(self) -> list[Chart]:
        """Return the plots by output of the residuals of all predictions."""
        plots, shown = [], self.shown
        for i, (column, unit) in enumerate(
            zip(self.record.columns, self.record.units, strict=True)
        ):
            left = {n: (shown.truth(p) - p.y)[:, i] for n, p in shown.predictions.items()}
            scale = limits(
                [left[n] for n in left if self.styles[n].recommended] or [*left.values()]
            )
            reach = DIVERGED * float(np.ptp(limits([self.record.y_with_gaps[:, i]])))
            scale = max(scale[0], -reach), min(scale[1], reach)
            caption = f"{column}: residuals, {shown.says}"
            chart = Chart(self.axis, _with("residual", unit), scale, caption, LOW)
            chart.mark(0.0, "zero", "width")
            for name in self._best_last():
                style = self.styles[name]
                chart.method(padded(left[name], self._length), style, **_look(style, 1.4))
            plots.append(chart)
        return plots

    def errors(self) -> list[Chart]:
        """Return plots by output of the error over the horizon, the range of trainings shaded."""
        counted, shown, plots = self.axis.label == "sample", self.shown, []
        step = 1.0 if counted else self.record.sampling_time
        horizon = step * np.arange(1.0, shown.steps + 1)
        axis = Axis.over(horizon, f"horizon ({'samples' if counted else 's'})")
        for i, (column, unit) in enumerate(
            zip(self.record.columns, self.record.units, strict=True)
        ):
            means = {name: self._grown(p, i) for name, p in shown.predictions.items()}
            late = [y[TRANSIENT:] for y in means.values() if len(y) > 2 * TRANSIENT]
            low, high = log_limits(np.concatenate(late or [np.ones(1)]))
            scale = low, min(high, 1e12 * low)
            caption = f"{column}: error over horizon, {shown.says}"
            chart = Chart(axis, _with("RMSE", unit), scale, caption, log=True)
            for name, y in means.items():
                by_training = [self._grown(p, i) for p in shown.trainings[name]]
                if len(by_training) > 1:
                    edges = np.min(by_training, axis=0), np.max(by_training, axis=0)
                    chart.band(*edges, name, self.styles[name].tags)
                chart.method(y, self.styles[name], self.styles[name].label or name)
            plots.append(chart)
        return plots

    def _grown(self, predicted: Prediction, i: int) -> Array:
        """Return the RMSE by horizon, NaN beyond the end of the prediction."""
        error = cumulative_rmse(self.shown.truth(predicted)[:, i], predicted.y[:, i])
        return padded(error, self.shown.steps, first=True)

    def components(self) -> list[Chart]:
        """Return plots of the components of split and hybrid models, without their means."""
        return [
            self._parts(name, predicted, i)
            for name, predicted in self.shown.predictions.items()
            if predicted.components
            for i in range(self.record.ny)
        ]

    def _parts(self, name: str, predicted: Prediction, i: int) -> Chart:
        column, parts = self.record.columns[i], predicted.components
        curves = {p: padded(y[:, i] - y[:, i].mean(), self._length) for p, y in parts.items()}
        measured = self.record.y_with_gaps[:, i]
        about = measured - np.nanmean(measured)
        scale, caption = (
            limits([about, *curves.values()]),
            f"{self.styles[name].label or name}, {column}: components",
        )
        chart = Chart(self.axis, f"{column}, less the mean", scale, caption, methods=[name])
        chart.line(about, "measured", ["measured"], line_width=1.0)
        for k, (part, y) in enumerate(curves.items()):
            chart.line(y, part, [f"c{k}"], line_width=1.4)
        return chart


def errors_ahead(comparison: Comparison, styles: Mapping[str, Method]) -> list[Chart]:
    """Return plots by output of the RMSE over the samples ahead of many origins, by record."""
    plots = list[Chart]()
    if comparison.plan.ahead in (None, 1):
        return plots
    every = {name: comparison.judging(name) for name in styles}
    for record in (*comparison.tests, comparison.record):
        errors = {
            name: np.stack([record.truth[o.at : o.at + o.steps] - p.y for o, p in made.items()])
            for name, found in every.items()
            for own, made in found
            if own is record
        }
        if not errors:
            continue
        of = "" if record is comparison.record else f", test record {record.name}"
        for i, (column, unit) in enumerate(zip(record.columns, record.units, strict=True)):
            curves = {n: _grown_ahead(e[:, :, i]) for n, e in errors.items()}
            axis = Axis.over(np.arange(1.0, 1 + len(next(iter(curves.values())))), "samples ahead")
            low, high = log_limits(np.concatenate([*curves.values()]))
            scale, caption = (low, min(high, 1e12 * low)), f"{column}: error by samples ahead{of}"
            chart = Chart(axis, _with("RMSE", unit), scale, caption, log=True)
            for name, y in curves.items():
                chart.method(y, styles[name], styles[name].label or name)
            plots.append(chart)
    return plots


def _grown_ahead(errors: Array) -> Array:
    """Return the RMSE over the samples ahead of errors `(origins, steps)`, NaN in gaps."""
    with np.errstate(invalid="ignore"):
        return np.asarray(np.sqrt(np.nansum(errors**2, axis=0) / (~np.isnan(errors)).sum(axis=0)))


def _look(style: Method, width: float) -> dict[str, Any]:
    """Return the style of a method's curve: this width if recommended, else faint."""
    return {"line_width": width} if style.recommended else {"line_alpha": FAINT}


def _with(what: str, unit: str) -> str:
    return f"{what} ({unit})" if unit else what


def spectrum(record: Record, cutoff: float | None, bases: Mapping[str, Array]) -> list[Chart]:
    """Return plots of the power of a record, and of its coherence with simulators and inputs.

    `bases` are outputs `(time, ny)`, by name, of fitted models in place of a simulator in hybrids.
    """
    beside = ({} if record.y_sim is None else {"simulator": record.y_sim}) | dict(bases)
    others = [(name, [*y.T]) for name, y in beside.items()]
    inputs = () if record.u is None else zip(record.inputs, record.u.T, strict=True)
    others += [(name, [u] * record.ny) for name, u in inputs]
    small = len(others) > 1
    return [
        _power(record, cutoff, beside),
        *(_coherence(record, name, y, cutoff, small) for name, y in others),
    ]


def _power(record: Record, cutoff: float | None, beside: Mapping[str, Array]) -> Chart:
    unit, curves = _unit(record), {}
    for name, y in {"": record.y, **beside}.items():
        estimate = periodogram(y, record.sampling_rate)
        for column, density in zip(record.columns, estimate.density.T, strict=True):
            several = name and (record.ny > 1 or name == column)
            curves[f"{name}, {column}" if several else name or column] = density[1:]
    low, high = log_limits(np.concatenate([curves[c] for c in record.columns]))
    note = "" if cutoff is None else f"; dashed: the cut-off at {number(cutoff)} {unit}"
    chart = Chart(
        Axis.over_frequency(estimate.frequencies[1:], unit),
        f"power density ({squared(record)}/{unit})",
        (max(low, 1e-9 * high), 2 * high),
        f"Spectrum{note}",
        log=True,
    )
    for i, (name, density) in enumerate(curves.items()):
        style: dict[str, Any] = {"line_width": 1.3, "line_dash": dash(i // len(PALETTE))}
        chart.line(density, name, [f"c{i % len(PALETTE)}"], **style)
    if cutoff is not None:
        chart.mark(cutoff, "cutoff")
    return chart


def _coherence(
    record: Record, name: str, others: Sequence[Array], cutoff: float | None, small: bool
) -> Chart:
    """Return a plot of the coherence of the record with a simulator, a fitted model or an input."""
    pairs = zip(record.y.T, others, strict=True)
    by_output = [coherence(y, x, record.sampling_rate) for y, x in pairs]
    axis = Axis.over_frequency(by_output[0][0][1:], _unit(record))
    chart = Chart(axis, "coherence", (0, 1.03), f"Coherence with {name}", SMALL, small=small)
    for i, (column, (_, y)) in enumerate(zip(record.columns, by_output, strict=True)):
        chart.line(y[1:], column, [f"c{i % len(PALETTE)}"], line_width=1.3)
    if cutoff is not None:
        chart.mark(cutoff, "cutoff")
    return chart


def cutoffs(choice: Choice) -> Chart:
    """Return a plot of the loss over all candidate cut-offs, one curve per order."""
    every = np.array(sorted({candidate.cutoff for candidate in choice.candidates}))
    curves: dict[tuple[int, bool], Array] = {}
    for candidate in choice.candidates:
        enough = candidate.passed >= LEAST_PASSED or choice.simulator_helps is True
        y = curves.setdefault((candidate.order, enough), np.full(len(every), np.nan))
        y[np.searchsorted(every, candidate.cutoff)] = candidate.loss
    _, high = limits([*curves.values()])
    caption = f"Loss: {choice.loss}; dashed: the cut-off chosen, {number(choice.cutoff)} Hz"
    chart = Chart(Axis.over_frequency(every, "Hz"), "loss", (0.0, high), caption, SMALL)
    for (order, enough), y in sorted(curves.items(), key=lambda item: item[0]):
        name = f"order {order}" if enough else f"order {order}, little in the low band"
        style: dict[str, Any] = {"line_width": 1.3, "line_dash": dash(not enough)}
        chart.line(y, name, [f"c{order - 1}"], **style)
    chart.mark(choice.cutoff, "cutoff")
    return chart


def _unit(record: Record) -> str:
    return "cycles per sample" if record.start is None and record.sampling_rate == 1 else "Hz"


def losses(fits: Mapping[str, Sequence[Fit]], styles: Mapping[str, Method]) -> list[Chart]:
    """Return plots of the losses over the epochs of all trainings, one per kind of network."""
    tasks = dict.fromkeys(task for of in fits.values() for fit in of for task in fit.report.losses)
    return [_losses(task, fits, styles) for task in tasks]


def _losses(task: str, fits: Mapping[str, Sequence[Fit]], styles: Mapping[str, Method]) -> Chart:
    losses = {name: [fit.report.losses.get(task, ()) for fit in of] for name, of in fits.items()}
    curves = {
        name: [np.asarray(y, float) for y in of if len(y)] for name, of in losses.items() if any(of)
    }
    every = [y for of in curves.values() for y in of]
    axis = Axis.over(np.arange(1.0, 1 + max(2, *map(len, every))), "epoch, then rounds of L-BFGS")
    caption, scale = f"Training loss: {task}", log_limits(np.concatenate(every))
    chart = Chart(axis, "training loss", scale, caption, log=True, methods=[*curves])
    for name, of_method in curves.items():
        for i, loss in enumerate(of_method):
            long = padded(loss, len(axis.values), first=True)
            chart.method(long, styles[name], line_dash=dash(i))
    return chart


def orders(model: LinearModel) -> list[Chart]:
    """Return plots over the order; none for outputs with different delays, in separate models."""
    most = min(max(model.orders, default=2 * model.order), len(model.values))
    tried = np.array(model.orders, float)
    curves = {
        "Singular values": ("singular value", np.arange(1.0, most + 1), model.values[:most]),
        "Held-out simulation error": ("RMSE (% of std)", tried, 100 * model.held_out),
    }
    plots = []
    for title, (label, x, y) in curves.items():
        if len(x) > 1:
            shown = np.maximum(y, 1e-9 * y.max())
            caption = f"{title}; dashed: the order {model.order}"
            chart = _curve(Axis.over(x, "order"), shown, label, caption, log=True)
            chart.mark(model.order)
            plots.append(chart)
    return plots


SILENT = 1e-12
"""Smallest gain in a plot: -240 dB. Rounding."""


def gains(record: Record, model: LinearModel) -> list[Chart]:
    """Return plots of a linear model's gain over frequency by input and output."""
    estimate = model.uncertainty
    if estimate is None:
        return []
    axis = Axis.over_frequency(estimate.angles / (2 * np.pi * record.sampling_time), "Hz")
    plots = []
    for (i, name), (j, column) in product(enumerate(record.inputs), enumerate(record.columns)):
        gain, error = estimate.response[:, j, i], NORMAL * estimate.response_errors[:, j, i]
        if not (np.isfinite(gain) & (gain > 0)).all():
            continue
        caption, certain = f"Gain, {name} to {column}", np.isfinite(error).all()
        if certain:
            least, most = (number(float(100 * f(error / gain))) for f in (np.min, np.max))
            caption += f"; shaded: 95 % interval, ± {least} to {most} %"
        chart = _response(axis, {"gain": (_decibels(gain), "c0", 0)}, "gain (dB)", caption)
        if certain:
            lower = np.maximum(gain - error, 1e-3 * gain)
            chart.band(_decibels(lower), _decibels(gain + error), "95 % interval", ["c0"])
        plots.append(chart)
    return plots


def responses(
    by_model: Mapping[str, Sequence[Responses]], styles: Mapping[str, Method], bode: bool = True
) -> list[Chart]:
    """Return plots of the step responses by input and output, one curve per model.

    Curves at further operating points are faint. With `bode`, plots of gain and phase follow. The
    models are of one record.
    """
    first = next(iter(by_model.values()))[0]
    frequencies, _ = first.frequency_response()
    every = [(n, response) for n, of in by_model.items() for response in of]
    kinds = {None: 0, SHARE: 1, 1 - SHARE: 2}
    named = {None: "", SHARE: " (dashed)", 1 - SHARE: " (dotted)"}
    labels = [
        (styles[n].label or n) + (f" at {r.place}" if r.share else "") + named[r.share]
        for n, r in every
    ]
    looks = [(f"c{styles[n].color}", kinds[response.share]) for n, response in every]
    gains = [response.frequency_response()[1] for _, response in every]
    time, over = Axis.over(first.time, "time (s)"), Axis.over_frequency(frequencies, "Hz")
    plots = []
    for (i, u), (j, y) in product(enumerate(first.inputs), enumerate(first.columns)):
        steps, of = [r.y[:, j, i] for _, r in every], [gain[:, j, i] for gain in gains]
        sizes = [_decibels(np.abs(gain)) for gain in of]
        phases = [np.degrees(np.unwrap(np.angle(gain))) for gain in of]
        drawn = (
            (time, steps, "change", "Step response"),
            (over, sizes, "gain (dB)", "Gain"),
            (over, phases, "phase (degrees)", "Phase"),
        )
        for axis, curves, label, what in drawn if bode else drawn[:1]:
            shown = {n: (y, *look) for n, y, look in zip(labels, curves, looks, strict=True)}
            plots.append(_response(axis, shown, label, f"{what}, {u} to {y}"))
    return plots


def unknown(model: GreyBox) -> list[Chart]:
    """Return plots of the trained terms of an equation, over each quantity's range in training."""
    plots, first = [], 0
    for number_of, term in enumerate(model.terms):
        for quantity in range(len(term.trained.centre) if term.trained else 0):
            curve = model.unknown_curve(number_of, quantity)
            axis, held = Axis.over(curve.z, curve.quantity), ""
            if curve.others:
                values = (f"{name} = {number(x)}" for name, x in curve.others.items())
                held = f", with {', '.join(values)}"
            for o, value in enumerate(curve.w.T):
                name, ends = f"w[{first + o}]", (curve.low[:, o], curve.high[:, o])
                caption = f"{name} over {curve.quantity}{held}"
                chart = Chart(axis, name, limits([value, *ends]), caption, LOW, small=True)
                chart.line(value, name, ["c0"], line_width=1.5)
                if curve.trainings > 1:
                    chart.band(*ends, "trainings", ["c0"])
                plots.append(chart)
        first += term.outputs
    return plots


def _response(
    axis: Axis, curves: Mapping[str, tuple[Array, str, int]], label: str, caption: str
) -> Chart:
    """Return a small plot of named curves, with colour and dash; frequencies also in rad/s."""
    chart = Chart(axis, label, limits([y for y, *_ in curves.values()]), caption, LOW, small=True)
    if axis.log:
        chart.add_angular_frequencies()
    for name, (y, color, k) in reversed([*curves.items()]):  # the first one above the others
        look: dict[str, Any] = {"line_dash": dash(k), "line_alpha": FAINT} if k else {}
        chart.line(y, name, [color], line_width=1.5, **look)
    return chart


def _decibels(gain: Array) -> Array:
    return np.asarray(20 * np.log10(np.maximum(gain, SILENT)))


def _curve(axis: Axis, y: Array, label: str, title: str, log: bool = False) -> Chart:
    """Return a small plot of one curve."""
    within = log_limits(y) if log else limits([y])
    chart = Chart(axis, label, within, title, SMALL, log, small=True)
    chart.line(y, label, ["c0"], line_width=1.5)
    return chart


def correlation(output: str, test: Correlation) -> Chart:
    """Return a plot of the correlation of residuals by lag, with the band of no correlation."""
    itself = test.of == "residuals"
    values, band = np.array(test.values), test.band
    most = max(2 * band, 1.1 * float(abs(values).max()))
    chance = f"p = {number(test.p)}" if test.p >= 0.001 else "p < 0.001"
    outside = f"{int((abs(values) > band).sum())} of {len(values)} outside ± {number(band)}"
    what = "its own past" if itself else test.of
    caption = f"{output} with {what}, all lags together: {chance}; one by one: {outside}"
    axis = Axis.over(itself + np.arange(len(values), dtype=float), "lag (samples)")
    chart = Chart(axis, "correlation", (-most, most), caption, SMALL, small=True)
    shaded = BoxAnnotation(bottom=-band, top=band, fill_alpha=0.2, tags=["c0"])
    chart.figure.add_layout(shaded)
    chart.stems(values, output, ["c0"])
    chart.mark(0.0, "zero", "width")
    return chart

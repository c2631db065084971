"""Plot what a model is: residuals and their tests, step and Bode responses, unknown terms."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product

import numpy as np

from splitband.checks.residuals import Correlation
from splitband.checks.responses import SHARE, Responses, of_stable_plant
from splitband.forecasters.base import Forecaster
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.linear import Linear
from splitband.linear.uncertainty import NORMAL
from splitband.report.numbers import gain_in_words, number
from splitband.report.page.charts import LOW, SMALL, Axis, Chart, limits
from splitband.report.page.parts import DASHES, Key
from splitband.runtime.arrays import Array

SILENT = 1e-12
"""Smallest gain in a plot: -240 dB. Rounding."""


def correlation(output: str, test: Correlation) -> Chart:
    """Return a plot of the correlation of residuals by lag, with the interval of no correlation."""
    most = (len(test.around) - 1) // 2
    own = test.of == "residuals"
    values = test.around[most + 1 :] if own else test.around
    lags = np.arange(1.0 if own else -most, most + 1)
    chance = f"p = {number(test.p)}" if test.p >= 0.001 else "p < 0.001"
    chance = chance.replace(" ", "\N{NO-BREAK SPACE}")
    scale = max(2 * test.band, 1.1 * float(abs(values).max()))
    caption = f"{output}, own past (Ljung-Box: {chance})"
    if not own:
        caption = f"{output} and {test.of}, prewhitened (F test: {chance})"
    axis = Axis.over(lags, "lag (samples)")
    chart = Chart(axis, "correlation", (-scale, scale), caption, SMALL, small=True)
    chart.shade(Key("by chance", "c0", shaded=True), bottom=-test.band, top=test.band)
    chart.line(values, Key("residuals", "measured"), line_width=1.2)
    chart.mark(0.0, "zero", "width")
    if not own:
        chart.mark(0.0, "zero")
    return chart


def responses(model: Forecaster, every: Sequence[Responses], bode: bool) -> list[Chart]:
    """Return plots of step responses by input and output, a curve for each operating point.

    With `bode`, gain and phase follow, those at the mean.
    """
    first, stable = every[0], of_stable_plant(model)
    frequencies, gains = first.frequency_response()
    looks = dict(zip((None, SHARE, 1 - SHARE), DASHES, strict=False))
    keys = [Key(f"inputs at {r.place}", "c0", looks[r.share]) for r in every]
    time, over = Axis.over(first.time, "time (s)"), Axis.over_frequency(frequencies, "Hz")
    plots = []
    for (i, u), (j, y) in product(enumerate(first.inputs), enumerate(first.columns)):
        pair, gain = f"{u} to {y}", float(first.gains[j, i])
        caption = f"Step, {pair}"
        if stable:
            caption += ": static gain " if np.isfinite(gain) else ": "
            caption += gain_in_words(gain) + " at the mean" * (len(every) > 1)
        plots.append(_curves(time, "change", caption, keys, [r.y[:, j, i] for r in every]))
        if bode:
            size = _decibels(np.abs(gains[:, j, i]))
            plots.append(_curves(over, "gain (dB)", f"Gain, {pair}", keys[:1], [size]))
            if isinstance(model, Linear):
                _add_interval(plots[-1], model, first, size, (j, i))
            phase = np.degrees(np.unwrap(np.angle(gains[:, j, i])))
            plots.append(_curves(over, "phase (degrees)", f"Phase, {pair}", keys[:1], [phase]))
    return plots


def _add_interval(
    chart: Chart, model: Linear, first: Responses, gain: Array, pair: tuple[int, int]
) -> None:
    """Add the 95 % interval of the gain of a linear model, if it is known."""
    estimate = model.model.uncertainty
    if estimate is None or estimate.response.shape[2] != len(first.inputs):
        return
    share = NORMAL * estimate.response_errors[:, *pair] / estimate.response[:, *pair]
    if np.isfinite(share).all():
        angles = 2 * np.pi * chart.axis.values * first.sampling_time
        share = np.interp(angles, estimate.angles, share)
        edges = gain + _decibels(np.maximum(1 - share, 1e-3)), gain + _decibels(1 + share)
        chart.band(*edges, Key("95 % interval", "c0", shaded=True))


def _curves(
    axis: Axis, label: str, caption: str, keys: Sequence[Key], curves: Sequence[Array]
) -> Chart:
    """Return a small plot of curves."""
    chart = Chart(axis, label, limits(curves), caption, LOW, small=True)
    for key, y in zip(reversed(keys), reversed(curves), strict=True):
        chart.line(y, key, line_width=1.5)
    return chart


def _decibels(gain: Array) -> Array:
    return np.asarray(20 * np.log10(np.maximum(gain, SILENT)))


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
                if curve.trainings > 1:
                    chart.band(*ends, Key("trainings that fit as well", "c0", shaded=True))
                chart.line(value, Key(name, "c0"), line_width=1.5)
                plots.append(chart)
        first += term.outputs
    return plots

"""Plots over the horizon: how errors grow."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from splitband.evaluation.comparison import Comparison
from splitband.metrics import cumulative_rmse
from splitband.report.numbers import number
from splitband.report.page import figures
from splitband.report.page.figures import TALL, TimeAxis
from splitband.report.page.parts import MethodStyles, Plot
from splitband.report.page.thinning import bin_size, places, thinned
from splitband.report.page.time_plots import LEAST

Array = npt.NDArray[np.float64]
Curves = Mapping[str, Array]

TRANSIENT = 10
"""Samples after a warm-up whose errors vary too much to set a scale by them."""


def errors(comparison: Comparison, styles: MethodStyles, most: int) -> list[Plot]:
    """Return how each channel's error grows with the horizon, with the range of the seeds."""
    plots = []
    axis = TimeAxis.of(comparison.record)
    sides = ["from the start", *(["forecast"] if comparison.predictions else [])]
    record = comparison.record
    for side in sides:
        for channel, column in enumerate(record.columns):
            curves: dict[str, Array] = {}
            for name, runs in comparison.runs.items():
                of_runs = [
                    run.from_start.y if side == sides[0] else run.ahead
                    for run in (comparison.means[name], *runs)
                ]
                truth = record.truth[len(record) - len(of_runs[0]) :, channel]
                mean, *each = (cumulative_rmse(truth, y[:, channel]) for y in of_runs)
                curves[name] = mean
                if len(each) > 1:
                    low, high = np.min(each, axis=0), np.max(each, axis=0)
                    curves |= {f"{name} low": low, f"{name} high": high}
            title = f"{side}, {column}" if record.ny > 1 else side
            plots.append(_errors(curves, title, styles, axis, record.sampling_time, most))
    return plots


def _errors(
    curves: Curves, side: str, styles: MethodStyles, axis: TimeAxis, step: float, most: int
) -> Plot:
    length = max(map(len, curves.values()))
    size = bin_size(length, max(most // 2, LEAST))
    unit = 1.0 if axis.unit == "samples" else step
    x = np.asarray(unit * (1.0 + places(length, size)), float)
    drawn = {name: _from_first(y, length) for name, y in curves.items()}
    settled = [y[TRANSIENT:][y[TRANSIENT:] > 0] for y in drawn.values() if len(y) > 2 * TRANSIENT]
    scale = [y for y in settled if len(y)] or [np.array([1e-3, 1.0])]
    low, high = min(float(np.nanmin(y)) for y in scale), max(float(np.nanmax(y)) for y in scale)
    shown = figures.plain(
        "RMSE since the warm-up",
        f"horizon ({axis.unit})",
        TALL,
        y_axis_type="log",
        x_range=figures.time_range(float(x[0]), float(x[-1])),
        y_range=figures.between(0.7 * low, 1.5 * min(high, 1e12 * low)),
    )
    data = figures.source(x, {n: thinned(np.maximum(y, 1e-300), size) for n, y in drawn.items()})
    for name in styles.names:
        if f"{name} low" in drawn:
            figures.method_band(shown, data, f"{name} low", f"{name} high", styles.of(name))
        figures.method_line(shown, data, name, styles.of(name))
    figures.hover(shown, f"horizon ({axis.unit})")
    last = {name: curves[name][-1] for name in styles.names}
    order = sorted(last, key=lambda name: last[name])[:4]
    return Plot(
        shown,
        f"Error over horizon, {side}",
        f"Line plot of the RMSE of all samples up to a horizon, {side}, with a logarithmic axis. "
        f"At its end the lowest are {', '.join(f'{n} {number(last[n])}' for n in order)}.",
    )


def _from_first(y: Array, length: int) -> Array:
    """An error over horizon, which begins with the first of `length` horizons."""
    whole = np.full(length, np.nan)
    whole[: len(y)] = y
    return whole

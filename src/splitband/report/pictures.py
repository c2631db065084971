"""Draw pictures of comparisons and predictions, by matplotlib."""

from __future__ import annotations

import textwrap
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd

from splitband.comparison.result import Comparison
from splitband.forecasters.prediction import Prediction
from splitband.metrics import fit_percent, tenths
from splitband.records import Record
from splitband.report.colors import PALETTE
from splitband.report.numbers import in_one_offset
from splitband.report.predictions import Predicted, predicted
from splitband.report.tables import labels_of, ordered
from splitband.runtime.errors import missing
from splitband.runtime.files import replacing

try:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
except ImportError:
    raise missing("a plot", "matplotlib", "plot") from None

MEASURED = "black"
ACROSS = 3
"""Panels in a row. Layout."""
TITLE = 40
"""Characters of a line above a panel. Layout."""


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)


def rollouts(comparison: Comparison) -> Figure:
    """Draw the prediction of each method over the measured output, the recommended one first.

    These are the forecasts after the training part, with the interval of the recommended one, or
    else simulations of the first test record, or of the whole record.
    """
    order = "forecast", "test", "start"
    every = sorted(predicted(comparison), key=lambda runs: order.index(runs.protocol))
    shown = next(runs for runs in every if runs.predictions)
    record, called = shown.record, labels_of(comparison)
    names = [n for n in ordered(comparison.trial, comparison.fits) if n in shown.predictions]
    across = record.ny if record.ny > 1 else min(len(names), ACROSS)
    down = -(-len(names) * record.ny // across)
    figure = Figure(figsize=(12, 0.8 + 2.2 * down), layout="constrained")
    grid = figure.subplots(down, across, squeeze=False, sharex=True)
    for i, (ax, (name, channel)) in enumerate(
        zip(grid.flat, product(names, range(record.ny)), strict=False)
    ):
        if name == names[0]:
            prediction = shown.predictions[name]
            _draw_interval(ax, times_of(record)[-len(prediction) :], prediction, channel)
        _draw(ax, shown, channel, name, PALETTE[i // record.ny % len(PALETTE)])
        words = textwrap.fill(literal(called[name]), TITLE)
        ax.set_title(f"{words}: {ax.get_title(loc='left')}", fontsize=9, loc="left")
    for ax in grid.flat[len(names) * record.ny :]:
        ax.set_axis_off()
    for ax in grid.flat[max(len(names) * record.ny - across, 0) : len(names) * record.ny]:
        ax.set_xlabel(time_label(record))
        ax.tick_params(labelbottom=True)
    handles, said = grid.flat[0].get_legend_handles_labels()
    figure.legend(handles, said, fontsize=8, loc="outside lower center", ncols=3, frameon=False)
    name = record.name or "a record"
    figure.suptitle(literal(f"{name}: {shown.says}"), fontsize=11)
    return figure


def _draw(ax: Axes, shown: Predicted, channel: int, name: str, color: str) -> None:
    """Draw the measurement of one channel, and a method's prediction."""
    record, times, prediction = shown.record, times_of(shown.record), shown.predictions[name]
    y, truth = prediction.y[:, channel], shown.truth(prediction)[:, channel]
    at = times[len(times) - len(y) :]
    ax.plot(at, y, color=color, lw=2.5, label="predicted")  # shows behind
    measured = record.y_with_gaps[shown.first :, channel]
    ax.plot(times[shown.first :], measured, color=MEASURED, lw=0.7, label="measured")
    low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
    margin = 0.25 * (high - low or 1.0)
    ax.set_ylim(low - margin, high + margin)
    ax.margins(x=0.01)
    ax.set_ylabel(literal(record.columns[channel]))
    ax.axvline(times[shown.begin], color="0.4", ls=":", lw=1)
    ax.set_title(f"fit {tenths(fit_percent(truth, y))} %", loc="left")


def _draw_interval(ax: Axes, at: npt.NDArray[Any], predicted: Prediction, channel: int) -> None:
    if predicted.lower is not None and predicted.upper is not None:
        label = f"{predicted.level:.0%} interval".replace("%", " %")
        edges = predicted.lower[:, channel], predicted.upper[:, channel]
        ax.fill_between(at, *edges, color=PALETTE[0], alpha=0.18, lw=0, label=label)


def prediction(predicted: Prediction) -> Figure:
    """Draw a prediction with its interval."""
    figure = Figure(figsize=(11, 0.8 + 2.2 * len(predicted.columns)), layout="constrained")
    grid = figure.subplots(len(predicted.columns), 1, sharex=True, squeeze=False)[:, 0]
    time = _drawn(pd.Index(predicted.time))
    for i, (ax, column) in enumerate(zip(grid, predicted.columns, strict=True)):
        ax.plot(time, predicted.y[:, i], color=PALETTE[0], lw=1.2, label="prediction")
        _draw_interval(ax, time, predicted, i)
        ax.set_ylabel(literal(column))
        ax.margins(x=0.01)
    grid[0].legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    grid[0].set_title(f"{len(predicted)} samples ahead", fontsize=10, loc="left")
    dates = isinstance(predicted.time, pd.DatetimeIndex)
    grid[-1].set_xlabel("time" if dates else "time (s)")
    return figure


def literal(name: str) -> str:
    """Escape dollar signs in a user's name, for matplotlib the marks of formulas."""
    return name.replace("$", r"\$")


def times_of(record: Record) -> npt.NDArray[Any]:
    """Return the values of the time axis: time stamps, or seconds from the first sample."""
    return _drawn(pd.Index(record.stamps))


def _drawn(stamps: pd.Index[Any]) -> npt.NDArray[Any]:
    """Return time stamps for matplotlib; dates are in the time zone of the first one."""
    if isinstance(stamps, pd.DatetimeIndex):
        stamps = in_one_offset(stamps)
    return np.asarray(stamps)


def time_label(record: Record) -> str:
    """Return the label of the time axis."""
    return "time" if isinstance(record.start, pd.Timestamp) else "time (s)"

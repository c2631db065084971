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
from splitband.metrics import fit_percent, rmse, tenths
from splitband.records import Record
from splitband.report.colors import PALETTE
from splitband.report.numbers import in_one_offset, number
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
SMALL_ACROSS = 4
"""Small panels in a row. Layout."""
SMALL_TITLE = 40
"""Characters of a line above a small panel. Layout."""


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)


def rollouts(comparison: Comparison) -> Figure:
    """Draw predictions, large for the recommended method, small below for the others.

    Panels show the forecast, with its interval, and the test records; without both, a simulation.
    """
    record = comparison.record
    every = [runs for runs in predicted(comparison) if runs.predictions]
    shown = [runs for runs in every if runs.protocol != "start"] or every
    shown.sort(key=lambda runs: runs.protocol)  # the forecast first
    names, called = ordered(comparison.trial, comparison.fits), labels_of(comparison)
    best, *others = names
    across = max(SMALL_ACROSS // record.ny, 1)
    below = -(-len(others) // across)
    across = -(-len(others) // below) if below else 0  # rows of equal length
    large, small = 2.6 * record.ny * len(shown), 1.5 * below
    figure = Figure(figsize=(12, large + small + 1.2), layout="constrained")
    ratios = [large, small] if below else [large]
    parts = figure.subfigures(len(ratios), 1, squeeze=False, height_ratios=ratios)[:, 0]
    grid = parts[0].subplots(record.ny * len(shown), 1, squeeze=False)[:, 0]
    for ax, (runs, channel) in zip(grid, product(shown, range(record.ny)), strict=True):
        _draw(ax, runs, channel, best, PALETTE[0])
    if below:
        grid = parts[1].subplots(below, across * record.ny, squeeze=False, sharex=True)
        panels = [*product(others, range(record.ny))]
        for ax, (name, channel) in zip(grid.flat, panels, strict=False):
            _draw(ax, shown[0], channel, name, PALETTE[names.index(name) % len(PALETTE)], True)
            words = textwrap.fill(literal(called[name]), SMALL_TITLE)
            ax.set_title(f"{words}\n{ax.get_title(loc='left')}", fontsize=7, loc="left", pad=2)
        for i, ax in enumerate(grid.flat[len(panels) :], start=len(panels)):
            ax.set_axis_off()
            grid.flat[i - across * record.ny].tick_params(labelbottom=True)
        parts[1].suptitle(f"Other methods, {literal(shown[0].says)}", fontsize=9)
    title = record.name or "a record"
    title += "; " if comparison.trial is None else "; recommended: "
    figure.suptitle(literal(title + called[best]), fontsize=11)
    return figure


def _draw(
    ax: Axes, shown: Predicted, channel: int, name: str, color: str, small: bool = False
) -> None:
    """Draw the measurement of one channel, and a method's prediction."""
    record, times = shown.record, times_of(shown.record)
    unit, title = f" {record.units[channel]}".rstrip(), "not tested"
    prediction = shown.predictions.get(name)
    if prediction is not None:
        y, truth = prediction.y[:, channel], shown.truth(prediction)[:, channel]
        at = times[len(times) - len(y) :]
        if not small:
            _draw_interval(ax, at, prediction, channel)
        ax.plot(at, y, color=color, lw=2 if small else 3, label="predicted")  # shows behind
        title = f"fit {tenths(fit_percent(truth, y))} %"
        title += "" if small else f", RMSE {number(rmse(truth, y))}{unit}"
    measured = record.y_with_gaps[shown.first :, channel]
    ax.plot(
        times[shown.first :], measured, color=MEASURED, lw=0.6 if small else 0.9, label="measured"
    )
    low, high = float(np.nanmin(measured)), float(np.nanmax(measured))
    margin = 0.25 * (high - low or 1.0)
    ax.set_ylim(low - margin, high + margin)
    ax.margins(x=0.01)
    ax.set_ylabel(literal(record.columns[channel]), fontsize=6 if small else None)
    if small:
        ax.set_title(title, fontsize=7, loc="left", pad=2)
        ax.tick_params(labelsize=6)
        return
    ax.axvline(times[shown.begin], color="0.4", ls=":", lw=1)
    ax.set_title(f"{literal(shown.says)}: {title}", fontsize=10, loc="left")
    ax.set_xlabel(time_label(record))
    ax.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)


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

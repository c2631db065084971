"""Evidence of test records: predictions, errors of each channel, and a picture of these."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splitband.evaluation.comparison import Comparison
from splitband.forecasters.prediction import time_header
from splitband.report.colors import PALETTE
from splitband.report.table import columns
from splitband.runtime.files import replacing
from splitband.runtime.outputs import TEST_PREDICTIONS


def save_predictions(comparison: Comparison, folder: Path) -> None:
    """Write predictions-test-1.csv, predictions-test-2.csv, ..., one for each test record."""
    for i in range(len(comparison.tests)):
        with replacing(folder / TEST_PREDICTIONS.format(i + 1)) as temporary:
            predictions(comparison, i).to_csv(temporary, index=False)


def predictions(comparison: Comparison, number: int) -> pd.DataFrame:
    """Return a test record and its predictions, a row for each sample.

    There is one column for each channel, and one for each channel and tested method: the mean of
    its seeds, empty during the warm-up.
    """
    test = comparison.tests[number]
    table: dict[str, Any] = {time_header(test.columns): test.stamps}
    for channel, column in enumerate(test.columns):
        table[column] = test.seen[:, channel]
        for name in _tested(comparison):
            predicted = comparison.means[name].tests[number].y
            values = np.full(len(test), np.nan)
            values[len(test) - len(predicted) :] = predicted[:, channel]
            table[f"{column}, {name}, from start"] = values
    return pd.DataFrame(table)


def facts(comparison: Comparison, number: int) -> dict[str, Any]:
    """Return what results.json says of the evidence of a test record."""
    test = comparison.tests[number]
    return {"columns": list(test.columns), "predictions": TEST_PREDICTIONS.format(number + 1)}


def picture(comparison: Comparison) -> Figure:
    """Draw the errors: a row for each test record, a column for each channel."""
    tests, names = comparison.tests, _tested(comparison)
    channels = comparison.record.columns
    only = len(channels) == 1
    size = max(3.6 * len(channels), 7), (0.9 + 0.22 * len(names)) * len(tests) + 0.5
    figure = Figure(figsize=size, layout="constrained")
    grid = figure.subplots(len(tests), len(channels), sharey=True, squeeze=False)
    errors = {
        (c.record, c.channel): c.values
        for c in columns(comparison)
        if c.record and c.unit == "record"
    }
    for i, test in enumerate(tests):
        for channel, column in enumerate(channels):
            of_column = errors[test.name, "" if only else column]
            values = [of_column.get(name, math.nan) for name in names]
            _draw(grid[i, channel], values, names.index(comparison.recommended)
                  if comparison.recommended in names else None)  # fmt: skip
            title = f"{test.name}: {column}".replace("$", r"\$")
            grid[i, channel].set_title(title, fontsize=9, loc="left")
            unit = test.units[channel]
            grid[i, channel].set_xlabel(f"RMSE ({unit})" if unit else "RMSE", fontsize=8)
        grid[i, 0].set_yticks(range(len(names)), names, fontsize=8)
        grid[i, 0].set_ylim(len(names) - 0.5, -0.5)
    figure.suptitle("Test records: RMSE of each output (blue: the recommended method)", fontsize=10)
    return figure


def _draw(ax: Axes, values: list[float], marked: int | None) -> None:
    for row, value in enumerate(values):
        if math.isfinite(value):
            ax.barh(row, value, height=0.7, color=PALETTE[0] if row == marked else "0.7")
            ax.annotate(f" {value:.3g}", (value, row), va="center", fontsize=7)
    ax.margins(x=0.2)
    ax.set_axisbelow(True)
    ax.grid(True, axis="x", color="0.93", lw=0.6)


def _tested(comparison: Comparison) -> list[str]:
    return [name for name, mean in comparison.means.items() if mean.tests]

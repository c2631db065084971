"""Evidence of test records: predictions, and what results.json says of them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from splitband.evaluation.comparison import Comparison
from splitband.forecasters.prediction import time_header
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


def _tested(comparison: Comparison) -> list[str]:
    return [name for name, mean in comparison.means.items() if mean.tests]

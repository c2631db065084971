"""A forecaster of your own in a comparison: it says what it learns and what comes next."""

from collections.abc import Sequence
from typing import Any

import numpy as np

import splitband as sb
from splitband.forecasters.prediction import ForecastContext


class Drift(sb.Forecaster):
    """The straight line through the first and the last measured sample."""

    name = "drift"

    def learn(self, records: Sequence[sb.Record], **_: Any) -> None:
        """Keep the slope of the (first) training record."""
        y = records[0].y
        self.slope = (y[-1] - y[0]) / (len(y) - 1)

    def extrapolate(self, known: ForecastContext) -> np.ndarray:
        """Go on with it from the last sample of the history."""
        return known.y[-1] + self.slope * np.arange(1, known.steps + 1)[:, None]


if __name__ == "__main__":
    rng = np.random.default_rng(0)
    record = sb.Record(0.01 * np.arange(400) + 0.1 * rng.standard_normal(400), 0.1)
    result = sb.compare(record, 300, [Drift(), sb.Mean(), sb.Persistence()])
    print(result.table[["forecast fit %", "held-out RMSE"]].round(3).to_string())
    print(f"recommended: {result.recommended}")

"""Collect the predictions of methods by protocol of a comparison."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

from splitband.comparison.backtest import Fit
from splitband.comparison.result import Comparison
from splitband.forecasters.prediction import Prediction
from splitband.records import Record
from splitband.runtime.arrays import Array

Protocol = Literal["test", "forecast", "start"]
"""Simulations of a test record, forecasts after the training part, simulations from the start."""
BEFORE = 8
"""Length of a prediction as a multiple of the measurements in front of it in a plot. Layout."""


@dataclass(frozen=True, eq=False)
class Predicted:
    """A record, and predictions of its last samples."""

    protocol: Protocol
    says: str  # the protocol in words, for captions
    record: Record  # the measured record
    predictions: Mapping[str, Prediction]  # medians over trainings; all end at the same sample
    trainings: Mapping[str, Sequence[Prediction]] = field(default_factory=dict)

    @property
    def steps(self) -> int:
        """Return the length of the longest prediction."""
        return max(map(len, self.predictions.values()), default=0)

    @property
    def begin(self) -> int:
        """Return the index of the first predicted sample."""
        return len(self.record) - self.steps

    @property
    def first(self) -> int:
        """Return the index of the first sample to show, shortly before the prediction."""
        return max(self.begin - max(self.steps // BEFORE, 2), 0)

    def truth(self, prediction: Prediction) -> Array:
        """Return the noise-free or measured samples of a prediction, `(time, ny)`."""
        return self.record.truth[len(self.record) - len(prediction) :]


def run_of(record: Record) -> str:
    """Return the name of a free run of a record: with known inputs a simulation."""
    return "simulation" if record.nu else "forecast"


def what_was_known(comparison: Comparison) -> str:
    """Return a sentence on the information of the methods about the predicted samples."""
    record = comparison.tests[0] if comparison.tests else comparison.record
    information = ["the inputs"] if record.nu else []
    information += [] if record.y_sim is None else ["the simulator's output"]
    if comparison.tests:
        first = "the first samples of the outputs"
        known = f"{', '.join(information)} and {first}" if information else first
        return f"Of a test record, models see only {known}."
    if not information:
        return "Models see nothing of these samples."
    return f"Models see {' and '.join(information)} here, not the measurements."


def predicted(comparison: Comparison) -> list[Predicted]:
    """Return the methods' predictions: of test records, after the training part, from the start.

    Some methods, or all, may be unable to simulate the test records.
    """
    record = comparison.record

    def of(
        protocol: Protocol, says: str, record: Record, take: Callable[[Fit], Prediction | None]
    ) -> Predicted:
        medians = {n: p for n, fit in comparison.medians.items() if (p := take(fit)) is not None}
        trainings = {
            name: [p for fit in comparison.fits[name] if (p := take(fit)) is not None]
            for name in medians
        }
        return Predicted(protocol, says, record, medians, trainings)

    runs = [
        of("test", f"simulation of the test record {test.name or i + 1}", test, partial(_tested, i))
        for i, test in enumerate(comparison.tests)
    ]
    if comparison.predictions:
        says = f"{run_of(record)} after the training part"
        ahead = of("forecast", says, record, lambda f: f.forecast)
        runs.append(replace(ahead, predictions=comparison.predictions))
    says = "simulation from the first samples"
    return [*runs, of("start", says, record, lambda fit: fit.from_start)]


def _tested(i: int, fit: Fit) -> Prediction | None:
    return fit.tests[i] if fit.tests else None

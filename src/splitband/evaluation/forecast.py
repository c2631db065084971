"""Hold what comes after the end of a record, by the method that is recommended."""

from __future__ import annotations

from dataclasses import dataclass, field
from html import escape
from pathlib import Path

from splitband.data import Record
from splitband.evaluation.budget import TimeBudget
from splitband.evaluation.plan import Plan
from splitband.evaluation.selection import Trial
from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import Prediction
from splitband.metrics import Extrapolation
from splitband.runtime.provided import provided


@dataclass(frozen=True, eq=False, repr=False)
class Forecast:
    """What comes after the end of a record.

    Attributes
    ----------
    plan : What was asked: record, methods, setup.
    model : The recommended method, fitted to the whole record: to predict and to be saved.
    prediction : Its forecast, the mean over seeds, with the interval.
    trial : What was tried, and how it did.
    description : What its fit has settled on.
    leaves : Samples before the forecast leaves the range of the training samples by far.
    inputs_beyond_training : Which inputs to come go beyond those that were trained on.
    time : See `Comparison`.
    """

    plan: Plan
    model: Forecaster
    prediction: Prediction
    trial: Trial
    description: str
    leaves: int | None
    inputs_beyond_training: list[Extrapolation]
    time: TimeBudget = field(default_factory=TimeBudget)

    @property
    def forecaster(self) -> Forecaster:
        """The recommended method, not fitted: to be fitted again."""
        return self.model.clone()

    @property
    def record(self) -> Record:
        """It goes on from."""
        return self.plan.record

    @property
    def seeds(self) -> tuple[int, ...]:
        """Of the recommended method."""
        return self.model.seeds

    @property
    def method(self) -> str:
        """The name of the recommended method."""
        return self.model.name

    def __repr__(self) -> str:
        steps = len(self.prediction)
        return f"<Forecast of {steps} samples after {self.record!r}, by {self.method}>"

    def _repr_html_(self) -> str:
        """Return the first and last rows of the prediction as a table, for notebooks."""
        return f"<p>{escape(repr(self))}</p>{self.prediction._repr_html_()}"

    def report(self, path: str | Path) -> None:
        """Write one HTML file with the forecast, what was tried and settings, to send on."""
        provided("page of a forecast")(self, path)

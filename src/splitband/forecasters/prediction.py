"""Define what a forecaster returns: values, their times, and the interval around them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from splitband.data import Grid
from splitband.data.preparation import Preparation
from splitband.data.timing import stamps_at
from splitband.forecasters.medians import mean_over, middle_members
from splitband.runtime.arrays import Array
from splitband.runtime.options import saved

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@saved
@dataclass(frozen=True, eq=False, repr=False)
class Prediction:
    """Hold the samples that follow an origin.

    Attributes
    ----------
    y : `(steps, ny)`, in the record's unit.
    grid : The times of the samples.
    columns : Names of the channels.
    components : The components that add up to `y`, by name; empty where there is only one.
    lower, upper : The interval around `y`, `(steps, ny)`, if requested.
    level : The share of samples that should lie in the interval.
    warnings : Reasons to doubt the prediction, in sentences.
    doubts : Those of them that come from the method itself, see `Forecaster.doubts`.
    """

    y: Array
    grid: Grid
    columns: tuple[str, ...]
    components: Mapping[str, Array] = field(default_factory=dict)
    lower: Array | None = None
    upper: Array | None = None
    level: float | None = None
    warnings: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.y)

    @property
    def time(self) -> Array | pd.DatetimeIndex:
        """Return the time stamps, `(steps,)`: seconds or dates; else seconds after the origin."""
        rows = np.arange(len(self))
        if self.grid.start is None:
            return stamps_at(0.0, self.grid.step, 1 + rows)
        return stamps_at(self.grid.start, self.grid.step, rows)

    def to_frame(self) -> pd.DataFrame:
        """Return a table with a column of time stamps and one for each channel and its interval."""
        table: dict[str, object] = {time_header(self.columns): self.time}
        for i, column in enumerate(self.columns):
            table[column] = self.y[:, i]
            if self.lower is not None and self.upper is not None:
                table[f"{column}, lower"] = self.lower[:, i]
                table[f"{column}, upper"] = self.upper[:, i]
        return pd.DataFrame(table)

    def restored(self, prepared: Sequence[Preparation], time: Array) -> Prediction:
        """Return the prediction with the preparation of its record undone, at these times in s."""
        signals = {"y": self.y, "lower": self.lower, "upper": self.upper}
        for step in reversed(prepared):
            signals = {
                name: None if signal is None else step.restored(signal, time)
                for name, signal in signals.items()
            }
        assert signals["y"] is not None
        trend = signals["y"] - self.y
        parts = {**self.components, "trend": trend} if self.components and trend.any() else {}
        return replace(
            self,
            y=signals["y"],
            lower=signals["lower"],
            upper=signals["upper"],
            components=parts or self.components,
        )

    def __repr__(self) -> str:
        level = "" if self.level is None else f", with a {100 * self.level:g} % interval"
        return f"<Prediction of {', '.join(self.columns)}: {self.grid}{level}>"

    def _repr_html_(self) -> str:
        """Return the first and last rows as a table, for notebooks."""
        return f"<p>{escape(repr(self))}</p>{self.to_frame().to_html(max_rows=10, index=False)}"

    def plot(self) -> Figure:
        """Return a plot of the prediction."""
        from splitband.report.pictures import prediction  # noqa: PLC0415  of a higher layer

        return prediction(self)


def median_of(predictions: Sequence[Prediction]) -> Prediction:
    """Return the median of several predictions of the same samples, such as those of several seeds.

    Of components that all of them have, it takes those of the predictions in the middle; the
    warnings of all are kept.
    """
    first = predictions[0]
    middle = middle_members([p.y for p in predictions])
    parts = [name for name in first.components if all(name in p.components for p in predictions)]
    return replace(
        first,
        y=mean_over([p.y for p in predictions], middle),
        components={
            name: mean_over([p.components[name] for p in predictions], middle) for name in parts
        },
        lower=None,
        upper=None,
        level=None,
        warnings=tuple(dict.fromkeys(said for p in predictions for said in p.warnings)),
        doubts=tuple(dict.fromkeys(said for p in predictions for said in p.doubts)),
    )


def time_header(columns: tuple[str, ...]) -> str:
    """Return a name for the time column that differs from those in `columns`."""
    return "time (s)" if "time" in columns else "time"

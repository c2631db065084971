"""The first plots of a page: what was measured against what was predicted, and the inputs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from bokeh.models import Range1d

from splitband.data import Record
from splitband.forecasters.prediction import Prediction
from splitband.report.numbers import percent
from splitband.report.page import figures
from splitband.report.page.figures import TimeAxis
from splitband.report.page.parts import Method, Plot
from splitband.report.page.thinning import bin_size, envelope, places, thinned

Array = npt.NDArray[np.float64]

MOST = 4_000
"""Points of one curve."""
BEFORE = 8
"""The plots begin this fraction of the prediction's length before it."""
FEW = 2
"""Outputs that have plots of full height."""


@dataclass(frozen=True, eq=False)
class Ahead:
    """A prediction beside the record that it is of, or goes on from.

    Attributes
    ----------
    record : What was measured.
    start : Index of the first predicted sample; it may be the record's length.
    prediction : From there on.
    method : How it is drawn.
    says : What the plots show, for captions.
    """

    record: Record
    start: int
    prediction: Prediction
    method: Method
    says: str

    @property
    def first(self) -> int:
        """Return the index of the first sample that is seen at first."""
        return max(self.start - max(len(self.prediction) // BEFORE, 2), 0)

    def plots(self) -> list[Plot]:
        """Return a plot for each output, and a small one for each input; they zoom together."""
        record, end = self.record, self.start + len(self.prediction)
        axis = TimeAxis.of(record, max(end - len(record), 0))
        x_range = figures.time_range(axis.values[0], axis.values[end - 1])
        x_range.update(start=axis.values[self.first], end=axis.values[end - 1])
        outputs = [self._output(i, axis, x_range) for i in range(record.ny)]
        return outputs + [self._input(i, axis, x_range) for i in range(record.nu)]

    def _output(self, channel: int, axis: TimeAxis, x_range: Range1d) -> Plot:
        record, predicted, column = self.record, self.prediction, self.record.columns[channel]
        seen, y = record.seen[:, channel], predicted.y[:, channel]
        low, high = figures.limits([seen[self.first :], y], 0.1)
        few = record.ny <= FEW
        shown = figures.plain(
            column, "" if record.nu else axis.label, figures.TALL if few else figures.LOW,
            axis.dates, x_range=x_range, y_range=figures.between(low, high),
        )  # fmt: skip
        key = [("measured", "measured"), (f"c{self.method.color}", "predicted")]
        caption = f"{column}: {self.says}"
        size = bin_size(len(y), MOST)
        at = axis.values[self.start :][places(len(y), size)]
        data = figures.source(at, {"y": thinned(figures.clipped(y, low, high), size)})
        if predicted.lower is not None and predicted.upper is not None:
            lower, upper = (
                figures.clipped(edge[:, channel], low, high)
                for edge in (predicted.lower, predicted.upper)
            )
            data.data["lower"], data.data["upper"] = envelope(lower, upper, size)
            figures.method_band(shown, data, "lower", "upper", self.method)
            assert predicted.level is not None
            caption += f"; shaded: {percent(predicted.level)} interval"
        # Wide enough to be seen on both sides of a measurement that it agrees with.
        figures.method_line(shown, data, "y", self.method, line_width=3.5)
        size = bin_size(len(seen), MOST * max(len(seen) // len(y), 1))
        at = axis.values[places(len(seen), size)]
        measured = figures.source(at, {"y": thinned(seen, size)})
        figures.line(shown, measured, "y", "measured", "measured", line_width=1.2)
        if self.start < len(axis.values):
            figures.mark(shown, axis.values[self.start])
        figures.hover(shown, axis.label, axis.dates)
        says = (
            f"Line plot of {column} over {axis.label}: {self.says}, in colour, and what was "
            "measured, in black on top. The dashed line is where the prediction begins."
        )
        return Plot(shown, caption, says, key=key)

    def _input(self, channel: int, axis: TimeAxis, x_range: Range1d) -> Plot:
        record, name = self.record, self.record.inputs[channel]
        assert record.u is not None
        u = record.u[:, channel]
        if record.u_beyond is not None:
            u = np.concatenate([u, record.u_beyond[:, channel]])
        u = u[: len(axis.values)]
        y_range = figures.between(*figures.limits([u[self.first :]], 0.1))
        few = record.nu <= FEW
        shown = figures.plain(name, axis.label, figures.SMALL, axis.dates,
                              x_range=x_range, y_range=y_range)  # fmt: skip
        size = bin_size(len(u), MOST)
        data = figures.source(axis.values[places(len(u), size)], {"u": thinned(u, size)})
        figures.line(shown, data, "u", "truth", name, line_width=1.0)
        figures.hover(shown, axis.label, axis.dates)
        says = f"Line plot of the input {name} over the same time."
        return Plot(shown, f"Input {name}", says, small=not few)

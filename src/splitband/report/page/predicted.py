"""Plot measurements and predictions, residuals, inputs and components over time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from splitband.data import Record
from splitband.forecasters.prediction import Prediction
from splitband.metrics import cumulative_rmse
from splitband.report.numbers import number, percent
from splitband.report.page.charts import LOW, SMALL, TALL, Axis, Chart, limits, padded
from splitband.report.page.parts import Method, Plot
from splitband.runtime.arrays import Array

BEFORE = 8
"""Plots begin earlier than the prediction, by its length divided by this number. By eye."""
FEW = 2
"""Largest number of outputs or inputs that have plots of full size. By eye."""
TRANSIENT = 10
"""First samples of a prediction, whose errors vary too much to set the scale. By eye."""


@dataclass(frozen=True, eq=False)
class Predicted:
    """Hold a record, and predictions of its last samples or of those after it.

    Attributes
    ----------
    record : The measured record.
    predictions : Predictions by method; all end at the same sample.
    styles : How each is drawn.
    says : What the plots show, for captions.
    axis : The times of the record and of the samples predicted after it.
    """

    record: Record
    predictions: Mapping[str, Prediction]
    styles: Mapping[str, Method]
    says: str
    axis: Axis

    @classmethod
    def of(
        cls, record: Record, predictions: Mapping[str, Prediction], styles: Mapping[str, Method],
        says: str, ahead: int = 0, name: str = "",
    ) -> Predicted:  # fmt: skip
        """Return them with the predicted part visible; they end `ahead` samples past the record."""
        axis = Axis.over_time(record, ahead, name)
        found = cls(record, predictions, styles, says, axis)
        axis.shown.update(start=axis.values[found.first], end=axis.values[-1])
        return found

    @property
    def steps(self) -> int:
        """Return the length of the longest prediction."""
        return max(map(len, self.predictions.values()))

    @property
    def begin(self) -> int:
        """Return the index of the first predicted sample."""
        return len(self.axis.values) - self.steps

    @property
    def first(self) -> int:
        """Return the index of the first visible sample, shortly before the prediction."""
        return max(self.begin - max(self.steps // BEFORE, 2), 0)

    def outputs(self) -> list[Plot]:
        """Return a plot for each output."""
        return [self._output(i) for i in range(self.record.ny)]

    def inputs(self) -> list[Plot]:
        """Return a plot for each input, which zooms together with the plots of the outputs."""
        record = self.record
        u = np.zeros((len(record), 0)) if record.u is None else record.u
        if record.u_beyond is not None:
            u = np.concatenate([u, record.u_beyond])
        plots = []
        for name, values in zip(record.inputs, u.T, strict=True):
            whole = padded(values[: len(self.axis.values)], len(self.axis.values), first=True)
            chart = Chart(self.axis, name, limits([whole[self.first :]]), SMALL)
            chart.line(whole, "truth", name, line_width=1.0)
            says = f"Line plot of the input {name} over the same time."
            plots.append(chart.plot(f"Input {name}", says, small=record.nu > FEW))
        return plots

    def residuals(self) -> list[Plot]:
        """Return a plot for each output, with the residuals of each prediction."""
        plots = []
        for i, column in enumerate(self.record.columns):
            left = {name: self._error(name, i) for name in self.predictions}
            scale = [left[n] for n in left if self.styles[n].recommended] or [*left.values()]
            unit = self.record.units[i]
            chart = Chart(self.axis, f"residual ({unit})" if unit else "residual", limits(scale),
                          LOW)  # fmt: skip
            chart.mark(0.0, "zero", "width")
            for name, y in left.items():
                chart.method(padded(y, len(self.axis.values)), self.styles[name])
            says = (
                f"What is left of {column} when the prediction is subtracted, over "
                f"{self.axis.label}; a good model leaves noise without a pattern."
            )
            plots.append(chart.plot(f"{column}: residuals, {self.says}", says))
        return plots

    def errors(self, each: Mapping[str, list[Prediction]]) -> list[Plot]:
        """Return plots of each output's error over the horizon, with its range over `each` shaded.

        `each` holds the predictions of a method's single trainings.
        """
        counted, record = self.axis.label == "sample", self.record
        step = 1.0 if counted else record.sampling_time
        horizon = step * np.arange(1.0, self.steps + 1)
        axis = Axis.over(horizon, f"horizon ({'samples' if counted else 's'})")
        plots = []
        for i, column in enumerate(record.columns):
            means = {name: self._grown(p, i) for name, p in self.predictions.items()}
            late = [y[TRANSIENT:] for y in means.values() if len(y) > 2 * TRANSIENT]
            seen = np.concatenate(late or [np.ones(1)])
            seen = seen[np.isfinite(seen) & (seen > 0)]
            low = float(seen.min()) if len(seen) else 1e-3
            high = min(float(seen.max()), 1e12 * low) if len(seen) else 1.0
            unit = record.units[i]
            label = f"RMSE ({unit})" if unit else "RMSE"
            chart = Chart(axis, label, (0.7 * low, 1.5 * high), log=True)
            for name, y in means.items():
                seeds = [self._grown(p, i) for p in each[name]]
                if len(seeds) > 1:
                    chart.band(np.min(seeds, axis=0), np.max(seeds, axis=0), self.styles[name])
                chart.method(y, self.styles[name])
            last = sorted((p[-1], name) for name, p in means.items() if p[-1] == p[-1])[:4]
            said = ", ".join(f"{name} {number(float(value))}" for value, name in last)
            caption = f"{column}: error over horizon, {self.says}"
            says = (
                f"Line plot of the RMSE of {column} over all samples up to a horizon, with a "
                f"logarithmic axis. At its end the lowest are {said}."
            )
            plots.append(chart.plot(caption, says))
        return plots

    def components(self) -> list[Plot]:
        """Return plots of the components of each split or hybrid model, without their means."""
        return [
            self._parts(name, i)
            for name, predicted in self.predictions.items()
            if predicted.components
            for i in range(self.record.ny)
        ]

    def _output(self, i: int) -> Plot:
        record, column, length = self.record, self.record.columns[i], len(self.axis.values)
        seen = padded(record.seen[:, i], length, first=True)
        recommended = next(m for m in self.styles.values() if m.recommended)
        best = self.predictions.get(recommended.name)
        shown = [seen[self.first :], *([] if best is None else [best.y[:, i]])]
        height = TALL if record.ny <= FEW else LOW
        chart = Chart(self.axis, column, limits(shown, 0.2), height)
        caption, says = f"{column}: {self.says}", ""
        if best is not None and best.lower is not None and best.upper is not None:
            lower, upper = (padded(edge[:, i], length) for edge in (best.lower, best.upper))
            chart.band(lower, upper, recommended)
            assert best.level is not None
            caption += f"; shaded: {percent(best.level)} interval"
        # The recommended one is wide, so that it shows behind curves that agree with it.
        for name in sorted(self.predictions, key=lambda n: self.styles[n].recommended):
            style = {"line_width": 3.5} if self.styles[name].recommended else {}
            chart.method(padded(self.predictions[name].y[:, i], length), self.styles[name], **style)
        key = [("measured", "measured"), (f"c{recommended.color}", "predicted")]
        if record.y_true is not None:
            chart.line(record.y_true[:, i], "truth", "noise-free", line_width=1.0)
            key.append(("truth", "noise-free"))
        chart.line(seen, "measured", "measured", line_width=1.2)
        if 0 < self.begin < length:
            chart.mark(self.axis.values[self.begin])
            says = " The dashed line is where it begins."
        says = (
            f"Line plot of {column} over {self.axis.label}: {self.says}, in colour, and what was "
            f"measured, in black on top.{says}"
        )
        return chart.plot(caption, says, key=key)

    def _parts(self, name: str, i: int) -> Plot:
        column, length = self.record.columns[i], len(self.axis.values)
        parts = self.predictions[name].components
        curves = {p: padded(y[:, i] - y[:, i].mean(), length) for p, y in parts.items()}
        seen = self.record.seen[:, i]
        about = padded(seen - np.nanmean(seen), length, first=True)
        chart = Chart(self.axis, f"{column}, less the mean", limits([about, *curves.values()]))
        chart.line(about, "measured", "measured", line_width=1.0)
        for k, (part, y) in enumerate(curves.items()):
            chart.line(y, f"c{k}", part, line_width=1.4)
        key = [("measured", "measured"), *((f"c{k}", part) for k, part in enumerate(curves))]
        says = (
            f"Line plot of the parts whose sum is the prediction by {name}, each less its mean: "
            f"{', '.join(parts)}; in black what was measured."
        )
        return chart.plot(f"{name}, {column}: components", says, methods=[name], key=key)

    def _error(self, name: str, i: int) -> Array:
        y = self.predictions[name].y[:, i]
        return self.record.truth[len(self.record) - len(y) :, i] - y

    def _grown(self, predicted: Prediction, i: int) -> Array:
        """Return the RMSE up to each horizon, NaN beyond the end of the prediction."""
        truth = self.record.truth[len(self.record) - len(predicted) :, i]
        return padded(cumulative_rmse(truth, predicted.y[:, i]), self.steps, first=True)

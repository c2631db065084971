"""Plots over the time of a record: free runs, forecasts, residuals, errors and components."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from bokeh.models import ColumnDataSource, Range1d
from bokeh.plotting import figure

from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.protocols import by_channel
from splitband.report.numbers import number, percent
from splitband.report.page import figures
from splitband.report.page.figures import LOW, TALL, TimeAxis
from splitband.report.page.parts import MethodStyles, Plot
from splitband.report.page.thinning import bin_size, envelope, places, thinned

Array = npt.NDArray[np.float64]
Curves = Mapping[str, Array]
Side = Literal["from the start", "forecast"]

VALUES, LEAST, MOST = 500_000, 500, 8_000
"""Drawn values of a whole page; points of one curve at least and at most."""


@dataclass(frozen=True, eq=False)
class Frame:
    """A record over time, for plots that zoom together.

    Attributes
    ----------
    record : What was measured.
    axis : Its times.
    size : Samples of which two are drawn; 1: all are.
    x_range : What the plots share.
    styles : The methods.
    """

    record: Record
    axis: TimeAxis
    size: int
    x_range: Range1d
    styles: MethodStyles

    @classmethod
    def of(cls, record: Record, styles: MethodStyles, most: int, name: str = "") -> Frame:
        """With all of the record in sight."""
        axis = TimeAxis.of(record)
        x_range = figures.time_range(*axis.whole, name)
        return cls(record, axis, bin_size(len(record), most), x_range, styles)

    @property
    def x(self) -> Array:
        """Where the points are drawn."""
        return self.axis.values[places(len(self.record), self.size)]

    def empty(self, label: str, height: int, y_range: Range1d) -> figure:
        """A figure over this time."""
        return figures.plain(
            label, self.axis.label, height, self.axis.dates, x_range=self.x_range, y_range=y_range
        )

    def padded(self, y: Array) -> Array:
        """A curve that ends with the record, `(time,)`, with NaN before it."""
        whole = np.full(len(self.record), np.nan)
        whole[len(whole) - len(y) :] = y
        return whole


def most_points(comparison: Comparison) -> int:
    """Points of a curve, so that the file stays small however many curves there are."""
    each = 8 + 2 * len(comparison.tests) + 2 * bool(comparison.predictions)
    curves = each * len(comparison.means) * comparison.record.ny
    return min(max(VALUES // max(curves, 1), LEAST), MOST)


def free_runs(comparison: Comparison, frame: Frame, side: Side) -> list[Plot]:
    """Return plots of the predictions and of the residuals of each output; they zoom together."""
    plots = []
    predicted = {
        name: mean.from_start.y if side == "from the start" else mean.ahead
        for name, mean in comparison.means.items()
    }
    for channel, column in enumerate(comparison.record.columns):
        seen = comparison.record.seen[:, channel]
        y_range = figures.between(*figures.limits([seen]))
        curves = {name: frame.padded(y[:, channel]) for name, y in predicted.items()}
        bands = _bands(comparison, frame, channel) if side == "forecast" else {}
        shown = _runs(frame, channel, curves, bands, y_range)
        rest = _residuals(frame, channel, curves)
        for each in (shown, rest):
            _marks(comparison, frame, each, side)
        plots.append(
            Plot(
                shown,
                f"{column}: {_CAPTIONS[side]}",
                f"Line plot of {column} over {frame.axis.label}. Black: what was measured. "
                f"In colour: {_listed(comparison, frame.styles, side, channel)}.",
                key=_key(frame.record),
            )
        )
        says = (
            f"What is left of {column} when the prediction ({side}) is subtracted, over "
            f"{frame.axis.label}; a good model leaves noise without a pattern."
        )
        plots.append(Plot(rest, f"{column}: residuals, {side}", says))
    return plots


_CAPTIONS: dict[Side, str] = {
    "from the start": "simulations from the first samples to the end of the record",
    "forecast": "forecasts from the end of the training part, with intervals",
}


def test_runs(comparison: Comparison, styles: MethodStyles, most: int) -> list[Plot]:
    """Of each test record: free runs and residuals."""
    plots = []
    for i, test in enumerate(comparison.tests):
        frame, name = Frame.of(test, styles, most), test.name or f"test {i + 1}"
        for channel, column in enumerate(test.columns):
            curves = {
                method: frame.padded(mean.tests[i].y[:, channel])
                for method, mean in comparison.means.items()
                if mean.tests
            }
            y_range = figures.between(*figures.limits([test.seen[:, channel]]))
            shown = _runs(frame, channel, curves, {}, y_range)
            best = comparison.means[styles.recommended].tests
            error = " was not tested"
            if best:
                error = f": RMSE {number(by_channel(test, best[i].y)[channel])}"
            says = (
                f"Line plot of {column} of the test record {name} over {frame.axis.label}, in "
                f"black what was measured. {styles.recommended}{error}."
            )
            plots.append(Plot(shown, f"{name}, {column}: simulations", says, key=_key(test)))
            says = f"What is left of {column} of {name} when the simulations are subtracted."
            rest = _residuals(frame, channel, curves)
            plots.append(Plot(rest, f"{name}, {column}: residuals", says))
    return plots


test_runs.__test__ = False  # type: ignore[attr-defined]  # for pytest, it is no test


def components(comparison: Comparison, frame: Frame) -> list[Plot]:
    """Return plots of what each model of several parts adds up, each less its mean."""
    plots = []
    for name, mean in comparison.means.items():
        parts = mean.from_start.components
        for channel, column in enumerate(comparison.record.columns if parts else ()):
            curves = {
                part: frame.padded(y[:, channel] - y[:, channel].mean())
                for part, y in parts.items()
            }
            seen = frame.record.seen[:, channel]
            about = seen - np.nanmean(seen)
            y_range = figures.between(*figures.limits([about, *curves.values()], 0.05))
            shown = frame.empty(f"{column}, less the mean", TALL, y_range)
            drawn = {part: thinned(y, frame.size) for part, y in curves.items()}
            drawn[" measured"] = thinned(about, frame.size)
            data = figures.source(frame.x, drawn)
            figures.line(shown, data, " measured", "measured", "measured", line_width=1.0)
            for i, part in enumerate(parts):
                figures.line(shown, data, part, f"c{i}", part, line_width=1.4)
            _marks(comparison, frame, shown, "from the start")
            figures.hover(shown, frame.axis.label, frame.axis.dates)
            plots.append(
                Plot(
                    shown,
                    f"{name}, {column}: components",
                    f"Line plot of the parts whose sum is the simulation by {name} from the start, "
                    f"each less its mean: {', '.join(parts)}; in black what was measured.",
                    [name],
                    [("measured", "measured"), *((f"c{i}", part) for i, part in enumerate(parts))],
                )
            )
    return plots


def _runs(
    frame: Frame,
    channel: int,
    curves: Curves,
    bands: Mapping[str, tuple[Array, Array]],
    y_range: Range1d,
) -> figure:
    shown = frame.empty(frame.record.columns[channel], TALL, y_range)
    low, high = figures.ends(y_range)
    data = _source(frame, channel, {n: figures.clipped(y, low, high) for n, y in curves.items()})
    for name, (lower, upper) in bands.items():
        edges = figures.clipped(lower, low, high), figures.clipped(upper, low, high)
        for edge, drawn in zip(("lower", "upper"), envelope(*edges, frame.size), strict=True):
            data.data[f"{name} {edge}"] = drawn
        edges_of = f"{name} lower", f"{name} upper"
        figures.method_band(shown, data, *edges_of, frame.styles.of(name), interval=True)
    for method in frame.styles.methods[::-1]:  # the recommended one is drawn over the others
        if method.name in curves:
            figures.method_line(shown, data, method.name, method)
    _draw_record(frame, shown, data)
    figures.hover(shown, frame.axis.label, frame.axis.dates)
    return shown


def _residuals(frame: Frame, channel: int, curves: Curves) -> figure:
    truth = frame.record.truth[:, channel]
    left = {name: truth - y for name, y in curves.items()}
    scale = [left[name] for name in left if frame.styles.of(name).shown] or [*left.values()]
    low, high = figures.limits(scale, 0.1)
    deviation = float(np.nanstd(truth)) or 1.0
    low, high = max(low, -5 * deviation), min(high, 5 * deviation)
    if low >= high:
        low, high = -deviation, deviation
    unit = frame.record.units[channel]
    label = f"residual ({unit})" if unit else "residual"
    shown = frame.empty(label, LOW, figures.between(low, high))
    drawn = {n: thinned(figures.clipped(y, low, high), frame.size) for n, y in left.items()}
    data = figures.source(frame.x, drawn)
    figures.mark(shown, 0.0, "zero", "width")
    for method in frame.styles.methods[::-1]:
        if method.name in drawn:
            figures.method_line(shown, data, method.name, method, line_width=1.1)
    figures.hover(shown, frame.axis.label, frame.axis.dates)
    return shown


def _source(frame: Frame, channel: int, curves: Curves) -> ColumnDataSource:
    """The record and curves over its time, thinned."""
    record = frame.record
    drawn = {"measured": record.seen[:, channel]}
    drawn |= {} if record.y_true is None else {"truth": record.y_true[:, channel]}
    both = {**{f" {name}": y for name, y in drawn.items()}, **curves}
    return figures.source(frame.x, {name: thinned(y, frame.size) for name, y in both.items()})


def _draw_record(frame: Frame, shown: figure, data: ColumnDataSource) -> None:
    figures.line(shown, data, " measured", "measured", "measured", line_width=1.0)
    if frame.record.y_true is not None:
        figures.line(shown, data, " truth", "truth", "noise-free", line_width=1.0)


def _marks(comparison: Comparison, frame: Frame, shown: figure, side: str) -> None:
    """Where the training part ends, and what the recommended method warmed up on."""
    values, train = frame.axis.values, comparison.setup.train
    warmup = comparison.setup.settings.warmup
    if train < len(values):
        figures.mark(shown, values[train])
    run = comparison.means[frame.styles.recommended]
    start = train if side == "forecast" else len(values) - len(run.from_start)
    figures.shade(shown, values[max(start - warmup, 0)], values[max(start - 1, 0)])


def _bands(comparison: Comparison, frame: Frame, channel: int) -> dict[str, tuple[Array, Array]]:
    """The intervals of the forecasts, over the whole record."""
    return {
        name: (frame.padded(p.lower[:, channel]), frame.padded(p.upper[:, channel]))
        for name, p in comparison.predictions.items()
        if p.lower is not None and p.upper is not None
    }


def _listed(comparison: Comparison, styles: MethodStyles, side: str, channel: int) -> str:
    """The methods that are drawn at first, with their errors, in words."""
    said = []
    for method in styles.methods:
        mean = comparison.means[method.name]
        if method.shown:
            y = mean.ahead if side == "forecast" else mean.from_start.y
            error = by_channel(comparison.record, y)[channel]
            mark = ", recommended," if method.recommended else ""
            said.append(f"{method.name}{mark} with RMSE {number(error)}")
    if side == "forecast" and comparison.trial is not None:
        share = comparison.trial.intervals[styles.recommended].share
        said[-1] += f"; shaded: the interval that should hold {percent(share)}"
    return ", ".join(said)


def _key(record: Record) -> Sequence[tuple[str, str]]:
    known = [] if record.y_true is None else [("truth", "noise-free")]
    return [("measured", "measured"), *known]

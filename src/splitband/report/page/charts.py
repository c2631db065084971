"""Draw charts for the page with Bokeh; the page's script sets their colours, light or dark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import pandas as pd
from bokeh.models import (
    BoxZoomTool,
    ColumnDataSource,
    DatetimeTickFormatter,
    FixedTicker,
    HoverTool,
    Line,
    PanTool,
    PlainText,
    Range1d,
    ResetTool,
    SaveTool,
    VArea,
    WheelZoomTool,
)
from bokeh.models.annotations import Span
from bokeh.models.renderers import GlyphRenderer
from bokeh.plotting import figure

from splitband.data import Record
from splitband.data.timing import stamps_at
from splitband.report.page.parts import Method, Plot
from splitband.report.page.thinning import bin_size, envelope, places, thinned
from splitband.runtime.arrays import Array

WIDTH, TALL, LOW, SMALL = 800, 270, 210, 150
"""Pixels: the width of plots, and the heights of large, low and small ones."""
LEFT = 70
"""Pixels for the numbers of a vertical axis, the same for all plots: their time axes line up."""
X = "x"
"""The column of a chart's source along its axis."""
MOST = 4_000
"""Points of one curve, at most: more than a screen has columns."""
FARTHEST = 1e3
"""How far beyond a plot a curve is drawn, in heights of the plot: a canvas takes no larger numbers.
By eye."""
DATES: dict[str, Any] = {
    "milliseconds": "%H:%M:%S.%3N", "seconds": "%H:%M:%S", "minsec": "%H:%M:%S",
    "minutes": "%H:%M", "hourmin": "%H:%M", "hours": "%d %b %H:%M", "days": "%d %b",
    "months": "%b %Y", "years": "%Y",
}  # fmt: skip
_DASHES = "dashed", "dotted", "dashdot"


@dataclass(frozen=True, eq=False)
class Axis:
    """Hold what charts over the same axis share; they zoom together.

    Attributes
    ----------
    values : Positions of the samples; dates are in milliseconds since 1970.
    label : Label with its unit.
    shown : The visible range.
    size : Samples in a bin, of which two are drawn; 1: all are drawn.
    dates, log : Whether the values are dates, and whether the axis is logarithmic.
    """

    values: Array
    label: str
    shown: Range1d
    size: int = 1
    dates: bool = False
    log: bool = False

    @classmethod
    def over(cls, values: Array, label: str, name: str = "", dates: bool = False) -> Axis:
        """Return an axis of numbers; the buttons of the page move the one called "time"."""
        margin = 0.01 * (values[-1] - values[0] or 1.0)
        shown = _range(values[0] - margin, values[-1] + margin, name)
        return cls(values, label, shown, bin_size(len(values), MOST), dates)

    @classmethod
    def over_frequency(cls, values: Array, unit: str) -> Axis:
        """Return a logarithmic axis."""
        shown = _range(values[0], max(values[-1], 2 * values[0]))  # a short record has only one
        return cls(values, f"frequency ({unit})", shown, log=True)

    @classmethod
    def over_time(cls, record: Record, ahead: int = 0, name: str = "") -> Axis:
        """Return the time axis of a record and of `ahead` samples after it."""
        rows, step = np.arange(len(record) + ahead), record.sampling_time
        if record.start is None and step == 1:
            return cls.over(rows.astype(float), "sample", name)
        stamps = stamps_at(0.0 if record.start is None else record.start, step, rows)
        if isinstance(stamps, pd.DatetimeIndex):
            naive = stamps.tz_localize(None).to_numpy().astype("datetime64[us]")
            return cls.over(naive.astype(np.int64) / 1e3, "time", name, dates=True)
        since = "time since the first sample (s)" if record.start is None else "time (s)"
        return cls.over(np.asarray(stamps, float), since, name)


def _range(low: float, high: float, name: str = "") -> Range1d:
    """Return a range that no panning or zooming can leave."""
    shown = Range1d(start=low, end=high, bounds=(low, high), name=name or None)
    shown.update(reset_start=low, reset_end=high)
    return shown


class Chart:
    """Draw a chart with its curves, and only those tools that a reader needs.

    Labels are plain text: to look for formulas in users' names, Bokeh would load a library.

    Parameters
    ----------
    axis : The horizontal axis.
    label : Label of the vertical axis, with its unit.
    limits : Limits of the vertical axis.
    height : Height in pixels; the width is that of its place on the page.
    log : Whether the vertical axis is logarithmic.
    """

    def __init__(
        self, axis: Axis, label: str, limits: tuple[float, float], height: int = TALL,
        log: bool = False,
    ) -> None:  # fmt: skip
        self.axis, self.limits, self.log = axis, limits, log
        x = axis.values[places(len(axis.values), axis.size)]
        self.data = ColumnDataSource({X: x})
        shown = self.figure = figure(
            width=WIDTH, height=height, sizing_mode="stretch_width", tools="", toolbar_inner=True,
            min_border_left=LEFT, background_fill_color=None, border_fill_color=None,
            x_range=axis.shown,
            y_range=Range1d(start=limits[0], end=limits[1]),
            x_axis_type="datetime" if axis.dates else "log" if axis.log else "auto",
            y_axis_type="log" if log else "auto",
        )  # fmt: skip
        box = BoxZoomTool(dimensions="width" if log else "both")
        along = PanTool(dimensions="width"), WheelZoomTool(dimensions="width")
        tips = [("", "$name"), (axis.label, "$x{%F %T}" if axis.dates else "$x{0,0.[000]}")]
        hover = HoverTool(
            tooltips=[*tips, ("", "$y")], line_policy="nearest", visible=False,
            formatters={"$x": "datetime"} if axis.dates else {},
        )  # fmt: skip
        shown.add_tools(*along, box, ResetTool(), SaveTool(), hover)
        shown.toolbar.update(active_drag=box, logo=None, autohide=True)
        shown.lod_threshold = None
        shown.yaxis.axis_label = PlainText(text=label)
        shown.xaxis.axis_label = PlainText(text=axis.label)
        if log:
            shown.yaxis.ticker = _decades(limits)
        if axis.dates:
            shown.xaxis.formatter = DatetimeTickFormatter(**DATES)

    def line(self, y: Array, role: str, name: str, **style: Any) -> None:
        """Add a curve in the colour of a role: `measured`, `truth`, `c0`..."""
        self.add(Line(x=X, y=self.column(y), **style), name, [role])

    def method(self, y: Array, method: Method, **style: Any) -> None:
        """Add a method's curve, which its switch turns on and off."""
        usual = {"line_width": 1.4, "line_dash": "dashed" if method.dashed else "solid"}
        self.add(Line(x=X, y=self.column(y), **{**usual, **style}), method.name, _tags(method))

    def band(self, lower: Array, upper: Array, method: Method) -> None:
        """Add the shaded area around a method's curve."""
        edges = envelope(self._within(lower), self._within(upper), self.axis.size)
        names = [self._kept(edge) for edge in edges]
        self.add(VArea(x=X, y1=names[0], y2=names[1], fill_alpha=0.18), method.name, _tags(method))

    def column(self, y: Array) -> str:
        """Add a curve, thinned out, to the source; return the name of its column."""
        return self._kept(thinned(self._within(y), self.axis.size))

    def add(self, glyph: Any, name: str, tags: list[str]) -> None:
        """Add a glyph without the glyphs for selections, which Bokeh would add.

        These would take most of the time to make a page.
        """
        renderer = GlyphRenderer(
            data_source=self.data, glyph=glyph, name=name, tags=tags,
            visible="hidden" not in tags,
            selection_glyph=None, nonselection_glyph=None, muted_glyph=None,
        )  # fmt: skip
        self.figure.renderers.append(renderer)

    def mark(
        self, at: float, role: str = "mark", dimension: Literal["width", "height"] = "height"
    ) -> None:
        """Add a dashed line across the chart."""
        style: dict[str, Any] = {"line_dash": "dashed", "line_width": 1.2, "tags": [role]}
        self.figure.add_layout(Span(location=at, dimension=dimension, **style))

    def plot(self, caption: str, says: str, **options: Any) -> Plot:
        """Return the chart as a plot of the page."""
        return Plot(self.figure, caption, says, **options)

    def _within(self, y: Array) -> Array:
        """Clip a curve to what a canvas can draw."""
        if self.log:
            return np.maximum(y, 1e-300)
        low, high = self.limits
        reach = FARTHEST * (high - low or 1.0)
        return np.clip(y, low - reach, high + reach)

    def _kept(self, values: Any) -> str:
        name = f"y{len(self.data.data)}"
        self.data.data[name] = values
        return name


def _tags(method: Method) -> list[str]:
    """Return the tags by which the page's script colours a method's curve and switches it."""
    return [f"c{method.color}", "method", *([] if method.recommended else ["hidden"])]


def _decades(limits: tuple[float, float]) -> FixedTicker:
    """Return ticks of a logarithmic axis at 1, 2 and 5; with many decades only at 1."""
    first, last = (math.floor(math.log10(v)) for v in limits)
    step = max((last - first) // 8, 1)
    mantissas = (1, 2, 5) if last - first < 4 else (1,)
    ticks = [m * 10.0**d for d in range(first, last + 1, step) for m in mantissas]
    minor = [m * 10.0**d for d in range(first, last + 1) for m in range(1, 10)]
    return FixedTicker(ticks=ticks, minor_ticks=minor if step == 1 else ticks)


def dash(i: int) -> str:
    """Return the style of the i-th line of one colour."""
    return "solid" if i == 0 else _DASHES[(i - 1) % len(_DASHES)]


def limits(values: Sequence[Array], margin: float = 0.1) -> tuple[float, float]:
    """Return limits around the finite values of some curves."""
    seen = np.concatenate([v[np.isfinite(v)].ravel() for v in values] or [np.zeros(1)])
    if not len(seen):
        return -1.0, 1.0
    low, high = float(seen.min()), float(seen.max())
    room = margin * (high - low or abs(high) or 1.0)
    return low - room, high + room


def padded(y: Array, length: int, first: bool = False) -> Array:
    """Return a curve padded with NaN in front (`first`: at the end), `(length,)`."""
    whole = np.full(length, np.nan)
    whole[slice(len(y)) if first else slice(length - len(y), None)] = y
    return whole

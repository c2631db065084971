"""Draw charts for the page with Bokeh; the page's script sets their colours, light or dark."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import pandas as pd
from bokeh.models import (
    BasicTicker,
    ColumnDataSource,
    DatetimeTickFormatter,
    FixedTicker,
    HoverTool,
    Line,
    LogTickFormatter,
    NoOverlap,
    PlainText,
    Range1d,
    Segment,
    Step,
    VArea,
)
from bokeh.models.annotations import BoxAnnotation, Span
from bokeh.models.renderers import GlyphRenderer
from bokeh.plotting import figure

from splitband.records import Record
from splitband.records.timing import stamps_at
from splitband.report.numbers import in_one_offset
from splitband.report.page.parts import Key
from splitband.runtime.arrays import Array

WIDTH, TALL, LOW, SMALL = 800, 270, 190, 125
"""Pixels: the width of plots, and the heights of large, low and small ones."""
LEFT = 70
"""Pixels for the numbers of a vertical axis, equal for all plots: the time axes line up."""
X = "x"
"""The column of an axis's source along it."""
MOST = 2_000
"""Largest number of points of a curve, more than the columns of a plot. Layout."""
MAX_AXIS_RANGE = 1e3
"""Largest distance of a curve from a plot, in heights of the plot: a canvas takes no larger
numbers. Layout."""
DATES: dict[str, Any] = {
    "milliseconds": "%H:%M:%S.%3N",
    **dict.fromkeys(("seconds", "minsec"), "%H:%M:%S"),
    **dict.fromkeys(("minutes", "hourmin"), "%H:%M"),
    "hours": "%H:%M",
    "days": "%d %b",
    "months": "%b %Y",
    "years": "%Y",
}
BELOW: dict[str, Any] = dict.fromkeys([*DATES][:-3], "%d %b") | {"days": "%Y"}
"""What stands below the first time of the day, or day of the year, on an axis."""
MIN_EXPONENT = 4
"""Least exponent of a number that is written as a power of ten. Layout."""
MOST_DECIMALS = 12
"""Largest number of decimals in a tooltip. Layout."""


@dataclass(frozen=True, eq=False)
class Axis:
    """The common axis of several charts, which zoom together."""

    values: Array  # positions of the samples; dates are in milliseconds since 1970
    label: str  # label with the unit
    shown: Range1d  # the visible range
    bins: npt.NDArray[np.int64]  # first samples of bins; two values of a longer bin are drawn
    dates: bool = False  # whether the values are dates
    log: bool = False

    @cached_property
    def source(self) -> ColumnDataSource:
        """Return the drawn positions, and the curves of all charts over this axis."""
        return ColumnDataSource({X: self.drawn})

    @classmethod
    def over(cls, values: Array, label: str, name: str = "", dates: bool = False) -> Axis:
        """Return an axis of numbers; the buttons of the page move the axis named "time"."""
        margin = 0.01 * (values[-1] - values[0] or 1.0)
        shown = _range(values[0] - margin, values[-1] + margin, name)
        samples = len(values)
        size = 1 if samples <= MOST else math.ceil(2 * samples / MOST)
        return cls(values, label, shown, np.arange(0, samples, size), dates)

    @classmethod
    def over_frequency(cls, values: Array, unit: str) -> Axis:
        """Return a logarithmic axis, with equally wide bins."""
        # A short record has only one.
        shown = _range(0.95 * values[0], 1.05 * max(values[-1], 2 * values[0]))
        bins = np.arange(len(values))
        if len(values) > MOST:
            edges = np.geomspace(1, len(values), MOST // 2, endpoint=False)
            bins = np.unique(edges.astype(np.int64)) - 1
        return cls(values, f"frequency ({unit})", shown, bins, log=True)

    @classmethod
    def over_time(cls, record: Record, name: str = "") -> Axis:
        """Return the time axis of a record."""
        rows, step = np.arange(len(record)), record.sampling_time
        if record.start is None and step == 1:
            return cls.over(rows.astype(float), "sample", name)
        stamps = stamps_at(0.0 if record.start is None else record.start, step, rows)
        if isinstance(stamps, pd.DatetimeIndex):
            naive = in_one_offset(stamps).to_numpy().astype("datetime64[us]")
            return cls.over(naive.astype(np.int64) / 1e3, "time", name, dates=True)
        since = "time since the first sample (s)" if record.start is None else "time (s)"
        return cls.over(np.asarray(stamps, float), since, name)

    @property
    def whole(self) -> bool:
        """Return whether all samples are drawn."""
        return len(self.bins) == len(self.values)

    @property
    def digits(self) -> str:
        """Return the format of a position, with decimals for the range of the axis."""
        size = float(self.values[0] if self.log else np.ptp(self.values)) or 1.0
        return f"0,0.[{'0' * min(max(3 - math.floor(math.log10(size)), 3), MOST_DECIMALS)}]"

    @property
    def drawn(self) -> Array:
        """Return the drawn positions: two a bin, equal for all curves."""
        if self.whole:
            return self.values
        sizes = np.diff(self.bins, append=len(self.values))
        pairs = np.stack([self.bins + sizes // 4, self.bins + 3 * sizes // 4], axis=1)
        return self.values[pairs.ravel()]

    def thinned(self, y: Array) -> Array:
        """Return the lowest and the highest value by bin, in the order of the curve."""
        if self.whole:
            return y
        low, high = np.fmin.reduceat(y, self.bins), np.fmax.reduceat(y, self.bins)
        falls = y[self.bins] > y[np.append(self.bins[1:], len(y)) - 1]
        pairs = np.where(falls[:, None], np.stack([high, low], 1), np.stack([low, high], 1))
        return np.asarray(pairs.ravel())


def _range(low: float, high: float, name: str = "") -> Range1d:
    """Return a range with limits for panning and zooming."""
    shown = Range1d(start=low, end=high, bounds=(low, high), name=name or None)
    shown.update(reset_start=low, reset_end=high)
    return shown


class Chart:
    """A chart with curves, and only the necessary tools.

    Labels are plain text: to look for formulas in users' names, Bokeh would load a library. Several
    `small` charts share a row.
    """

    def __init__(  # noqa: PLR0913
        self,
        axis: Axis,
        label: str,
        limits: tuple[float, float],
        caption: str,
        height: int = TALL,
        log: bool = False,
        small: bool = False,
    ) -> None:
        self.axis, self.label, self.limits, self.log = axis, label, limits, log
        self.caption, self.small, self.keys = caption, small, list[Key]()
        box = "xbox_zoom" if log else "box_zoom"
        shown = self.figure = figure(
            x_range=axis.shown,
            y_range=Range1d(start=limits[0], end=limits[1]),
            x_axis_type="datetime" if axis.dates else "log" if axis.log else "auto",
            y_axis_type="log" if log else "auto",
            tools=f"xpan,xwheel_zoom,{box},reset,save",
            active_drag=box,
            active_scroll=None,
        )
        shown.update(width=WIDTH, height=height, sizing_mode="stretch_width", toolbar_inner=True)
        shown.update(min_border_left=LEFT, background_fill_color=None, border_fill_color=None)
        tips = [("", "$name"), (axis.label, "$x{%F %T}" if axis.dates else f"$x{{{axis.digits}}}")]
        hover = HoverTool(tooltips=[*tips, ("", "$y")], line_policy="nearest", visible=False)
        hover.formatters = {"$x": "datetime"} if axis.dates else {}
        shown.add_tools(hover)
        shown.toolbar.update(logo=None, autohide=True)
        shown.lod_threshold = None
        shown.yaxis.axis_label = PlainText(text=label)
        shown.xaxis.axis_label = PlainText(text=axis.label)
        for each in (*[shown.xaxis] * axis.log, *[shown.yaxis] * log):
            each.formatter = LogTickFormatter(min_exponent=MIN_EXPONENT)
        if log:
            shown.yaxis.ticker = _decades(limits)
        elif height <= SMALL:
            shown.yaxis.ticker = BasicTicker(desired_num_ticks=4)
        shown.xaxis.major_label_policy = NoOverlap()
        if axis.dates:
            below, shown.xaxis.axis_label = DatetimeTickFormatter(**BELOW), None
            shown.xaxis.formatter = DatetimeTickFormatter(
                **DATES, context=below, context_which="start"
            )

    @property
    def legend(self) -> list[Key]:
        """Return the legend: curves, the last one first, then areas; none of a single curve."""
        curves = [key for key in reversed(self.keys) if not key.shaded]
        return [*curves, *(key for key in self.keys if key.shaded)] if len(curves) > 1 else []

    @property
    def says(self) -> str:
        """Describe the plot for blind readers."""
        curves = "; ".join(key.name for key in self.keys)
        return f"{self.caption}. Plot of {self.label} over {self.axis.label}: {curves}."

    def line(self, y: Array, key: Key, stepped: bool = False, **style: Any) -> None:
        """Add a curve.

        With `stepped`, values are constant until the next sample, if all samples are drawn.
        """
        column = self._kept(self.axis.thinned(self._within(y)))
        look: dict[str, Any] = {"line_width": 1.4, "line_dash": [*key.dash], **style}
        if stepped and self.axis.whole:
            self._add(Step(x=X, y=column, mode="after", **look), key)
        else:
            self._add(Line(x=X, y=column, **look), key)

    def stems(self, y: Array, key: Key) -> None:
        """Add vertical lines from 0 to the values."""
        ends = (self._kept(each) for each in (0 * self.axis.drawn, self.axis.thinned(y)))
        y0, y1 = ends
        self._add(Segment(x0=X, x1=X, y0=y0, y1=y1, line_width=2), key)

    def band(self, lower: Array, upper: Array, key: Key) -> None:
        """Add a shaded area between two curves."""
        names = [self._kept(self.axis.thinned(self._within(edge))) for edge in (lower, upper)]
        self._add(VArea(x=X, y1=names[0], y2=names[1], fill_alpha=0.25), key)
        for name in names:
            self._add(Line(x=X, y=name, line_width=1.2), key)

    def shade(self, key: Key, **edges: Any) -> None:
        """Shade a part of the chart: from `left` to `right`, or from `bottom` to `top`."""
        self.keys.append(key)
        box = BoxAnnotation(fill_alpha=0.25, level="underlay", tags=[key.color], **edges)
        self.figure.add_layout(box)

    def mark(
        self, at: float, role: str = "mark", dimension: Literal["width", "height"] = "height"
    ) -> None:
        """Add a dashed line across the chart."""
        style: dict[str, Any] = {"line_dash": "dashed", "line_width": 1.2, "tags": [role]}
        self.figure.add_layout(Span(location=at, dimension=dimension, **style))

    def _add(self, glyph: Any, key: Key) -> None:
        """Add a glyph without Bokeh's glyphs for selections, which take most of a page's time."""
        if key not in self.keys:
            self.keys.append(key)
        none: dict[str, Any] = dict.fromkeys(
            ("selection_glyph", "nonselection_glyph", "muted_glyph")
        )
        renderer = GlyphRenderer(data_source=self.axis.source, glyph=glyph, name=key.name, **none)
        renderer.update(tags=[key.color], visible=not key.hidden)
        self.figure.renderers.append(renderer)

    def _within(self, y: Array) -> Array:
        """Clip a curve to the numbers of a canvas."""
        if self.log:
            return np.maximum(y, 1e-300)
        low, high = self.limits
        reach = MAX_AXIS_RANGE * (high - low or 1.0)
        return np.clip(y, low - reach, high + reach)

    def _kept(self, values: Any) -> str:
        data = self.axis.source.data
        name = f"y{len(data)}"
        data[name] = values
        return name


def _decades(limits: tuple[float, float]) -> FixedTicker:
    """Return ticks of a logarithmic axis at 1, 2 and 5; over many decades only at 1."""
    first, last = (math.floor(math.log10(v)) for v in limits)
    step = max((last - first) // 8, 1)
    mantissas = (1, 2, 5) if last - first < 4 else (1,)
    ticks = [m * 10.0**d for d in range(first, last + 1, step) for m in mantissas]
    minor = [m * 10.0**d for d in range(first, last + 1) for m in range(1, 10)]
    return FixedTicker(ticks=ticks, minor_ticks=minor if step == 1 else ticks)


def limits(values: Sequence[Array], margin: float = 0.1) -> tuple[float, float]:
    """Return limits around the finite values of some curves."""
    finite = np.concatenate([v[np.isfinite(v)].ravel() for v in values] or [np.zeros(1)])
    if not len(finite):
        return -1.0, 1.0
    low, high = float(finite.min()), float(finite.max())
    room = margin * (high - low or abs(high) or 1.0)
    return low - room, high + room


def log_limits(values: Array) -> tuple[float, float]:
    """Return limits of a logarithmic axis around the positive finite values."""
    positive = values[np.isfinite(values) & (values > 0)]
    low, high = (float(f(positive)) for f in (np.min, np.max)) if len(positive) else (1.0, 1.0)
    return 0.7 * low, 1.5 * high

"""Figures of Bokeh as the page has them; their colours are set by its script, light or dark."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
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
from bokeh.models.annotations import BoxAnnotation, Span
from bokeh.models.renderers import GlyphRenderer
from bokeh.plotting import figure

from splitband.data import Record
from splitband.report.page.parts import Method

Array = npt.NDArray[np.float64]

WIDTH, TALL, LOW, SMALL = 800, 270, 210, 150
LEFT = 70
"""Pixels for the numbers beside an axis, so that the axes of time lie below each other."""
X = " x"
"""The column of a figure's source along its axis, which no method is called."""
FARTHEST = 1e3
"""Times the height of a plot: how far out a curve is drawn, as a canvas takes no larger numbers."""
DATES: dict[str, Any] = {
    "milliseconds": "%H:%M:%S.%3N", "seconds": "%H:%M:%S", "minsec": "%H:%M:%S",
    "minutes": "%H:%M", "hourmin": "%H:%M", "hours": "%d %b %H:%M", "days": "%d %b",
    "months": "%b %Y", "years": "%Y",
}  # fmt: skip
_DASHES = "dashed", "dotted", "dashdot"


@dataclass(frozen=True, eq=False)
class TimeAxis:
    """The times of a record as they are drawn.

    Attributes
    ----------
    values : Seconds or samples, `(time,)`; of dates milliseconds, as browsers count them.
    label : With its unit.
    dates : Whether they are dates.
    unit : Of a duration along it.
    per_unit : Seconds of that unit.
    """

    values: Array
    label: str
    dates: bool = False
    unit: str = "s"
    per_unit: float = 1.0

    @classmethod
    def of(cls, record: Record, ahead: int = 0) -> TimeAxis:
        """The times of a record and of so many samples after it."""
        grid = np.arange(len(record) + ahead)
        stamps = record.stamps
        if ahead:
            stamps = _joined(stamps, record.grid.after(ahead).start, record.sampling_time, ahead)
        if isinstance(stamps, pd.DatetimeIndex):
            naive = stamps.tz_localize(None).to_numpy().astype("datetime64[us]")
            return cls(naive.astype(np.int64) / 1e3, "time", True)
        if record.start is not None:
            return cls(np.asarray(stamps, float), "time (s)")
        if record.sampling_time == 1:
            return cls(grid.astype(float), "sample", unit="samples")
        return cls(np.asarray(stamps, float), "time since the first sample (s)")

    @property
    def whole(self) -> tuple[float, float]:
        """From the first to the last."""
        return float(self.values[0]), float(self.values[-1])


def _joined(stamps: Any, start: Any, step: float, ahead: int) -> Any:
    """Time stamps that go on for so many samples."""
    if isinstance(stamps, pd.DatetimeIndex):
        return stamps.append(start + pd.to_timedelta(step * np.arange(ahead), unit="s"))
    return np.concatenate([stamps, stamps[-1] + step * np.arange(1, ahead + 1)])


def time_range(start: float, end: float, name: str = "") -> Range1d:
    """A range that several figures share; the buttons of the page move the one called "time"."""
    margin = 0.01 * (end - start or 1.0)
    return along(start - margin, end + margin, name)


def along(low: float, high: float, name: str = "") -> Range1d:
    """A range from which nothing leads out."""
    shown = between(low, high)
    shown.update(bounds=(low, high), reset_start=low, reset_end=high, name=name or None)
    return shown


def between(low: float, high: float) -> Range1d:
    """A range of an axis."""
    return Range1d(start=low, end=high)


def ends(shown: Range1d) -> tuple[float, float]:
    """From where to where a range goes."""
    return float(shown.start), float(shown.end)  # type: ignore[arg-type]


def plain(
    y_label: str, x_label: str = "", height: int = TALL, dates: bool = False, **options: Any
) -> figure:
    """An empty figure as wide as the page, without anything to click that a reader does not need.

    Names are of the user: they are not looked through for formulas, which would be loaded.
    """
    shown = figure(
        width=WIDTH, height=height, sizing_mode="stretch_width", tools="", min_border_left=LEFT,
        toolbar_inner=True,
        x_axis_type="datetime" if dates else options.pop("x_axis_type", "auto"), **options,
    )  # fmt: skip
    logarithmic = options.get("y_axis_type") == "log"
    pan = PanTool(dimensions="width")
    box = BoxZoomTool(dimensions="width" if logarithmic else "both")
    shown.add_tools(pan, box, WheelZoomTool(dimensions="width"), ResetTool(), SaveTool())
    shown.toolbar.active_drag = box
    shown.toolbar.logo = None
    shown.toolbar.autohide = True
    shown.lod_threshold = None
    shown.yaxis.axis_label = PlainText(text=y_label)
    shown.xaxis.axis_label = PlainText(text=x_label)
    if logarithmic:
        shown.yaxis.ticker = _decades(options["y_range"])
    if dates:
        shown.xaxis.formatter = DatetimeTickFormatter(**DATES)
    return shown


def _decades(y_range: Range1d) -> FixedTicker:
    """Ticks of a logarithmic axis at 1, 2 and 5, or where there are many decades at 1 alone."""
    first, last = (math.floor(math.log10(v)) for v in ends(y_range))
    step = max((last - first) // 8, 1)
    mantissas = (1, 2, 5) if last - first < 4 else (1,)
    ticks = [m * 10.0**d for d in range(first, last + 1, step) for m in mantissas]
    minor = [m * 10.0**d for d in range(first, last + 1) for m in range(1, 10)]
    return FixedTicker(ticks=ticks, minor_ticks=minor if step == 1 else ticks)


def hover(shown: figure, x: str, dates: bool = False) -> None:
    """Say the name and the values of the curve under the pointer."""
    shown.add_tools(
        HoverTool(
            tooltips=[("", "$name"), (x, "$x{%F %T}" if dates else "$x{0,0.[000]}"), ("", "$y")],
            formatters={"$x": "datetime"} if dates else {},
            line_policy="nearest",
            visible=False,
        )
    )


def source(x: Array, curves: Mapping[str, Any]) -> ColumnDataSource:
    """What the curves of a figure, by name, have in common."""
    return ColumnDataSource({X: x, **curves})


def line(
    shown: figure, data: ColumnDataSource, column: str, role: str, name: str, **style: Any
) -> None:
    """A curve in the colour of a role (`measured`, `truth`, `c0`...)."""
    _add(shown, data, Line(x=X, y=column, **style), name, [role])


def method_line(
    shown: figure, data: ColumnDataSource, column: str, method: Method, **style: Any
) -> None:
    """A method's curve, which its switch turns on and off."""
    dash = style.pop("line_dash", "dashed" if method.dashed else "solid")
    width = style.pop("line_width", 2.0 if method.recommended else 1.4)
    glyph = Line(x=X, y=column, line_width=width, line_dash=dash, **style)
    _add(shown, data, glyph, method.name, _tags(method), method.shown)


def method_band(
    shown: figure, data: ColumnDataSource, lower: str, upper: str, method: Method,
    interval: bool = False,
) -> None:  # fmt: skip
    """What surrounds a method's curve; of intervals only the recommended method's is seen at first.

    All at once would hide each other.
    """
    tags = [*_tags(method), *(["interval"] if interval and not method.recommended else [])]
    glyph = VArea(x=X, y1=lower, y2=upper, fill_alpha=0.18)
    _add(shown, data, glyph, method.name, tags, method.shown and "interval" not in tags)


def _add(
    shown: figure, data: ColumnDataSource, glyph: Any, name: str, tags: list[str],
    visible: bool = True,
) -> None:  # fmt: skip
    """Add a curve without what the methods of `figure` make beside it: glyphs of what is selected.

    Most of the time that a page takes would go into these.
    """
    renderer = GlyphRenderer(
        data_source=data, glyph=glyph, name=name, tags=tags, visible=visible,
        selection_glyph=None, nonselection_glyph=None, muted_glyph=None,
    )  # fmt: skip
    shown.renderers.append(renderer)


def _tags(method: Method) -> list[str]:
    """What the script of the page knows a curve by: its colour, and that it has a switch."""
    return [f"c{method.color}", "method"]


def dash(i: int) -> str:
    """The style of the i-th line of one colour."""
    return "solid" if i == 0 else next(itertools.islice(itertools.cycle(_DASHES), i - 1, None))


def shade(shown: figure, left: float, right: float) -> None:
    """Mark a warm-up."""
    shown.add_layout(BoxAnnotation(left=left, right=right, fill_alpha=0.12, tags=["shade"]))


def mark(
    shown: figure, at: float, role: str = "mark", dimension: Literal["width", "height"] = "height"
) -> None:
    """A line across."""
    shown.add_layout(
        Span(location=at, dimension=dimension, line_dash="dashed", line_width=1.2, tags=[role])
    )


def clipped(y: Array, low: float, high: float) -> Array:
    """Without what is so far out that a canvas cannot draw it."""
    reach = FARTHEST * (high - low or 1.0)
    return np.clip(y, low - reach, high + reach)


def limits(values: Sequence[Array], margin: float = 0.25) -> tuple[float, float]:
    """Around what is finite of some curves."""
    seen = np.concatenate([v[np.isfinite(v)].ravel() for v in values] or [np.zeros(1)])
    if not len(seen):
        return -1.0, 1.0
    low, high = float(seen.min()), float(seen.max())
    room = margin * (high - low or abs(high) or 1.0)
    return low - room, high + room

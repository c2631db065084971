"""Pictures of comparisons and spectra; the only importer of matplotlib."""

from __future__ import annotations

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splitband.data import Record
from splitband.data.gaps import last_before
from splitband.evaluation.comparison import Comparison
from splitband.evaluation.forecast import Forecast
from splitband.evaluation.protocols import Run, by_channel
from splitband.filters.cutoff import LEAST_PASSED, Choice
from splitband.filters.spectrum import Spectrum, coherence, periodogram
from splitband.forecasters.intervals import Interval
from splitband.forecasters.prediction import Prediction
from splitband.metrics import cumulative_rmse
from splitband.report.colors import PALETTE, place
from splitband.runtime.files import replacing

Array = npt.NDArray[np.float64]
Picture: TypeAlias = Figure
Runs = Mapping[str, Sequence[Run]]

_MEASURED, _TRUTH = "0.55", "0.15"


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)


@dataclass(frozen=True, eq=False)
class _Side:
    """One protocol's column in the picture of free runs.

    Attributes
    ----------
    record : What was measured.
    start : Index of the first predicted sample.
    y : What was predicted from there to the record's end.
    """

    record: Record
    start: int
    y: Array


def rollouts(comparison: Comparison) -> Figure:
    """Every method's prediction over the record, one row each; a column for each protocol.

    Test records have a column each. With a trial, each forecast has its interval around it, and the
    recommended method is named.
    """
    record, runs, trial = comparison.record, comparison.runs, comparison.trial
    untested = comparison.left_out
    names = [*(name for name in runs if name not in untested), *untested]
    rows = [(name, channel) for name in names for channel in range(record.ny)]
    ahead = any(mean.forecast is not None for mean in comparison.means.values())
    columns = 1 + ahead + len(comparison.tests)
    figure = Figure(figsize=(6.5 * max(columns, 2), 1.1 + 1.25 * len(rows)), layout="constrained")
    grid = figure.subplots(len(rows), columns, sharex="col", sharey="row", squeeze=False)
    end, times = comparison.setup.train, _times(record)
    for axes, (name, channel) in zip(grid, rows, strict=True):
        warmup = comparison.setup.settings.warmup
        sides = _sides(comparison, name, ahead)
        for ax in axes[len(sides) :]:  # a method that was not tested has no curve here
            ax.set_axis_off()
            ax.text(0.01, 0.5, f"{name}: not tested", transform=ax.transAxes, fontsize=9)
        for ax, side in zip(axes, sides, strict=False):
            _draw_side(ax, side, channel, warmup, _color(runs, name))
            chosen = trial is not None and name == trial.recommended
            error = by_channel(side.record, side.y)[channel]
            title = f"{name}{' (recommended)' if chosen else ''}   RMSE {error:.3g}"
            ax.set_title(title, fontsize=9, loc="left", pad=3)
        for ax in axes[: 1 + ahead]:
            if end < len(record):
                ax.axvline(times[end], color="0.4", ls=":", lw=1)
        forecast = comparison.predictions.get(name)
        if forecast is not None and forecast.lower is not None and forecast.upper is not None:
            edges = forecast.lower[:, channel], forecast.upper[:, channel]
            axes[1].fill_between(times[end:], *edges, color=_color(runs, name), alpha=0.18, lw=0)
        axes[0].set_ylabel(_literal(record.columns[channel]))
        axes[0].set_ylim(*_limits(record.seen[:, channel]))
    for column in grid.T:
        lowest = [ax for ax in column if ax.axison][-1]
        lowest.tick_params(labelbottom=True)
        lowest.set_xlabel(_time_label(record))
    figure.suptitle(_rollouts_title(comparison, ahead), fontsize=10)
    return figure


def _sides(comparison: Comparison, name: str, ahead: bool) -> list[_Side]:
    """What a method predicted under each protocol, the mean of its seeds."""
    record, mean = comparison.record, comparison.means[name]
    warmup, end = comparison.setup.settings.warmup, comparison.setup.train
    sides = [_Side(record, len(record) - len(mean.from_start), mean.from_start.y)]
    if ahead:
        start = last_before(record.complete, warmup, end)
        sides.append(_Side(record, end if start is None else start, mean.ahead))
    return sides + [
        _Side(test, len(test) - len(predicted), predicted.y)
        for test, predicted in zip(comparison.tests, mean.tests, strict=False)
    ]


def _draw_side(ax: Axes, side: _Side, channel: int, warmup: int, color: str) -> None:
    times, begin = _times(side.record), max(side.start - warmup, 0)
    _draw_record(ax, side.record, channel, begin)
    ax.plot(times[-len(side.y) :], side.y[:, channel], color=color, lw=1.1)
    ax.axvspan(times[begin], times[max(side.start - 1, 0)], color="0.93", zorder=0)
    ax.margins(x=0.01)


def _rollouts_title(comparison: Comparison, ahead: bool) -> str:
    sides = ["from the start"]
    if ahead:
        sides.append("forecast from the end of the training part (dotted line)")
        if comparison.trial is not None:
            sides[-1] += f", in {_interval(comparison.trial.intervals.values())}"
    sides += [f"test record {_literal(test.name)}" for test in comparison.tests]
    places = ["left", "right"] if len(sides) == 2 else [str(i + 1) for i in range(len(sides))]
    listed = "; ".join(f"{place}: {side}" for place, side in zip(places, sides, strict=False))
    return (
        f"{_literal(comparison.record.name)}: free runs (colour, mean of the seeds); grey line: "
        f"what was measured; shaded: warm-up\n{listed}"
    )


def forecast(result: Forecast) -> Figure:
    """The end of a record and what comes after it."""
    return prediction(result.prediction, result.record, result.method)


def prediction(
    predicted: Prediction, record: Record | None = None, method: str = "prediction"
) -> Figure:
    """A prediction with its interval, after the end of a record if one is given."""
    figure = Figure(figsize=(11, 0.8 + 2.2 * len(predicted.columns)), layout="constrained")
    grid = figure.subplots(len(predicted.columns), 1, sharex=True, squeeze=False)[:, 0]
    ahead = _drawn(pd.Index(predicted.time))
    title = f"{len(predicted)} samples ahead"
    if record is not None:
        time = _times(record)
        ahead = time[-1] + ahead if record.start is None else ahead
        shown = max(len(record) - 2 * len(predicted), 0)
        title = f"{_literal(record.name)}: {title}"
    for i, (ax, column) in enumerate(zip(grid, predicted.columns, strict=True)):
        if record is not None:
            ax.plot(time[shown:], record.seen[shown:, i], color="0.35", lw=0.9, label="measured")
        ax.plot(ahead, predicted.y[:, i], color=PALETTE[0], lw=1.2, label=_literal(method))
        lower, upper, level = predicted.lower, predicted.upper, predicted.level
        if lower is not None and upper is not None and level is not None:
            label = f"should hold {level:.0%}".replace("%", " %")
            edges = lower[:, i], upper[:, i]
            ax.fill_between(ahead, *edges, color=PALETTE[0], alpha=0.18, lw=0, label=label)
        ax.set_ylabel(_literal(column))
        ax.margins(x=0.01)
    grid[0].legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    grid[0].set_title(title, fontsize=10, loc="left")
    dates = isinstance(predicted.time, pd.DatetimeIndex)
    grid[-1].set_xlabel("time" if dates else "time (s)")
    return figure


def components(
    comparison: Comparison, what: Literal["components", "unfiltered"] = "components"
) -> Figure:
    """What each prediction from the start is the sum of, a row for each method of several parts.

    With "unfiltered", what the filters of a method were fed with instead.
    """
    record, setup, runs = comparison.record, comparison.setup, comparison.runs
    parts: dict[str, Mapping[str, Array]] = {
        name: of_method[0].from_start.components
        if what == "components"
        else of_method[0].unfiltered
        for name, of_method in runs.items()
    }
    rows = [(name, channel) for name in runs if parts[name] for channel in range(record.ny)]
    if not rows:
        raise ValueError(f"none of {', '.join(runs)} has {what} to draw")
    figure = Figure(figsize=(13, 0.9 + 1.7 * len(rows)), layout="constrained")
    grid = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    times = _times(record)
    says = "components before they are added" if what == "components" else "before the filters"
    for ax, (name, channel) in zip(grid, rows, strict=True):
        _draw_record(ax, record, channel, 0)
        warmup = setup.settings.warmup
        start = len(record) - len(next(iter(parts[name].values())))
        for color, (part, values) in zip(PALETTE, parts[name].items(), strict=False):
            ax.plot(times[start:], values[:, channel], color=color, lw=1, label=part)
        ax.axvspan(times[start - warmup], times[start - 1], color="0.93", zorder=0)
        if setup.train < len(record):
            ax.axvline(times[setup.train], color="0.4", ls=":", lw=1)
        ax.set_title(f"{name}: {says}", fontsize=9, loc="left", pad=3)
        ax.set_ylabel(_literal(record.columns[channel]))
        ax.margins(x=0.01)
        ax.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    grid[-1].set_xlabel(_time_label(record))
    return figure


def errors(comparison: Comparison) -> Figure:
    """Return a picture of the cumulative RMSE e_n over time, a row for each channel.

    Lines are of the mean of the seeds' predictions, shaded is the range of the single seeds.
    """
    record, setup, runs = comparison.record, comparison.setup, comparison.runs
    figure = Figure(figsize=(13, 0.6 + 4 * record.ny), layout="constrained")
    protocols = [("from the start", _from_start), ("forecast", _forecast)]
    times, end = _times(record), setup.train
    if end == len(record):  # nothing is forecast
        protocols = protocols[:1]
    grid = figure.subplots(record.ny, len(protocols), squeeze=False)
    sides = [(channel, side) for channel in range(record.ny) for side in protocols]
    for ax, (channel, (title, prediction)) in zip(grid.flat, sides, strict=True):
        for name, of_method in runs.items():
            steps = len(prediction(of_method[0]))
            truth, time = record.truth[-steps:, channel], times[-steps:]
            mean, *each = (
                cumulative_rmse(truth, prediction(run)[:, channel])
                for run in (comparison.means[name], *of_method)
            )
            color = _color(runs, name)
            ax.plot(time, mean, color=color, lw=1.4, label=name)
            if len(each) > 1:
                low, high = np.min(each, axis=0), np.max(each, axis=0)
                ax.fill_between(time, low, high, color=color, alpha=0.15, lw=0)
        if end < len(record):
            ax.axvline(times[end], color="0.4", ls=":", lw=1)
        ax.set_yscale("log")
        # The first errors after a warm-up vary too much to set the scale by them.
        settled = [line.get_ydata()[10:] for line in ax.lines if len(line.get_ydata()) > 20]
        lowest = [float(y[y > 0].min()) for y in map(np.asarray, settled) if (y > 0).any()]
        ax.set_ylim(bottom=0.7 * min(lowest, default=1e-3))
        ax.yaxis.set_major_formatter("{x:g}")
        of = [record.name, title, *([record.columns[channel]] if record.ny > 1 else [])]
        ax.set_title(_literal(", ".join(of)), fontsize=10)
        ax.set_xlabel(_time_label(record))
        ax.set_ylabel("RMSE since the warm-up (e_n)")
        ax.grid(True, which="both", color="0.93", lw=0.6)
    grid[0, -1].legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1))
    return figure


def spectrum(
    record: Record,
    measured_spectrum: Spectrum,
    cutoff: float | None,
    choice: Choice | None = None,
) -> Figure:
    """The power spectral density of every channel with the cut-off marked.

    With a simulator, its spectrum beside them and the coherence of both below; with a `choice`,
    what each cut-off that was looked at would lose.
    """
    heights = [2.2, *[1] * (record.y_sim is not None), *[1] * (choice is not None)]
    figure = Figure(figsize=(8, 2 + 2 * len(heights)), layout="constrained")
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    _draw_spectrum(axes[0], record, measured_spectrum)
    if record.y_sim is not None:
        simulated = periodogram(record.y_sim, record.sampling_rate)
        frequencies, agreement = coherence(record.y, record.y_sim, record.sampling_rate)
        for i, name in enumerate(record.columns):
            label = f"simulator's {_literal(name)}"
            style = {"color": PALETTE[(2 + i) % len(PALETTE)], "lw": 1.2}
            axes[0].loglog(
                simulated.frequencies[1:], simulated.density[1:, i], "--", label=label, **style
            )
            axes[1].semilogx(frequencies[1:], agreement[1:, i], **style)
        axes[1].set_ylim(0, 1.02)
        axes[1].set_ylabel("coherence")
        axes[1].grid(True, which="both", color="0.93", lw=0.6)
    if cutoff is not None:
        said = f"cut-off {cutoff:.4g} Hz"
        for ax in axes:
            first = ax is axes[0]
            ax.axvline(cutoff, color="#D55E00", ls="--", lw=1.2, label=said if first else None)
    if choice is not None:
        _draw_choice(axes[-1], choice)
    figure.suptitle(f"{_literal(record.name)}: spectrum", fontsize=10)
    axes[0].legend(fontsize=8, loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)
    axes[-1].set_xlabel("frequency (Hz)")
    axes[-1].xaxis.set_major_formatter("{x:g}")
    return figure


def _draw_choice(ax: Axes, choice: Choice) -> None:
    """What each candidate would lose, and where the low band would not hold enough."""
    for order in sorted({c.order for c in choice.candidates}):
        of_order = [c for c in choice.candidates if c.order == order]
        enough = [c.passed >= LEAST_PASSED or choice.simulator_helps is True for c in of_order]
        color = PALETTE[order % len(PALETTE)]
        x, loss = [c.cutoff for c in of_order], [c.loss for c in of_order]
        ax.semilogx(x, loss, "o-", ms=3, lw=0.8, color=color, label=f"order {order}")
        few = [(c.cutoff, c.loss) for c, ok in zip(of_order, enough, strict=True) if not ok]
        if few:
            label = "little in the low band" if order == choice.order else None
            ax.semilogx(*zip(*few, strict=True), "x", color="0.4", ms=5, label=label)
    best = next(c for c in choice.candidates if not c.rejected)
    ax.semilogx([best.cutoff], [best.loss], "D", color="#D55E00", ms=6, label="chosen")
    ax.set_ylim(bottom=0)
    ax.set_ylabel(textwrap.fill(choice.loss, 24), fontsize=8)
    ax.grid(True, which="both", color="0.93", lw=0.6)
    ax.legend(fontsize=8, loc="best")


def _draw_spectrum(ax: Axes, record: Record, spectrum: Spectrum) -> None:
    for name, density in zip(record.columns, spectrum.density.T, strict=True):
        ax.loglog(
            spectrum.frequencies[1:], np.maximum(density[1:], 1e-300), lw=1, label=_literal(name)
        )
    top = spectrum.density[1:].max()
    if top > 0:
        ax.set_ylim(max(spectrum.density[1:].min(), top * 1e-9), top * 3)
    ax.set_ylabel("power spectral density (squared units per Hz)")
    ax.grid(True, which="both", color="0.93", lw=0.6)


def _from_start(run: Run) -> Array:
    return run.from_start.y


def _forecast(run: Run) -> Array:
    return run.ahead


def _interval(intervals: Iterable[Interval]) -> str:
    share = next(iter(intervals)).share
    return f"the interval that should hold {share:.0%} of what is measured"


def _literal(name: str) -> str:
    """A user's name, whose dollar signs are not for formulas."""
    return name.replace("$", r"\$")


def _draw_record(ax: Axes, record: Record, channel: int, begin: int) -> None:
    time = _times(record)[begin:]
    ax.plot(time, record.seen[begin:, channel], color=_MEASURED, lw=0.9)
    if record.y_true is not None:
        ax.plot(time, record.y_true[begin:, channel], color=_TRUTH, lw=0.7)


def _times(record: Record) -> npt.NDArray[Any]:
    """What is drawn along the axis of time: the time stamps, or seconds from the beginning."""
    return _drawn(pd.Index(record.stamps))


def _drawn(stamps: pd.Index[Any]) -> npt.NDArray[Any]:
    """Time stamps as matplotlib takes them; dates as they read in their own time zone."""
    if isinstance(stamps, pd.DatetimeIndex):
        stamps = stamps.tz_localize(None)
    return np.asarray(stamps)


def _time_label(record: Record) -> str:
    return "time" if isinstance(record.start, pd.Timestamp) else "time (s)"


def _color(runs: Runs, name: str) -> str:
    return PALETTE[place(runs, name)]


def _limits(y: Array) -> tuple[float, float]:
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    margin = 0.25 * (high - low or 1.0)
    return low - margin, high + margin

"""Draw pictures of comparisons and spectra; nothing else imports matplotlib."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splitband.data import Record
from splitband.evaluation.comparison import Comparison
from splitband.filters.cutoff import LEAST_PASSED, Choice
from splitband.filters.spectrum import Spectrum, coherence, periodogram
from splitband.forecasters.prediction import Prediction
from splitband.metrics import fit_percent, rmse
from splitband.report.colors import PALETTE
from splitband.report.numbers import number, squared
from splitband.report.table import FARTHEST, ordered
from splitband.runtime.arrays import Array
from splitband.runtime.files import replacing

MEASURED = "black"


def save(figure: Figure, path: str | Path) -> None:
    """Write a figure as PNG, whole or not at all."""
    with replacing(path) as temporary:
        figure.savefig(temporary, format="png", dpi=110)


@dataclass(frozen=True, eq=False)
class _Side:
    """Hold what one panel shows.

    Attributes
    ----------
    record : The measured record.
    start : Index of the first predicted sample; 0 where no method predicts any.
    what : The kind of prediction, in words.
    predicted : Predictions up to the record's end, by method; some methods may have none.
    """

    record: Record
    start: int
    what: str
    predicted: Mapping[str, Prediction]

    @property
    def first(self) -> int:
        """Return the index of the first sample that is drawn: shortly before the prediction."""
        return max(self.start - (len(self.record) - self.start) // 8, 0)


def rollouts(comparison: Comparison) -> Figure:
    """Draw the recommended method's predictions large, and those of the others small below.

    Panels show the forecast, with its interval, and each test record; without both, a simulation.
    """
    sides, names = _sides(comparison), ordered(comparison.trial, comparison.fits)
    best, *others = names
    ny, across = comparison.record.ny, max(SMALL_ACROSS // comparison.record.ny, 1)
    below = -(-len(others) // across)
    across = -(-len(others) // below) if below else 0  # rows of the same length
    large, small = 2.6 * ny * len(sides), 1.5 * below
    figure = Figure(figsize=(12, large + small + 1.2), layout="constrained")
    parts = figure.subfigures(2 if below else 1, 1, squeeze=False,
                              height_ratios=[large, small][: 1 + bool(below)])[:, 0]  # fmt: skip
    grid = parts[0].subplots(ny * len(sides), 1, squeeze=False)[:, 0]
    for ax, (side, channel) in zip(grid, product(sides, range(ny)), strict=True):
        _draw_large(ax, side, channel, best)
    if below:
        grid = parts[1].subplots(below, across * ny, squeeze=False, sharex=True, sharey=ny == 1)
        panels = [*product(others, range(ny))]
        for ax, (name, channel) in zip(grid.flat, panels, strict=False):
            color = PALETTE[names.index(name) % len(PALETTE)]
            _draw_small(ax, sides[0], channel, name, color)
        for i, ax in enumerate(grid.flat[len(panels) :], start=len(panels)):
            ax.set_axis_off()
            grid.flat[i - across * ny].tick_params(labelbottom=True)
        parts[1].supxlabel(time_label(comparison.record), fontsize=7)
        if ny == 1:
            parts[1].supylabel(literal(comparison.record.columns[0]), fontsize=7)
        parts[1].suptitle(f"Other methods, {sides[0].what}", fontsize=9)
    said = "" if comparison.trial is None else "recommended: "
    figure.suptitle(f"{literal(comparison.record.name)}; {said}{best}", fontsize=11)
    return figure


SMALL_ACROSS = 4
"""Small panels in a row. By eye."""


def _sides(comparison: Comparison) -> list[_Side]:
    """Return the panels of the forecast and the test records, or else one of the simulation."""
    record, medians, train = comparison.record, comparison.medians, comparison.plan.train
    sides = []
    if comparison.predictions:
        sides.append(_Side(record, train, "forecast", comparison.predictions))
    for i, test in enumerate(comparison.tests):
        tested = {name: run.tests[i] for name, run in medians.items() if run.tests}
        start = len(test) - max(map(len, tested.values()), default=len(test))
        sides.append(_Side(test, start, f"test record {literal(test.name)}", tested))
    simulated = {name: run.from_start for name, run in medians.items()}
    start = len(record) - max(map(len, simulated.values()))
    return sides or [_Side(record, start, "simulation", simulated)]


def _draw_large(ax: Axes, side: _Side, channel: int, name: str) -> None:
    record, times = side.record, times_of(side.record)
    predicted = side.predicted.get(name)
    title = f"{side.what}: not tested"
    if predicted is not None:
        y, at = predicted.y[:, channel], times[len(times) - len(predicted) :]
        _draw_interval(ax, at, predicted, channel)
        ax.plot(at, y, color=PALETTE[0], lw=3, label="predicted")  # wide, to show behind it
        truth = record.truth[len(times) - len(y) :, channel]
        fit, error = fit_percent(truth, y), rmse(truth, y)
        unit = f" {record.units[channel]}".rstrip()
        title = f"{side.what}: fit {fit:.1f} %, RMSE {number(error)}{unit}"
    seen = record.seen[side.first :, channel]
    ax.plot(times[side.first :], seen, color=MEASURED, lw=0.9, label="measured")
    ax.axvline(times[side.start], color="0.4", ls=":", lw=1)
    ax.set_ylim(*_limits(seen))
    ax.margins(x=0.005)
    ax.set_title(title, fontsize=10, loc="left")
    ax.set_ylabel(literal(record.columns[channel]))
    ax.set_xlabel(time_label(record))
    ax.legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False)


def _draw_interval(ax: Axes, at: npt.NDArray[Any], predicted: Prediction, channel: int) -> None:
    if predicted.lower is not None and predicted.upper is not None:
        label = f"{predicted.level:.0%} interval".replace("%", " %")
        edges = predicted.lower[:, channel], predicted.upper[:, channel]
        ax.fill_between(at, *edges, color=PALETTE[0], alpha=0.18, lw=0, label=label)


def _draw_small(ax: Axes, side: _Side, channel: int, name: str, color: str) -> None:
    record, times, predicted = side.record, times_of(side.record), side.predicted.get(name)
    seen, said = record.seen[side.first :, channel], "not tested"
    if predicted is not None:
        y = predicted.y[:, channel]
        ax.plot(times[len(times) - len(y) :], y, color=color, lw=2)
        fit = fit_percent(record.truth[len(times) - len(y) :, channel], y)
        said = f"fit {round(fit) + 0} %" if fit > FARTHEST else f"fit < {FARTHEST:.0f} %"
    ax.plot(times[side.first :], seen, color=MEASURED, lw=0.6)
    ax.set_ylim(*_limits(seen))
    ax.margins(x=0.01)
    ax.set_title(f"{name}\n{said}", fontsize=7, loc="left", pad=2)
    ax.tick_params(labelsize=6)
    if record.ny > 1:
        ax.set_ylabel(literal(record.columns[channel]), fontsize=6)


def prediction(
    predicted: Prediction, record: Record | None = None, method: str = "prediction"
) -> Figure:
    """Draw a prediction with its interval, after the end of a record if one is given."""
    figure = Figure(figsize=(11, 0.8 + 2.2 * len(predicted.columns)), layout="constrained")
    grid = figure.subplots(len(predicted.columns), 1, sharex=True, squeeze=False)[:, 0]
    ahead = _drawn(pd.Index(predicted.time))
    title = f"{len(predicted)} samples ahead"
    if record is not None:
        time = times_of(record)
        ahead = time[-1] + ahead if record.start is None else ahead
        shown = max(len(record) - len(predicted), 0)
        title = f"{literal(record.name)}: {title}"
    for i, (ax, column) in enumerate(zip(grid, predicted.columns, strict=True)):
        if record is not None:
            ax.plot(time[shown:], record.seen[shown:, i], color=MEASURED, lw=0.9, label="measured")
        ax.plot(ahead, predicted.y[:, i], color=PALETTE[0], lw=1.2, label=literal(method))
        _draw_interval(ax, ahead, predicted, i)
        ax.set_ylabel(literal(column))
        ax.margins(x=0.01)
    grid[0].legend(fontsize=8, loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3)
    grid[0].set_title(title, fontsize=10, loc="left")
    dates = isinstance(predicted.time, pd.DatetimeIndex)
    grid[-1].set_xlabel("time" if dates else "time (s)")
    return figure


def spectrum(
    record: Record,
    measured_spectrum: Spectrum,
    cutoff: float | None,
    choice: Choice | None = None,
) -> Figure:
    """Draw the power spectral density of every channel with the cut-off marked.

    With a simulator, also draw its spectrum and its coherence with the record; with a `choice`,
    the loss at each candidate cut-off.
    """
    heights = [2.2, *[1] * (record.y_sim is not None), *[1] * (choice is not None)]
    figure = Figure(figsize=(8, 2 + 2 * len(heights)), layout="constrained")
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    _draw_spectrum(axes[0], record, measured_spectrum)
    if record.y_sim is not None:
        simulated = periodogram(record.y_sim, record.sampling_rate)
        frequencies, agreement = coherence(record.y, record.y_sim, record.sampling_rate)
        for i, name in enumerate(record.columns):
            label = f"simulator's {literal(name)}"
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
    figure.suptitle(f"{literal(record.name)}: spectrum", fontsize=10)
    axes[0].legend(fontsize=8, loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)
    axes[-1].set_xlabel("frequency (Hz)")
    axes[-1].xaxis.set_major_formatter("{x:g}")
    return figure


def _draw_choice(ax: Axes, choice: Choice) -> None:
    """Draw the loss of each candidate cut-off, and mark those whose low band holds too little."""
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
            spectrum.frequencies[1:], np.maximum(density[1:], 1e-300), lw=1, label=literal(name)
        )
    top = spectrum.density[1:].max()
    if top > 0:
        ax.set_ylim(max(spectrum.density[1:].min(), top * 1e-9), top * 3)
    ax.set_ylabel(f"power spectral density ({squared(record)}/Hz)")
    ax.grid(True, which="both", color="0.93", lw=0.6)


def literal(name: str) -> str:
    """Escape dollar signs in a user's name, which matplotlib would read as formulas."""
    return name.replace("$", r"\$")


def times_of(record: Record) -> npt.NDArray[Any]:
    """Return the values of the time axis: time stamps, or seconds from the first sample."""
    return _drawn(pd.Index(record.stamps))


def _drawn(stamps: pd.Index[Any]) -> npt.NDArray[Any]:
    """Return time stamps as matplotlib takes them; dates are in their own time zone."""
    if isinstance(stamps, pd.DatetimeIndex):
        stamps = stamps.tz_localize(None)
    return np.asarray(stamps)


def time_label(record: Record) -> str:
    """Return the label of the time axis."""
    return "time" if isinstance(record.start, pd.Timestamp) else "time (s)"


def _limits(y: Array) -> tuple[float, float]:
    low, high = float(np.nanmin(y)), float(np.nanmax(y))
    margin = 0.25 * (high - low or 1.0)
    return low - margin, high + margin

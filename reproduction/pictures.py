"""Pictures of the paper's runs: how errors grow, and what a prediction is the sum of."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Literal

import numpy as np
import numpy.typing as npt
from matplotlib.figure import Figure

from splitband.comparison.backtest import Fit
from splitband.comparison.result import Comparison
from splitband.filters.spectrum import coherence, periodogram
from splitband.metrics import cumulative_rmse, rmse
from splitband.report.colors import PALETTE
from splitband.report.numbers import squared
from splitband.report.pictures import MEASURED, literal, time_label, times_of
from splitband.report.tables import ordered

Array = npt.NDArray[np.float64]


def spectrum(comparison: Comparison) -> Figure:
    """Draw the power spectral density of every channel, with the cut-off marked.

    With a simulator, also draw its spectrum, dashed, and its coherence with the record.
    """
    record, rate = comparison.record, comparison.record.sampling_rate
    heights = [2.2, 1.0][: 1 + (record.y_sim is not None)]
    figure = Figure(figsize=(8, 2 + 2 * len(heights)), layout="constrained")
    axes = figure.subplots(len(heights), 1, sharex=True, squeeze=False, height_ratios=heights)[:, 0]
    found = periodogram(record.y, rate)
    for i, (name, density) in enumerate(zip(record.columns, found.density.T, strict=True)):
        shown = np.maximum(density[1:], 1e-300)
        axes[0].loglog(found.frequencies[1:], shown, lw=1, label=literal(name))
        if record.y_sim is not None:
            simulated = periodogram(record.y_sim, rate)
            color, label = PALETTE[(2 + i) % len(PALETTE)], f"simulator's {literal(name)}"
            y = simulated.density[1:, i]
            axes[0].loglog(simulated.frequencies[1:], y, "--", color=color, lw=1.2, label=label)
            frequencies, agreement = coherence(record.y, record.y_sim, rate)
            axes[1].semilogx(frequencies[1:], agreement[1:, i], color=color, lw=1.2)
            axes[1].set(ylim=(0, 1.02), ylabel="coherence")
    top = float(found.density[1:].max())
    axes[0].set_ylim(max(float(found.density[1:].min()), top * 1e-9), top * 3)
    axes[0].set_ylabel(f"power spectral density ({squared(record)}/Hz)")
    cutoff = comparison.plan.bands.cutoff
    for ax in axes:
        ax.grid(True, which="both", color="0.93", lw=0.6)
        if cutoff is not None:
            ax.axvline(cutoff, color="#D55E00", ls="--", lw=1.2, label=f"cut-off {cutoff:.4g} Hz")
    figure.suptitle(f"{literal(record.name)}: spectrum", fontsize=10)
    axes[0].legend(fontsize=8, loc="lower left", bbox_to_anchor=(0, 1), ncols=3, frameon=False)
    axes[-1].set_xlabel("frequency (Hz)")
    axes[-1].xaxis.set_major_formatter("{x:g}")
    return figure


def components(
    comparison: Comparison, what: Literal["components", "unfiltered"] = "components"
) -> Figure:
    """What each prediction from the start is the sum of, a row for each method of several parts.

    With "unfiltered", what the filters of a method were fed with instead.
    """
    record, setup, runs = comparison.record, comparison.plan, comparison.fits
    parts: dict[str, Mapping[str, Array]] = {
        name: of_method[0].from_start.components
        if what == "components"
        else getattr(of_method[0], "unfiltered", {})
        for name, of_method in runs.items()
    }
    rows = [(name, channel) for name in runs if parts[name] for channel in range(record.ny)]
    if not rows:
        raise ValueError(f"none of {', '.join(runs)} has {what} to draw")
    figure = Figure(figsize=(13, 0.9 + 1.7 * len(rows)), layout="constrained")
    grid = figure.subplots(len(rows), 1, sharex=True, squeeze=False)[:, 0]
    times = times_of(record)
    says = "components before they are added" if what == "components" else "before the filters"
    for ax, (name, channel) in zip(grid, rows, strict=True):
        warmup = setup.settings.warmup
        start = len(record) - len(next(iter(parts[name].values())))
        seen = record.y_with_gaps[:, channel]
        ax.plot(times, seen - np.nanmean(seen), color=MEASURED, lw=0.8, label="measured")
        for color, (part, values) in zip(PALETTE, parts[name].items(), strict=False):
            y = values[:, channel] - values[:, channel].mean()
            ax.plot(times[start:], y, color=color, lw=1, label=part)
        ax.axvspan(times[start - warmup], times[start - 1], color="0.93", zorder=0)
        if setup.train < len(record):
            ax.axvline(times[setup.train], color="0.4", ls=":", lw=1)
        ax.set_title(f"{name}: {says}, each less its mean", fontsize=9, loc="left", pad=3)
        ax.set_ylabel(literal(record.columns[channel]))
        ax.margins(x=0.01)
        ax.legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    grid[-1].set_xlabel(time_label(record))
    return figure


def rollouts(comparison: Comparison) -> Figure:
    """Draw the median predictions of each method, a row for each channel, by both protocols."""
    record, setup, medians = comparison.record, comparison.plan, comparison.medians
    rows = [(name, channel) for name in medians for channel in range(record.ny)]
    figure = Figure(figsize=(13, 0.9 + 1.25 * len(rows)), layout="constrained")
    grid = figure.subplots(len(rows), 2, sharex="col", sharey=record.ny == 1, squeeze=False)
    times, names = times_of(record), ordered(comparison.trial, medians)
    for axes, (name, channel) in zip(grid, rows, strict=True):
        color = PALETTE[names.index(name) % len(PALETTE)]
        for ax, (title, prediction) in zip(axes, PROTOCOLS.items(), strict=True):
            y = prediction(medians[name])[:, channel]
            begin = len(record) - len(y)
            first = max(begin - setup.settings.warmup, 0)
            ax.plot(times[first:], record.y_with_gaps[first:, channel], color=MEASURED, lw=0.8)
            ax.plot(times[begin:], y, color=color, lw=1.2)
            ax.axvspan(times[first], times[begin - 1], color="0.93", zorder=0)
            if setup.train < len(record):
                ax.axvline(times[setup.train], color="0.4", ls=":", lw=1)
            error = rmse(record.truth[begin:, channel], y)
            ax.set_title(f"{name}, {title}: RMSE {error:.3g}", fontsize=9, loc="left", pad=3)
            ax.margins(x=0.01)
        axes[0].set_ylabel(literal(record.columns[channel]))
    # A method that diverges must not set the scale.
    seen = record.y_with_gaps[np.isfinite(record.y_with_gaps)]
    if record.ny == 1:
        grid[0, 0].set_ylim(seen.min() - np.ptp(seen) / 4, seen.max() + np.ptp(seen) / 4)
    for ax in grid[-1]:
        ax.set_xlabel(time_label(record))
    figure.suptitle(
        literal(f"{record.name}: median of the seeds in colour, measured in black; grey: warm-up"),
        fontsize=10,
    )
    return figure


def errors(comparison: Comparison) -> Figure:
    """Return a picture of the RMSE up to each time, a row for each channel.

    Lines are of the median of the seeds' predictions, shaded is the range of the single seeds.
    """
    record, setup, runs = comparison.record, comparison.plan, comparison.fits
    figure = Figure(figsize=(13, 0.6 + 4 * record.ny), layout="constrained")
    protocols = [*PROTOCOLS.items()]
    times, end = times_of(record), setup.train
    names = ordered(comparison.trial, runs)
    if end == len(record):  # nothing is forecast
        protocols = protocols[:1]
    grid = figure.subplots(record.ny, len(protocols), squeeze=False)
    sides = [(channel, side) for channel in range(record.ny) for side in protocols]
    for ax, (channel, (title, prediction)) in zip(grid.flat, sides, strict=True):
        for name, of_method in runs.items():
            steps = len(prediction(of_method[0]))
            truth, time = record.truth[-steps:, channel], times[-steps:]
            median, *each = (
                cumulative_rmse(truth, prediction(run)[:, channel])
                for run in (comparison.medians[name], *of_method)
            )
            color = PALETTE[names.index(name) % len(PALETTE)]
            ax.plot(time, median, color=color, lw=1.4, label=name)
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
        ax.set_title(literal(", ".join(of)), fontsize=10)
        ax.set_xlabel(time_label(record))
        unit = f" ({record.units[channel]})" if record.units[channel] else ""
        ax.set_ylabel(f"RMSE up to this time{unit}")
        ax.grid(True, which="both", color="0.93", lw=0.6)
    grid[0, -1].legend(fontsize=8, loc="upper left", bbox_to_anchor=(1.01, 1))
    return figure


def _from_start(run: Fit) -> Array:
    return run.from_start.y


def _forecast(run: Fit) -> Array:
    return run.ahead


PROTOCOLS: dict[str, Callable[[Fit], Array]] = {
    "from the start": _from_start,
    "forecast": _forecast,
}
"""What a run predicted, by what pictures call it."""

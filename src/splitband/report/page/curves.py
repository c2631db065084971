"""Plot over frequency and over epochs: power, coherence, training losses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from splitband.data import Record
from splitband.filters.spectrum import coherence, periodogram
from splitband.forecasters.backtest import Fit
from splitband.report.colors import PALETTE
from splitband.report.numbers import number, squared
from splitband.report.page.charts import SMALL, TALL, Axis, Chart, dash, padded
from splitband.report.page.parts import Method, Plot
from splitband.runtime.arrays import Array

POINTS = 2000
"""Points of a curve over frequency. By eye."""


def spectrum(record: Record, cutoff: float | None, bases: Mapping[str, Array]) -> list[Plot]:
    """Return plots of power and coherence of the training samples.

    `bases` `(time, ny)` are outputs of fitted models that replace a simulator in hybrids, by name.
    """
    beside = ({} if record.y_sim is None else {"simulator": record.y_sim}) | dict(bases)
    inputs = {} if record.u is None else dict(zip(record.inputs, record.u.T, strict=True))
    others = {name: [*y.T] for name, y in beside.items()}
    others |= {name: [u] * record.ny for name, u in inputs.items()}
    plots = [_power(record, cutoff, beside)]
    for name, of_outputs in others.items():
        curves = {
            column: coherence(record.y[:, i], of_outputs[i], record.sampling_rate)
            for i, column in enumerate(record.columns)
        }
        plots.append(_coherence(record, name, curves, cutoff, small=len(others) > 1))
    return plots


def _power(record: Record, cutoff: float | None, beside: Mapping[str, Array]) -> Plot:
    unit, curves = _unit(record), {}
    for name, y in {"": record.y, **beside}.items():
        found = periodogram(y, record.sampling_rate)
        for column, density in zip(record.columns, found.density.T, strict=True):
            several = name and record.ny > 1
            curves[f"{name}, {column}" if several else name or column] = density[1:]
    positive = np.concatenate([curves[c] for c in record.columns])
    positive = positive[positive > 0] if (positive > 0).any() else np.ones(1)
    top = float(positive.max())
    between = max(float(positive.min()), 1e-9 * top), 3 * top
    kept, label = _bands(len(found.frequencies) - 1), f"power density ({squared(record)}/{unit})"
    axis = Axis.over_frequency(_extremes(found.frequencies[1:], kept), unit)
    chart = Chart(axis, label, between, TALL, log=True)
    for i, (name, density) in enumerate(curves.items()):
        style = {"line_width": 1.3, "line_dash": dash(i // len(PALETTE))}
        chart.line(_extremes(density, kept), f"c{i % len(PALETTE)}", name, **style)
    said = "" if cutoff is None else f"; dashed: the cut-off at {number(cutoff)} {unit}"
    if cutoff is not None:
        chart.mark(cutoff, "cutoff")
    says = (
        f"Line plot of the power spectral density of {', '.join(curves)} over frequency in {unit}, "
        f"both axes logarithmic{said}."
    )
    key = [(f"c{i % len(PALETTE)}", name) for i, name in enumerate(curves)]
    return chart.plot(f"Spectrum{said}", says, key=key)


def _coherence(
    record: Record, name: str, curves: Mapping[str, tuple[Array, Array]], cutoff: float | None,
    small: bool,
) -> Plot:  # fmt: skip
    """Return a plot of the coherence of the record with a simulator, a fitted model or an input."""
    unit = _unit(record)
    frequencies = next(iter(curves.values()))[0][1:]
    chart = Chart(Axis.over_frequency(frequencies, unit), "coherence", (0, 1.03), SMALL)
    for i, (column, (_, y)) in enumerate(curves.items()):
        chart.line(y[1:], f"c{i % len(PALETTE)}", column, line_width=1.3)
    if cutoff is not None:
        chart.mark(cutoff, "cutoff")
    means = [f"{column} {float(y[1:].mean()):.2f} on average" for column, (_, y) in curves.items()]
    says = (
        f"Line plot of the coherence of the record with {name} over frequency in {unit}; 1 where "
        f"all of the record follows, 0 where nothing does: {', '.join(means)}."
    )
    key = [(f"c{i % len(PALETTE)}", column) for i, column in enumerate(curves)]
    return chart.plot(f"Coherence with {name}", says, key=key * (len(key) > 1), small=small)


def losses(runs: Mapping[str, Sequence[Fit]], styles: Mapping[str, Method]) -> list[Plot]:
    """Return plots of the loss over the epochs of each training, one for each kind of network."""
    tasks = dict.fromkeys(task for of in runs.values() for run in of for task in run.report.losses)
    return [_losses(task, runs, styles) for task in tasks]


def _losses(task: str, runs: Mapping[str, Sequence[Fit]], styles: Mapping[str, Method]) -> Plot:
    curves: dict[str, list[Array]] = {
        name: [np.asarray(y, float) for run in of if len(y := run.report.losses.get(task, ()))]
        for name, of in runs.items()
    }
    whole = np.concatenate([y for of in curves.values() for y in of])
    positive = whole[np.isfinite(whole) & (whole > 0)]
    positive = positive if len(positive) else np.ones(1)
    longest = max(len(y) for of in curves.values() for y in of)
    axis = Axis.over(np.arange(1.0, 1 + max(longest, 2)), "epoch, then rounds of L-BFGS")
    between = 0.7 * float(positive.min()), 1.5 * float(positive.max())
    chart = Chart(axis, "training loss", between, log=True)
    for name, of_method in curves.items():
        for i, loss in enumerate(of_method):
            long = padded(loss, len(axis.values), first=True)
            chart.method(long, styles[name], line_dash=dash(i))
    ends = {name: of[-1][-1] for name, of in curves.items() if of}
    said = ", ".join(f"{name} {number(float(end))}" for name, end in ends.items())
    says = (
        "Line plot of the training loss over epochs, a line for each training, with a logarithmic "
        f"axis. At the end: {said}."
    )
    return chart.plot(f"Training loss: {task}", says, methods=[*ends])


def _unit(record: Record) -> str:
    return "cycles per sample" if record.start is None and record.sampling_rate == 1 else "Hz"


def _bands(bins: int) -> npt.NDArray[np.int64]:
    """Return the first bins of bands that are equally wide on a logarithmic axis."""
    if bins <= POINTS:
        return np.arange(bins)
    edges = np.geomspace(1, bins, POINTS // 2, endpoint=False)
    return np.unique(edges.astype(np.int64)) - 1


def _extremes(y: Array, kept: npt.NDArray[np.int64]) -> Array:
    """Return the lowest and the highest value of each band."""
    if len(kept) == len(y):
        return y
    return np.stack([np.minimum.reduceat(y, kept), np.maximum.reduceat(y, kept)], 1).ravel()

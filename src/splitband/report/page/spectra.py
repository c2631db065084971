"""Plots over frequency: where the power lies, what the cut-off parts, and what is coherent."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
from bokeh.models import Range1d
from bokeh.plotting import figure

from splitband.data import Record
from splitband.filters.cutoff import Choice
from splitband.filters.spectrum import coherence, periodogram
from splitband.report.colors import PALETTE
from splitband.report.numbers import number, squared
from splitband.report.page import figures
from splitband.report.page.figures import LOW, TALL
from splitband.report.page.parts import Plot

Array = npt.NDArray[np.float64]

POINTS = 2000
"""Of a curve over frequency."""


def spectrum(
    record: Record, cutoff: float | None, choice: Choice | None, bases: Mapping[str, Array]
) -> list[Plot]:
    """Power, coherence and what each cut-off would lose, of the samples that were trained on.

    `bases` `(time, ny)` are what holds the slow part of hybrid models, by name.
    """
    rate = record.sampling_rate
    unit = "cycles per sample" if record.start is None and rate == 1 else "Hz"
    found = periodogram(record.y, rate)
    lowest, highest = float(found.frequencies[1]), float(found.frequencies[-1])
    x_range = figures.along(lowest, max(highest, 2 * lowest))  # a short record has only one
    beside = {} if record.y_sim is None else {"simulator": record.y_sim}
    beside |= bases
    plots = [_power(record, cutoff, beside, x_range, unit)]
    plots += _coherences(record, beside, cutoff, x_range, unit)
    if choice is not None and choice.candidates:
        plots.append(_choice(choice, cutoff, x_range, unit))
    return plots


def _power(
    record: Record,
    cutoff: float | None,
    beside: Mapping[str, Array],
    x_range: Range1d,
    unit: str,
) -> Plot:
    found = periodogram(record.y, record.sampling_rate)
    curves = dict(zip(record.columns, found.density.T, strict=True))
    for name, y in beside.items():
        of = periodogram(y, record.sampling_rate).density.T
        curves |= {_of(name, c, record): d for c, d in zip(record.columns, of, strict=True)}
    positive = found.density[1:][found.density[1:] > 0]
    top = float(positive.max()) if len(positive) else 1.0
    bottom = max(float(positive.min()), 1e-9 * top) if len(positive) else 1e-9
    shown = _over_frequency(f"power density ({squared(record)}/{unit})", TALL, x_range, unit,
                            figures.between(bottom, 3 * top), y_axis_type="log")  # fmt: skip
    _draw(shown, found.frequencies, {n: np.maximum(d, 1e-300) for n, d in curves.items()})
    said = "."
    if cutoff is not None:
        figures.mark(shown, cutoff, "cutoff")
        said = f"; dashed: the cut-off at {number(cutoff)} {unit}."
    return Plot(
        shown, f"Spectrum{said.rstrip('.')}",
        f"Line plot of the power spectral density of {', '.join(curves)} over frequency in {unit}, "
        f"both axes logarithmic{said}",
        key=[(f"c{i % len(PALETTE)}", name) for i, name in enumerate(curves)],
    )  # fmt: skip


def _coherences(
    record: Record, beside: Mapping[str, Array], cutoff: float | None, x_range: Range1d, unit: str
) -> list[Plot]:
    """Return plots of where the record follows what stands beside it, or an input; one of each."""
    outputs = dict(zip(record.columns, record.y.T, strict=True))
    pairs = {
        name: {c: (y, other) for (c, y), other in zip(outputs.items(), others.T, strict=True)}
        for name, others in beside.items()
    }
    if record.u is not None:
        pairs |= {
            name: {column: (y, u) for column, y in outputs.items()}
            for name, u in zip(record.inputs, record.u.T, strict=True)
        }
    plots = []
    for name, of_name in pairs.items():
        shown = _over_frequency("coherence", figures.SMALL, x_range, unit, figures.between(0, 1.03))
        curves = {}
        for column, (y, other) in of_name.items():
            frequencies, curves[column] = coherence(y, other, record.sampling_rate)
        _draw(shown, frequencies, curves)
        if cutoff is not None:
            figures.mark(shown, cutoff, "cutoff")
        means = [f"{column} {float(c[1:].mean()):.2f} on average" for column, c in curves.items()]
        key = [(f"c{i % len(PALETTE)}", column) for i, column in enumerate(curves)]
        plots.append(
            Plot(
                shown,
                f"Coherence with {name}",
                f"Line plot of the coherence of the record with {name} over frequency in {unit}; "
                f"1 where all of the record follows, 0 where nothing does: {', '.join(means)}.",
                key=key if len(curves) > 1 else (),
                small=len(pairs) > 1,
            )
        )
    return plots


def _choice(choice: Choice, cutoff: float | None, x_range: Range1d, unit: str) -> Plot:
    losses = [c.loss for c in choice.candidates]
    shown = _over_frequency(
        "loss", LOW, x_range, unit, figures.between(0, 1.1 * max(losses) or 1.0)
    )
    orders = sorted({c.order for c in choice.candidates})
    for i, order in enumerate(orders):
        of = [c for c in choice.candidates if c.order == order]
        data = figures.source(
            np.array([c.cutoff for c in of]), {"loss": np.array([c.loss for c in of])}
        )
        figures.line(shown, data, "loss", f"c{i}", f"order {order}", line_width=1.4)
        dots = shown.scatter(figures.X, "loss", source=data, size=4, name=f"order {order}")
        dots.update(tags=[f"c{i}"])
    if cutoff is not None:
        figures.mark(shown, cutoff, "cutoff")
    figures.hover(shown, f"cut-off ({unit})")
    return Plot(
        shown, f"What each cut-off would lose: {choice.loss}",
        f"Line plot of the loss over the cut-off in {unit}; chosen: {choice.reason}.",
        key=[(f"c{i}", f"order {order}") for i, order in enumerate(orders)],
    )  # fmt: skip


def _over_frequency(
    label: str, height: int, x_range: Range1d, unit: str, y_range: Range1d, **options: Any
) -> figure:
    return figures.plain(
        label, f"frequency ({unit})", height, x_axis_type="log", x_range=x_range, y_range=y_range,
        **options,
    )  # fmt: skip


def _draw(shown: figure, frequencies: Array, curves: Mapping[str, Array]) -> None:
    """Curves without the mean, the highest and the lowest of each narrow band kept."""
    at = _bands(len(frequencies) - 1)
    for i, (name, y) in enumerate(curves.items()):
        data = figures.source(*_extremes(frequencies[1:], y[1:], at))
        figures.line(
            shown,
            data,
            "y",
            f"c{i % len(PALETTE)}",
            name,
            line_width=1.3,
            line_dash=figures.dash(i // len(PALETTE)),
        )
    figures.hover(shown, "frequency")


def _bands(bins: int) -> npt.NDArray[np.int64]:
    """Where bands of the same width on a logarithmic axis begin."""
    if bins <= POINTS:
        return np.arange(bins)
    edges = np.geomspace(1, bins, POINTS // 2, endpoint=False)
    return np.unique(edges.astype(np.int64)) - 1


def _extremes(x: Array, y: Array, at: npt.NDArray[np.int64]) -> tuple[Array, dict[str, Array]]:
    if len(at) == len(y):
        return x, {"y": y}
    low, high = np.minimum.reduceat(y, at), np.maximum.reduceat(y, at)
    return np.repeat(x[at], 2), {"y": np.stack([low, high], axis=1).ravel()}


def _of(name: str, column: str, record: Record) -> str:
    return name if record.ny == 1 else f"{name}, {column}"

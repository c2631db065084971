"""Plot errors, power and coherence over frequency."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy

from splitband.filters.spectrum import coherence, periodogram
from splitband.records import Record
from splitband.report.colors import PALETTE
from splitband.report.numbers import number, squared
from splitband.report.page.charts import SMALL, TALL, Axis, Chart, log_limits
from splitband.report.page.over_time import Run
from splitband.report.page.parts import DASHES, Key
from splitband.runtime.arrays import Array

MOST_SAMPLES, SEGMENT = 2**18, 2**16
"""Largest number of samples of spectra of errors, and of a segment of Welch's method. Bounds the
time."""
BANDS = 40
"""Largest number of frequency bands. Layout."""
MOST_SHOWN = 300.0
"""Largest error in a plot, in percent of the record: above 100 a method is of no use. Layout."""
LARGEST = 1e6
"""Largest error, in ranges of the record: squares of larger ones overflow. Rounding."""


def error_spectra(
    y: Array, errors: Mapping[str, Array], rate: float
) -> tuple[Array, dict[str, Array], Array]:
    """Return the size of errors by frequency band, beside that of the record.

    Parameters
    ----------
    y : The record, `(time,)`, NaN in gaps.
    errors : By method, `(time,)`, NaN where nothing is predicted: these samples do not count.
    rate : Sampling rate in Hz.

    Returns
    -------
    frequencies : Middles of the bands in Hz, `(bands,)`.
    ratios : By method, root of the power of the error over that of the record, `(bands,)`.
    share : Share of the record's power in each band, `(bands,)`.
    """
    centred, n = y[-MOST_SAMPLES:] - np.nanmean(y), min(len(y), SEGMENT)
    most = LARGEST * float(np.nanmax(abs(centred)) or 1.0)
    edges = np.unique(np.geomspace(1, n // 2 + 1, BANDS + 1).astype(int))
    frequencies = np.fft.rfftfreq(n, 1 / rate)

    def power(x: Array) -> Array:
        _, density = scipy.signal.welch(np.nan_to_num(x), rate, nperseg=n)
        return np.add.reduceat(density, edges[:-1])

    def ratio(error: Array) -> Array:
        own = power(np.where(np.isnan(error), 0.0, centred))
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.sqrt(power(np.clip(error, -most, most)) / np.where(own > 0, own, np.nan))

    ratios = {name: ratio(error[-MOST_SAMPLES:]) for name, error in errors.items()}
    own = power(centred)
    middles = np.sqrt(frequencies[edges[:-1]] * frequencies[edges[1:] - 1])
    return middles, ratios, own / (own.sum() or 1.0)


def errors_by_band(run: Run, looks: Mapping[str, Key], cutoff: float | None) -> list[Chart]:
    """Return the plots by output of the errors of all methods over frequency."""
    plots, part = list[Chart](), slice(run.scored, None)
    for i, column in enumerate(run.record.columns):
        y = run.record.truth[part, i]
        if np.isfinite(y).sum() < 8 or not np.nanstd(y):
            continue
        errors = {name: y - curve[part, i] for name, curve in run.curves.items()}
        middles, ratios, share = error_spectra(y, errors, run.record.sampling_rate)
        axis = Axis.over_frequency(middles, _unit(run.record))
        low, high = log_limits(100 * np.concatenate([np.ones(1), *ratios.values()]))
        high = min(high, MOST_SHOWN)
        caption = f"{column}: error by frequency band, {run.says}"
        scale = max(low, 1e-5 * high), high
        chart = Chart(axis, "error / record (%)", scale, caption, TALL, log=True)
        chart.mark(100.0, "zero", "width")
        for place, name in reversed([*enumerate(ratios)]):
            chart.line(100 * ratios[name], looks[name], line_width=2.0 if place else 3.0)
        power = Chart(
            axis,
            "power (%)",
            (0.0, 110 * float(share.max())),
            f"{column}: share of the power by band",
            SMALL,
        )
        power.stems(100 * share, Key("record", "measured"))
        for each in (chart, power) if cutoff else ():
            each.mark(cutoff or 0.0, "cutoff")
        plots += [chart, power]
    return plots


def spectrum(record: Record, cutoff: float | None) -> list[Chart]:
    """Return plots of the power of a record, and of its coherence with its simulator and inputs."""
    others = [] if record.y_sim is None else [("simulator", [*record.y_sim.T])]
    inputs = () if record.u is None else zip(record.inputs, record.u.T, strict=True)
    others += [(name, [u] * record.ny) for name, u in inputs]
    small = len(others) > 1
    found = [_power(record, cutoff), *(_coherence(record, name, y, small) for name, y in others)]
    for chart in found if cutoff else ():
        chart.mark(cutoff or 0.0, "cutoff")
    return found


def _power(record: Record, cutoff: float | None) -> Chart:
    """Return the plot of the power of the outputs, and of a simulator's."""
    unit = _unit(record)
    own = periodogram(record.y, record.sampling_rate)
    curves = dict(zip(record.columns, own.density[1:].T, strict=True))
    if record.y_sim is not None:
        simulated = periodogram(record.y_sim, record.sampling_rate).density[1:]
        names = (f"simulator, {column}" for column in record.columns)
        curves |= dict(zip(names, simulated.T, strict=True))
    low, high = log_limits(own.density[1:])
    axis, label = Axis.over_frequency(own.frequencies[1:], unit), f"({squared(record)}/{unit})"
    scale = max(low, 1e-9 * high), 2 * high
    caption = f"Spectrum; dashed: the cut-off at {number(cutoff)} {unit}" if cutoff else "Spectrum"
    chart = Chart(axis, f"power density {label}", scale, caption, log=True)
    for i, (name, density) in enumerate(curves.items()):
        chart.line(density, _key(i, name), line_width=1.3)
    return chart


def _coherence(record: Record, name: str, others: list[Array], small: bool) -> Chart:
    """Return a plot of the coherence of the record with a simulator or an input."""
    pairs = zip(record.y.T, others, strict=True)
    by_output = [coherence(y, x, record.sampling_rate) for y, x in pairs]
    axis = Axis.over_frequency(by_output[0][0][1:], _unit(record))
    chart = Chart(axis, "coherence", (0, 1.03), f"Coherence with {name}", SMALL, small=small)
    for i, (column, (_, y)) in enumerate(zip(record.columns, by_output, strict=True)):
        chart.line(y[1:], _key(i, column), line_width=1.3)
    return chart


def _key(i: int, name: str) -> Key:
    """Return the look of the i-th curve of a record."""
    return Key(name, f"c{i % len(PALETTE)}", DASHES[i % len(DASHES)])


def _unit(record: Record) -> str:
    return "cycles per sample" if record.start is None and record.sampling_rate == 1 else "Hz"

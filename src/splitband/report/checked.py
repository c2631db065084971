"""Write what a check of a model found: results.json, a picture and the page."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from splitband.forecasters.checking import Correlation, ModelCheck
from splitband.forecasters.responses import Responses
from splitband.report import pictures
from splitband.report.colors import PALETTE
from splitband.report.results import environment
from splitband.runtime.outputs import staged, write_facts

SHOWN = 3
"""Inputs in a row of the picture."""


@dataclass(frozen=True, eq=False)
class CheckReport:
    """Hold what `splitband check` shows.

    Attributes
    ----------
    check : Fits, tests, stability and ranges.
    kind : What the model is, in words.
    responses : To steps; None for a model without inputs, or whose simulator stays outside.
    asked : The command.
    """

    check: ModelCheck
    kind: str
    responses: Responses | None = None
    asked: str = ""


def save(report: CheckReport, folder: Path) -> None:
    """Write results.json, check.png and report.html in place of an earlier result."""
    page = import_module("splitband.report.page")
    with staged(folder) as new:
        pictures.save(picture(report.check), new / "check.png")
        if report.responses is not None:
            pictures.save(of_responses(report.responses), new / "responses.png")
        page.of_check(report, new / page.NAME)
        write_facts(new, facts(report))


def facts(report: CheckReport) -> dict[str, Any]:
    """Return what results.json says."""
    found = report.check.as_json() | {"kind": report.kind, "command": report.asked}
    if report.responses is not None:
        gain = report.responses.y[-1]
        found["static_gain"] = {
            column: dict(zip(report.responses.inputs, map(float, row), strict=True))
            for column, row in zip(report.responses.columns, gain, strict=True)
        }
    return found | {"environment": environment()}


def picture(check: ModelCheck) -> Figure:
    """Draw the simulation, and the correlation of the residuals with their and the inputs' past."""
    tests = check.tests
    across = max(1 + min(len(tests[0].inputs), SHOWN), 2)
    figure = Figure(figsize=(3.6 * across, 4.6 * len(tests)), layout="constrained")
    parts = figure.subfigures(len(tests), 1, squeeze=False)[:, 0]
    start = len(check.record) - len(check.simulation)
    for channel, (part, test) in enumerate(zip(parts, tests, strict=True)):
        grid = part.add_gridspec(2, across)
        ax = part.add_subplot(grid[0, :])
        fit = check.fits["simulation"][channel]
        title = f"simulation: fit {fit:.1f} %"
        simulated = check.simulation.y[:, channel]
        pictures.draw_measured(ax, check.record, channel, start, simulated, title)
        shown = [test.whiteness, *test.inputs[:SHOWN]]
        for i, correlation in enumerate(shown):
            _stems(part.add_subplot(grid[1, i]), correlation)
    figure.suptitle(f"{check.method}: {'accepted' if check.accepted else 'rejected'}", fontsize=11)
    return figure


def of_responses(responses: Responses) -> Figure:
    """Draw the step responses, and the gain and phase over frequency, of each input."""
    nu = len(responses.inputs)
    figure = Figure(figsize=(11, 2.4 * nu + 0.4), layout="constrained")
    grid = figure.subplots(nu, 3, squeeze=False)
    frequencies, gains = responses.frequency_response()
    for axes, name, i in zip(grid, responses.inputs, range(nu), strict=True):
        for j, column in enumerate(responses.columns):
            style: dict[str, Any] = {"color": PALETTE[j % len(PALETTE)], "lw": 1.2}
            label = column.replace("$", r"\$")
            gain = gains[:, j, i]
            axes[0].plot(responses.time, responses.y[:, j, i], label=label, **style)
            axes[1].loglog(frequencies, np.maximum(abs(gain), 1e-12), **style)
            axes[2].semilogx(frequencies, np.degrees(np.unwrap(np.angle(gain))), **style)
        axes[0].set_ylabel(f"step of {name}".replace("$", r"\$"), fontsize=8)
        for ax, title in zip(axes, ("step response", "gain", "phase (degrees)"), strict=True):
            ax.set_title(title, fontsize=9, loc="left")
            ax.grid(True, color="0.93", lw=0.6)
    grid[0, 0].legend(fontsize=7)
    for ax, label in zip(grid[-1], ("time (s)", "frequency (Hz)", "frequency (Hz)"), strict=True):
        ax.set_xlabel(label)
    return figure


def _stems(ax: Axes, correlation: Correlation) -> None:
    first = 1 if correlation.of == "residuals" else 0
    lags = first + np.arange(len(correlation.values))
    ax.axhspan(-correlation.band, correlation.band, color=PALETTE[0], alpha=0.15, lw=0)
    ax.vlines(lags, 0, correlation.values, color=PALETTE[0], lw=1.5)
    ax.axhline(0, color="0.4", lw=0.8)
    most = max(2 * correlation.band, 1.1 * float(np.max(np.abs(correlation.values))))
    ax.set_ylim(-most, most)
    ax.set_xlabel("lag (samples)", fontsize=8)
    title = f"with {correlation.of}, p = {correlation.p:.2g}".replace("$", r"\$")
    ax.set_title(title, fontsize=8, loc="left")
    ax.tick_params(labelsize=7)

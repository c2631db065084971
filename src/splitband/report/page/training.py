"""How the training of networks went."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from splitband.evaluation.protocols import Run
from splitband.report.numbers import number
from splitband.report.page import figures
from splitband.report.page.parts import MethodStyles, Plot


def training(runs: Mapping[str, Sequence[Run]], styles: MethodStyles) -> list[Plot]:
    """The loss over the epochs of each seed, a plot for each kind of network."""
    tasks = dict.fromkeys(task for of in runs.values() for run in of for task in run.fit.losses)
    return [_losses(task, runs, styles) for task in tasks]


def _losses(task: str, runs: Mapping[str, Sequence[Run]], styles: MethodStyles) -> Plot:
    curves = {
        (name, run.seed): np.asarray(run.fit.losses[task], float)
        for name, of in runs.items()
        for run in of
        if len(run.fit.losses.get(task, ()))
    }
    ends = {name: float(y[-1]) for (name, _), y in curves.items()}
    positive = np.concatenate([y[np.isfinite(y) & (y > 0)] for y in curves.values()])
    positive = positive if len(positive) else np.ones(1)
    longest = max(map(len, curves.values()))
    shown = figures.plain(
        "training loss", "epoch, then rounds of L-BFGS",
        y_axis_type="log", x_range=figures.time_range(1, max(longest, 2)),
        y_range=figures.between(0.7 * float(positive.min()), 1.5 * float(positive.max())),
    )  # fmt: skip
    drawn: dict[str, int] = {}
    for (name, _), y in curves.items():
        i = drawn[name] = drawn.get(name, -1) + 1
        data = figures.source(np.arange(1.0, 1 + len(y)), {"loss": np.maximum(y, 1e-300)})
        style = {"line_dash": figures.dash(i), "line_width": 1.4}
        figures.method_line(shown, data, "loss", styles.of(name), **style)
    figures.hover(shown, "epoch")
    said = ", ".join(f"{name} {number(loss)}" for name, loss in ends.items())
    return Plot(
        shown,
        f"Training loss: {task}",
        f"Line plot of the training loss over epochs, a line for each seed, with a logarithmic "
        f"axis. At the end: {said}.",
        [*ends],
    )

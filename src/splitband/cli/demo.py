"""Define `splitband demo`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import typer

from splitband.cli import INTERRUPTED, options, printing
from splitband.cli.compare import compared
from splitband.comparison.methods import Sizes
from splitband.comparison.plan import plan
from splitband.comparison.request import PlanRequest
from splitband.comparison.result import Comparison
from splitband.records.named import overhead_crane
from splitband.report.predictions import run_of
from splitband.report.tables import labels_of

TRAIN = 2000
"""Training samples, half of the record."""
SIMULATOR, NETWORK, BOTH = "simulator", "gru", "residual-gru-conditioned"
ALONE = (SIMULATOR, "linear", NETWORK)
METHODS = [*ALONE, "filtered-gru-conditioned", BOTH, "persistence"]
RECIPE: dict[str, Any] = {"window": 150, "warmup": 30, "epochs": 5, "lbfgs_iterations": 400}
"""Chosen on the cranes of seeds 1 to 3, so that the demo needs no search."""
SIZES = Sizes(hidden_high=20, hidden_low=12)
"""Hidden units of the networks: small, so that the demo ends within a minute. Layout."""
STRETCH = 30.0
"""Seconds at the beginning and at the end of the forecast whose errors are compared. Layout."""


def demo(
    context: typer.Context,
    out: options.Out = Path("demo"),
    jobs: options.Jobs = None,
) -> None:
    """Show what the package does, in about a minute, on a crane whose load swings.

    A trolley carries a load on a rope. The inputs are the commanded speed and the length of the
    rope, the output is the position of the load. The simulator omits the swing. Models are trained
    on 200 s and simulate the next 200 s: the simulator alone, a network alone, and both combined.

    Nothing is downloaded: the record is computed, and is the same each time. Other commands know
    it, too: `splitband compare overhead-crane`.
    """
    record = overhead_crane()
    printing.console.print(
        f"{record.name}: {len(record)} samples of the position of a swinging load, "
        f"{TRAIN} of them for training"
    )
    found = plan(PlanRequest(record, TRAIN, METHODS, seeds=1, settings=RECIPE, sizes=SIZES))
    result = compared(context, found, out, jobs)
    if {*METHODS} <= {*result.medians}:  # Ctrl-C may have left some out
        _tell(result)
    if result.interrupted:
        raise typer.Exit(INTERRUPTED)


def _tell(result: Comparison) -> None:
    """Print the three steps of the story, with the errors of this run."""
    story = (
        (SIMULATOR, "the simulator alone omits the swing"),
        (NETWORK, "a network alone drifts, because it has to integrate the speed"),
        (BOTH, "combined, they stay accurate: the network adds the swing to the simulator"),
    )
    called, run, step = labels_of(result), run_of(result.record), result.record.sampling_time
    samples = round(STRETCH / step)
    truth = result.record.truth[result.plan.train :]
    printing.console.print(
        f"\n{run} of {len(truth) * step:g} s, RMSE of its first and of its last {STRETCH:g} s:"
    )
    for number, (name, what) in enumerate(story, 1):
        left = result.medians[name].ahead - truth
        first, last = (np.sqrt(np.mean(part**2)) for part in (left[:samples], left[-samples:]))
        printing.console.print(
            f"{number}. {called[name]}: {first:.2f} m, then {last:.2f} m; {what}"
        )
    best = result.recommended
    errors = {name: result.errors(fit).forecast for name, fit in result.medians.items()}
    alone = min(ALONE, key=errors.__getitem__)
    printing.console.print(
        f"over the whole {run}: {called[best]} {errors[best]:.2f} m; the best of simulator, "
        f"linear model and network alone ({called[alone]}): {errors[alone]:.2f} m"
    )

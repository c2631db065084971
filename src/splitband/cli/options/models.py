"""Define the options of filters, networks, training and time limits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from splitband.cli.options.groups import panel
from splitband.training.settings import Recipe

_filter, _training, _time = panel("Filter"), panel("Training"), panel("Time")

AUTO = -math.inf
"""Stands for a cut-off chosen from the data, even if the paper gives one for the record."""


def _hertz(value: str) -> float:
    if value == "auto":
        return AUTO
    try:
        hertz = float(value)
    except ValueError:
        hertz = math.nan
    if not math.isfinite(hertz):
        raise typer.BadParameter("must be a frequency in Hz or auto")
    return hertz


def _samples(value: str) -> int | None:
    if value == "auto":
        return None
    try:
        return int(value)
    except ValueError:
        raise typer.BadParameter("must be a whole number of samples or auto") from None


Cutoff = Annotated[
    float | None,
    _filter("Cut-off between the two bands; auto chooses it.", "HZ|auto", "auto", parser=_hertz),
]
Order = Annotated[
    int | None, _filter("Order of each Butterworth filter.", "N", "1 or 2, with the cut-off")
]
Conditioned = Annotated[
    bool, _filter("Give networks the slow band as an input.", None, True, "--conditioned")
]
Epochs = Annotated[int | None, _training("Passes over all windows.", "N", "about 1,000 steps")]
Methods = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        help="Methods, separated by commas; see splitband methods.",
        show_default="what suits the record",
    ),
]
Seeds = Annotated[
    int | None, _training("Trainings of each network; the median is used.", "N", "1 to 8", min=1)
]
Like = Annotated[
    Path | None,
    _training("Train as the model of an earlier run was, with its settings alone.", "DIR", False),
]
Device = Annotated[str, _training("Train networks on cpu, cuda, cuda:1, ...", "NAME")]
Budget = Annotated[str | None, _time("Wall time of the whole command: 90s, 10m, 1h.", "TIME", "2m")]
Rounds = Annotated[
    int | None,
    _time("Rounds of the search, in place of a time: the same anywhere.", "N", False, min=1),
]
Seed = Annotated[int, _time("Of all random numbers.", "N", min=0)]
Jobs = Annotated[int | None, _time("Trainings at once, one on each core.", "N", "all cores", min=1)]
Cluster = Annotated[
    str | None, _time("Dask scheduler whose workers train: tcp://...:8786.", "ADDRESS", False)
]


@dataclass(frozen=True)
class ModelOptions:
    """Hold the options of filters, networks and their training."""

    cutoff: Cutoff = None
    order: Order = None
    downsampling: Annotated[
        int | None,
        _filter("Keep every K-th sample of the low band.", "K", "as the low band allows"),
    ] = None
    warmup: Annotated[
        int | None,
        _training(
            "Measured samples that start a simulation.", "R|auto", "auto, up to 50", parser=_samples
        ),
    ] = None
    window: Annotated[
        int | None,
        _training("Samples in a training window, warm-up included.", "N", "150 to 400"),
    ] = None
    epochs: Epochs = None
    recipe: Annotated[Recipe, _training("Training settings where none are given.")] = "default"
    learning_rate: Annotated[
        float | None, _training("Highest learning rate of Adam.", "RATE", "1e-2")
    ] = None
    lr_milestones: Annotated[
        str | None, _training("Later rates by epoch: 20:1e-4,500:1e-5.", "LIST", False)
    ] = None
    hidden: Annotated[
        str | None,
        _training("Hidden units of the fast and the slow network.", "HIGH,LOW", "32,16"),
    ] = None
    budget: Budget = None
    rounds: Rounds = None
    seed: Seed = 0
    device: Device = "cpu"

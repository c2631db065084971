"""Options that say what models are made of, and how they are trained."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from splitband.training.recipes import Recipe

_FILTER, _TRAINING, _TIME = "Filter", "Training", "Time"

AUTO = -math.inf
"""A cut-off that is to be chosen, in place of the paper's for one of its records."""


def _hertz(value: str) -> float:
    """A cut-off, or `AUTO`."""
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
    """A number of samples; None is auto."""
    if value == "auto":
        return None
    try:
        return int(value)
    except ValueError:
        raise typer.BadParameter("must be a whole number of samples or auto") from None


Cutoff = Annotated[
    float | None,
    typer.Option(
        parser=_hertz,
        metavar="HZ|auto",
        help="Cut-off between the two bands; auto chooses it.",
        rich_help_panel=_FILTER,
        show_default="auto",
    ),
]
Order = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Order of each Butterworth filter.",
        rich_help_panel=_FILTER,
        show_default="1 or 2, with the cut-off",
    ),
]
Downsampling = Annotated[
    int | None,
    typer.Option(
        help="Keep every K-th sample of the low band.",
        metavar="K",
        rich_help_panel=_FILTER,
        show_default="as the low band allows",
    ),
]
Conditioned = Annotated[
    bool,
    typer.Option(
        "--conditioned",
        help="Give networks the slow band as an input.",
        rich_help_panel=_FILTER,
    ),
]
Warmup = Annotated[
    int | None,
    typer.Option(
        parser=_samples,
        help="Measured samples that start a simulation.",
        metavar="R|auto",
        rich_help_panel=_TRAINING,
        show_default="auto, up to 50",
    ),
]
Window = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Samples in a training window, warm-up included.",
        rich_help_panel=_TRAINING,
        show_default="150 to 400",
    ),
]
Epochs = Annotated[
    int | None,
    typer.Option(
        metavar="N",
        help="Passes over all windows.",
        rich_help_panel=_TRAINING,
        show_default="about 1,000 steps",
    ),
]
Seeds = Annotated[
    int | None,
    typer.Option(
        "--seeds",
        min=1,
        metavar="N",
        help="Trainings of each network, averaged.",
        rich_help_panel=_TRAINING,
        show_default="1 to 8",
    ),
]
Budget = Annotated[
    str | None,
    typer.Option(
        metavar="TIME",
        help="Wall time of the whole command: 90s, 10m, 1h.",
        rich_help_panel=_TIME,
        show_default="2m",
    ),
]
Effort = Annotated[
    str | None,
    typer.Option(
        metavar="TIME",
        help="Limit work, not time: reproducible results.",
        rich_help_panel=_TIME,
        show_default=False,
    ),
]
RecipeOption = Annotated[
    Recipe,
    typer.Option(
        "--recipe",
        help="Training settings: ours, or those of the paper.",
        rich_help_panel=_TRAINING,
    ),
]
LearningRate = Annotated[
    float | None,
    typer.Option(
        metavar="RATE",
        help="Highest learning rate of Adam.",
        rich_help_panel=_TRAINING,
        show_default="1e-2",
    ),
]
Milestones = Annotated[
    str | None,
    typer.Option(
        "--lr-milestones",
        metavar="LIST",
        help="Later rates by epoch: 20:1e-4,500:1e-5.",
        rich_help_panel=_TRAINING,
        show_default=False,
    ),
]
Hidden = Annotated[
    str | None,
    typer.Option(
        help="Hidden units of the fast and the slow network.",
        metavar="HIGH,LOW",
        rich_help_panel=_TRAINING,
        show_default="32,16",
    ),
]
SettingsFile = Annotated[
    Path | None,
    typer.Option(
        "--settings",
        metavar="FILE",
        help="Train as recommended.json of an earlier run says.",
        rich_help_panel=_TRAINING,
        show_default=False,
    ),
]
Device = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="Train networks on cpu, cuda, cuda:1, ...",
        rich_help_panel=_TRAINING,
    ),
]


@dataclass(frozen=True)
class ModelOptions:
    """Filters, networks and their training."""

    cutoff: Cutoff = None
    order: Order = None
    downsampling: Downsampling = None
    warmup: Warmup = None
    window: Window = None
    epochs: Epochs = None
    recipe: RecipeOption = "default"
    learning_rate: LearningRate = None
    lr_milestones: Milestones = None
    hidden: Hidden = None
    budget: Budget = None
    effort: Effort = None
    device: Device = "cpu"

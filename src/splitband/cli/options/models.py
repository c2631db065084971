"""Options that say what models are made of, and how they are trained."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from splitband.training.recipes import Recipe

_FILTER, _TRAINING = "Filter", "Training"

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


Cutoff = Annotated[
    float | None,
    typer.Option(
        parser=_hertz,
        metavar="HZ|auto",
        help="Frequency that parts the two bands. auto: by the training samples, from the spectrum "
        "or from where simulator and record agree.",
        rich_help_panel=_FILTER,
        show_default="auto",
    ),
]
Order = Annotated[
    int | None,
    typer.Option(
        help="Order of each Butterworth filter.",
        rich_help_panel=_FILTER,
        show_default="1 or 2, with the cut-off",
    ),
]
Downsampling = Annotated[
    int | None,
    typer.Option(
        help="The low band keeps every K-th sample.",
        metavar="K",
        rich_help_panel=_FILTER,
        show_default="as large as the low band allows, up to 10",
    ),
]
Conditioned = Annotated[
    bool,
    typer.Option(
        "--conditioned",
        help="Tell the network what the slower band or the simulator predicts.",
        rich_help_panel=_FILTER,
    ),
]
Warmup = Annotated[
    int | None,
    typer.Option(
        help="Measured samples before a simulation.",
        metavar="R",
        rich_help_panel=_TRAINING,
        show_default="up to 50",
    ),
]
Window = Annotated[
    int | None,
    typer.Option(
        help="Samples of a training window, warm-up included.",
        rich_help_panel=_TRAINING,
        show_default="two fifths of the training part, 150 to 400",
    ),
]
Epochs = Annotated[
    int | None,
    typer.Option(
        help="Passes over all windows.",
        rich_help_panel=_TRAINING,
        show_default="what makes about 1,000 steps",
    ),
]
Seeds = Annotated[
    int | None,
    typer.Option(
        "--seeds",
        min=1,
        help="Trainings of each network; the mean of their predictions is handed out.",
        rich_help_panel=_TRAINING,
        show_default="1 to 8, as the budget allows and the method deserves; without a search 3",
    ),
]
Budget = Annotated[
    str | None,
    typer.Option(
        metavar="TIME",
        help="Wall time for the whole command, such as 90s, 10m or 1h, from its start to its last "
        "file: it is kept on a busy machine, too. Trainings that are not done by then end with "
        "what they have, and methods that there is no time for are left out by name. More of it "
        "means longer trials, larger ones and more seeds. Windows, sizes and steps of networks are "
        "found on held-out training samples, unless --window, --epochs, --learning-rate, "
        "--lr-milestones or --recipe paper decides how to train; then there is no limit.",
        rich_help_panel=_TRAINING,
        show_default="2m, of which a quiet machine needs less",
    ),
]
Effort = Annotated[
    str | None,
    typer.Option(
        metavar="TIME",
        help="In place of --budget: work for the search and the training of networks, as reckoned "
        "for a reference core, such as 4m. The work is limited, not the clock, so that the same "
        "command finds the same on every run, however long it takes.",
        rich_help_panel=_TRAINING,
        show_default=False,
    ),
]
RecipeOption = Annotated[
    Recipe,
    typer.Option(
        "--recipe",
        help="How networks are trained where no other option says so: long windows, one cycle of "
        "the learning rate and free runs that grow, or as in the paper.",
        rich_help_panel=_TRAINING,
    ),
]
LearningRate = Annotated[
    float | None,
    typer.Option(
        help="Of Adam: the highest, or the first one with --recipe paper.",
        rich_help_panel=_TRAINING,
        show_default="1e-2; with --recipe paper 1e-3",
    ),
]
Milestones = Annotated[
    str | None,
    typer.Option(
        "--lr-milestones",
        help="Later learning rates as EPOCH:RATE,...: 20:1e-4,500:1e-5. In place of one cycle.",
        rich_help_panel=_TRAINING,
        show_default=False,
    ),
]
Hidden = Annotated[
    str | None,
    typer.Option(
        help="Hidden units of the high- and the low-band network.",
        metavar="HIGH,LOW",
        rich_help_panel=_TRAINING,
        show_default="32,16, with --recipe paper 64,32; a single network has their sum",
    ),
]
SettingsFile = Annotated[
    Path | None,
    typer.Option(
        "--settings",
        metavar="FILE",
        help="Method, sizes, training and bands of an earlier comparison (its recommended.json), "
        "in place of a search, and the columns and inputs that they are for. Other options "
        "override the file; a record with other columns or inputs is refused.",
        rich_help_panel=_TRAINING,
        show_default=False,
    ),
]
Device = Annotated[
    str,
    typer.Option(
        help="Where networks are trained: cpu, cuda, cuda:1, ...", rich_help_panel=_TRAINING
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

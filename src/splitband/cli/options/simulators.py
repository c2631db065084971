"""Options that say which simulators there are, and how they are run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from splitband.simulators.named import SIMULATORS

_PANEL = "Simulator"

_SIMULATOR = (
    "A simulator of the record: an exported trajectory (any file a record can be), an .fmu, "
    "FILE.py:FUNCTION (called with the record's time stamps in s; with seconds from 0 where these "
    f"are dates, or missing), or one of {', '.join(SIMULATORS)}."
)
SimulatorOption = Annotated[
    str | None,
    typer.Option(
        "--simulator",
        metavar="FILE|NAME",
        help=_SIMULATOR,
        rich_help_panel=_PANEL,
        show_default="a named record's own",
    ),
]
SimulatorOrBase = Annotated[
    str | None,
    typer.Option(
        "--simulator",
        metavar="FILE|NAME",
        help=f"{_SIMULATOR} Also linear (of the known inputs), periodic or harmonic: what is "
        "fitted to the training samples takes its place.",
        rich_help_panel=_PANEL,
        show_default="a named record's own",
    ),
]
SimulatorColumns = Annotated[
    str | None,
    typer.Option(
        help="Columns of the trajectory, or outputs of the FMU, that correspond to --columns.",
        rich_help_panel=_PANEL,
        show_default="those of the record's names, or all",
    ),
]
SimulatorTimeout = Annotated[
    float,
    typer.Option(
        min=0.0, help="Seconds after which a simulator is given up on.", rich_help_panel=_PANEL
    ),
]
PATIENCE = 600.0
"""Of a simulator, in s."""
SimulatorCache = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Keep what a slow FMU or function computes in this folder, by its content.",
        rich_help_panel=_PANEL,
        show_default="not kept",
    ),
]
SimulatorReads = Annotated[
    list[str] | None,
    typer.Option(
        "--simulator-reads",
        metavar="FILE",
        help="A file that the FMU or function reads, such as a table of parameters: what "
        "--simulator-cache keeps is computed again when it changes, as when a module changes that "
        "the function's file imports; give it once for each.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
Calibrate = Annotated[
    bool,
    typer.Option(
        "--calibrate",
        help="Calibrate the simulator of hybrid methods on the training samples first: gain, "
        "offset, delay and clock, each kept only where it pays on held-out ones.",
        rich_help_panel=_PANEL,
    ),
]
MoreSimulators = Annotated[
    list[str] | None,
    typer.Option(
        "--more-simulator",
        metavar="FILE",
        help="The simulator of each --more, in their order.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
TestSimulators = Annotated[
    list[str] | None,
    typer.Option(
        "--test-simulator",
        metavar="FILE",
        help="The simulator of each --test, in their order; without, hybrid models are not tested.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]


@dataclass(frozen=True)
class SimulatorOptions:
    """Which simulator stands beside the record, and how it is run."""

    simulator: SimulatorOption = None
    simulator_columns: SimulatorColumns = None
    simulator_timeout: SimulatorTimeout = PATIENCE
    simulator_cache: SimulatorCache = None
    simulator_reads: SimulatorReads = None


@dataclass(frozen=True)
class SimulatorOrBaseOptions(SimulatorOptions):
    """The same for commands that also put what is fitted to the record in a simulator's place."""

    simulator: SimulatorOrBase = None

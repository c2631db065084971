"""Options that say which simulators there are, and how they are run."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from splitband.simulators.named import SIMULATORS

_PANEL = "Simulator"

_SIMULATOR = (
    "A simulator: an exported trajectory, an .fmu, FILE.py:FUNCTION of time in s, "
    f"or one of {', '.join(SIMULATORS)}."
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
        help=f"{_SIMULATOR} Or linear, periodic, harmonic: a fitted model.",
        rich_help_panel=_PANEL,
        show_default="a named record's own",
    ),
]
SimulatorColumns = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        help="Its columns or outputs that match --columns.",
        rich_help_panel=_PANEL,
        show_default="of the same names",
    ),
]
SimulatorTimeout = Annotated[
    float,
    typer.Option(
        min=0.0,
        metavar="SECONDS",
        help="Give up on a simulator after this time.",
        rich_help_panel=_PANEL,
    ),
]
PATIENCE = 600.0
"""Of a simulator, in s."""
SimulatorCache = Annotated[
    Path | None,
    typer.Option(
        metavar="DIR",
        help="Keep the output of a slow simulator here.",
        rich_help_panel=_PANEL,
        show_default="not kept",
    ),
]
SimulatorReads = Annotated[
    list[str] | None,
    typer.Option(
        "--simulator-reads",
        metavar="FILE",
        help="A file it reads: the cache is renewed with it.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
Parameters = Annotated[
    str | None,
    typer.Option(
        "--parameters",
        metavar="k=0.1:10,c=0.05",
        help="Fit the simulator's parameters in these ranges, or set them. The simulator is an "
        "FMU, FILE.py:RHS with a function of (t, x, u, p), whose states begin at x0_1, x0_2, ... "
        "and are measured in this order, FILE.py:FUNCTION of (time, u, p), or an sb.Ode of a file, "
        "which may have its ranges itself.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
Calibrate = Annotated[
    bool,
    typer.Option(
        "--calibrate",
        help="Fit its gain, offset, delay and clock first.",
        rich_help_panel=_PANEL,
    ),
]
MoreSimulators = Annotated[
    list[str] | None,
    typer.Option(
        "--more-simulator",
        metavar="FILE",
        help="Simulator of each --more, in order.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
TestSimulators = Annotated[
    list[str] | None,
    typer.Option(
        "--test-simulator",
        metavar="FILE",
        help="Simulator of each --test, in order.",
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
    parameters: Parameters = None


@dataclass(frozen=True)
class SimulatorOrBaseOptions(SimulatorOptions):
    """The same for commands that also put what is fitted to the record in a simulator's place."""

    simulator: SimulatorOrBase = None

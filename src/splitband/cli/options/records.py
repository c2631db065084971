"""Options that say which records there are, and how their files are read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from splitband.cli.options.simulators import MoreSimulators, TestSimulators
from splitband.data.gaps import Gaps
from splitband.data.named import RECORDS
from splitband.data.stamps import TIME_NAMES

_PANEL = "Record"

RecordArgument = Annotated[
    str,
    typer.Argument(
        metavar="RECORD",
        help=f"A CSV, Parquet, NPZ, NPY, MAT or text file, or one of {', '.join(RECORDS)}.",
        show_default=False,
    ),
]
Train = Annotated[
    int | None,
    typer.Option(
        "--train",
        metavar="N",
        help="Train on the first N samples.",
        rich_help_panel=_PANEL,
        show_default="three quarters",
    ),
]
Columns = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        help="Measured columns, by name or position.",
        rich_help_panel=_PANEL,
        show_default="all numeric",
    ),
]
Inputs = Annotated[
    str | None,
    typer.Option(
        metavar="NAMES",
        help="Known inputs: forces, set-points.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
TimeColumn = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="Column of time stamps, seconds or dates.",
        rich_help_panel=_PANEL,
        show_default=", ".join(TIME_NAMES),
    ),
]
SamplingTime = Annotated[
    float | None,
    typer.Option(
        metavar="SECONDS",
        help="Time between samples, without a time column.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
GapsOption = Annotated[
    Gaps,
    typer.Option(
        "--gaps",
        help="Refuse missing values and rows, or mask them.",
        rich_help_panel=_PANEL,
    ),
]
More = Annotated[
    list[str] | None,
    typer.Option(
        "--more",
        metavar="FILE",
        help="Train on this record too; may be repeated.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
Tests = Annotated[
    list[str] | None,
    typer.Option(
        "--test",
        metavar="FILE",
        help="Validate on this record; may be repeated.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
Initial = Annotated[
    int | None,
    typer.Option(
        min=1,
        metavar="N",
        help="Samples of a test record that are known.",
        rich_help_panel=_PANEL,
        show_default="the warm-up",
    ),
]
FutureInputs = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Known inputs of the samples to come.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]


@dataclass(frozen=True)
class RecordOptions:
    """How files are read."""

    columns: Columns = None
    inputs: Inputs = None
    time_column: TimeColumn = None
    sampling_time: SamplingTime = None
    gaps: GapsOption = "refuse"


@dataclass(frozen=True)
class FurtherRecords:
    """Other records of the same system, to train on."""

    more: More = None
    more_simulator: MoreSimulators = None


@dataclass(frozen=True)
class TestRecords:
    """Other records of the same system, to test on."""

    __test__ = False  # for pytest, it is no test

    test: Tests = None
    test_simulator: TestSimulators = None
    initial: Initial = None

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
        help="A file (CSV, TSV, Parquet, NPZ, NPY, MAT or plain text) or a named record: "
        f"{', '.join(RECORDS)}.",
        show_default=False,
    ),
]
Train = Annotated[
    int | None,
    typer.Option(
        "--train",
        help="Samples at the beginning to train on.",
        rich_help_panel=_PANEL,
        show_default="three quarters of a file, the paper's number for a named record",
    ),
]
Columns = Annotated[
    str | None,
    typer.Option(
        help="Measured columns, by name or position, separated by commas.",
        rich_help_panel=_PANEL,
        show_default="all numeric",
    ),
]
Inputs = Annotated[
    str | None,
    typer.Option(
        help="Columns of known inputs (forces, set-points), separated by commas.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
TimeColumn = Annotated[
    str | None,
    typer.Option(
        help="Column of time stamps, in seconds or as dates.",
        rich_help_panel=_PANEL,
        show_default=f"one called {', '.join(TIME_NAMES[:-1])} or {TIME_NAMES[-1]}",
    ),
]
SamplingTime = Annotated[
    float | None,
    typer.Option(
        help="Seconds between samples, where the file has no time column.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
GapsOption = Annotated[
    Gaps,
    typer.Option(
        "--gaps",
        help="A missing or infinite value, or a row that is missing between two time stamps: "
        "refuse the file, or mask it. What is masked counts in no error, and no simulation warms "
        "up on it.",
        rich_help_panel=_PANEL,
    ),
]
More = Annotated[
    list[str] | None,
    typer.Option(
        "--more",
        metavar="FILE",
        help="Another record of the same system, all of it to train on; give it once for each.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
Tests = Annotated[
    list[str] | None,
    typer.Option(
        "--test",
        metavar="FILE",
        help="Another record of the same system, to be simulated to its end from its first "
        "samples (--warmup) by what is fitted to all of RECORD, or to --train samples; give it "
        "once for each.",
        rich_help_panel=_PANEL,
        show_default=False,
    ),
]
FutureInputs = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="Known inputs of the samples to come, where the record has any: by their time stamps; "
        "without any, from the first of these samples on.",
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

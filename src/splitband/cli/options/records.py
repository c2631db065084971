"""Define the options that name records and say how their files are read."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from splitband.cli.options.groups import panel
from splitband.data.named import RECORDS
from splitband.data.signals import Gaps
from splitband.data.stamps import TIME_NAMES

_record, _simulator = panel("Record"), panel("Simulator")

RecordArgument = Annotated[
    str,
    typer.Argument(
        metavar="RECORD",
        help=f"A CSV, Parquet, NPZ, NPY, MAT or text file, or one of {', '.join(RECORDS)}.",
        show_default=False,
    ),
]
ModelArgument = Annotated[
    Path,
    typer.Argument(
        metavar="MODEL_DIR",
        help="What `fit` wrote, or `compare` and `forecast` (OUT/model).",
        show_default=False,
    ),
]
FutureInputs = Annotated[
    Path | None, _record("Known inputs of the samples to come.", "FILE", False)
]


@dataclass(frozen=True)
class FileOptions:
    """Say how files of samples are read."""

    time_column: Annotated[
        str | None,
        _record(
            "Column of time stamps, seconds or dates; or a date and a time of the day, DATE,TIME.",
            "NAME",
            ", ".join(TIME_NAMES),
        ),
    ] = None
    gaps: Annotated[Gaps, _record("Refuse missing values and rows, or mask them.")] = "refuse"
    missing: Annotated[
        str | None,
        _record("Words or numbers that stand for a missing value: Bad,-9999.", "WORDS", False),
    ] = None
    skip_rows: Annotated[
        int, _record("Lines at the top of a text file to leave out.", "N", False, min=0)
    ] = 0
    header_row: Annotated[
        int | None,
        _record("Line of a text file with the names, from 1; 0: none.", "N", "found", min=0),
    ] = None


@dataclass(frozen=True)
class RecordOptions(FileOptions):
    """Say how records are read, and what they hold."""

    columns: Annotated[
        str | None,
        _record(
            "Measured columns, by name, or by position from 0 in a file without names.",
            "NAMES",
            "all numeric",
        ),
    ] = None
    inputs: Annotated[str | None, _record("Known inputs: forces, set-points.", "NAMES", False)] = (
        None
    )
    sampling_time: Annotated[
        float | None,
        _record(
            "Time between samples, without a time column or with one that can mean two things.",
            "SECONDS",
            False,
        ),
    ] = None


@dataclass(frozen=True)
class FurtherRecords:
    """Name other records of the same system, to train on."""

    more: Annotated[
        list[str] | None,
        _record("Train on this record too; may be repeated.", "FILE", False),
    ] = None
    more_simulator: Annotated[
        list[str] | None, _simulator("Simulator of each --more, in order.", "FILE", False)
    ] = None


@dataclass(frozen=True)
class TestRecords:
    """Name other records of the same system, to test on."""

    __test__ = False  # for pytest: not a test class

    test: Annotated[
        list[str] | None,
        _record("Validate on this record; may be repeated.", "FILE", False),
    ] = None
    test_simulator: Annotated[
        list[str] | None, _simulator("Simulator of each --test, in order.", "FILE", False)
    ] = None
    initial: Annotated[
        int | None,
        _record("Measured samples at the beginning of a test record.", "N", "the warm-up", min=1),
    ] = None

"""The records and known inputs that options name, read and put beside each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from splitband.cli import showing
from splitband.cli.naming import names
from splitband.cli.options.records import RecordOptions
from splitband.data import Trajectory, aligned, read, resampled
from splitband.data.gaps import places
from splitband.data.named import RECORDS
from splitband.data.reading import ColumnError
from splitband.data.timing import near_sampling, same_sampling


def load_record(record: str, reading: RecordOptions | None = None) -> Trajectory:
    """A named record, or a file."""
    reading = reading or RecordOptions()
    if record not in RECORDS:
        if not Path(record).exists():
            raise FileNotFoundError(
                f"RECORD must be a file or one of {', '.join(RECORDS)}, got {record}"
            )
        trajectory = read(
            record,
            columns=names(reading.columns) if reading.columns else None,
            inputs=names(reading.inputs or ""),
            time_column=reading.time_column,
            sampling_time=reading.sampling_time,
            gaps=reading.gaps,
        )
        if trajectory.measured is not None:
            missing = ~trajectory.complete
            showing.console.print(
                f"{record}: {missing.sum()} of {len(missing)} samples were not measured in whole, "
                f"and are masked: {places(missing)}"
            )
        return trajectory
    for option, value in (
        ("--columns", reading.columns),
        ("--inputs", reading.inputs),
        ("--time-column", reading.time_column),
        ("--sampling-time", reading.sampling_time),
    ):
        if value is not None:
            raise ValueError(f"{option} is for files; {record} is a named record, got {value}")
    return RECORDS[record].make()


def read_beside(
    path: str | Path, sampling_time: float, time_column: str | None, **others: Any
) -> Trajectory:
    """Read a file that is put beside a record of that sampling time.

    Its time column is the record's, or one with a usual name where it has no such column.
    """
    others["fallback_sampling_time"] = sampling_time
    try:
        return read(path, time_column=time_column, **others)
    except ColumnError:
        if not time_column:
            raise
        return read(path, **others)


def like(record: Trajectory, sampling_time: float, what: str) -> Trajectory:
    """The record at a sampling time from which its own differs by 1 % at most.

    It is left as it is where both end within half a sample.
    """
    if same_sampling(record.sampling_time, sampling_time, len(record)):
        return record
    showing.console.print(
        f"{what}: sampled every {record.sampling_time:.7g} s, interpolated to every "
        f"{sampling_time:.7g} s"
    )
    return resampled(record, sampling_time)


def load_further(
    files: Sequence[str] | None, option: str, record: Trajectory, reading: RecordOptions
) -> list[Trajectory]:
    """The records of --more or --test, with the columns of `record`."""
    records = []
    for file in files or []:
        if not Path(file).exists():
            raise FileNotFoundError(f"{option} must be a file, got {file}")
        more = read_beside(
            file,
            record.sampling_time,
            reading.time_column,
            columns=record.columns,
            inputs=names(reading.inputs or ""),
            gaps=reading.gaps,
        )
        if near_sampling(more.sampling_time, record.sampling_time):  # otherwise refused by `check`
            more = like(more, record.sampling_time, file)
        records.append(replace(more, name=file if option == "--more" else Path(file).stem))
    return records


def inputs_ahead(
    file: Path | None, known: Trajectory, steps: int, reading: RecordOptions
) -> npt.NDArray[np.float64] | None:
    """Known inputs of the samples after a record, `(steps, nu)`, where there are any."""
    inputs = names(reading.inputs or "")
    if file is None:
        if inputs:
            raise ValueError(
                f"this record has known inputs ({', '.join(inputs)}): give their future values "
                "with --future-inputs FILE"
            )
        return None
    if not inputs:
        raise ValueError("this record has no known inputs: leave out --future-inputs")
    ahead = known.grid.after(steps)
    coming = read_beside(file, ahead.step, reading.time_column, columns=inputs)
    # Straight lines, as inputs may jump.
    u = aligned(f"--future-inputs {file}", coming.y, coming.grid, ahead, smooth=False)
    if u.note:
        showing.console.print(f"{file}: {u.note}")
    return u.values

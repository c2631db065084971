"""Read the records and known inputs that options name, and align them in time."""

from __future__ import annotations

import os
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from splitband.cli import showing
from splitband.cli.options.records import FileOptions, RecordOptions
from splitband.cli.options.values import names
from splitband.data import Record, aligned, read, resampled
from splitband.data.named import RECORDS
from splitband.data.reading import ColumnError
from splitband.data.signals import ReadingWarning, described, row_ranges, same_names
from splitband.data.timing import near_sampling, same_sampling
from splitband.forecasters.base import Forecaster
from splitband.runtime.errors import InputError

_OF_TEXT = ("missing", "skip_rows", "header_row")
"""Options for the layout of a file."""


def load_record(name: str, reading: RecordOptions, like: Forecaster | None = None) -> Record:
    """Return a named record, or read a file, and print its channels and inputs.

    Columns and inputs default to those of the model of --like. Raises ValueError if the record's
    differ from these.
    """
    if name in RECORDS:
        for option in ("columns", "inputs", "sampling_time", "time_column", *_OF_TEXT):
            if (value := getattr(reading, option)) not in (None, 0):
                raise InputError(
                    f"--{option.replace('_', '-')} is for files; {name} is a named record, got "
                    f"{value}"
                )
        record = RECORDS[name].make()
        announce(record, name)
    else:
        record = _of_file(name, reading, like)
    if like is not None:
        trained = like.require_fitted().record
        pairs = ((record.columns, trained.columns), (record.inputs, trained.inputs))
        if not all(same_names(sorted(a), sorted(b)) for a, b in pairs):
            raise InputError(
                f"--like must name a model of such a record: it is for "
                f"{described(trained.columns, trained.inputs)}, the record has "
                f"{described(record.columns, record.inputs)}"
            )
    return record


def _of_file(path: str, reading: RecordOptions, like: Forecaster | None) -> Record:
    check_file(path, "RECORD", f" or one of {', '.join(RECORDS)}")
    columns = None if reading.columns is None else names(reading.columns)
    inputs = None if reading.inputs is None else names(reading.inputs)
    needed = ""
    if like is not None:
        trained = like.require_fitted().record
        needed = f"the model of --like is for {described(trained.columns, trained.inputs)}"
        if inputs is None:
            inputs = [name for name in trained.inputs if name not in (columns or ())]
        if columns is None:
            columns = [name for name in trained.columns if name not in inputs]
    record = read_file(
        path,
        "RECORD",
        needed,
        columns=columns or None,
        inputs=inputs or (),
        time_column=reading.time_column,
        sampling_time=reading.sampling_time,
        gaps=reading.gaps,
        **_layout(reading),
    )
    if record.measured is not None:
        missing = ~record.complete
        showing.console.print(
            f"{path}: {missing.sum()} of {len(missing)} samples have missing values "
            f"and are masked: {row_ranges(missing)}"
        )
    announce(record, path)
    return record


def _layout(files: FileOptions) -> dict[str, Any]:
    """Return the arguments of `read` that say how a file is laid out."""
    return {
        "missing": names(files.missing or ""),
        "skip_rows": files.skip_rows,
        "header_row": files.header_row,
    }


def announce(record: Record, name: str) -> None:
    """Print what a record holds, on one line."""
    showing.console.print(
        f"{name}: {described(record.columns, record.inputs)}; {len(record)} samples every "
        f"{record.sampling_time:.7g} s"
    )


def check_file(path: str | Path, argument: str, other: str = "") -> None:
    """Raise OSError if an argument is not a file; `other` extends the rule in the message."""
    rule = f"{argument} must be a file{other}"
    if not os.path.exists(path):
        raise FileNotFoundError(f"{rule}, got {path}")
    if os.path.isdir(path):
        raise IsADirectoryError(f"{rule}, got the folder {path}")


def read_file(path: str | Path, argument: str, needed: str = "", **options: Any) -> Record:
    """Read the file that an argument names, and print the warnings of its reader.

    `needed` is appended to the error for a missing column.
    """
    check_file(path, argument)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", ReadingWarning)
        try:
            record = read(path, **options)
        except ColumnError as error:
            raise ColumnError(f"{error}{'; ' if needed else ''}{needed}") from None
    for each in caught:
        showing.warn(str(each.message))
    return record


def read_companion(
    path: str | Path, argument: str, sampling_time: float, files: FileOptions, **others: Any
) -> Record:
    """Read a file that accompanies a record, whose sampling time is the default.

    The time column is the record's, or one with a usual name if the file has no such column.
    """
    others = {"fallback_sampling_time": sampling_time, **_layout(files), **others}
    try:
        return read_file(path, argument, time_column=files.time_column, **others)
    except ColumnError:
        if not files.time_column:
            raise
        return read_file(path, argument, **others)


def sampled_like(record: Record, sampling_time: float, what: str) -> Record:
    """Resample a record to a sampling time that differs from its own by 1 % at most.

    Return it unchanged if they differ by more, or if both grids end within half a sample.
    """
    if not near_sampling(record.sampling_time, sampling_time) or same_sampling(
        record.sampling_time, sampling_time, len(record)
    ):
        return record
    showing.console.print(
        f"{what}: sampled every {record.sampling_time:.7g} s, interpolated to every "
        f"{sampling_time:.7g} s"
    )
    return resampled(record, sampling_time)


def history_of(file: Path, option: str, record: Record, files: FileOptions) -> Record:
    """Read the measured history that an option names, at the training record's sampling time."""
    past = read_file(
        file,
        option,
        f"the model is for {described(record.columns, record.inputs)}",
        columns=record.columns,
        inputs=record.inputs,
        time_column=files.time_column,
        fallback_sampling_time=record.sampling_time,
        gaps=files.gaps,
        **_layout(files),
    )
    announce(past, str(file))
    if not near_sampling(past.sampling_time, record.sampling_time):
        raise InputError(
            f"{option} must be sampled like the training record, every "
            f"{record.sampling_time:g} s, got every {past.sampling_time:g} s in {file}"
        )
    if past.start is None and record.start is not None:
        showing.console.print(
            f"{file}: no time stamps, the training record has some: taken to begin together; "
            "--time-column names the column"
        )
    past = sampled_like(past, record.sampling_time, str(file))
    return replace(past, columns=record.columns)


def inputs_ahead(
    file: Path | None, known: Record, steps: int, files: FileOptions, since: int = 0
) -> npt.NDArray[np.float64] | None:
    """Return the known inputs of the samples after a record, `(steps, nu)`; None without inputs.

    From a named record without time stamps, they are taken from its sample `since` on.
    """
    inputs = known.inputs
    if file is None:
        if inputs:
            raise InputError(
                f"this record has known inputs ({', '.join(inputs)}): give their future values "
                "with --future-inputs FILE"
            )
        return None
    if not inputs:
        raise InputError("this record has no known inputs: leave out --future-inputs")
    ahead = known.grid.after(steps)
    if str(file) in RECORDS:
        named = RECORDS[str(file)].make()
        assert named.u is not None
        coming = replace(named, y=named.u, y_sim=None, y_true=None, columns=named.inputs)
        coming = coming if named.start is not None else coming[since:]
    else:
        coming = read_companion(file, "--future-inputs", ahead.step, files, columns=inputs)
    # Linear interpolation, as inputs may jump.
    u = aligned(f"--future-inputs {file}", coming.y, coming.grid, ahead, smooth=False)
    if u.note:
        showing.console.print(f"{file}: {u.note}")
    return u.values

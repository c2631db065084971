"""Load the columns of a file in any supported format, with pandas and SciPy."""

from __future__ import annotations

import math
import warnings
import zipfile
from collections.abc import Callable, Mapping
from io import BufferedReader
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import pyarrow.parquet  # type: ignore[import-untyped]
import scipy
from numpy.typing import NDArray

from splitband.data.columns import Column
from splitband.data.signals import one_line
from splitband.data.text import check_different, read_table

MOST_BYTES = 2**31
"""Limit of the size of a file's numbers in memory, in bytes. By eye."""

_MAT_NUMBERS = (
    "double", "single", "logical", *(f"{u}int{n}" for u in ("", "u") for n in (8, 16, 32, 64)),
)  # fmt: skip

_AnyArray: TypeAlias = NDArray[Any]
Table: TypeAlias = dict[str, Column]
"""Columns by name; in NPZ and MAT files they may differ in length."""


def load(path: Path) -> Table:
    """Read every column of a file; an error of any reader is raised as a ValueError."""
    kind, reader = _READERS.get(path.suffix.lower(), ("text", None))
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not file.peek(1):
            raise ValueError("the file is empty")
        try:
            return _read_text(path, file) if reader is None else reader(path)
        except Exception as error:  # zip, pickle, Arrow, pandas and SciPy each raise their own
            raise ValueError(f"cannot be read as {kind}: {one_line(error)}") from error


def _read_text(path: Path, file: BufferedReader) -> Table:
    """Read separated numbers, with or without a header, in one pass: `file` may be a pipe."""
    most = MOST_BYTES // 4  # memory holds it as bytes, as lines and as numbers
    check_size(4 * path.stat().st_size)
    raw = file.read(most + 1)
    check_size(4 * len(raw))
    check_size(100 * raw.count(b"\n"))
    return _columns(read_table(raw, path.suffix.lower()))


def check_size(size: int) -> None:
    """Raise ValueError for a file whose numbers, in bytes, exceed `MOST_BYTES`."""
    if size > MOST_BYTES:
        raise ValueError(f"it would take {size / 2**30:.1f} GiB, at most {MOST_BYTES / 2**30:g} do")


def _read_parquet(path: Path) -> Table:
    metadata = pyarrow.parquet.read_metadata(path)
    groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
    columns = [group.column(i) for group in groups for i in range(group.num_columns)]
    check_size(8 * sum(column.num_values for column in columns))
    check_size(sum(column.total_uncompressed_size for column in columns))
    return of_frame(pd.read_parquet(path))


def of_frame(frame: pd.DataFrame) -> Table:
    """Return the columns of a table, including an index that has a name or holds times."""
    times = isinstance(frame.index, pd.DatetimeIndex | pd.TimedeltaIndex)
    if times or (frame.index.name is not None and not isinstance(frame.index, pd.RangeIndex)):
        frame = frame.reset_index(names=str(frame.index.name or "time"))
    return _columns(frame)


def _read_numpy(path: Path) -> Table:
    with path.open("rb") as file:  # np.load(path) would leave a damaged file open
        zipped = zipfile.is_zipfile(file)
        file.seek(0)
        if zipped:
            with zipfile.ZipFile(file) as archive:
                check_size(sum(_bytes_of(archive, member) for member in archive.infolist()))
            file.seek(0)
            with np.load(file, allow_pickle=False) as archive:
                return _variables(dict(archive))
    array = np.lib.format.open_memmap(path, mode="r")  # raises for a file that is cut short
    check_size(8 * array.size)
    return _columns(pd.DataFrame(_native(array)))


def _bytes_of(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> int:
    """Return the size in bytes of an archive's array as float64, from its header."""
    with archive.open(member) as file:
        version = np.lib.format.read_magic(file)
        read_header = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, _, _ = read_header(file)
    return max(8 * math.prod(shape), member.file_size)


def _read_mat(path: Path) -> Table:
    try:
        numeric = [v for v in scipy.io.whosmat(path) if v[2] in _MAT_NUMBERS]
        check_size(8 * sum(math.prod(shape) for _, shape, _ in numeric))
        names = [name for name, _, _ in numeric]
        return _variables(scipy.io.loadmat(path, variable_names=names))
    except NotImplementedError:
        raise ValueError("it is a v7.3 (HDF5) file; save it with the option -v7") from None


def _columns(frame: pd.DataFrame) -> Table:
    names = [str(name).strip() for name in frame.columns]
    check_different(names)
    return {name: frame.iloc[:, i] for i, name in enumerate(names)}


def _native(array: _AnyArray) -> _AnyArray:
    """Return an array without axes of length 1 (one stays), in native byte order for pandas."""
    return np.atleast_1d(array.astype(array.dtype.newbyteorder("="), copy=False).squeeze())


def _variables(variables: Mapping[str, object]) -> Table:
    """Return named arrays as columns: a matrix `m` becomes `m[0]`, `m[1]`, ..."""
    table: Table = {}
    names = [name.strip() for name in variables]
    check_different(names)
    for name, variable in zip(names, variables.values(), strict=True):
        if isinstance(variable, np.ndarray) and variable.dtype.names is None:
            array = _native(variable)
            if array.ndim == 1:
                table[name] = pd.Series(array)
            elif array.ndim == 2:
                table |= {f"{name}[{i}]": pd.Series(array[:, i]) for i in range(array.shape[1])}
    return table


_READERS: dict[str, tuple[str, Callable[[Path], Table]]] = {
    ".parquet": ("Parquet", _read_parquet),
    ".pq": ("Parquet", _read_parquet),
    ".npz": ("NPZ", _read_numpy),
    ".npy": ("NPY", _read_numpy),
    ".mat": ("MAT", _read_mat),
}

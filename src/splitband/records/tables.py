"""Load the columns of a file in any supported format, with pandas and SciPy."""

from __future__ import annotations

import contextlib
import math
import warnings
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd
import scipy
from numpy.typing import NDArray
from pandas.api.types import is_float_dtype
from pandas.io.common import get_handle, infer_compression  # type: ignore[import-not-found]

from splitband.records.remedies import Table
from splitband.records.signals import Column, is_text
from splitband.records.stamps import is_time
from splitband.records.text import Layout, check_different, read_table
from splitband.runtime.errors import InputError, missing, one_line

MOST_BYTES = 2**31
"""Limit of the size of a file's numbers in memory, in bytes. Bounds the memory."""
_MAT_INTEGERS = [f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)]
_MAT_NUMBERS = ("double", "single", "logical", *_MAT_INTEGERS)
_MAT_READ = (*_MAT_NUMBERS, "struct", "cell", "char")
_IN_MATLAB = {
    "timetable": "; in MATLAB writetimetable({0}, '{0}.csv')",
    "table": "; in MATLAB writetable({0}, '{0}.csv')",
    "timeseries": "; in MATLAB time = {0}.Time; data = {0}.Data; save('{0}.mat', 'time', 'data')",
    "datetime": "; in MATLAB time = seconds({0} - {0}(1))",
}
"""What saves objects in a form that others can read."""
_OPENED_BY = {
    **dict.fromkeys((".xlsx", ".xls", ".xlsm", ".ods"), "pandas.read_excel('{0}')"),
    **dict.fromkeys((".h5", ".hdf5", ".hdf"), "pandas.read_hdf('{0}'), or h5py's arrays,"),
    **dict.fromkeys((".mf4", ".mdf"), "asammdf.MDF('{0}').to_dataframe()"),
    ".tdms": "nptdms.TdmsFile.read('{0}').as_dataframe(time_index=True)",
    ".feather": "pandas.read_feather('{0}')",
    ".json": "pandas.read_json('{0}')",
}
"""What makes a DataFrame of files that are not read here."""
_AnyArray: TypeAlias = NDArray[Any]


def load(path: Path, layout: Layout) -> Table:
    """Read every column of a file; an error of any reader is raised as an `InputError`."""
    suffix = path.suffix.lower()
    kind, reader = _READERS.get(suffix, ("text", None))
    if reader is not None:
        layout.check_no_lines(kind)
    with path.open("rb") as file, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if not file.peek(1):
            raise InputError("the file is empty")
        if (opened := _OPENED_BY.get(suffix)) is not None:
            raise InputError(
                f"a {suffix} file is not read: save it as CSV or Parquet, or in Python pass "
                f"{opened.format(path.name)} to splitband.read"
            )
        if reader is None:  # in one pass, as the file may be a pipe
            check_size(4 * path.stat().st_size)
            # Memory holds it as bytes, as lines and as numbers.
            packed = infer_compression(str(path), "infer")
            try:
                with get_handle(file, "rb", compression=packed, is_text=False) as unpacked:
                    raw = unpacked.handle.read(MOST_BYTES // 4 + 1)
            except Exception as error:  # gzip, zipfile and lzma each raise their own
                raise InputError(f"cannot be read as {path.suffix}: {one_line(error)}") from error
            suffix = Path(path.stem).suffix if packed else path.suffix
            check_size(max(4 * len(raw), 100 * raw.count(b"\n")))
            return known(_columns(read_table(raw, suffix.lower(), layout)), layout)
        try:
            table = reader(path)
        except InputError:
            raise
        except Exception as error:  # zip, pickle, Arrow and SciPy each raise their own
            raise InputError(f"cannot be read as {kind}: {one_line(error)}") from error
    return known(table, layout)


def known(table: Table, layout: Layout) -> Table:
    """Return a table without the cells that stand for missing values; time stamps are none."""
    return {
        name: column
        if is_time(name) and column.is_monotonic_increasing
        else _without(column, layout.missing)
        for name, column in table.items()
    }


def _without(column: Column, words: Sequence[str]) -> Column:
    """Return a column without the cells that hold one of the words, or its number."""
    if not words:
        return column
    values = pd.to_numeric(column, errors="coerce") if is_text(column) else column
    plain = pd.to_numeric(pd.Series(words).str.replace(",", "."), errors="coerce")
    plain = plain[np.isfinite(plain)]
    single = values.dtype == np.float32  # which holds -99.9 in its own precision
    missing = values.isin(plain.astype(np.float32) if single else plain)
    if is_text(column):
        missing |= column.astype(str).str.strip().isin(words)
    column = column.mask(missing) if missing.any() else column
    values = pd.to_numeric(column, errors="coerce") if is_text(column) else column
    return column if (values.isna() & column.notna()).any() else values


def check_size(size: int) -> None:
    """Raise ValueError for a file whose numbers, in bytes, exceed `MOST_BYTES`."""
    if size > MOST_BYTES:
        raise InputError(f"it would take {size / 2**30:.1f} GiB, at most {MOST_BYTES / 2**30:g} do")


def of_frame(frame: pd.DataFrame) -> Table:
    """Return the columns of a table, including an index that has a name or holds times."""
    if isinstance(frame.index, pd.MultiIndex):
        names = [i if name is None else name for i, name in enumerate(frame.index.names)]
        raise InputError(
            f"its rows must have one index, not {', '.join(map(repr, names))}: "
            f"table.xs(..., level={names[0]!r}) is one part, table.reset_index() makes columns of "
            "all"
        )
    if isinstance(frame.index, pd.PeriodIndex):
        frame = frame.to_timestamp()
    index = frame.index
    times = isinstance(index, pd.DatetimeIndex | pd.TimedeltaIndex) or is_float_dtype(index)
    if times or (index.name is not None and not isinstance(index, pd.RangeIndex)):
        name = index.name or ("index" if "time" in frame.columns else "time")
        frame = frame.reset_index(names=str(name))
    return _columns(frame)


def _read_parquet(path: Path) -> Table:
    try:
        from pyarrow import parquet  # type: ignore[import-untyped]  # noqa: PLC0415  an extra
    except ImportError:
        raise missing("a Parquet file", "PyArrow", "parquet") from None
    metadata = parquet.read_metadata(path)
    groups = [metadata.row_group(i) for i in range(metadata.num_row_groups)]
    columns = [group.column(i) for group in groups for i in range(group.num_columns)]
    check_size(sum(max(8 * c.num_values, c.total_uncompressed_size) for c in columns))
    return of_frame(pd.read_parquet(path))


def _read_numpy(path: Path) -> Table:
    if not zipfile.is_zipfile(path):
        array = np.lib.format.open_memmap(path, mode="r")  # raises for a file that is cut short
        check_size(8 * array.size)
        return _columns(pd.DataFrame(_native(array)))
    with zipfile.ZipFile(path) as archive:
        check_size(sum(member.file_size for member in archive.infolist()))
    # np.load(path) would leave a damaged file open.
    with path.open("rb") as file, np.load(file, allow_pickle=False) as arrays:
        variables = dict(arrays)
    check_size(8 * sum(array.size for array in variables.values()))
    return _variables(variables)


def _read_mat(path: Path) -> Table:
    try:
        found = [v for v in _in_mat(path) if not v[0].startswith("__")]
        check_size(8 * sum(math.prod(shape) for _, shape, kind in found if kind in _MAT_NUMBERS))
        names = [name for name, _, kind in found if kind in _MAT_READ]
        content = scipy.io.loadmat(path, variable_names=names, simplify_cells=True)
    except NotImplementedError:
        raise InputError(
            "cannot be read as MAT: it is a v7.3 (HDF5) file; save it with the option -v7"
        ) from None
    if {"Aclass", "name", "dataInfo", "data_2"} <= {*content}:
        return _of_modelica(content)
    table = _variables(content)
    others = {
        name: (kind + _IN_MATLAB.get(kind, "")).format(name)
        for name, _, kind in found
        if kind not in _MAT_READ or not table
    }
    if not table:
        kinds = ", ".join(f"{name!r} ({what})" for name, what in others.items()) or "nothing"
        raise InputError(f"it holds no numbers, but {kinds}")
    return table | {name: _unread(why) for name, why in others.items()}


def _in_mat(path: Path) -> Sequence[tuple[str, tuple[int, ...], str]]:
    """Return name, shape and class of each variable of a MAT file, those of objects included."""
    with contextlib.suppress(TypeError):  # which SciPy raises for an object
        return scipy.io.whosmat(path)
    found: list[tuple[str, tuple[int, ...], str]] = []
    with path.open("rb") as file:
        for name, part in scipy.io.matlab.varmats_from_mat(file):
            each: Any = part
            if name != "None":
                found += scipy.io.whosmat(each)
            else:
                opaque = scipy.io.loadmat(each)[name][0]
                found.append((opaque["s0"].decode(), (1, 1), opaque["s2"].decode()))
    return found


def _of_modelica(content: Mapping[str, _AnyArray]) -> Table:
    """Return the variables of a result file of Dymola or OpenModelica by their names.

    `dataInfo` holds the matrix of each variable, and its column with a sign; `data_1` has the first
    and the last value of constants. In the form "binTrans" all matrices are transposed.
    """
    names, places = np.atleast_1d(content["name"]), content["dataInfo"]
    parts = {key: value for key, value in content.items() if key.startswith("data_")}
    if "binTrans" in "".join(content["Aclass"]):
        names = np.array(["".join(letters) for letters in zip(*names, strict=True)])
        parts, places = {key: value.T for key, value in parts.items()}, places.T
    rows = _even_rows(parts["data_2"][:, 0])
    table: Table = {}
    for name, (part, column) in zip(map(str.strip, names), places[:, :2], strict=True):
        values = parts[f"data_{part or 2}"][:, abs(column) - 1]
        values = np.full(len(rows), values[0]) if part == 1 else values[rows]
        table[name] = pd.Series(values if column > 0 else -values)
        if part < 2:
            table[name].attrs["left out" if part else "abscissa"] = "a constant"
    return table


def _even_rows(time: _AnyArray) -> NDArray[np.int_]:
    """Return the rows of a simulation's output at even times, or those of different times.

    At an event, the tools write a row before it and one after it, also between even times.
    """
    rows = np.flatnonzero(np.diff(time, append=np.inf) > 0)  # after the event
    steps = np.diff(time := time[rows])
    step = np.quantile(steps, 0.9)
    whole = np.concatenate([[False], np.abs(steps - step) < 0.02 * step, [False]])
    on = whole[1:] | whole[:-1]  # beside no event
    on[0] = True
    at = np.interp(time, time[on], np.cumsum(np.rint(np.diff(time[on], prepend=time[0]) / step)))
    even = np.abs(at - np.rint(at)) < 0.02
    return rows[even] if (np.diff(np.rint(at[even])) == 1).all() else rows


def _unread(why: str) -> Column:
    """Return an empty column in place of a variable that is none."""
    column: Column = pd.Series(dtype=object)
    column.attrs["unread"] = why
    return column


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
    arrays = list(_arrays(variables))
    check_different([name for name, _ in arrays])
    for name, array in arrays:
        if array.ndim == 1:
            table[name] = pd.Series(array)
        elif array.ndim == 2:
            table |= {f"{name}[{i}]": pd.Series(array[:, i]) for i in range(array.shape[1])}
        else:
            table[name] = _unread(f"{array.ndim} axes instead of 2")
    return table


def _arrays(value: object, name: str = "") -> Iterator[tuple[str, _AnyArray]]:
    """Yield the arrays of variables and of their fields, such as `out.signals[0].values`."""
    match value:
        case Mapping():
            for key, field in value.items():
                if not key.startswith("__"):  # the header of a MAT file
                    yield from _arrays(field, f"{name}.{key.strip()}".lstrip("."))
        case list() | np.ndarray(dtype=np.dtypes.ObjectDType()) if {*map(type, value)} == {str}:
            yield name, np.asarray(value)  # a cell of dates
        case list() | np.ndarray(dtype=np.dtypes.ObjectDType()):
            for i, cell in enumerate(value):
                yield from _arrays(cell, f"{name}[{i}]")
        case np.ndarray() if value.dtype.names:
            yield from _arrays({key: value[key] for key in value.dtype.names}, name)
        case np.ndarray() if not value.size:
            pass
        case np.ndarray() | np.generic() | float() | int() | complex():
            yield name, _native(np.asarray(value))


_READERS = {
    ".parquet": ("Parquet", _read_parquet),
    ".pq": ("Parquet", _read_parquet),
    ".npz": ("NPZ", _read_numpy),
    ".npy": ("NPY", _read_numpy),
    ".mat": ("MAT", _read_mat),
}

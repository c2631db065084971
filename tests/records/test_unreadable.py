"""Files that cannot be read say why, in one line."""

from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from splitband.records import (
    read,
)
from tests.records.support import U, message, saved, text_file


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("", {}, "the file is empty"),
        ("\n\n# only a comment\n", {}, "it holds no data"),
        ("a,b\n", {}, "at least 2 rows: it has 0"),
        ("a,b\n1,2\n", {}, "at least 2 rows: it has 1"),
        ("a,b\n1,2\n3,4\n", {"columns": ["c"]}, "column 'c' is unknown: the columns are 'a', 'b'"),
        ("a,b\n1,2\n3,4\n", {"columns": ["a"], "inputs": ["a"]}, "'a' is asked for twice"),
        ("a,b\n1,2\n3,4\n", {"columns": []}, "no numeric column to model"),
        ("a,b\nx,y\nz,w\n", {}, "no numeric column to model: left out: 'a' (no numbers: 'x')"),
        ("a,b\n1,2\n3,4.x\n5,6\n", {}, "column 'b' must be numeric: row 1 holds '4.x'"),
        ("a,b\n1,2\n3,-inf\n", {"columns": "a", "inputs": "b"}, "column 'b' must be finite"),
        ("a,b\n1,2+1j\n3,1j\n", {"columns": "b"}, "row 0 holds '2+1j'"),
        ("# note\na,b\n1,2\n\n3,4,5\n", {}, "line 5 holds 3 cells instead of 2"),
        ("y\n1\n2\n", {"sampling_time": None}, "(--sampling-time) in seconds, or time_column"),
        ("y\n1\n2\n", {"sampling_time": -1}, "sampling_time must be a positive number"),
        (b"\x00\x01\x02\x03", {}, "it is a binary file"),
        ("1,,3\n", {}, "must be finite: 1 bad value, the first (nan) at row 1"),
    ],
)
def test_errors_in_text(
    tmp_path: Path, text: str | bytes, options: dict[str, Any], words: str
) -> None:
    assert words in message(text_file(tmp_path, text), **{"sampling_time": 1, **options})


@pytest.mark.parametrize(
    ("name", "opened"),
    [
        ("rig.xlsx", "pandas.read_excel('rig.xlsx')"),
        ("rig.MF4", "asammdf.MDF('rig.MF4').to_dataframe()"),
        ("rig.tdms", "nptdms.TdmsFile.read('rig.tdms').as_dataframe(time_index=True)"),
    ],
)
def test_files_that_other_libraries_read(tmp_path: Path, name: str, opened: str) -> None:
    said = message(text_file(tmp_path, b"\x00\x01", name))
    assert "save it as CSV or Parquet" in said
    assert f"pass {opened} to splitband.read" in said


def test_at_most_ten_columns_are_listed(tmp_path: Path) -> None:
    path = text_file(tmp_path, ",".join(f"c{i}" for i in range(50)) + "\n" + "1," * 49 + "1\n")
    text = message(path, columns="z")
    assert "'c9', ..." in text
    assert "c10" not in text


def test_files_that_cannot_be_opened(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, *args: Any) -> None:  # a file mode would not stop root
        raise PermissionError(13, "Permission denied", str(path))

    with pytest.raises(FileNotFoundError, match="absent\\.csv"):
        read(tmp_path / "absent.csv")
    with pytest.raises(IsADirectoryError, match=tmp_path.name):
        read(tmp_path)
    path = text_file(tmp_path, "1\n2\n")
    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(PermissionError, match=path.name):
        read(path)


@pytest.mark.parametrize("name", ["r.csv", "r.parquet", "r.npz", "r.npy", "r.mat"])
def test_what_would_not_fit_into_memory_is_refused_before_it_is_read(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = saved(tmp_path / name, y=np.zeros((1000, 2)))
    assert len(read(path, sampling_time=1)) == 1000
    monkeypatch.setattr("splitband.records.tables.MOST_BYTES", 15_000)
    assert "it would take" in message(path, sampling_time=1)


def test_a_file_that_only_says_it_is_large_takes_no_memory(tmp_path: Path) -> None:
    path = tmp_path / "record.npy"
    for rows in (10**5, 10**15):
        with path.open("wb") as file:
            header = {"descr": "<f8", "fortran_order": False, "shape": (rows, 2)}
            np.lib.format.write_array_header_1_0(file, header)
            file.write(bytes(160))
        assert "cannot be read as NPY" in message(path, sampling_time=1)


@pytest.mark.parametrize(("factor", "rule"), [(1e121, "at most"), (1e-122, "at least")])
def test_values_out_of_all_proportion_are_refused(tmp_path: Path, factor: float, rule: str) -> None:
    path = text_file(tmp_path, "a,b\n" + "".join(f"1,{factor * n}\n" for n in range(1, 5)))
    said = message(path, sampling_time=1)
    assert "column 'b' must be" in said
    assert rule in said


GARBAGE = [
    b"PK\x03\x04" + b"x" * 90,
    b"\0" * 300,
    b"PAR1aaaaaaaaPAR1",
]


@pytest.mark.parametrize("suffix", ["parquet", "pq", "npz", "npy", "mat"])
@pytest.mark.parametrize("content", GARBAGE, ids=range(len(GARBAGE)))
def test_files_that_are_something_else(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = text_file(tmp_path, content, f"record.{suffix}")
    kind = {"parquet": "Parquet", "pq": "Parquet"}.get(suffix, suffix.upper())
    assert f"cannot be read as {kind}: " in message(path, sampling_time=1)


def test_objects_are_not_unpickled(tmp_path: Path) -> None:
    np.savez(tmp_path / "record.npz", y=np.array([{}, 1], dtype=object))
    assert "allow_pickle=False" in message(tmp_path / "record.npz", sampling_time=1)
    np.save(tmp_path / "record.npy", np.array([{}, 1], dtype=object))
    assert "Python objects" in message(tmp_path / "record.npy", sampling_time=1)


def test_hdf5_mat_files_say_what_to_do(tmp_path: Path) -> None:
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    said = message(text_file(tmp_path, header + b"\0" * 512, "record.mat"))
    assert "v7.3" in said
    assert "-v7" in said.replace("v7.3", "")


@pytest.mark.parametrize("name", ["record.npz", "record.mat"])
def test_complex_values(tmp_path: Path, name: str) -> None:
    assert "column 'y' must be real" in message(saved(tmp_path / name, y=U * 1j, dt=1.0))


def test_missing_and_nested_cells_of_a_parquet_file(tmp_path: Path) -> None:
    path = tmp_path / "record.parquet"
    counts = pd.array([1, None, 3], dtype="Int64")
    pd.DataFrame({"count": counts, "list": [[1], [2], [3]]}).to_parquet(path)
    assert "column 'count' must be finite: 1 bad value" in message(path, sampling_time=1)
    assert "column 'list' must be numeric" in message(path, columns="list", sampling_time=1)

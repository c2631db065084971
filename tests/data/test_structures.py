"""Structures of MAT and NPZ files: their fields are columns."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy

from splitband.data import read
from splitband.data.signals import ReadingWarning
from tests.data.support import message, saved

T = 0.01 * np.arange(50)
Y = np.sin(T)
SCOPE = {
    "time": T[:, None],
    "signals": [
        {"values": Y[:, None], "dimensions": 1.0, "label": "speed", "title": ""},
        {"values": np.column_stack([Y, -Y]), "dimensions": 2.0, "label": ""},
    ],
    "blockName": "model/Scope",
}


def mat(folder: Path, **variables: Any) -> Path:
    return saved(folder / "record.mat", **variables)


@pytest.mark.parametrize(
    ("variables", "options", "columns"),
    [
        ({"out": SCOPE}, {}, ["out.signals[0].values", "out.signals[1].values[0]",
                              "out.signals[1].values[1]"]),
        ({"out": {"time": T, "signals": {"values": Y.reshape(1, 1, -1)}}}, {},
         ["out.signals.values"]),
        ({"exp1": {"t": T, "y": Y}}, {"columns": "exp1.y"}, ["exp1.y"]),
        ({"data": {"run": {"time": T, "y": Y, "u": Y}, "who": "me"}}, {"inputs": "data.run.u"},
         ["data.run.y"]),
        ({"t": T, "s": {"y": Y}}, {}, ["s.y"]),
        ({"e1": {"t": T, "y": Y}, "e2": {"t": 2 * T, "y": Y}},
         {"time_column": "e1.t", "columns": "e1.y"}, ["e1.y"]),
        ({"tout": T, "yout": Y}, {"time_column": "tout"}, ["yout"]),
    ],
)  # fmt: skip
def test_fields_are_columns(
    tmp_path: Path, variables: dict[str, Any], options: dict[str, Any], columns: list[str]
) -> None:
    found = read(mat(tmp_path, **variables), **options)
    assert found.columns == tuple(columns)
    assert found.sampling_time == pytest.approx(0.01, rel=1e-12)
    np.testing.assert_array_equal(found.y[:, 0], Y)


def test_fields_of_a_structured_array(tmp_path: Path) -> None:
    rows = np.array([*zip(T, Y, strict=True)], dtype=[("time", "f8"), ("y", "f8")])
    np.savez(tmp_path / "record.npz", run=rows)
    assert read(tmp_path / "record.npz").columns == ("run.y",)


@pytest.mark.parametrize(
    ("variables", "options", "words"),
    [
        ({"s": {"note": "hi"}}, {}, "it holds no numbers, but 's' (struct)"),
        ({"t": T, "y": np.vstack([Y, Y])}, {}, "'y' (2 rows instead of 50 in each of its 50"),
        ({"e": {"t": T, "y": np.vstack([Y, Y])}}, {}, "transpose it"),
        ({"t": T, "z": np.zeros((2, 3, 50))}, {}, "'z' (3 axes instead of 2)"),
        ({"t": T, "z": np.zeros((2, 3, 50))}, {"columns": "z"}, "column 'z' cannot be read"),
        ({"e1": {"t": T, "y": Y}, "e2": {"t": 2 * T, "y": Y}}, {}, "different time stamps"),
        ({"tout": T, "yout": Y}, {}, "the columns are 'tout', 'yout'"),
    ],
)
def test_what_is_no_column_is_named(
    tmp_path: Path, variables: dict[str, Any], options: dict[str, Any], words: str
) -> None:
    assert words in message(mat(tmp_path, **variables), **options)


def test_objects_of_matlab_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """SciPy cannot write them; it lists a timetable as an opaque variable."""
    path, listed = mat(tmp_path, t=T, y=Y), scipy.io.whosmat
    monkeypatch.setattr(scipy.io, "whosmat", lambda p: [*listed(p), ("tt", (1, 1), "opaque")])
    with pytest.warns(ReadingWarning, match=r"left out: 'tt' \(opaque, which only MATLAB can"):
        assert read(path).columns == ("y",)
    monkeypatch.setattr(scipy.io, "whosmat", lambda p: [("tt", (1, 1), "opaque")])
    said = message(path)
    assert "it holds no numbers, but 'tt' (opaque)" in said
    assert "writetimetable" in said

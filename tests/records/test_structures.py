"""Structures of MAT and NPZ files: their fields are columns."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy

from splitband.records import read
from splitband.records.signals import ReadingWarning
from tests.records.support import message, saved, text_file

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
ENDS = "0].values", "1].values[0]", "1].values[1]"
ONE_SIGNAL = {"time": T, "signals": {"values": Y.reshape(1, 1, -1)}}
RUN = {"time": T, "y": Y, "u": Y}
FIRST = {"time_column": "e1.t", "columns": "e1.y"}


def mat(folder: Path, **variables: Any) -> Path:
    return saved(folder / "record.mat", **variables)


@pytest.mark.parametrize(
    ("variables", "options", "columns"),
    [
        ({"out": SCOPE}, {}, [f"out.signals[{i}" for i in ENDS]),
        ({"out": ONE_SIGNAL}, {}, ["out.signals.values"]),
        ({"exp1": {"t": T, "y": Y}}, {"columns": "exp1.y"}, ["exp1.y"]),
        ({"data": {"run": RUN, "who": "me"}}, {"inputs": "data.run.u"}, ["data.run.y"]),
        ({"t": T, "s": {"y": Y}}, {}, ["s.y"]),
        ({"e1": {"t": T, "y": Y}, "e2": {"t": 2 * T, "y": Y}}, FIRST, ["e1.y"]),
        ({"tout": T, "yout": Y}, {"time_column": "tout"}, ["yout"]),
    ],
)
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


def element(kind: int, content: bytes) -> bytes:
    """An element of a MAT file of version 5."""
    return struct.pack("<II", kind, len(content)) + content + bytes(-len(content) % 8)


def opaque(name: str, kind: str, packed: bool) -> bytes:
    """What MATLAB appends to a workspace for an object, which SciPy cannot write."""
    words = b"".join(element(1, word.encode()) for word in (name, "MCOS", kind))
    meta = element(6, struct.pack("<II", 13, 0)) + element(5, struct.pack("<ii", 6, 1))
    meta += element(1, b"") + element(6, struct.pack("<6I", 0xDD000000, 2, 1, 1, 1, 1))
    whole = element(14, element(6, struct.pack("<II", 17, 0)) + words + element(14, meta))
    content = zlib.compress(whole)
    return struct.pack("<II", 15, len(content)) + content if packed else whole


@pytest.mark.parametrize("packed", [False, True])
def test_objects_of_matlab_are_named(tmp_path: Path, packed: bool) -> None:
    path = mat(tmp_path, t=T, y=Y)
    kinds = {"tt": "timetable", "note": "string", "begin": "datetime"}
    with path.open("ab") as file:
        file.write(b"".join(opaque(name, kind, packed) for name, kind in kinds.items()))
    with pytest.raises(TypeError):
        scipy.io.whosmat(path)
    with pytest.warns(ReadingWarning, match="left out: 'tt' .timetable; in MATLAB writetimetable"):
        found = read(path)
    assert found.columns == ("y",)
    np.testing.assert_array_equal(found.y[:, 0], Y)
    scipy.io.savemat(path, {})
    with path.open("ab") as file:
        file.write(opaque("tt", "timetable", packed))
    said = message(path)
    assert (
        "it holds no numbers, but 'tt' (timetable; in MATLAB writetimetable(tt, 'tt.csv'))" in said
    )
    rows = "".join(f"{t:.2f} sec,{y}\n" for t, y in zip(T, Y, strict=True))
    written = text_file(tmp_path, f"Time,y\n{rows}", "tt.csv")
    np.testing.assert_array_equal(read(written).y[:, 0], Y)


def trajectory(turned: bool, events: tuple[float, ...] = ()) -> dict[str, Any]:
    """A result of Dymola or OpenModelica, with a row before and one after each event."""
    even = np.arange(400) / 20
    time = np.sort(np.concatenate([even, events, [e for e in events if e not in even]]))
    after = np.diff(time, prepend=-1) == 0
    x = np.sin(time) + after
    names = ["time", "cart.x", "cart.minus", "cart.mass", "cart.set"]
    width = max(map(len, names))
    places = np.array([[0, 1, 0, -1], [2, 2, 0, -1], [2, -2, 0, -1], [1, 2, 0, 0], [1, -2, 0, 0]])
    letters = ["".join(row) for row in zip(*(n.ljust(width) for n in names), strict=True)]
    content: dict[str, Any] = {
        "Aclass": np.array(["Atrajectory", "1.1", "", "binTrans" if turned else "binNormal"]),
        "name": np.array(letters if turned else names),
        "dataInfo": places.astype(np.int32),
        "data_1": np.array([[0, 2.5], [time[-1], 2.5]]),
        "data_2": np.column_stack([time, x]).astype(np.float32),
    }
    flipped = ("dataInfo", "data_1", "data_2") if turned else ()
    return content | {name: content[name].T for name in flipped}


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("events", [(), (3.0, 7.013, 7.021, 12.04)])
def test_results_of_modelica_have_the_names_of_its_variables(
    tmp_path: Path, turned: bool, events: tuple[float, ...]
) -> None:
    path = tmp_path / "Cart_res.mat"
    scipy.io.savemat(path, trajectory(turned, events), format="4")
    found = read(path, columns=["cart.x", "cart.minus", "cart.mass", "cart.set"])
    assert (len(found), found.sampling_time, found.start) == (400, 0.05, 0)
    x = np.sin(0.05 * np.arange(400))
    x[60] += 1 if events else 0  # of an event on a sample, what follows it
    np.testing.assert_allclose(found.y[:, 0], x, atol=1e-6)
    np.testing.assert_array_equal(found.y[:, 1], -found.y[:, 0])
    np.testing.assert_array_equal(found.y[:, 2:], np.tile([2.5, -2.5], (400, 1)))
    with pytest.warns(ReadingWarning, match="left out: 'cart.mass' .a constant., 'cart.set'"):
        assert read(path).columns == ("cart.x", "cart.minus")

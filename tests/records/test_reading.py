"""What is written in any format is read again."""

import os
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from splitband.records import read
from splitband.records.signals import ReadingWarning
from splitband.runtime.arrays import Array
from tests.records.support import STEP, WRITERS, U, Y, message, saved, text_file


@pytest.mark.parametrize("name", WRITERS)
def test_round_trip(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    WRITERS[name](path)

    everything = read(path)
    np.testing.assert_array_equal(everything.y, np.column_stack([Y, U]))
    assert everything.columns == ("torque", "angle", "force")
    assert everything.sampling_time == pytest.approx(STEP, rel=1e-12)
    assert everything.name == path.stem

    conditioned = read(str(path), inputs=["force"])
    np.testing.assert_array_equal(conditioned.y, Y)
    np.testing.assert_array_equal(conditioned.u, U[:, None])

    chosen = read(path, columns=["angle"], inputs="torque", time_column="time")
    np.testing.assert_array_equal(chosen.y, Y[:, 1:])
    np.testing.assert_array_equal(chosen.u, Y[:, :1])
    assert chosen.columns == ("angle",)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("plain.txt", lambda path: np.savetxt(path, Y, fmt="%.17g", header="two channels")),
        ("noextension", lambda path: np.savetxt(path, Y, fmt="%.17g", delimiter=";")),
        ("plain.npy", lambda path: np.save(path, Y)),
        ("big-endian.npy", lambda path: np.save(path, np.asfortranarray(Y).astype(">f8"))),
    ],
)
def test_without_header_columns_are_positions(
    tmp_path: Path, name: str, write: Callable[[Any], None]
) -> None:
    path = tmp_path / name
    with path.open("wb") as file:  # np.save adds an extension to names without one
        write(file)
    np.testing.assert_array_equal(read(path, sampling_time=STEP).y, Y)
    for position in (1, "1"):
        part = read(path, columns=[position], inputs=[0], sampling_time=STEP)
        np.testing.assert_array_equal(part.y, Y[:, 1:])
        np.testing.assert_array_equal(part.u, Y[:, :1])
    assert "the columns are '0', '1'" in message(path, columns=[2], sampling_time=STEP)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("row.txt", "# one line\n" + ",".join(map(str, range(300))) + "\n"),
        ("row.csv", ",".join(map(str, range(300))) + ",\n"),
        ("column.txt", "# one\n\n" + "\n".join(f"{i}  # note" for i in range(300))),
    ],
)
def test_a_single_row_or_column_is_one_channel(
    tmp_path: Path, name: str, text: str | bytes
) -> None:
    trajectory = read(text_file(tmp_path, text, name), sampling_time=STEP)
    np.testing.assert_array_equal(trajectory.y, np.arange(300.0)[:, None])
    assert trajectory.columns == ("y",)


@pytest.mark.parametrize("suffix", ["npz", "mat"])
def test_matrices_and_scalars_of_a_variable_file(tmp_path: Path, suffix: str) -> None:
    variables: dict[str, Any] = {"y": Y, "force": U[None, :], "gains": np.arange(3.0), "Ts": STEP}
    path = saved(tmp_path / f"record.{suffix}", **variables)
    with pytest.warns(ReadingWarning, match=r"left out: 'gains' \(3 rows instead of 40\)$"):
        trajectory = read(path, inputs=["force"])
    assert trajectory.columns == ("y[0]", "y[1]")
    assert trajectory.sampling_time == STEP
    np.testing.assert_array_equal(trajectory.u, U[:, None])
    np.testing.assert_array_equal(read(path, columns=["y"]).y, Y)
    np.testing.assert_array_equal(read(path, columns="y[1]").y, Y[:, 1:])
    assert read(path, columns="y", sampling_time=2.0).sampling_time == 2.0
    np.testing.assert_array_equal(read(path, columns="gains").y[:, 0], [0, 1, 2])
    words = "'force' has 40 rows, 'gains' has 3"
    assert words in message(path, columns=["gains"], inputs=["force"])


@pytest.mark.parametrize(
    ("header", "name", "reason"),
    [
        ("timestamp,y,time", "timestamp", "another time column"),
        ("elapsed time (s),y,t", "elapsed time (s)", "another time column"),
        (",y,time", "Unnamed: 0", "no name"),
        ("status,y,time", "status", "no numbers: 'good'"),
    ],
)
def test_columns_that_are_left_out_are_named(
    tmp_path: Path, header: str, name: str, reason: str
) -> None:
    """An empty column, as of a separator at the end of each line, is not worth a word."""
    text = f"{header},\n5,1.5,0,\n5.5,2.5,0.5,\n6.5,2.5,1,\n"
    if name == "status":
        text = text.replace("\n5,", "\ngood,").replace("\n5.5,", "\nbad,").replace("\n6.5", "\n")
    path = text_file(tmp_path, text)
    with pytest.warns(ReadingWarning) as caught:
        assert read(path, time_column=header.rpartition(",")[2]).columns == ("y",)
    assert [str(w.message) for w in caught] == [f"{path}: left out: {name!r} ({reason})"]


@pytest.mark.parametrize("source", ["record.csv", "frame", "record.npz"])
def test_blanks_around_a_name_do_not_matter(tmp_path: Path, source: str) -> None:
    path, columns = tmp_path / source, {"u ": [1.0, 2, 3], " y": [4.0, 5, 6]}
    frame = pd.DataFrame(columns)
    if source == "record.csv":
        frame.to_csv(path, index=False)
    else:
        np.savez(tmp_path / "record.npz", **columns)  # type: ignore[arg-type]
    for name in ("u", "u "):
        found = read(frame if source == "frame" else path, inputs=name, sampling_time=1)
        assert (found.columns, found.inputs) == (("y",), ("u",))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs a named pipe")
def test_a_pipe_is_read_from_its_first_character_on(tmp_path: Path) -> None:
    pipe = tmp_path / "record"
    os.mkfifo(pipe)
    writer = threading.Thread(target=pipe.write_text, args=("time,y\n0,1\n0.5,2\n",))
    writer.start()
    found = read(pipe)
    writer.join()
    assert (found.columns, found.sampling_time) == (("y",), 0.5)


def test_a_column_that_tells_the_time_can_be_asked_for(tmp_path: Path) -> None:
    path = text_file(tmp_path, "time,run time,y\n0,1,1.5\n1,2,2.5\n2,4,2.5\n")
    assert read(path, columns=["run time", "y"]).columns == ("run time", "y")


@pytest.mark.parametrize("suffix", ["npy", "npz", "txt", "mat"])
def test_samples_in_columns_are_refused(tmp_path: Path, suffix: str) -> None:
    across = np.random.default_rng(1).standard_normal((2, 800))
    path = saved(tmp_path / f"record.{suffix}", y=across)
    said = message(path, sampling_time=1)
    assert "more samples than channels: it has 2 rows of 800 columns" in said
    assert said.endswith("transpose it")


@pytest.mark.parametrize(
    ("text", "columns", "name"),
    [
        ("motor #1,2 mass,0\n1,2,3\n4,5,6\n", ("motor #1", "2 mass", "0"), "record.csv"),
        (b"\xb0C,y\n1,2\n3,4\n", ("°C", "y"), "record.csv"),
        ("\ufeffx,y\n1,2\n3,4\n", ("x", "y"), "record.csv"),
        ('y, "x, mm"\n1, 2\n3, 4\n', ("y", "x, mm"), "record.csv"),
    ],
)
def test_awkward_headers(
    tmp_path: Path, text: str | bytes, columns: tuple[str, ...], name: str
) -> None:
    assert read(text_file(tmp_path, text, name), sampling_time=1).columns == columns


def test_warnings_of_the_readers_do_not_escape(tmp_path: Path) -> None:
    path = tmp_path / "record.mat"
    scipy.io.savemat(path, {"y": Y})
    content = path.read_bytes()
    path.write_bytes(content + content[128:])  # a second variable of the same name
    with pytest.warns(scipy.io.matlab.MatReadWarning):
        scipy.io.loadmat(path)
    np.testing.assert_array_equal(read(path, sampling_time=1).y, Y)


@settings(suppress_health_check=[HealthCheck.too_slow])
@given(
    values=hnp.arrays(
        np.float64,
        hnp.array_shapes(min_dims=2, max_dims=2, min_side=2, max_side=9),
        elements=st.floats(-1e100, 1e100).filter(lambda x: x == 0 or abs(x) > 1e-100),
    ),
    separator=st.sampled_from([",", ";", "\t"]),
    header=st.booleans(),
)
def test_text_round_trip_is_exact(
    tmp_path_factory: pytest.TempPathFactory, values: Array, separator: str, header: bool
) -> None:
    if not header and values.shape[1] > len(values):
        values = values.T
    path = tmp_path_factory.mktemp("property") / "record.csv"
    names = [f"c{i}" for i in range(values.shape[1])]
    pd.DataFrame(values, columns=names).to_csv(path, sep=separator, header=header, index=False)
    trajectory = read(path, sampling_time=1)
    np.testing.assert_array_equal(trajectory.y, values)
    if header:
        assert trajectory.columns == tuple(names)


@pytest.mark.parametrize("unit", ["[N m]", "(m3 / h)", "[N]"])
def test_a_column_is_found_without_its_unit(unit: str, tmp_path: Path) -> None:
    path = tmp_path / "rig.csv"
    rows = "".join(f"{n},{n % 3},{n}\n" for n in range(9))
    path.write_text(f"time,force {unit},level [mm]\n{rows}")
    record = read(path, inputs=["force"], columns=["level"])
    assert (record.inputs, record.columns) == ((f"force {unit}",), ("level [mm]",))

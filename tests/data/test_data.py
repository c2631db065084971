import hashlib
import http.server
import logging
import os
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import FrozenInstanceError
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pooch
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from splitband.data import (
    PUBLIC,
    PublicFile,
    Trajectory,
    double_torsion,
    drill_string,
    fetch,
    public,
    read,
)
from splitband.data.gaps import FloatArray
from splitband.data.reading import ColumnError

STEP = 0.25
RNG = np.random.default_rng(7)
Y = RNG.standard_normal((40, 2))
U = RNG.standard_normal(40)
TIME = STEP * np.arange(40)
NAMES = ["time", "torque", "angle", "force"]
FRAME = pd.DataFrame(np.column_stack([TIME, Y, U]), columns=NAMES)


def text_file(folder: Path, text: str | bytes, name: str = "record.csv") -> Path:
    path = folder / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def stamped(folder: Path, stamps: Sequence[object], name: str = "t") -> Path:
    """A CSV with the given stamps, as they are to be printed, and a channel y."""
    rows = "".join(f"{stamp},{row}\n" for row, stamp in enumerate(stamps))
    return text_file(folder, f"{name},y\n{rows}")


def message(path: Path, **options: Any) -> str:
    """The message of the ValueError that reading raises: one line that begins with the path."""
    with pytest.raises(ValueError, match=r"^[^\n]+$") as caught:
        read(path, **options)
    assert str(caught.value).startswith(f"{path}: ")
    assert type(caught.value) in (ValueError, ColumnError)
    return str(caught.value)


# ---------------------------------------------------------------- Trajectory


def test_signals_become_read_only_matrices() -> None:
    y: Any = np.arange(5, dtype=np.float32)
    trajectory = Trajectory(y, 0.5, u=np.ones((5, 3)), y_sim=y + 1, name="demo")
    assert trajectory.y.shape == (5, 1)
    assert trajectory.y.dtype == np.float64
    assert trajectory.y.flags.c_contiguous
    assert (trajectory.ny, trajectory.nu, len(trajectory)) == (1, 3, 5)
    assert trajectory.sampling_rate == 2.0
    np.testing.assert_array_equal(trajectory.time, [0.0, 0.5, 1.0, 1.5, 2.0])
    assert trajectory.columns == ("y",)
    assert trajectory.u is not None
    assert trajectory.y_sim is not None
    for signal in (trajectory.y, trajectory.u, trajectory.y_sim):
        with pytest.raises(ValueError, match="read-only"):
            signal[0] = 9.0
    y[0] = 9.0
    assert trajectory.y[0, 0] == 0.0, "the caller's array must have been copied"
    with pytest.raises(FrozenInstanceError):
        trajectory.name = "other"  # type: ignore[misc]


def test_channels_are_named_and_fortran_order_is_undone() -> None:
    trajectory = Trajectory(np.asfortranarray(Y), STEP)
    assert trajectory.y.flags.c_contiguous
    assert trajectory.columns == ("y0", "y1")
    assert Trajectory(Y, STEP, columns=("a", "b")).columns == ("a", "b")
    assert trajectory.nu == 0


def test_slices_cut_every_signal() -> None:
    whole = Trajectory(Y, STEP, u=U, y_true=Y + 1, y_sim=Y + 2, name="n", columns=("a", "b"))
    part = whole[10:-5]
    np.testing.assert_array_equal(part.y, Y[10:-5])
    np.testing.assert_array_equal(part.u, U[10:-5, None])
    np.testing.assert_array_equal(part.y_true, Y[10:-5] + 1)
    np.testing.assert_array_equal(part.y_sim, Y[10:-5] + 2)
    assert (part.name, part.columns, part.sampling_time) == ("n", ("a", "b"), STEP)
    assert len(whole[:7]) == 7
    assert part.time[0] == 0.0


@pytest.mark.parametrize("later", [0, 6])
@pytest.mark.parametrize("key", [slice(None, 12), slice(5, 30), slice(-9, -4), slice(3, None)])
def test_a_slice_hands_what_the_simulator_says_after_it_to_beyond(key: slice, later: int) -> None:
    simulated = RNG.standard_normal((40 + later, 2))
    whole = Trajectory(Y, STEP, y_sim=simulated[:40], beyond=simulated[40:] if later else None)
    part = whole[key]
    assert part.y_sim is not None
    np.testing.assert_array_equal(part.y_sim, simulated[:40][key])
    following = simulated[range(40)[key][-1] + 1 :]
    if len(following):
        assert part.beyond is not None
        np.testing.assert_array_equal(part.beyond, following)
    else:
        assert part.beyond is None
    again = whole[:30][5:20]
    assert again.beyond is not None
    np.testing.assert_array_equal(again.beyond, simulated[20:])


def test_without_a_simulator_a_slice_has_nothing_beyond() -> None:
    assert Trajectory(Y, STEP)[:10].beyond is None


def test_what_lies_beyond_is_a_signal_like_the_others() -> None:
    y: Any = np.arange(5, dtype=np.float32)
    record = Trajectory(y, STEP, y_sim=y, beyond=y[:2])
    assert record.beyond is not None
    assert record.beyond.shape == (2, 1)
    assert record.beyond.dtype == np.float64
    with pytest.raises(ValueError, match="read-only"):
        record.beyond[0] = 1.0


@pytest.mark.parametrize(
    ("key", "error", "words"),
    [
        (slice(0, 10, 2), ValueError, "step 1"),
        (slice(None, None, -1), ValueError, "step -1"),
        (slice(3, 4), ValueError, "at least 2 samples"),
        (3, TypeError, "slices only"),
    ],
)
def test_other_indices_are_refused(key: Any, error: type[Exception], words: str) -> None:
    with pytest.raises(error, match=words):
        Trajectory(Y, STEP)[key]


def with_bad(*cells: tuple[int, int], value: float = np.nan) -> FloatArray:
    y = Y.copy()
    for cell in cells:
        y[cell] = value
    return y


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"y": with_bad((17, 1), (20, 0), (21, 0)), "columns": ("angle", "torque")},
            "y must be finite: 3 bad values, the first (nan) at row 17, column 'torque'",
        ),
        ({"y": with_bad((3, 0), value=-np.inf)}, "1 bad value, the first (-inf) at row 3"),
        ({"u": with_bad((5, 1))}, "u must be finite: 1 bad value, the first (nan) at row 5"),
        ({"u": with_bad((5, 1))}, "column 'u1'"),
        ({"y_sim": with_bad((5, 1))}, "y_sim must be finite"),
        ({"y_true": with_bad((5, 1))}, "y_true must be finite"),
        ({"u": np.ones(39)}, "u must have as many samples as y, (40, 2): its shape is (39, 1)"),
        ({"y_sim": np.ones(40)}, "y_sim must have the shape of y, (40, 2): its shape is (40, 1)"),
        ({"y_true": np.ones((41, 2))}, "y_true must have the shape of y"),
        (
            {"beyond": np.ones((3, 2))},
            "beyond must go on from y_sim, (any time, 2): its shape is (3, 2)",
        ),
        (
            {"y_sim": Y, "beyond": np.ones(3)},
            "beyond must go on from y_sim, (any time, 2): its shape is (3, 1)",
        ),
        (
            {"y_sim": Y, "beyond": with_bad((4, 1)), "columns": ("angle", "torque")},
            "beyond must be finite: 1 bad value, the first (nan) at row 4, column 'torque'",
        ),
        ({"y_sim": Y, "beyond": "later"}, "beyond must be an array of numbers"),
        ({"y": [1.0]}, "y must have at least 2 samples: it has 1"),
        ({"y": np.ones((4, 2, 2))}, "its shape is (4, 2, 2)"),
        ({"y": 3.0}, "its shape is ()"),
        ({"y": np.ones((4, 0))}, "its shape is (4, 0)"),
        ({"y": np.ones(4) * 1j}, "y must be real"),
        ({"y": ["a", "b"]}, "y must be an array of numbers"),
        ({"y": [[1.0, 2.0], [3.0]]}, "y must be an array of numbers"),
        ({"sampling_time": 0.0}, "sampling_time must be a positive number of seconds: got 0.0"),
        ({"sampling_time": -0.1}, "got -0.1"),
        ({"sampling_time": np.nan}, "got nan"),
        ({"sampling_time": np.inf}, "got inf"),
        ({"sampling_time": "fast"}, "got 'fast'"),
        ({"columns": ("one",)}, "columns must name each of the 2 channels of y: got ('one',)"),
    ],
)
def test_invalid_trajectories_are_refused_in_one_line(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=r"^[^\n]+$") as caught:
        Trajectory(**{"y": Y, "sampling_time": STEP, **changes})
    assert words in str(caught.value)


# ---------------------------------------------------------------- round trips


def write_npz(path: Path) -> None:
    columns: dict[str, Any] = {name: FRAME[name].to_numpy() for name in NAMES}
    np.savez(path, **columns)


def write_mat(path: Path) -> None:  # columns, as MATLAB has them
    scipy.io.savemat(path, {name: FRAME[[name]].to_numpy() for name in NAMES})


WRITERS: dict[str, Callable[[Path], object]] = {
    "record.csv": lambda path: FRAME.to_csv(path, index=False),
    "index.csv": FRAME.to_csv,
    "semicolon.csv": lambda path: FRAME.to_csv(path, index=False, sep=";"),
    "comma.csv": lambda path: FRAME.to_csv(path, index=False, sep=";", decimal=","),
    "utf16.csv": lambda path: FRAME.to_csv(path, index=False, encoding="utf-16"),
    "windows.csv": lambda path: FRAME.to_csv(path, index=False, lineterminator="\r\n"),
    "record.tsv": lambda path: FRAME.to_csv(path, index=False, sep="\t"),
    "record.txt": lambda path: FRAME.to_csv(path, index=False, sep=" "),
    "record.log": lambda path: FRAME.to_csv(path, index=False, sep="\t"),
    "record.parquet": FRAME.to_parquet,
    "index.pq": lambda path: FRAME.set_index("time").to_parquet(path),
    "record.npz": write_npz,
    "record.mat": write_mat,
}


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
        ("plain.dat", lambda path: np.savetxt(path, Y, fmt="%.17g", delimiter=" , ")),
        ("plain.csv", lambda path: np.savetxt(path, Y, fmt="%.17g", delimiter=",")),
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
        ("row.dat", " ".join(map(str, range(300)))),
        ("column.txt", "# one\n\n" + "\n".join(f"{i}  # note" for i in range(300))),
    ],
)
def test_a_single_row_or_column_is_one_channel(
    tmp_path: Path, name: str, text: str | bytes
) -> None:
    trajectory = read(text_file(tmp_path, text, name), sampling_time=STEP)
    np.testing.assert_array_equal(trajectory.y, np.arange(300.0)[:, None])
    assert trajectory.columns == ("y",)


def test_single_row_of_an_npy_is_one_channel(tmp_path: Path) -> None:
    np.save(tmp_path / "row.npy", Y[:, 0][None, :])
    np.testing.assert_array_equal(read(tmp_path / "row.npy", sampling_time=1).y, Y[:, :1])


@pytest.mark.parametrize("save", [np.savez, scipy.io.savemat], ids=["npz", "mat"])
def test_matrices_and_scalars_of_a_variable_file(tmp_path: Path, save: Any) -> None:
    path = tmp_path / ("record.npz" if save is np.savez else "record.mat")
    variables: dict[str, Any] = {"y": Y, "force": U[None, :], "gains": np.arange(3.0), "Ts": STEP}
    if save is np.savez:
        np.savez(path, **variables)
    else:
        scipy.io.savemat(path, variables)

    trajectory = read(path, inputs=["force"])
    assert trajectory.columns == ("y[0]", "y[1]")
    assert trajectory.sampling_time == STEP
    np.testing.assert_array_equal(trajectory.u, U[:, None])
    np.testing.assert_array_equal(read(path, columns=["y"]).y, Y)
    np.testing.assert_array_equal(read(path, columns="y[1]").y, Y[:, 1:])
    assert read(path, sampling_time=2.0).sampling_time == 2.0
    np.testing.assert_array_equal(read(path, columns="gains").y[:, 0], [0, 1, 2])
    words = "'force' has 40 rows, 'gains' has 3"
    assert words in message(path, columns=["gains"], inputs=["force"])


def test_columns_that_hold_no_number_or_name_are_left_out(tmp_path: Path) -> None:
    text = ",y,status,\n0,1.5,good,\n1,2.5,bad,\n"
    trajectory = read(text_file(tmp_path, text), sampling_time=1)
    assert trajectory.columns == ("y",)
    np.testing.assert_array_equal(trajectory.y[:, 0], [1.5, 2.5])


@pytest.mark.parametrize(
    ("text", "columns"),
    [
        ("motor #1,2 mass,0\n1,2,3\n4,5,6\n", ("motor #1", "2 mass", "0")),
        (b"\xb0C,y\n1,2\n3,4\n", ("°C", "y")),
        ("\ufeffx,y\n1,2\n3,4\n", ("x", "y")),
        ('y, "x, mm"\n1, 2\n3, 4\n', ("y", "x, mm")),
        ("motor torque\n1\n2\n", ("motor torque",)),
    ],
)
def test_awkward_headers(tmp_path: Path, text: str | bytes, columns: tuple[str, ...]) -> None:
    assert read(text_file(tmp_path, text), sampling_time=1).columns == columns


def test_a_single_column_of_a_tsv_may_have_a_space_in_its_name(tmp_path: Path) -> None:
    path = text_file(tmp_path, "torque, N m\n1\n2\n", "record.tsv")
    assert read(path, sampling_time=1).columns == ("torque, N m",)


def test_a_byte_order_mark_is_no_part_of_the_first_number(tmp_path: Path) -> None:
    trajectory = read(text_file(tmp_path, "\ufeff1,2\n3,4\n"), sampling_time=1)
    np.testing.assert_array_equal(trajectory.y, [[1, 2], [3, 4]])


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
    tmp_path_factory: pytest.TempPathFactory, values: FloatArray, separator: str, header: bool
) -> None:
    path = tmp_path_factory.mktemp("property") / "record.csv"
    names = [f"c{i}" for i in range(values.shape[1])]
    pd.DataFrame(values, columns=names).to_csv(path, sep=separator, header=header, index=False)
    trajectory = read(path, sampling_time=1)
    np.testing.assert_array_equal(trajectory.y, values)
    if header:
        assert trajectory.columns == tuple(names)


# ---------------------------------------------------------------- time


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("t", 1),
        ("TIME", 1),
        ("time_s", 1),
        ("time [s]", 1),
        ("t (s)", 1),
        ("Time [ms]", 1e-3),
        ("timestamp_us", 1e-6),
        ("time/min", 60),
    ],
)
def test_time_columns_are_found_by_name_and_unit(tmp_path: Path, name: str, unit: float) -> None:
    trajectory = read(stamped(tmp_path, [10, 12, 14, 16], name))
    assert trajectory.sampling_time == pytest.approx(2 * unit, rel=1e-12)
    assert trajectory.columns == ("y",)


def test_time_column_by_position(tmp_path: Path) -> None:
    path = text_file(tmp_path, "1 0.0\n2 0.5\n5 1.0\n", "record.txt")
    trajectory = read(path, time_column=1)
    assert trajectory.sampling_time == 0.5
    np.testing.assert_array_equal(trajectory.y, [[1], [2], [5]])


@pytest.mark.parametrize("name", ["T", "ts", "torque_s", "times"])
def test_a_channel_is_not_taken_for_the_time(tmp_path: Path, name: str) -> None:
    options: dict[str, Any] = (
        {"columns": ["T"]} if name == "T" else {}
    )  # asked for, it is a temperature
    path = text_file(tmp_path, f"{name}\n3\n1\n2\n")
    assert read(path, sampling_time=1, **options).columns == (name,)


def iso(seconds: Sequence[float]) -> list[str]:
    return [(datetime(2024, 2, 29, 23, 59, 59) + timedelta(seconds=s)).isoformat() for s in seconds]


@pytest.mark.parametrize(
    ("stamps", "step"),
    [
        (iso([0.0, 0.25, 0.5, 0.75, 1.0]), 0.25),  # isoformat drops the zero fractions
        ([f"{stamp}+02:00" for stamp in iso([0, 1, 2, 3])], 1.0),
        (["29.02.2024 10:00:00", "29.02.2024 10:00:02", "29.02.2024 10:00:04"], 2.0),
        (["00:00:01.5", "00:00:02.0", "00:00:02.5"], 0.5),
    ],
)
def test_dates(tmp_path: Path, stamps: Sequence[object], step: float) -> None:
    trajectory = read(stamped(tmp_path, stamps, "date"))
    assert trajectory.sampling_time == pytest.approx(step, rel=1e-12)
    assert trajectory.columns == ("y",)


def test_dates_without_a_header(tmp_path: Path) -> None:
    path = text_file(tmp_path, "2024-01-01 00:00:00,1\n2024-01-01 00:00:01,2\n")
    trajectory = read(path, time_column=0)
    assert trajectory.sampling_time == 1.0
    assert len(trajectory) == 2, "the first row must not pass for a header"


@pytest.mark.parametrize(
    "index",
    [pd.date_range("2024", periods=40, freq="10ms"), pd.to_timedelta(0.01 * np.arange(40), "s")],
    ids=["dates", "durations"],
)
def test_time_in_the_index_of_a_parquet_file(tmp_path: Path, index: pd.Index) -> None:
    pd.DataFrame({"y": U}, index=index).to_parquet(tmp_path / "record.parquet")
    trajectory = read(tmp_path / "record.parquet")
    assert trajectory.sampling_time == pytest.approx(0.01, rel=1e-12)
    assert trajectory.columns == ("y",)


@pytest.mark.parametrize(
    ("step", "places", "start"),
    [
        (1 / 30, 2, 0),
        (1 / 60, 2, 0),
        (1 / 3, 1, 5),
        (1 / 64, 2, 0),
        (1 / 30, 3, 1_074_000_002),
        (0.01, 2, 0),
    ],
)
@pytest.mark.parametrize("rows", [40, 1000])
def test_rounded_stamps_are_even_but_a_gap_is_not(
    tmp_path: Path, step: float, places: int, start: float, rows: int
) -> None:
    stamps = [f"{start + step * row:.{places}f}" for row in range(rows)]
    found = read(stamped(tmp_path, stamps)).sampling_time
    assert found == pytest.approx(step, rel=1 / rows**1.5)
    assert "must be even" in message(stamped(tmp_path, stamps[:25] + stamps[26:]))


def test_the_rounding_of_the_last_stamp_does_not_set_the_step(tmp_path: Path) -> None:
    stamps = [f"{row / 30:.2f}" for row in range(50)]  # the ends alone say 0.03327 s
    found = read(stamped(tmp_path, stamps)).sampling_time
    assert found == pytest.approx(1 / 30, rel=2e-4)


def test_a_gap_is_named_among_rounded_stamps(tmp_path: Path) -> None:
    stamps = [f"{row / 30:.2f}" for row in range(1000) if row != 500]
    words = "expected a step of 0.03 s at row 500, found 0.07 s"
    assert words in message(stamped(tmp_path, stamps))


def test_rounding_to_float32_is_allowed_for(tmp_path: Path) -> None:
    stamps = (0.001 * np.arange(20000)).astype(np.float32)
    assert np.ptp(np.diff(stamps)) > 1e-3 * 0.001, "steps must differ for this to test anything"
    np.savez(tmp_path / "record.npz", t=stamps + np.float32(500), y=np.arange(20000.0))
    assert read(tmp_path / "record.npz").sampling_time == pytest.approx(0.001, rel=1e-4)


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        ([0, 1, 2, 4, 5, 6], "must be even: expected a step of 1 s at row 3, found 2 s"),
        ([0.0, 0.1, 0.2, 0.32, 0.42], "at row 3, found 0.12 s"),
        ([0, 1, 2, 2, 3], "must increase: row 3 (2 s) follows 2 s"),
        ([0, 1, 2, 1, 3], "must increase: row 3 (1 s) follows 2 s"),
        ([f"{0.0025 * i:.3f}" for i in range(9)] + ["0.032", "0.042"], "must be even"),
        ([0, 1, "soon", 3], "must be numeric: row 2 holds 'soon'"),
        ([0, 1, "", 3], "must be finite: 1 bad value, the first (nan) at row 2"),
        ([*iso([0, 1]), "later"], "must hold numbers or dates: row 2 holds 'later'"),
        ([1700000000000, 1700000000010], "must be in seconds, or name its unit"),
    ],
)
def test_bad_stamps(tmp_path: Path, stamps: Sequence[object], words: str) -> None:
    text = message(stamped(tmp_path, stamps))
    assert words in text
    assert "time column 't'" in text


def test_a_drift_within_the_rounding_of_each_step_is_found(tmp_path: Path) -> None:
    steps = np.repeat([0.010, 0.011], 60)  # each pair differs by one printed unit only
    stamps = [f"{stamp:.3f}" for stamp in np.cumsum(steps)]
    assert "must be even" in message(stamped(tmp_path, stamps))


def test_sampling_time_beside_stamps(tmp_path: Path) -> None:
    path = stamped(tmp_path, [0, 0.5, 1.0])
    assert read(path, sampling_time=0.5004).sampling_time == 0.5004
    words = "sampling_time (--sampling-time) is 0.4 s, but time column 't' steps by 0.5 s"
    assert words in message(path, sampling_time=0.4)
    assert words in message(path, sampling_time=0.4, time_column="t")
    ignored = read(path, sampling_time=0.4, time_column="")
    assert ignored.sampling_time == 0.4
    assert ignored.columns == ("y",)


def test_without_any_time(tmp_path: Path) -> None:
    text = message(text_file(tmp_path, "y\n1\n2\n"))
    assert "sampling_time (--sampling-time)" in text
    assert "time_column (--time-column)" in text


# ---------------------------------------------------------------- errors


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("", {}, "the file is empty"),
        ("\n\n# only a comment\n", {}, "it holds no data"),
        ("a,b\n", {}, "at least 2 rows: it has 0"),
        ("a,b\n1,2\n", {}, "at least 2 rows: it has 1"),
        ("a,b\n1,2\n3,4\n", {"columns": ["c"]}, "column 'c' is unknown: the columns are 'a', 'b'"),
        ("a,b\n1,2\n3,4\n", {"inputs": ["c"]}, "column 'c' is unknown"),
        ("a,b\n1,2\n3,4\n", {"time_column": "c"}, "column 'c' is unknown"),
        ("a,b\n1,2\n3,4\n", {"columns": ["a"], "inputs": ["a"]}, "'a' is asked for twice"),
        ("a,b\n1,2\n3,4\n", {"columns": []}, "no numeric column to model"),
        ("a,b\nx,y\nz,w\n", {}, "no numeric column to model: the columns are 'a', 'b'"),
        ("a,b\n1,2\n3,4.x\n5,6\n", {}, "column 'b' must be numeric: row 1 holds '4.x'"),
        ("a,b\nu,2\nv,4\n", {"columns": ["a"]}, "column 'a' must be numeric: row 0 holds 'u'"),
        ("a,b\n1,2\n3,\n5,nan\n", {}, "column 'b' must be finite: 2 bad values, the first (nan)"),
        ("a,b\n1,2\n3,\n5,nan\n", {}, "at row 1"),
        ("a,b\n1,2\n3,-inf\n", {"columns": "a", "inputs": "b"}, "column 'b' must be finite"),
        ("a,b\n1,2+1j\n3,1j\n", {"columns": "b"}, "row 0 holds '2+1j'"),
        ("a,b\n1,2\n3\n", {}, "column 'b' must be finite"),
        ("# note\na,b\n1,2\n\n3,4,5\n", {}, "Expected 2 fields in line 5, saw 3"),
        ("a,b\n1,2,3\n4,5,6\n", {}, "cannot be read as text"),
        ('a,b\n"1,2\n3,4\n', {}, "cannot be read as text"),
        ("y\n1\n2\n", {"sampling_time": -1}, "sampling_time must be a positive number"),
        (b"\x00\x01\x02\x03", {}, "it is a binary file"),
        ("1,,3\n", {}, "must be finite: 1 bad value, the first (nan) at row 1"),
    ],
)
def test_errors_in_text(
    tmp_path: Path, text: str | bytes, options: dict[str, Any], words: str
) -> None:
    assert words in message(text_file(tmp_path, text), **{"sampling_time": 1, **options})


def test_at_most_ten_columns_are_listed(tmp_path: Path) -> None:
    path = text_file(tmp_path, ",".join(f"c{i}" for i in range(50)) + "\n" + "1," * 49 + "1\n")
    text = message(path, columns="z")
    assert "'c9', ..." in text
    assert "c10" not in text


def test_files_that_cannot_be_opened(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match="absent\\.csv"):
        read(tmp_path / "absent.csv")
    with pytest.raises(IsADirectoryError, match=tmp_path.name):
        read(tmp_path)


def test_files_that_may_not_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(path: Path, *args: Any) -> None:  # a file mode would not stop root
        raise PermissionError(13, "Permission denied", str(path))

    path = text_file(tmp_path, "1\n2\n")
    monkeypatch.setattr(Path, "open", refuse)
    with pytest.raises(PermissionError, match=path.name):
        read(path)


@pytest.mark.parametrize("name", ["r.csv", "r.parquet", "r.npz", "r.npy", "r.mat"])
def test_what_would_not_fit_into_memory_is_refused_before_it_is_read(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    values, path = np.zeros((1000, 2)), tmp_path / name
    match path.suffix:
        case ".csv":
            np.savetxt(path, values, delimiter=",")
        case ".parquet":
            pd.DataFrame(values, columns=["a", "b"]).to_parquet(path)
        case ".npz":
            np.savez_compressed(path, y=values)
        case ".npy":
            np.save(path, values)
        case _:
            scipy.io.savemat(path, {"y": values}, do_compression=True)
    assert len(read(path, sampling_time=1)) == 1000
    monkeypatch.setattr("splitband.data.reading.MOST_BYTES", 15_000)
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
    b"garbage" * 40,
    b"PK\x03\x04" + b"x" * 90,
    b"\0" * 300,
    b"\xff" * 50,
    b"PAR1aaaaaaaaPAR1",
]


@pytest.mark.parametrize("suffix", ["parquet", "pq", "npz", "npy", "mat"])
@pytest.mark.parametrize("content", GARBAGE, ids=range(len(GARBAGE)))
def test_files_that_are_something_else(tmp_path: Path, suffix: str, content: bytes) -> None:
    path = text_file(tmp_path, content, f"record.{suffix}")
    kind = {"parquet": "Parquet", "pq": "Parquet"}.get(suffix, suffix.upper())
    assert f"cannot be read as {kind}: " in message(path, sampling_time=1)


@pytest.mark.parametrize("name", ["record.parquet", "record.npz", "record.mat", "plain.npy"])
@pytest.mark.parametrize("kept", [0.1, 0.5, 0.95])
def test_truncated_files(tmp_path: Path, name: str, kept: float) -> None:
    path = tmp_path / name
    if name == "plain.npy":
        np.save(path, Y)
    else:
        WRITERS[name](path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(kept * len(whole))])
    assert "cannot be read as" in message(path, sampling_time=1)


def test_a_damaged_member_of_an_npz(tmp_path: Path) -> None:
    path = tmp_path / "record.npz"
    write_npz(path)
    content = bytearray(path.read_bytes())
    content[250] ^= 0xFF
    path.write_bytes(content)
    assert "CRC" in message(path)


def test_objects_are_not_unpickled(tmp_path: Path) -> None:
    np.savez(tmp_path / "record.npz", y=np.array([{}, 1], dtype=object))
    assert "allow_pickle=False" in message(tmp_path / "record.npz", sampling_time=1)
    np.save(tmp_path / "record.npy", np.array([{}, 1], dtype=object))
    assert "Python objects" in message(tmp_path / "record.npy", sampling_time=1)


def test_hdf5_mat_files_say_what_to_do(tmp_path: Path) -> None:
    header = b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM"
    path = text_file(tmp_path, header + b"\0" * 512, "record.mat")
    text = message(path)
    assert "v7.3" in text
    assert "-v7" in text.replace("v7.3", "")


def test_complex_values(tmp_path: Path) -> None:
    np.savez(tmp_path / "record.npz", y=U * 1j, dt=1.0)
    assert "column 'y' must be real" in message(tmp_path / "record.npz")
    scipy.io.savemat(tmp_path / "record.mat", {"y": U * 1j, "dt": 1.0})
    assert "column 'y' must be real" in message(tmp_path / "record.mat")


def test_missing_and_nested_cells_of_a_parquet_file(tmp_path: Path) -> None:
    path = tmp_path / "record.parquet"
    counts = pd.array([1, None, 3], dtype="Int64")
    pd.DataFrame({"count": counts, "list": [[1], [2], [3]]}).to_parquet(path)
    assert "column 'count' must be finite: 1 bad value" in message(path, sampling_time=1)
    assert "column 'list' must be numeric" in message(path, columns="list", sampling_time=1)


# ---------------------------------------------------------------- public records


@pytest.fixture
def public_data() -> Path:
    """The folder of the public records."""
    folder = os.environ.get("SPLITBAND_DATA_DIR")
    if not folder:
        pytest.skip("SPLITBAND_DATA_DIR is not set: the public records are not at hand")
    return Path(folder)


CONTENT = b"1\n2\n3\n"
TINY = PublicFile(
    "tiny", "sub/tiny.txt", hashlib.sha256(CONTENT).hexdigest(), len(CONTENT), "", "", ""
)


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(PUBLIC, "tiny", TINY)
    monkeypatch.delenv("SPLITBAND_DATA_DIR", raising=False)


def test_public_files_are_the_published_ones(public_data: Path) -> None:
    assert len(PUBLIC) == 4
    for name, record in PUBLIC.items():
        path = fetch(name)
        assert path == public_data / record.path
        assert path.stat().st_size == record.size
        assert record.name == name
        assert record.licence
        assert record.citation


def test_every_public_file_can_be_read(public_data: Path) -> None:
    lengths = {name: len(read(fetch(name), sampling_time=0.01)) for name in PUBLIC}
    assert lengths == {
        "drill_string_data": 23814,
        "drill_string_sim": 6001,
        "double_torsion_phi2": 9998,
        "double_torsion_num_phi2": 400,
    }


@pytest.mark.usefixtures("public_data")
def test_drill_string_simulator_error_is_that_of_the_paper() -> None:
    trajectory = drill_string()
    assert trajectory.y_sim is not None
    assert len(trajectory) == 4001
    assert trajectory.sampling_rate == 100.0
    assert trajectory.y.mean() == pytest.approx(0, abs=1e-12)
    assert trajectory.y.std() == pytest.approx(1)
    error = np.sqrt(np.mean((trajectory.y_sim - trajectory.y) ** 2))
    assert error == pytest.approx(0.7292, abs=5e-5)


@pytest.mark.usefixtures("public_data")
def test_double_torsion_repeats_every_160_samples() -> None:
    trajectory = double_torsion()
    y = trajectory.y[:, 0]
    assert (trajectory.name, trajectory.columns) == ("double-torsion", ("phi2",))
    assert y.std() == pytest.approx(1)
    tiled = np.resize(y[440:600], 1400)
    assert np.sqrt(np.mean((tiled - y[600:]) ** 2)) == pytest.approx(0.068, abs=5e-4)


@pytest.mark.usefixtures("public_data")
@pytest.mark.parametrize("samples", [1, 9999])
def test_double_torsion_has_only_so_many_samples(samples: int) -> None:
    with pytest.raises(ValueError, match=f"samples must be from 2 to 9998: got {samples}"):
        double_torsion(samples)


def test_unknown_public_name() -> None:
    with pytest.raises(ValueError, match="'pendulum' is unknown: there are drill_string_data, "):
        fetch("pendulum")


@pytest.mark.usefixtures("tiny")
def test_a_changed_file_is_refused_and_left_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / TINY.path
    path.parent.mkdir()
    path.write_bytes(b"other")
    monkeypatch.setenv("SPLITBAND_DATA_DIR", str(tmp_path))
    with pytest.raises(ValueError, match="sha256") as caught:
        fetch("tiny")
    found = hashlib.sha256(b"other").hexdigest()
    assert all(word in str(caught.value) for word in (str(path), TINY.sha256, found))
    assert path.read_bytes() == b"other"
    path.write_bytes(CONTENT)
    assert fetch("tiny") == path


@pytest.mark.usefixtures("tiny")
def test_a_file_missing_from_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SPLITBAND_DATA_DIR", str(tmp_path))
    with pytest.raises(FileNotFoundError) as caught:
        fetch("tiny")
    assert str(tmp_path / TINY.path) in str(caught.value)
    assert f"SPLITBAND_DATA_DIR={tmp_path}" in str(caught.value)
    with pytest.raises(FileNotFoundError, match="data_dir is "):
        fetch("tiny", data_dir=tmp_path / "elsewhere")


class Server(http.server.ThreadingHTTPServer):
    """A loopback stand-in for the repository; it keeps the paths that it was asked for."""

    content = CONTENT

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.requested: list[str] = []


class Handler(http.server.BaseHTTPRequestHandler):
    server: Server

    def do_GET(self) -> None:
        self.server.requested.append(self.path)
        self.send_response(200)
        self.send_header("Content-Length", str(len(self.server.content)))
        self.end_headers()
        self.wfile.write(self.server.content)

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def server(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, tiny: None) -> Iterator[Server]:
    server = Server()
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
    thread.start()
    monkeypatch.setattr(public, "_SOURCE", f"http://127.0.0.1:{server.server_port}/data")
    monkeypatch.setattr(pooch, "os_cache", lambda name: tmp_path / "cache" / name)
    monkeypatch.setenv("NO_PROXY", "127.0.0.1")
    monkeypatch.setenv("no_proxy", "127.0.0.1")
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def files_below(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_download_once_in_silence(
    server: Server, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    records: list[logging.LogRecord] = []

    def keep(record: logging.LogRecord) -> bool:
        records.append(record)
        return False

    logger = pooch.get_logger()
    level = logger.level
    logger.addFilter(keep)
    path = fetch("tiny")
    assert path == tmp_path / "cache" / "splitband" / TINY.path
    assert path.read_bytes() == CONTENT
    assert fetch("tiny") == path
    assert server.requested == ["/data/sub/tiny.txt"], "the second time it is in the cache"
    logger.removeFilter(keep)
    assert records == []
    assert logger.level == level, "other users of pooch keep their messages"
    assert capfd.readouterr() == ("", "")
    np.testing.assert_array_equal(read(path, sampling_time=1).y, [[1], [2], [3]])


@pytest.mark.usefixtures("tiny")
def test_a_download_of_other_content_leaves_nothing(server: Server, tmp_path: Path) -> None:
    server.content = b"1\n2\n"
    with pytest.raises(ValueError, match=r"^[^\n]*not the published file[^\n]*$") as caught:
        fetch("tiny")
    assert "SPLITBAND_DATA_DIR" in str(caught.value)
    assert files_below(tmp_path) == []


def test_no_connection(server: Server, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(public, "_SOURCE", "http://127.0.0.1:1/data")
    with pytest.raises(OSError, match=r"^[^\n]*could not be downloaded[^\n]*$") as caught:
        fetch("tiny")
    assert type(caught.value) is OSError
    assert "set SPLITBAND_DATA_DIR" in str(caught.value)
    assert "check the connection" in str(caught.value)
    assert files_below(tmp_path) == []
    assert server.requested == []


def test_the_source_is_pinned() -> None:
    assert public._SOURCE == (
        "https://raw.githubusercontent.com/boschresearch/hybrid-observer/"
        "b1d56108588de19694341727eb86ee6e2f402cbf/hybrid_observer/data"
    )

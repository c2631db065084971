"""Trajectories: their signals, their slices and what they refuse."""

from dataclasses import FrozenInstanceError, replace
from typing import Any

import numpy as np
import pandas as pd
import pytest

from splitband.records import Record
from splitband.runtime.arrays import Array
from tests.records.support import STEP, U, Y


def test_signals_become_read_only_matrices() -> None:
    assert Record(np.asfortranarray(Y), STEP).y.flags.c_contiguous
    y: Any = np.arange(5, dtype=np.float32)
    trajectory = Record(y, 0.5, u=np.ones((5, 3)), y_sim=y + 1, name="demo")
    assert trajectory.y.shape == (5, 1)
    assert trajectory.y.dtype == np.float64
    assert trajectory.y.flags.c_contiguous
    assert (trajectory.ny, trajectory.nu, len(trajectory)) == (1, 3, 5)
    assert trajectory.sampling_rate == 2.0
    np.testing.assert_array_equal(trajectory.time, [0.0, 0.5, 1.0, 1.5, 2.0])
    assert (trajectory.columns, Record(Y, STEP).columns) == (("y",), ("y0", "y1"))
    assert Record(Y, STEP).nu == 0
    for signal in (trajectory.y, trajectory.u, trajectory.y_sim):
        assert signal.dtype == np.float64
        with pytest.raises(ValueError, match="read-only"):
            signal[0] = 9.0
    y[0] = 9.0
    assert trajectory.y[0, 0] == 0.0, "the caller's array must have been copied"
    with pytest.raises(FrozenInstanceError):
        trajectory.name = "other"  # type: ignore[misc]


def test_slices_and_replacements_share_what_nobody_can_change() -> None:
    y, u = np.arange(40.0), np.ones((40, 2))
    whole = Record(y, 0.1, u=u, y_sim=y)
    part = replace(whole[5:30], name="part")
    for name in ("y", "u", "y_sim"):
        assert np.shares_memory(getattr(part, name), getattr(whole, name))
    seen = y[:, None].view()  # of what its owner can still change
    seen.setflags(write=False)
    copied = Record(seen, 0.1)
    y[:] = -1.0
    assert copied.y[3] == whole.y[3] == part.y[3] - 5 == 3.0


def test_slices_cut_every_signal() -> None:
    longer = np.concatenate([Y, Y]) + 2
    whole = Record(Y, STEP, u=U, y_true=Y + 1, y_sim=longer, name="n", columns=("a", "b"))
    part = whole[10:-5]
    np.testing.assert_array_equal(part.y, Y[10:-5])
    np.testing.assert_array_equal(part.u, U[10:-5, None])
    np.testing.assert_array_equal(part.y_true, Y[10:-5] + 1)
    np.testing.assert_array_equal(part.y_sim, Y[10:-5] + 2)
    assert (part.name, part.columns, part.sampling_time) == ("n", ("a", "b"), STEP)
    assert len(whole[:7]) == 7
    assert part.time[0] == 0.0
    np.testing.assert_array_equal(whole[3:].y_sim, longer[3 : len(Y)])


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
        Record(Y, STEP)[key]


def with_bad(*cells: tuple[int, int], value: float = np.nan) -> Array:
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
        ({"u": with_bad((5, 1))}, "bad value, the first (nan) at row 5, column 'u1'"),
        ({"y_sim": with_bad((5, 1))}, "y_sim must be finite"),
        ({"u": np.ones(39)}, "u must have the shape (40, any number): its shape is (39, 1)"),
        ({"y_sim": np.ones(40)}, "y_sim must have the shape (40 or more, 2): its shape is (40, 1)"),
        ({"y_true": np.ones((41, 2))}, "y_true must have the shape (40, 2)"),
        ({"y_sim": Y[1:]}, "y_sim must have the shape (40 or more, 2): its shape is (39, 2)"),
        ({"y": [1.0]}, "y must have at least 2 samples: it has 1"),
        ({"y": np.ones((4, 2, 2))}, "its shape is (4, 2, 2)"),
        ({"y": 3.0}, "its shape is ()"),
        ({"y": np.ones((4, 0))}, "its shape is (4, 0)"),
        ({"y": np.ones(4) * 1j}, "y must be real"),
        ({"y": [[1.0, 2.0], [3.0]]}, "y must be an array of numbers"),
        ({"sampling_time": 0.0}, "sampling_time must be a positive number of seconds: got 0.0"),
        ({"start": "soon"}, "a time stamp must be a finite number of seconds or a date: got soon"),
        ({"start": pd.NaT}, "a time stamp must be a finite number of seconds or a date: got NaT"),
        ({"sampling_time": "fast"}, "got 'fast'"),
        ({"columns": ("one",)}, "columns must name each of the 2 channels of y: got ('one',)"),
        ({"columns": ("one", "one")}, "columns must differ: got ('one', 'one')"),
    ],
)
def test_invalid_trajectories_are_refused_in_one_line(changes: dict[str, Any], words: str) -> None:
    with pytest.raises(ValueError, match=r"^[^\n]+$") as caught:
        Record(**{"y": Y, "sampling_time": STEP, **changes})
    assert words in str(caught.value)

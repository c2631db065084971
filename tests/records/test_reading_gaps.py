"""Files with missing cells and rows: what is masked, and what is refused."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

import splitband as sb
from splitband import read
from tests.records.support import iso, message, stamped, text_file
from tests.signals import NAN, holed


@pytest.mark.parametrize("cell", ["nan", "inf", "-inf", "", "NA"])
def test_cells_without_a_number_are_gaps(tmp_path: Path, cell: str) -> None:
    path = text_file(tmp_path, f"t,a,b\n0.0,1,5\n0.1,{cell},6\n0.2,3,7\n0.3,5,8\n")
    found = read(path, gaps="mask")
    np.testing.assert_array_equal(found.y_with_gaps, [[1, 5], [NAN, 6], [3, 7], [5, 8]])
    assert found.y[1, 0] == 2
    said = message(path)
    assert "column 'a' must be finite: 1 bad value" in said
    assert "row 1" in said
    assert "--gaps mask" in said


def test_inputs_that_are_missing_together_are_said_together() -> None:
    u = np.column_stack([[1.0, np.nan, 3], [1, np.nan, 3], [np.nan, 2, 3]])
    with pytest.warns(UserWarning, match="missing in 1 of 3") as said:
        sb.Record.with_gaps(np.zeros(3), 1.0, u=u, inputs=("a", "b", "c"))
    first, other = (str(each.message) for each in said)
    assert "inputs 'a', 'b' are missing in 1 of 3 samples (row 1)" in first
    assert "input 'c' is missing in 1 of 3 samples (row 0)" in other


@pytest.mark.parametrize(
    ("name", "stamps", "step"),
    [
        ("t", [f"{0.25 * row:.2f}" for row in range(12)], 0.25),
        ("t [ms]", [f"{5000 + 4 * row}" for row in range(12)], 0.004),
        ("date", iso([60 * row for row in range(12)]), 60),
        ("date", iso([86400 * row for row in range(12)]), 86400),
    ],
)
def test_rows_missing_between_stamps_are_gaps(
    tmp_path: Path, name: str, stamps: Sequence[str], step: float
) -> None:
    missing = [3, 4, 9]
    kept = [row for row in range(12) if row not in missing]
    rows = "".join(f"{stamps[row]},{row},{100 - row}\n" for row in kept)
    path = text_file(tmp_path, f"{name},y,force\n{rows}")
    with pytest.warns(UserWarning, match="'force' is missing in 3 of 12 samples .rows 3 to 4, 9."):
        found = read(path, inputs="force", gaps="mask")
    assert found.sampling_time == pytest.approx(step, rel=1e-9)
    driven = [*missing, 5, 10]  # an input acts on the sample after it, too
    np.testing.assert_array_equal(found.y_with_gaps, holed(np.arange(12.0)[:, None], *driven))
    np.testing.assert_allclose(found.y[:, 0], np.arange(12), rtol=1e-12)
    held = [0, 1, 2, 2, 2, 5, 6, 7, 8, 8, 10, 11]
    np.testing.assert_allclose(found.u[:, 0], 100 - np.array(held), rtol=1e-12)
    said = message(path)
    assert "must be even" in said
    assert "at row 3" in said
    assert "--gaps mask" in said


def test_the_refusal_names_the_stretches(tmp_path: Path) -> None:
    cells = ["" if row in (3, 5, 6) else f"{row}" for row in range(9)]
    path = text_file(tmp_path, "t,y\n" + "".join(f"{i},{c}\n" for i, c in enumerate(cells)))
    said = message(path)
    assert "3 bad values, the first (nan) at row 3; rows 3, 5 to 6;" in said
    assert "--gaps mask" in said
    cells = ["" if row % 2 else f"{row}" for row in range(20)]
    path = text_file(tmp_path, "t,y\n" + "".join(f"{i},{c}\n" for i, c in enumerate(cells)))
    assert "rows 1, 3, 5, 7, 9, 11 and 4 more stretches;" in message(path)


@pytest.mark.parametrize("last", [100, 1e12, 1e100])
def test_a_stamp_far_away_is_refused_before_room_is_made_for_it(
    tmp_path: Path, last: float
) -> None:
    stamps: list[object] = [*range(9), f"{last:g}"]
    words = "must have a stamp for one row in ten at least"
    assert words in message(stamped(tmp_path, stamps), gaps="mask")
    assert len(read(stamped(tmp_path, [*range(9), 99]), gaps="mask")) == 100


def test_what_is_no_gap_is_refused(tmp_path: Path) -> None:
    path = text_file(tmp_path, "t,y,dead,word\n0,1,inf,1\n1,2,-inf,broken\n2,,,2\n3,4,,3\n")
    words = "column 'dead' must hold finite values: it has none"
    assert words in message(path, columns=["y", "dead"], gaps="mask")
    assert words.replace("1", "0") in message(path, columns="y", inputs="dead", gaps="mask")
    assert "row 1 holds 'broken'" in message(path, columns="word", gaps="mask")
    with pytest.raises(ValueError, match="gaps must be one of refuse, mask, got 'drop'"):
        read(path, gaps="drop")


@pytest.mark.parametrize("rate", [30, 60])
@pytest.mark.parametrize("missing", [1, 10, 100])
def test_rows_may_be_missing_between_rounded_stamps(
    tmp_path: Path, rate: int, missing: int
) -> None:
    kept = [row for row in range(400) if not 50 <= row < 50 + missing]
    rows = "".join(f"{row / rate:.3f},{row}\n" for row in kept)
    found = read(text_file(tmp_path, f"t,y\n{rows}"), gaps="mask")
    assert np.flatnonzero(~found.complete).tolist() == [*range(50, 50 + missing)]
    assert found.sampling_time == pytest.approx(1 / rate, rel=1e-4)

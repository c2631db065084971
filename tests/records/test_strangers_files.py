"""Files by someone who did not write the reader: right, or refused with a remedy that works."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.io

from splitband.records import read
from splitband.records.signals import ReadingWarning
from tests.records.support import message, text_file

Y = np.sin(np.arange(40) / 3).round(3)
DAYS = pd.date_range("2024-03-01", periods=40)
HOURS = pd.date_range("2024-03-01 20:00", periods=40, freq="h")
ZULU, BEGIN = pd.Timestamp("2024-03-01 10:00Z"), 35999.6
OFF: dict[str, Any] = {"time_column": "", "sampling_time": 1}


def table(row: Callable[[int], str], head: str = "time,y\n") -> str:
    return head + "".join(f"{row(i)},{Y[i]}\n" for i in range(40))


def check(path: Path, step: float, start: Any, columns: tuple[str, ...], **options: Any) -> None:
    found = read(path, **options)
    assert found.sampling_time == pytest.approx(step, rel=1e-4)
    assert found.columns == columns
    assert found.start == (pytest.approx(start, abs=0.01) if np.isscalar(start) else start)
    np.testing.assert_array_equal(found.y[:, -1], Y)


@pytest.mark.parametrize(
    ("text", "step", "start", "columns"),
    [
        (table(str, "time,y\nms,\n"), 1e-3, 0, ("y",)),  # a unit for the time alone
        (table(lambda i: f"{i},{i}", "time,x,y\nms,1,1\n"), 1e-3, 0, ("x [1]", "y [1]")),
        (table(str, "ms,C\ntime,y\n"), 1e-3, 0, ("y [C]",)),  # units above the names
        (table(str, "Started 2024-01-05 10:00:00\ntime,y\nrun 3,\n"), 1, 0, ("y",)),
        (table(str, "Probe,#7\n\nTime,y\nsec,°C\n"), 1, 0, ("y [°C]",)),
        (table(lambda i: f"{HOURS[i]:%d.%m.%y,%H:%M:%S}", "Date,Time,y\n"), 3600, HOURS[0], ("y",)),
        (table(lambda i: f"2024-03-01,10:00:{i:02d}Z", "Date,Time,y\n"), 1, ZULU, ("y",)),
        (table(lambda i: f"{HOURS[i]:%H.%M.%S}"), 3600, 72000, ("y",)),
        (table(lambda i: f"{59 + i // 60}:{i % 60:02d}.25"), 1, 3540.25, ("y",)),
        (
            table(lambda i: f"10:{int(3.3 * i) // 60:02d}:{int(3.3 * i) % 60:02d}"),
            3.3,
            BEGIN,
            ("y",),
        ),
        (table(lambda i: f"{i / 120:.6f}"), 1 / 120, 0, ("y",)),  # a camera of 120 Hz
        (table(lambda i: f"{DAYS[i]:%d.%m.%Y %H:%M}"), 86400, DAYS[0], ("y",)),
        (
            table(lambda i: f"{HOURS[i]:%d.%m.%Y %H:%M:%S}", "Zeitstempel,y\n"),
            3600,
            HOURS[0],
            ("y",),
        ),
    ],
)
def test_files_that_are_read(
    tmp_path: Path, text: str, step: float, start: Any, columns: tuple[str, ...]
) -> None:
    check(text_file(tmp_path, text), step, start, columns)


BAD = "time,y\nMon Jan 1 9:00:00 2024,Bad\n" + table(lambda i: f"Mon Jan 1 10:00:{i:02d} 2024", "")
THREE = table(lambda i: f'"2024-03-01 10:00:{i:02d}",{i / 4}', '"time","y"\n')
FIVES = table(lambda i: f"{i},5", "time,(ms),y\n")
HALVES = table(lambda i: f"{i + 0.5}", "0,1\n")
INDEXED = table(lambda i: f"{i + 0.5},{i / 2}", ",1,2\n")
MINUTES = table(lambda i: f"{i * 30 // 60 + 10}:{i * 30 % 60:02d}")
DATES, DAY = table(lambda i: f"10.10.{i + 10}"), table(lambda i: f"{i / 24:.9f}")
NUMBERS = "line 1 may hold names or numbers"
SKIP = {"skip_rows": 1, "time_column": 0}


@pytest.mark.parametrize(
    ("text", "words", "remedy", "step"),
    [
        (
            BAD,
            "line 2 holds 'Mon Jan 1 9:00:00 2024' and 'Bad'",
            {"skip_rows": 2, "header_row": 1},
            1,
        ),
        (THREE, "line 1 holds 2 names, line 2 3 cells", SKIP, 1),
        (FIVES, "'(ms)' where a name is due", {"header_row": 1, "columns": "y"}, 1),
        (HALVES, f"{NUMBERS}: header_row=1", {"header_row": 1, "time_column": "0"}, 1),
        (INDEXED, NUMBERS, {"header_row": 1, "time_column": "1"}, 0.5),
        ("Key,Value\n" * 450 + table(str), "no time column", {"header_row": 451}, 1),
        (MINUTES, "as minutes and seconds (30 s)", {"sampling_time": 1800}, 1800),
        (DATES, "times of the day (1 s) or as dates", {"sampling_time": 1}, 1),
        (DAY, "fractions of a day (3600 s)", {"sampling_time": 3600}, 3600),
        (table(lambda i: f"{2024 + i / 8784:.8f}"), "or as years", OFF, 1),
        (table(lambda i: f"{202401 + i // 12 * 100 + i % 12}"), "dates from 2024-01-01", OFF, 1),
        (table(lambda i: f"{HOURS[i]:%Y%m%d%H}"), "dates from 2024-03-01", OFF, 1),
        ("y\n1\n2\n\n4\n5\n", "line 4 is empty: write nan", None, 0),
        ("time u y\n0 1 2\n1   3\n2 1 4\n", "line 3 has 2 cells instead of 3", None, 0),
        ("1,500\n-0,250\n-0,125\n0,000\n", "line 1 may hold decimal commas", None, 0),
        ("1,5\n-0,25\n-0,12\n0,4\n", "whole numbers, which a line of names", None, 0),
        (table(lambda i: f"{i} msec"), "row 0 holds '0 msec' (line 2)", None, 0),
        (table(str) + "Mean,0.1\n", "(line 42); remove what stands below the samples", None, 0),
        (table(str) + ",0.1\n", "empty in the last rows; remove what stands below", None, 0),
        (table(str) + table(lambda i: f"{i + 40}"), "(line 42); the names stand again", None, 0),
    ],
)
@pytest.mark.filterwarnings("ignore::splitband.records.signals.ReadingWarning")
def test_files_that_are_refused_with_what_to_do(
    tmp_path: Path, text: str, words: str, remedy: dict[str, Any] | None, step: float
) -> None:
    path = text_file(tmp_path, text)
    assert words in message(path)
    if remedy is not None:
        found = read(path, **remedy)
        assert found.sampling_time == pytest.approx(step, rel=1e-6)
        np.testing.assert_array_equal(found.y[:, -1], Y)


@pytest.mark.parametrize("words", ["# rig A, test 3\n", "% Ann Lee, pump\n"])
def test_a_comment_of_several_words_is_no_header_unless_it_is_said_to_be(
    tmp_path: Path, words: str
) -> None:
    path = text_file(tmp_path, table(lambda i: f"{i / 8}", words))
    said = message(path)
    assert "line 1 is a comment" in said
    assert "header_row=1" in said
    check(path, 1, None, ("0", "1"), header_row=0, **OFF)
    check(path, 1, None, tuple(words[2:-1].split(", ")), header_row=1, **OFF)
    told = text_file(tmp_path, table(lambda i: f"{i / 8}", f"{words}# tank level [m], y\n"))
    check(told, 1, None, ("tank level [m]", "y"), **OFF)


def test_one_column_that_pandas_wrote_without_a_name(tmp_path: Path) -> None:
    frame = pd.DataFrame(Y + 0.0005)
    path = text_file(tmp_path, frame.to_csv(index=False))
    said = message(path, sampling_time=1)
    assert "line 1 may hold names or numbers" in said
    for row, values in ((1, frame[0]), (0, [0.0, *frame[0]])):
        found = read(path, header_row=row, sampling_time=1)
        np.testing.assert_array_equal(found.y[:, 0], values)
    for column in (frame[0], frame[0].rename(7), pd.Series(np.arange(40) % 4, name=3)):
        found = read(text_file(tmp_path, column.to_csv()), sampling_time=1)
        assert found.columns == (str(column.name or 0),)
        np.testing.assert_array_equal(found.y[:, 0], column)


@pytest.mark.parametrize("head", ["", "time y\n"])
@pytest.mark.parametrize("zone", ["", ",25"])
def test_times_and_decimal_commas_between_blanks(tmp_path: Path, head: str, zone: str) -> None:
    """10:00:00 0,5 is half a unit, not a 5 after "10:00:00 0"."""
    rows = "".join(f"10:00:{i:02d}{zone} {str(Y[i]).replace('.', ',')}\n" for i in range(40))
    found = read(text_file(tmp_path, head + rows), time_column="time" if head else "0")
    assert found.sampling_time == 1
    np.testing.assert_array_equal(found.y[:, 0], Y)


def test_names_may_be_like_the_words_below(tmp_path: Path) -> None:
    with pytest.warns(ReadingWarning, match="'mode 1'"):
        check(text_file(tmp_path, table(lambda i: f"{i},mode {i}", "t,mode 1,y\n")), 1, 0, ("y",))


def test_a_unit_that_is_not_known_is_refused(tmp_path: Path) -> None:
    path = text_file(tmp_path, table(str, "Zeit [ticks],y\n"))
    assert "such as 'Zeit [ticks]', which increases" in message(path)
    assert "a unit that is not known, 'ticks'" in message(path, time_column="Zeit [ticks]")


@pytest.mark.parametrize("thousands", [" ", "\u00a0", "\u202f", "'"])
@pytest.mark.parametrize("decimal", [",", "."])
def test_thousands_may_be_separated_by_blanks(tmp_path: Path, thousands: str, decimal: str) -> None:
    rows = "".join(f"{i};1{thousands}{Y[i] + 500:07.3f}\n" for i in range(40))
    found = read(text_file(tmp_path, "time;y\n" + rows.replace(".", decimal)))
    np.testing.assert_allclose(found.y[:, 0], Y + 1500, rtol=1e-12)


def test_two_whole_numbers_in_a_cell_are_no_thousands(tmp_path: Path) -> None:
    path = text_file(tmp_path, "time;x y\n" + "".join(f"{i};12 {i + 345}\n" for i in range(40)))
    assert "no numbers: '12 345'" in message(path)


def test_a_unit_in_each_cell_is_taken_out_as_the_message_says(tmp_path: Path) -> None:
    path = text_file(tmp_path, "time,y\n" + "".join(f"{i},{y} mV\n" for i, y in enumerate(Y)))
    assert "columns='y' (--columns y) says how to leave the unit ' mV' out" in message(path)
    said, data = message(path, columns="y"), pd.read_csv(path)
    assert said.endswith("; in pandas table['y'].str.replace(' mV', '') leaves the unit out")
    data["y"] = data["y"].str.replace(" mV", "")
    np.testing.assert_array_equal(read(data, columns="y").y[:, 0], Y)
    mixed = text_file(tmp_path, "time,y\n0,1 V\n1,1 mV\n2,3 V\n")  # no unit in common
    assert "leaves the unit" not in message(mixed, columns="y")
    after = text_file(tmp_path, "time,y\n0,1-\n1,2-\n2,3-\n")  # a sign
    assert "leaves the unit" not in message(after, columns="y")


def test_exponents_of_fortran(tmp_path: Path) -> None:
    rows = "".join(f"  {i:.3E}  {Y[i]:.7E}\n" for i in range(40)).replace("E", "D")
    check(text_file(tmp_path, "time y\n" + rows, "run.dat"), 1, 0, ("y",))


def test_labviews_column_of_comments_has_no_cells(tmp_path: Path) -> None:
    end, names = "***End_of_Header***\t\n", "X_Value\ty\tComment\n"
    rows = "".join(f"{i}.0\t{Y[i]}\n" for i in range(40))
    part = f"Channels\t1\nX0\t0\nDelta_X\t1\n{end}{names}{rows}"
    text = f"Separator\tTab\nDate\t2024/03/01\n{end}\t\n{part}"
    path = text_file(tmp_path, text, "rig.lvm")
    assert "such as 'X_Value'" in message(path)
    check(path, 1, 0, ("y",), time_column="X_Value")
    bare = text_file(tmp_path, text.replace(end, "", 1) + part, "rig.lvm")  # parts alone
    assert "row 40 holds 'Channels'" in message(bare, time_column="X_Value")
    twice = text_file(tmp_path, text + part, "rig.lvm")  # each part begins anew
    assert "row 40 holds 'Channels' (line 50)" in message(twice, time_column="X_Value")


def test_structures_of_matlab(tmp_path: Path) -> None:
    time, path = 0.01 * np.arange(40), tmp_path / "record.mat"
    rows = np.array([(t, y) for t, y in zip(time, Y, strict=True)], [("t", "O"), ("y", "O")])
    scipy.io.savemat(path, {"log": rows})
    assert "'log[0].t', 'log[0].y', 'log[1].t'" in message(path)
    stamps = np.array([f"2024-01-01 10:00:{i:02d}" for i in range(40)], dtype=object)
    scipy.io.savemat(path, {"log": {"date": stamps, "y": Y}})
    check(path, 1, pd.Timestamp("2024-01-01 10:00"), ("log.y",))

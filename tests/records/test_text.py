"""Text files as loggers and spreadsheets write them, numbers as people write them."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from splitband.records import read
from tests.records.support import message, text_file


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("a;b;c\n0,07;3,09;999\n0,08;3,46;1.006\n", [[0.07, 3.09, 999], [0.08, 3.46, 1006]]),
        ("a;b\n1.000,0;2\n1.234.567,5;3\n", [[1000, 2], [1234567.5, 3]]),
        ('a,b\n"1,234.5",2\n"-12,000.25",3\n', [[1234.5, 2], [-12000.25, 3]]),
        ('a,b\n"1,234",0.5\n999,0.75\n', [[1234, 0.5], [999, 0.75]]),
        ('a,b\n"0,5","1.234,5"\n"0,75",7\n', [[0.5, 1234.5], [0.75, 7]]),
        ("a\tb\n0,5\t1.006\n0,75\t999\n", [[0.5, 1006], [0.75, 999]]),
        ("a;b\n1.234;5.678\n2.345;6.789\n", [[1.234, 5.678], [2.345, 6.789]]),
        ("a b\n0,5 1,5\n2,5 3,5\n", [[0.5, 1.5], [2.5, 3.5]]),
    ],
)
def test_one_decimal_sign_for_a_file(tmp_path: Path, text: str, values: list[list[float]]) -> None:
    np.testing.assert_array_equal(read(text_file(tmp_path, text), sampling_time=1).y, values)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("a;b\n1;2,5\n2;3.25\n", ["one decimal sign", "'b' holds '3.25' at row 1", "'2,5' at row"]),
        ("a;b\n0;999\n1;1.006\n", ["cannot be told", "column 'b' holds '1.006' at row 1"]),
        ("a;b\n0;999\n1;1,006\n", ["cannot be told", "column 'b' holds '1,006' at row 1"]),
        ('a,b\n1,"1,006"\n2,"1,007"\n', ["cannot be told", "column 'b' holds '1,006' at row 0"]),
        ("a;b\n1.234;1,234\n2.345;1,007\n", ["cannot be told", "thousands separators"]),
        ("a;b\n0,5;1,5\n0,75;1,x\n1,5;2,5\n", ["column 'b' must be numeric: row 1 holds '1,x'"]),
    ],
)
def test_an_unclear_decimal_sign_is_refused(tmp_path: Path, text: str, words: list[str]) -> None:
    said = message(text_file(tmp_path, text), sampling_time=1)
    assert [word for word in words if word not in said] == [], said


def test_numbers_among_words_do_not_set_the_decimal_sign(tmp_path: Path) -> None:
    path = text_file(tmp_path, "a;note\n1.5;start\n2.5;4,5 bar\n3.5;3,5\n4.5;end\n")
    found = read(path, columns="a", sampling_time=1)
    np.testing.assert_array_equal(found.y[:, 0], [1.5, 2.5, 3.5, 4.5])


def test_dates_with_dots_beside_decimal_commas(tmp_path: Path) -> None:
    path = text_file(tmp_path, "date;y\n13.02.2024;1.006,5\n14.02.2024;999,5\n")
    found = read(path)
    assert found.start == pd.Timestamp("2024-02-13")
    np.testing.assert_array_equal(found.y[:, 0], [1006.5, 999.5])


@pytest.mark.parametrize("text", ["NA,1,2\n3,4,5\n6,7,8\n", "nan,1,2\n3,4,5\n6,7,8\n"])
def test_a_first_row_of_numbers_and_missing_values_is_data(tmp_path: Path, text: str) -> None:
    found = read(text_file(tmp_path, text), sampling_time=1, gaps="mask")
    assert found.columns == ("0", "1", "2")
    np.testing.assert_array_equal(found.y_with_gaps, [[np.nan, 1, 2], [3, 4, 5], [6, 7, 8]])


@pytest.mark.parametrize("name", ["record.csv", "record.txt"])
def test_an_error_of_a_spreadsheets_cell_begins_no_comment(tmp_path: Path, name: str) -> None:
    path = text_file(tmp_path, "# of a pump\na,b\n1,2\n#N/A,3\n5,#N/A\n", name)
    found = read(path, sampling_time=1, gaps="mask")
    np.testing.assert_array_equal(found.y_with_gaps, [[1, 2], [np.nan, 3], [5, np.nan]])
    path = text_file(tmp_path, "a,b\n1,2\n#DIV/0!,3\n", name)
    assert "column 'a' must be numeric: row 1 holds '#DIV/0!'" in message(path, sampling_time=1)

"""Time stamps that may mean several things, in one column or two."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from splitband.records import read
from splitband.records.signals import ReadingWarning
from tests.records.support import iso, message, stamped, text_file


def clock(seconds: float, form: str = "{h:02d}:{m:02d}:{s:02d}") -> str:
    whole = int(seconds)
    return form.format(h=whole // 3600 % 24, m=whole // 60 % 60, s=whole % 60)


IN_A_WORD, LISTED = {"time_column": "day,clock"}, {"time_column": ["day", "clock"]}


@pytest.mark.parametrize(
    ("header", "row", "step", "start", "options"),
    [
        ("Date,Time", "{0:%Y-%m-%d},{0:%H:%M:%S}", "1h", "2024-03-01 20:00", {}),
        ("Time,Date", "{0:%H:%M:%S},{0:%Y-%m-%d}", "1h", "2024-03-01 20:00", {}),
        ("day,clock", "{0:%d.%m.%Y},{0:%H:%M:%S}", "1h", "2024-03-30 20:00", IN_A_WORD),
        ("day,clock", "{0:%d.%m.%Y},{0:%H:%M:%S}", "1h", "2024-03-30 20:00", LISTED),
        ("Date,Time", "{0:%d/%m/%Y},{0:%H.%M.%S}", "1h", "2004-03-10 18:00", {}),  # UCI
        ("Date,Time", "{0:%m/%d/%Y},{0:%I:%M:%S %p}", "1h", "2024-03-13 20:00", {}),
        ("Date,Time", "{0:%Y%m%d},{0:%H:%M:%S}", "1min", "2024-03-01 23:50", {}),
        ("Date,Time", "{0:%Y-%m-%d} 00:00:00,{0:%H:%M}", "1min", "2024-03-01 23:50", {}),
    ],
)
def test_a_date_and_a_time_of_the_day(
    tmp_path: Path, header: str, row: str, step: str, start: str, options: dict[str, Any]
) -> None:
    dates = pd.date_range(start, periods=48, freq=step)
    rows = "".join(f"{row.format(date)},{i}\n" for i, date in enumerate(dates))
    found = read(text_file(tmp_path, f"{header},y\n{rows}"), **options)
    assert (len(found), found.start, found.columns) == (48, dates[0], ("y",))
    assert found.sampling_time == pd.Timedelta(step).total_seconds()
    np.testing.assert_array_equal(found.y[:, 0], np.arange(48))


def test_a_whole_date_needs_no_time_of_the_day(tmp_path: Path) -> None:
    rows = "".join(f"2024-03-01 10:00:0{i},00:00:0{i},{i}\n" for i in range(9))
    with pytest.warns(ReadingWarning, match="'Date' \\(another time column\\)"):
        assert read(text_file(tmp_path, f"Date,Time,y\n{rows}")).start == 0


@pytest.mark.parametrize("form", ["{h:02d}:{m:02d}:{s:02d}", "{m:02d}:{s:02d}.0"])
@pytest.mark.parametrize("newest_first", [False, True])
def test_clocks_go_on_past_midnight_and_in_reverse(
    tmp_path: Path, form: str, newest_first: bool
) -> None:
    order = range(59, -1, -1) if newest_first else range(60)
    stamps = [clock(23 * 3600 + 59 * 60 + 30 + i, form) for i in order]
    rows = "".join(f"{stamp},{i}\n" for i, stamp in zip(order, stamps, strict=True))
    found = read(text_file(tmp_path, f"time,y\n{rows}"))
    assert (found.sampling_time, len(found)) == (1, 60)
    assert found.start == (86370 if "h" in form else 3570)
    np.testing.assert_array_equal(found.y[:, 0], np.arange(60))


@pytest.mark.parametrize("written", [lambda i: f"2024-01-01 10:00:{i:02d}", lambda i: i / 4])
def test_rows_may_be_newest_first(tmp_path: Path, written: Callable[[int], object]) -> None:
    rows = "".join(f"{written(i)},{i},{-i}\n" for i in range(20, -1, -1))
    found = read(text_file(tmp_path, f"time,u,y\n{rows}"), inputs="u")
    np.testing.assert_array_equal(found.u[:, 0], np.arange(21))
    np.testing.assert_array_equal(found.y, -found.u)
    path = text_file(tmp_path, f"time,u,y\n{rows}".replace(",7,-7", ",7,x"))
    assert "holds 'x' (line 15)" in message(path)


def test_a_clock_that_goes_back_has_not_passed_midnight(tmp_path: Path) -> None:
    stamps = ["10:00:00", "10:00:01", "09:59:59", "10:00:02"]
    for gaps in ("refuse", "mask"):
        assert "must increase: row 2" in message(stamped(tmp_path, stamps, "time"), gaps=gaps)


@pytest.mark.parametrize(
    ("stamps", "step"),
    [
        ([f"00:{i // 10:02d}.{i % 10}" for i in range(30)], 0.1),
        (["59:58", "59:59", "1:00:00", "1:00:01"], 1),
        ([f"10:00:00:{10 * i:03d}" for i in range(9)], 0.01),
        ([f"{24 + i}:30:00" for i in range(9)], 3600),
        ([str(pd.Timedelta(i, "h")) for i in range(30)], 3600),
        ([f"{20240101 + i}1200" for i in range(9)], 86400),
        (iso([0.0, 0.25, 0.5, 0.75, 1.0]), 0.25),  # isoformat drops the zero fractions
        ([f"{stamp}+02:00" for stamp in iso([0, 1, 2, 3])], 1),
        (["29.02.2024 10:00:00", "29.02.2024 10:00:02", "29.02.2024 10:00:04"], 2),
    ],
)
def test_stamps_that_mean_one_thing(tmp_path: Path, stamps: Sequence[str], step: float) -> None:
    found = read(stamped(tmp_path, [f'"{stamp}"' for stamp in stamps], "time"))
    assert found.sampling_time == pytest.approx(step, rel=1e-9)


@pytest.mark.parametrize(
    ("stamps", "others"),
    [
        ([f"10:{i:02d}" for i in range(20)], {60: "hours and minutes", 1: "minutes and seconds"}),
        ([f"{45 + i // 60}:{i % 60:02d}" for i in range(90)], {60: "hours", 1: "and seconds"}),
        (range(739252, 739272), {1: "seconds", 86400: "MATLAB's serial days"}),
        (np.arange(20) / 4 + 45292, {0.25: "seconds", 21600: "Excel's serial days"}),
        (np.arange(20) + 2460310.5, {1: "seconds", 86400: "Julian days"}),
        (range(20240101, 20240121), {1: "seconds", 86400: "dates from 2024-01-01"}),
        (range(1970, 1990), {1: "seconds", 31557600: "years"}),
        ((np.arange(30) / 12 + 1949).round(5), {1 / 12: "seconds", 31557600 / 12: "years"}),
        (range(0, 20000, 1000), {1000: "seconds", 1: "milliseconds", 0.001: "microseconds"}),
        (range(5, 200000, 10007), {10007: "seconds", 10.007: "milliseconds"}),
        ([f"{i / 86400:.11f}" for i in range(20)], {1 / 86400: "seconds", 1: "fractions of a day"}),
    ],
)
@pytest.mark.filterwarnings("ignore::splitband.records.signals.ReadingWarning")
def test_stamps_that_mean_several_things_are_refused_with_all_of_them(
    tmp_path: Path, stamps: Sequence[object], others: dict[float, str]
) -> None:
    path = stamped(tmp_path, stamps, "time")
    for gaps in ("refuse", "mask"):
        said = message(path, gaps=gaps)
        assert [words for words in others.values() if words not in said] == [], said
        assert "sampling_time (--sampling-time)" in said
    for step in others:
        assert read(path, sampling_time=step).sampling_time == pytest.approx(step)
        assert read(path, fallback_sampling_time=step).sampling_time == pytest.approx(step, 1e-4)


@pytest.mark.parametrize(
    ("stamps", "step", "start"),
    [
        ([f"{739252.5 + i / 86400:.8f}" for i in range(40)], 1, "2024-01-01 12:00"),
        ([f"{2460310.5 + i / 1440:.7f}" for i in range(40)], 60, "2024-01-01"),
        ([1700000000000 + 10 * i for i in range(40)], 0.01, 1.7e9),
        ([1700000000000000000 + 10**7 * i for i in range(40)], 0.01, 1.7e9),
        ([f"01/02/2024 10:00:{i:02d}" for i in range(40)], 1, "2024-01-02 10:00"),
        ([f"24-02-03 10:00:{i:02d}" for i in range(40)], 1, None),
    ],
)
def test_a_reading_that_is_probable_is_said(
    tmp_path: Path, stamps: Sequence[object], step: float, start: Any
) -> None:
    with pytest.warns(ReadingWarning, match="read as (dates|milli|nano)"):
        found = read(stamped(tmp_path, stamps, "time"))
    assert found.sampling_time == pytest.approx(step, rel=1e-4)
    if isinstance(start, str):
        assert isinstance(found.start, pd.Timestamp)
        assert abs(found.start - pd.Timestamp(start)) < pd.Timedelta("50ms")
    elif start:
        assert found.start == start


@pytest.mark.parametrize(
    ("stamps", "step"),
    [
        ([f"{i + (i % 5 == 1) / 100:.2f}" for i in range(60)], 1),  # 0.99, 1, 1.01 s
        ([60 * i - (i % 4 == 1) for i in range(60)], 60),
        ([f"2024-01-01 {clock(60 * i - (i % 3 == 1))}" for i in range(60)], 60),
        ([f"{0.1 * i + 0.001 * (i % 3 == 1):.3f}" for i in range(60)], 0.1),
    ],
)
def test_steps_of_one_percent_or_one_last_place_are_even(
    tmp_path: Path, stamps: Sequence[object], step: float
) -> None:
    for gaps in ("refuse", "mask"):
        found = read(stamped(tmp_path, stamps), gaps=gaps)
        assert (found.sampling_time, len(found)) == (step, 60)

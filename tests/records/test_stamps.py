"""Time columns: found, put in seconds, and even."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from splitband.records import Record, read
from splitband.records.signals import Gaps, ReadingWarning
from tests.records.support import iso, message, stamped, text_file


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("t", 1),
        ("time [s]", 1),
        ("Time [ms]", 1e-3),
        ("timestamp_us", 1e-6),
        ("time/min", 60),
    ],
)
def test_time_columns_are_found_by_name_and_unit(tmp_path: Path, name: str, unit: float) -> None:
    trajectory = read(stamped(tmp_path, [10, 12, 14, 16], name))
    assert trajectory.sampling_time == pytest.approx(2 * unit, rel=1e-12)
    assert trajectory.columns == ("y",)


@pytest.mark.parametrize(
    ("text", "column", "step", "values"),
    [
        ("1 0.0\n2 0.5\n5 1.0\n", 1, 0.5, [1, 2, 5]),
        ("2024-01-01 00:00:00,1\n2024-01-01 00:00:01,2\n", 0, 1, [1, 2]),  # the first is no header
    ],
)
def test_time_column_by_position(
    tmp_path: Path, text: str, column: int, step: float, values: list[float]
) -> None:
    found = read(text_file(tmp_path, text, "record.txt"), time_column=column)
    assert found.sampling_time == step
    np.testing.assert_array_equal(found.y[:, 0], values)


@pytest.mark.parametrize("name", ["T", "ts", "torque_s", "times"])
def test_a_channel_is_not_taken_for_the_time(tmp_path: Path, name: str) -> None:
    options: dict[str, Any] = {"columns": ["T"]} if name == "T" else {}  # T may be a temperature
    path = text_file(tmp_path, f"{name}\n3\n1\n2\n")
    assert read(path, sampling_time=1, **options).columns == (name,)


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


CUT = [3 * row // 2 for row in range(60)]
HOLED = CUT[:20] + CUT[40:]


@pytest.mark.parametrize("gaps", ["refuse", "mask"])
@pytest.mark.parametrize("rows", [7, 8, 59, 60])
def test_stamps_cut_to_units_almost_as_long_as_a_step(
    tmp_path: Path, gaps: Gaps, rows: int
) -> None:
    """1.5 s cut to whole seconds: 0, 1, 3, 4, 6, 7, 9 s, of which no row is missing."""
    found = read(stamped(tmp_path, CUT[:rows]), gaps=gaps)
    assert (len(found), found.measured) == (rows, None)
    assert found.sampling_time == pytest.approx(1.5, rel=1 / rows**1.5)
    minutes = [f"{12 + each // 60}:{each % 60:02d}:00" for each in CUT[:rows]]
    found = read(stamped(tmp_path, minutes), gaps=gaps)
    assert found.sampling_time == pytest.approx(90, rel=1 / rows**1.5)


def test_rows_that_are_missing_from_stamps_cut_to_units(tmp_path: Path) -> None:
    found = read(stamped(tmp_path, HOLED), gaps="mask")
    assert found.sampling_time == pytest.approx(1.5, rel=1e-3)
    np.testing.assert_array_equal(np.flatnonzero(~found.complete), np.arange(20, 40))


@pytest.mark.parametrize("gaps", ["refuse", "mask"])
def test_rows_missing_at_even_distances_may_be_a_longer_step(tmp_path: Path, gaps: Gaps) -> None:
    """A loop of 1.1 s whose stamps are cut, or every eleventh row lost; few may be by chance."""
    path = stamped(tmp_path, [11 * row // 10 for row in range(60)])
    said = message(path, gaps=gaps)
    assert all(each in said for each in ("every 1 s with", "every 1.1 s, cut to 1 s", "--sampling"))
    assert read(path, gaps=gaps, sampling_time=1.1).measured is None
    lost = read(path, gaps="mask", sampling_time=1.0)
    assert (len(lost), int((~lost.complete).sum())) == (65, 5)
    few = stamped(tmp_path, [row for row in range(60) if row not in (20, 40)])
    assert read(few, gaps="mask").sampling_time == 1


@pytest.mark.parametrize("rate", [24, 48, 72, 96, 144])
def test_rates_whose_steps_are_parts_of_a_day_too(tmp_path: Path, rate: int) -> None:
    found = read(stamped(tmp_path, [f"{row / rate:.5f}" for row in range(500)]))
    assert found.sampling_time == pytest.approx(1 / rate, rel=1e-6)


def test_rounding_to_float32_is_allowed_for(tmp_path: Path) -> None:
    stamps = (0.001 * np.arange(20000)).astype(np.float32)
    assert np.ptp(np.diff(stamps)) > 1e-3 * 0.001, "steps must differ for this to test anything"
    np.savez(tmp_path / "record.npz", t=stamps + np.float32(500), y=np.arange(20000.0))
    assert read(tmp_path / "record.npz").sampling_time == pytest.approx(0.001, rel=1e-4)


@pytest.mark.parametrize(
    ("stamps", "words"),
    [
        ([0, 1, 2, 4, 5, 6], "must be even: expected a step of 1 s at row 3, found 2 s"),
        ([i + 0.012 * (i % 5 == 1) for i in range(60)], "must be even"),
        ([0, 1, 2, 2, 3], "must increase: row 3 (2 s) follows 2 s"),
        # A drift within the rounding of each step; a gap among rounded stamps.
        ([f"{s:.3f}" for s in np.cumsum(np.repeat([0.010, 0.011], 60))], "must be even"),
        (
            [f"{row / 30:.2f}" for row in range(1000) if row != 500],
            "expected a step of 0.03 s at row 500, found 0.07 s",
        ),
        ([0, 1, "soon", 3], "must be numeric: row 2 holds 'soon'"),
        ([0, 1, "", 3], "must be finite: 1 bad value, the first (nan) at row 2"),
        ([*iso([0, 1]), "later"], "must hold numbers or dates: row 2 holds 'later'"),
        ([5e11, 5e11 + 10, 5e11 + 20], "must be in seconds, or name its unit"),
        (
            ["2024-01-01T10:00:00", "2024-01-01T10:00:01Z"],
            "in all rows or in none: row 1 holds '2024-01-01T10:00:01Z', row 0 '2024-01-01T10:00:",
        ),
        (["2024-01-01 10:00:00+0100", "2024-01-01 10:00:01", ""], "in all rows or in none: row 0"),
    ],
)
def test_bad_stamps(tmp_path: Path, stamps: Sequence[object], words: str) -> None:
    text = message(stamped(tmp_path, stamps))
    assert words in text
    assert "time column 't'" in text


def test_sampling_time_beside_stamps(tmp_path: Path) -> None:
    path = stamped(tmp_path, [0, 0.5, 1.0])
    assert read(path, sampling_time=0.5004).sampling_time == 0.5004
    words = "sampling_time (--sampling-time) is 0.4 s, but time column 't' steps by 0.5 s"
    assert words in message(path, sampling_time=0.4)
    ignored = read(path, sampling_time=0.4, time_column="")
    assert (ignored.sampling_time, ignored.columns) == (0.4, ("y",))
    drifting = stamped(tmp_path, [f"{0.1009 * row:.4f}" for row in range(240)])
    assert "is 0.1 s, but time column 't' steps by 0.1009 s" in message(drifting, sampling_time=0.1)


@pytest.mark.parametrize(
    ("written", "start", "step"),
    [
        ("%d.%m.%Y %H:%M:%S", "2024-02-03 10:00", "1s"),
        ("%d.%m.%Y", "2024-02-03", "1D"),
        ("%d/%m/%Y %H:%M", "2024-02-03 23:55", "1min"),
        ("%d/%m/%Y", "2024-02-03", "1D"),
        ("%m/%d/%Y %H:%M", "2024-02-03 23:55", "1min"),
        ("%m/%d/%Y", "2024-02-03", "1D"),
        ("%Y-%m-%d", "2024-02-03", "1D"),
    ],
)
def test_days_and_months_are_not_mistaken_for_each_other(
    tmp_path: Path, written: str, start: str, step: str
) -> None:
    """The order in which the steps are even; for a single day the custom of how it is written."""
    dates = pd.date_range(start, periods=12, freq=step)
    frame = pd.DataFrame({"time": dates.strftime(written), "y": np.arange(12.0)})
    frame.to_csv(tmp_path / "dates.csv", index=False)
    found = read(tmp_path / "dates.csv")
    assert found.start == pd.Timestamp(start)
    assert found.sampling_time == pd.Timedelta(step).total_seconds()


def test_a_date_of_numpy_is_a_time_stamp() -> None:
    start = np.datetime64("2024-01-01T10:00", "ns")
    found: Any = Record(np.arange(3.0), 0.1, start=start)  # type: ignore[arg-type]
    assert found.start == pd.Timestamp("2024-01-01 10:00")


@pytest.mark.parametrize(
    ("name", "step", "places"),
    [
        *(("Date", *each) for each in ((1.0, 10), (60.0, 7), (86400.0, 0), (0.01, 12))),
        *(
            ("Time", *each) for each in ((3600.0, 5), (900.0, 10), (1.0, 11), (0.1, 11))
        ),  # by their step
    ],
)
def test_serial_days_of_excel_are_dates(
    tmp_path: Path, name: str, step: float, places: int
) -> None:
    """By the day that is known: 45292 is the first of January 2024."""
    days = [f"{45292.25 + step * row / 86400:.{places}f}" for row in range(50)]
    with pytest.warns(ReadingWarning, match=f"'{name}' holds Excel's serial days, read as dates"):
        found = read(stamped(tmp_path, days, name))
    assert isinstance(found.start, pd.Timestamp)
    expected = pd.Timestamp("2024-01-01 06:00" if places else "2024-01-01")
    assert abs(found.start - expected) < pd.Timedelta(0.5 * 86400 / 10**places + 0.005, unit="s")
    assert found.sampling_time == pytest.approx(step, rel=1e-3 if places < 6 else 1e-4)


@pytest.mark.parametrize(("step", "places"), [(0.01, 2), (1e-5, 5), (1 / 30, 7), (1 / 3, 9)])
def test_seconds_in_a_column_of_time_stay_seconds(
    tmp_path: Path, step: float, places: int, recwarn: pytest.WarningsRecorder
) -> None:
    stamps = [f"{45292.25 + step * row:.{places}f}" for row in range(50)]
    assert read(stamped(tmp_path, stamps, "time")).sampling_time == pytest.approx(step, rel=1e-3)
    assert not recwarn.list


def test_a_column_of_dates_may_name_its_unit_and_holds_no_other_numbers(tmp_path: Path) -> None:
    said = message(stamped(tmp_path, [0, 1, 2], "date"))
    assert "must hold dates, Excel's serial days or seconds since 1970, or name its unit" in said
    assert read(stamped(tmp_path, [45292, 45293, 45294], "date [s]")).sampling_time == 1
    assert read(stamped(tmp_path, [1.7e9, 1.7e9 + 1, 1.7e9 + 2], "date")).sampling_time == 1


def test_a_change_to_summer_time_is_no_gap(tmp_path: Path) -> None:
    times = pd.date_range("2024-03-31 00:30", periods=8, freq="15min", tz="Europe/Berlin")
    found = read(stamped(tmp_path, [time.isoformat() for time in times], "date"))
    assert found.sampling_time == 900
    assert found.start == times[0]


def test_a_temperature_that_rises_is_not_the_time(tmp_path: Path) -> None:
    rows = "".join(f"2024-03-01 10:00:{i:02d},{20 + i / 10},{i}\n" for i in range(40))
    with pytest.warns(ReadingWarning, match="left out: 'T'"):
        assert read(text_file(tmp_path, f"date,T,P\n{rows}")).sampling_time == 1


def test_a_missing_value_in_single_precision_is_found(tmp_path: Path) -> None:
    y = np.array([1, 2, -99.9, 3, 4, 5], np.float32)
    np.savez(tmp_path / "record.npz", time=0.1 * np.arange(6), y=y)
    found = read(tmp_path / "record.npz", missing="-99.9", gaps="mask")
    assert np.isnan(found.y_with_gaps[:, 0]).tolist() == (y == y[2]).tolist()

"""What a message names as a way out leads to the right record."""

import bz2
import gzip
import lzma
import re
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy

import splitband as sb
from splitband.records.signals import ReadingWarning
from tests.records.support import message, stamped, text_file

CSV = "time,u,y\n" + "".join(f"{i / 10},{i % 3},{i * i}\n" for i in range(30))


def told(said: str, **names: Any) -> Any:
    """Run the line of pandas that a message names."""
    parts = re.split(r"in pandas | gives |; |, or| puts| adds", said)
    line = next(part for part in parts if part.startswith("table"))
    scope = {"pd": pd, **names}
    if re.match(r"table\[.*\] = ", line):
        exec(line, scope)
        return scope["table"]
    return eval(line, scope)


def option(said: str, name: str) -> dict[str, Any]:
    """Return the argument of `read` that a message names."""
    found = re.search(rf"{name}=(\(.*?\)|'.*?'|[\d.e-]+)", said)
    return {name: eval(found[1])}


@pytest.mark.parametrize("by_tag", [False, True])
@pytest.mark.parametrize("tags", [("F.PV", "F.OP", "T.PV"), (11, 12, 13)])
def test_a_long_table_is_made_wide(tmp_path: Path, by_tag: bool, tags: Sequence[object]) -> None:
    dates = pd.date_range("2024-05-01", periods=40, freq="min")
    cells = [(k, i) for k in range(40) for i in range(3)]
    cells = sorted(cells, key=lambda each: each[1]) if by_tag and tags[0] == "F.PV" else cells
    rows = "".join(f"{dates[k]},{tags[i]},{100 * i + k / 10}\n" for k, i in cells)
    path = text_file(tmp_path, f"time,tag,value\n{rows}")
    said = message(path)
    assert "column 'tag' names several signals, one measurement a row" in said
    assert "ignores" not in said
    found = sb.read(path, **option(said, "long"))
    assert (len(found), found.sampling_time) == (40, 60)
    order = [found.columns.index(str(tag)) for tag in tags]
    np.testing.assert_allclose(
        found.y[:, order], np.arange(40)[:, None] / 10 + [0, 100, 200], rtol=1e-12
    )


@pytest.mark.filterwarnings("ignore::splitband.records.signals.ReadingWarning")
@pytest.mark.parametrize("named", [False, True])
def test_signals_with_stamps_of_their_own(tmp_path: Path, named: bool) -> None:
    """A set-point that is logged on change among the rows of an even signal, at other stamps.

    `inspect` takes words for inputs, and is told the same.
    """
    at, changes = np.arange(200) / 10 + 0.013, np.arange(0, 20, 1.5)
    levels = np.random.default_rng(0).uniform(-1, 1, len(changes))
    parts = [pd.DataFrame({"ts": at, "name": "level", "val": np.sin(at)})]
    parts += [pd.DataFrame({"ts": changes, "name": "valve", "val": levels})]
    table = pd.concat(parts).sort_values("ts")
    table.to_csv(tmp_path / "long.csv", index=False)
    inputs: Any = (lambda column: not pd.api.types.is_numeric_dtype(column)) if named else ()
    said = message(tmp_path / "long.csv", time_column="ts", inputs=inputs)
    found = sb.read(tmp_path / "long.csv", inputs="valve", **option(said, "long"))
    assert found.sampling_time == 0.1
    np.testing.assert_allclose(found.y[:, 0], np.sin(found.time), atol=1e-9)
    at_once = np.searchsorted(changes, found.time + 1e-9, side="right") - 1
    held = np.searchsorted(changes, found.time + 0.1 - 1e-9, side="right") - 1 == at_once
    np.testing.assert_allclose(found.u[held, 0], levels[at_once[held]], rtol=1e-9)
    status = pd.DataFrame({"ts": np.cumsum(np.arange(60) % 7 + 1), "val": 1.0})
    status["name"] = np.where(status.index % 9, "ok", "bad")  # a word beside every value
    status.to_csv(tmp_path / "status.csv", index=False)
    assert "long" not in message(tmp_path / "status.csv", time_column="ts", inputs=inputs)


def test_values_of_one_signal_at_one_time_are_said(tmp_path: Path) -> None:
    rows = "".join(f"{tag},{t},{t}\n" for t in [*range(9), 4, 5] for tag in "ab")
    with pytest.warns(ReadingWarning, match=r"one signal .* the last counts \(4 are left out\)"):
        sb.read(text_file(tmp_path, f"tag,time,value\n{rows}"), long=("tag", "time", "value"))


@pytest.mark.parametrize("column", ["run", "day", None])
def test_several_runs_in_one_file_are_several_records(tmp_path: Path, column: str | None) -> None:
    g, parts = np.random.default_rng(1), []
    for i in range(8):
        u = np.repeat(g.uniform(-1, 1, 3), 20)
        x = scipy.signal.lfilter([0, 0.05], [1, -0.95], u, zi=[g.normal(0, 3)])[0]
        part = pd.DataFrame({"time": np.arange(60) / 10, "u": u, "x": x})
        words: dict[str, Any] = {"run": i, "day": f"d{i}"}
        parts.append(part if column is None else part.assign(**{column: words[column]}))
    table = pd.concat(parts)
    table.to_csv(tmp_path / "runs.csv", index=False)
    said = message(tmp_path / "runs.csv", columns="x", inputs="u")
    assert "the clock begins again (7 times), so the file holds several runs" in said
    assert ("which column" in said) == (column is not None)
    assert ("if it names signals" in said) == (column == "day")
    assert "ignores" not in said
    records = sb.read(tmp_path / "runs.csv", inputs="u", **option(said, "runs"))
    assert [len(record) for record in records] == [60] * 8
    model = sb.Linear().fit(*records[1:])
    test = records[0]
    found = model.predict(40, test[:20], u=test.u[20:], other_record=True)
    assert sb.fit_percent(test.y[20:], found.y)[0] > 99


@pytest.mark.parametrize("begin", ["2024-10-27 00:00", "2024-03-31 00:00"])
@pytest.mark.parametrize("step", [15, 60])
def test_stamps_of_a_clock_that_is_changed(tmp_path: Path, begin: str, step: int) -> None:
    times = pd.date_range(begin, periods=40, freq=f"{step}min", tz="Europe/Berlin")
    path = stamped(tmp_path, [f"{time:%Y-%m-%d %H:%M}" for time in times], "time")
    said = message(path)
    assert "if summer time began or ended there, name the zone" in said
    found = sb.read(told(said, table=pd.read_csv(path)))
    assert (len(found), found.sampling_time, found.start) == (40, 60 * step, times[0])


def test_rows_that_stand_twice_and_rows_out_of_order(tmp_path: Path) -> None:
    twice, mixed = [0, 1, 2, 2, 3, 4, 5, 6], [0, 1, 3, 2, 4, 5, 6]
    path = text_file(tmp_path, "t,y\n" + "".join(f"{t},{i}\n" for i, t in enumerate(twice)))
    with pytest.warns(ReadingWarning, match="of rows of one time the last counts"):
        found = sb.read(path, **option(message(path), "step"))
    np.testing.assert_array_equal(found.y[:, 0], [0, 1, 3, 4, 5, 6, 7])
    path = text_file(tmp_path, "t,y\n" + "".join(f"{row},{row**2}\n" for row in mixed))
    found = sb.read(told(message(path), table=pd.read_csv(path)))
    np.testing.assert_array_equal(found.y[:, 0], np.arange(7.0) ** 2)
    assert "step='auto'" not in message(path)  # which does not put rows in order
    assert message(path, step="auto").startswith(message(path).split(" (line")[0])


def test_serial_days_beside_fractions_are_added(tmp_path: Path) -> None:
    rows = "".join(f"{45292 + i // 24},{i % 24 / 24:.9f},{i}\n" for i in range(48))
    path = text_file(tmp_path, f"Date,Time,y\n{rows}")
    said = message(path)
    assert "it begins again with each 'Date'" in said
    with pytest.warns(ReadingWarning, match="Excel's serial days"):
        found = sb.read(told(said, table=pd.read_csv(path)))
    assert found.sampling_time == pytest.approx(3600, rel=1e-6)
    assert found.columns == ("y",)


@pytest.mark.parametrize(
    ("cell", "said", "old", "new", "step"),
    [
        ("2024-03-01,{h}00", "write times of the day as 09:30", "00,", ":00,", 3600),
        ("2024-03-01,{h}:00 UTC+1", "+01:00 for an hour east", " UTC+1", "+01:00", 3600),
    ],
)
def test_stamps_that_are_to_be_written_otherwise(
    tmp_path: Path, cell: str, said: str, old: str, new: str, step: float
) -> None:
    text = "Date,Time,y\n" + "".join(f"{cell.format(h=h)},{h}\n" for h in range(10, 24))
    assert said in message(text_file(tmp_path, text))
    found = sb.read(text_file(tmp_path, text.replace(old, new)))
    assert (found.sampling_time, len(found), found.columns) == (step, 14, ("y",))


def test_jitter_is_ignored_where_nothing_else_is_wrong(tmp_path: Path) -> None:
    jitter = np.random.default_rng(3).integers(-40, 40, 50)
    path = stamped(tmp_path, [5020 + 1020 * i + jitter[i] for i in range(50)], "timestamp")
    assert "milliseconds (1.0" in message(path)
    said = message(path, sampling_time=1.0)
    assert "must be even" in said
    assert "--time-column ''" in said
    found = sb.read(path, sampling_time=1.0, time_column="")
    np.testing.assert_array_equal(found.y[:, 0], np.arange(50))


@pytest.mark.parametrize(
    ("stamp", "start"),
    [
        (lambda d, h: f" {d:%m/%d}  {h:02d}:00:00", 3600.0),
        (lambda d, h: f"{d:%Y-%m-%d} {h:02d}:00", pd.Timestamp("2023-01-01 01:00")),
        (lambda d, h: f"{d:%Y-%m-%d}T{h:02d}:00:00Z", pd.Timestamp("2023-01-01 01:00Z")),
        (lambda d, h: f"{h:02d}:00", None),
    ],
)
@pytest.mark.filterwarnings("ignore:.*has no year")
def test_days_may_end_at_24(tmp_path: Path, stamp: Callable[..., str], start: Any) -> None:
    days = pd.date_range("2023-01-01", periods=400)  # past the end of a year
    stamps = [stamp(day, hour) for day in days for hour in range(1, 25)]
    options: dict[str, Any] = {} if start else {"sampling_time": 3600}
    found = sb.read(stamped(tmp_path, stamps, "time"), **options)
    assert (len(found), found.sampling_time) == (9600, 3600)
    assert start is None or found.start == start


def test_dates_without_a_year_are_said(tmp_path: Path) -> None:
    stamps = [f"02/03 {hour:02d}:00" for hour in range(1, 25)]
    with pytest.warns(ReadingWarning, match="has no year: .* seconds since 1 January, from 03 Feb"):
        assert sb.read(stamped(tmp_path, stamps, "time")).start == 33 * 86400 + 3600


@pytest.mark.parametrize(
    ("name", "number", "step"),
    [("Time_ms", lambda d: f"{1e6 * d:.2f}", 2), ("time", lambda d: f"{1e7 * (d - 45418):.2f}", 0)],
)
def test_dates_beside_serial_numbers_are_compared(
    tmp_path: Path, name: str, number: Callable[[float], str], step: float
) -> None:
    """WinCC's millionths of a day, and ticks of nobody's."""
    dates = pd.date_range("2024-05-06 08:00", periods=60, freq="2s")
    days = (dates - pd.Timestamp("1899-12-30")) / pd.Timedelta(1, "D")
    both = enumerate(zip(dates, days, strict=True))
    rows = "".join(f"{d:%d.%m.%Y %H:%M:%S},{number(n)},{i}\n" for i, (d, n) in both)
    path = text_file(tmp_path, f"TimeString,{name},y\n{rows}")
    if step:
        with pytest.warns(ReadingWarning, match="millionths of Excel's serial days, read as dates"):
            found = sb.read(path, columns="y")
        assert isinstance(found.start, pd.Timestamp)
        assert abs(found.start - dates[0]) < pd.Timedelta("1ms")
    else:
        assert "time_column='time' or 'TimeString' (--time-column)" in message(path, columns="y")
        found = sb.read(path, columns="y", time_column="TimeString")
        assert sb.read(path, columns="y", time_column="time").sampling_time > 200
    assert found.sampling_time == 2


@pytest.mark.parametrize(
    "text",
    [
        "t\tcode\tq\n" + "".join(f"2024-03-01 00:00:{i:02d}\tP\t{i}\n" for i in range(40)),
        "t|mode|q\n" + "".join(f"2024-03-01 00:00:{i:02d}|mode {i % 3}|{i}\n" for i in range(40)),
        "t, z, q, c, h, d\n"
        + "".join(f"2024-03-01 00:00:{i:02d}, EST, {i}, P, 1, P\n" for i in range(40)),
    ],
)
@pytest.mark.parametrize("name", ["log.txt", "log.csv"])
def test_words_and_dates_with_blanks_between_other_separators(
    tmp_path: Path, text: str, name: str
) -> None:
    found = sb.read(text_file(tmp_path, text, name), columns="q", time_column="t")
    assert found.sampling_time == 1
    np.testing.assert_array_equal(found.y[:, 0], np.arange(40))


@pytest.mark.parametrize(
    ("on", "off"),
    [("ON", "OFF"), ("True", "False"), ("Active", "inactive")],
)
def test_switches_are_read_as_1_and_0(tmp_path: Path, on: str, off: str) -> None:
    states = np.arange(40) % 3 == 0
    rows = "".join(f"{i},{on if state else off},{i}\n" for i, state in enumerate(states))
    path = text_file(tmp_path, f"time,valve,y\n{rows}".replace(f"5,{off},5", "5,,5"))
    with pytest.warns(ReadingWarning) as caught:
        found = sb.read(path, inputs="valve", gaps="mask")
    np.testing.assert_array_equal(np.delete(found.u[:, 0], 5), np.delete(states, 5))
    said = f"words of column 'valve' are read as 0 ({off}) and 1 ({on})"
    assert any(said in str(each.message) for each in caught) or on == "True"  # which pandas reads


def test_words_become_a_column_each_but_the_first_in_other_files_too(tmp_path: Path) -> None:
    """The oracle is pandas.get_dummies; a file without some of the words is read alike."""
    words = np.resize(["auto", "heat", "cool", "heat"], 40)
    table = pd.DataFrame({"time": range(40), "mode": words, "fan": "Off", "y": range(40)})
    table.loc[7, "fan"] = "On"
    with pytest.warns(ReadingWarning) as caught:
        found = sb.read(table, inputs=["mode", "fan"])
    said = "words of column 'mode' are read as 2 inputs, mode=cool, mode=heat: 0 in all is auto"
    assert said in str(caught[0].message)
    assert found.inputs == ("mode=cool", "mode=heat", "fan")
    assert "fan (0 Off, 1 On)" in repr(found)
    expected = pd.get_dummies(table[["mode", "fan"]], drop_first=True)
    np.testing.assert_array_equal(found.u, expected)
    kept = found.reading.categories
    table["mode"], table["fan"] = "heat", "on"
    with pytest.warns(ReadingWarning):
        alike = sb.read(table, inputs=found.inputs, columns="y", reading=found.reading)
    assert (alike.inputs, alike.reading.categories) == (found.inputs, kept)
    np.testing.assert_array_equal(alike.u, np.tile([0, 1, 1], (40, 1)))
    table.loc[3, "mode"] = "dry"
    with pytest.raises(
        sb.InputError, match=r"'mode' must hold one of auto, cool, heat: row 3 .*dry"
    ):
        sb.read(table, inputs=found.inputs, reading=found.reading)


def test_words_of_an_output_need_numbers(tmp_path: Path) -> None:
    rows = "".join(f"{i},{('AUTO', 'MAN', 'OFF')[i % 3]},{i}\n" for i in range(9))
    path = text_file(tmp_path, f"time,mode,y\n{rows}")
    said = message(path, columns="mode")
    assert "--missing" not in said
    table = pd.read_csv(path)
    table["mode"] = told(said, table=table)
    found = sb.read(table, columns="mode")
    np.testing.assert_array_equal(found.y[:, 0], np.arange(9) % 3)


def zipped(path: Path, text: bytes) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("record.csv", text)


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("record.csv.gz", lambda path, text: path.write_bytes(gzip.compress(text))),
        ("record.csv.bz2", lambda path, text: path.write_bytes(bz2.compress(text))),
        ("record.csv.xz", lambda path, text: path.write_bytes(lzma.compress(text))),
        ("record.zip", zipped),
    ],
)
def test_packed_text(tmp_path: Path, name: str, write: Callable[[Path, bytes], object]) -> None:
    write(tmp_path / name, CSV.encode())
    found = sb.read(tmp_path / name, inputs="u")
    assert (found.name, found.columns, found.sampling_time) == ("record", ("y",), 0.1)
    (tmp_path / name).write_bytes((tmp_path / name).read_bytes()[:40])
    assert "cannot be read as" in message(tmp_path / name)


@pytest.mark.parametrize(
    "index",
    [
        pd.date_range("2024", periods=40, freq="s"),
        pd.to_timedelta(np.arange(40), "s"),
        pd.period_range("2024", periods=40, freq="s"),
        pd.Index(np.arange(40.0)),
        pd.Index(np.arange(40), name="time"),
    ],
    ids=["dates", "durations", "periods", "numbers", "named"],
)
def test_a_series_and_its_index(index: pd.Index) -> None:
    for name in ("x", None):
        found = sb.read(pd.Series(np.arange(40.0) ** 2, index, name=name))
        assert (found.columns, found.sampling_time) == ((name or "y",), 1)
        np.testing.assert_array_equal(found.y[:, 0], np.arange(40.0) ** 2)
    table = pd.DataFrame({"time": np.arange(40), "y": 1.0 * np.arange(40)}, index)
    if index.name is None:
        assert sb.read(table, time_column="time", columns="y").sampling_time == 1


def test_an_index_of_several_levels_is_refused() -> None:
    index = pd.MultiIndex.from_product([["a", "b"], np.arange(30) / 10], names=["run", "time"])
    table = pd.DataFrame({"y": np.arange(60.0)}, index)
    with pytest.raises(sb.InputError, match=r"not 'run', 'time': table.xs\(..., level='run'\)"):
        sb.read(table, sampling_time=0.1)
    assert len(sb.read(table.xs("a", level="run"))) == 30
    whole = table.reset_index()
    found = sb.read(whole[whole["run"] == "b"], columns="y")
    np.testing.assert_array_equal(found.y[:, 0], np.arange(30, 60.0))


def test_measured_values_survive_a_longer_step() -> None:
    g, n = np.random.default_rng(1), 6000
    u = np.repeat(g.uniform(-1, 1, n // 40), 40)
    y = scipy.signal.lfilter([0, 0.02], [1, -0.98], u)
    holed = np.where((np.arange(n) % 10 == 0) & (np.arange(n) // 10 != 7), y, np.nan)
    record = sb.Record.with_gaps(holed, 0.01, u=u).resample(0.1)
    expected = pd.Series(holed).groupby(np.arange(n) // 10).mean()
    np.testing.assert_allclose(record.y_with_gaps[:, 0], expected, rtol=1e-12)
    assert np.isnan(record.y_with_gaps).sum() == 1
    model = sb.Linear().fit(record[:450])
    assert sb.fit_percent(y[4500::10], model.predict(150, u=record.u[450:]).y[:, 0]) > 95


def test_a_record_without_a_measured_sample_is_refused() -> None:
    empty = sb.Record(np.arange(50.0), 0.1, measured=np.zeros(50, bool))
    for model in (sb.Linear(), sb.Mean()):
        with pytest.raises(sb.InputError, match="records must have a measured sample of 'y'"):
            model.fit(empty)
    u = np.repeat(np.random.default_rng(0).uniform(-1, 1, 40), 20)
    y = np.column_stack([scipy.signal.lfilter([0, 1 - a], [1, -a], u) for a in (0.9, 0.95)])
    noisy = y + 0.01 * np.random.default_rng(1).standard_normal(y.shape)
    turns = np.where(np.arange(800)[:, None] % 2 == [0, 1], noisy, np.nan)  # never at one time
    found = sb.Linear().fit(sb.Record.with_gaps(turns, 0.1, u=u)[:600]).predict(200, u=u[600:])
    assert sb.fit_percent(y[600:], found.y).min() > 95

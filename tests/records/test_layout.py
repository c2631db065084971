"""Files as instruments, loggers and other programs write them: read, or refused with the line."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from splitband.records import read
from splitband.records.signals import ReadingWarning
from tests.records.support import message, text_file

Y = np.sin(np.arange(12) / 3).round(3)


def table(row: str, step: float) -> str:
    """Twelve rows, of the number, the time and the value of each."""
    begin, seconds = pd.Timestamp("2013-06-24 13:00"), [step * i for i in range(12)]
    rows = zip(seconds, begin + pd.to_timedelta(seconds, "s"), Y, strict=True)
    return "".join(
        f"{row.format(i=i, n=i + 1, before=step * (i - 1), t=t, at=at, y=y)}\n"
        for i, (t, at, y) in enumerate(rows)
    )


TOA5 = (
    '"TOA5","Roof","CR1000","1234","CR1000.Std.32","CPU:p.CR1","567","Fast"\n'
    '"TIMESTAMP","RECORD","T"\n"TS","RN","Deg C"\n"","","Avg"\n'
)
LVM = (
    "LabVIEW Measurement\t\nWriter_Version\t2\nSeparator\tTab\nDate\t2024/02/03\n"
    "Time\t10:00:00.123\n***End_of_Header***\t\n\t\nChannels\t1\t\nX_Dimension\tTime\t\n"
    "Delta_X\t0.001\t\n***End_of_Header***\t\t\nX_Value\tV\tComment\n"
)
DEWESOFT = (
    '"Data1"\n"File name","C:\\x.dxd"\n"Start time","5/16/2013 1:31:07 PM"\n"Channels","1"\n\n'
)
TEKTRONIX = (
    "Model,MSO44\nFirmware,1.28\n\nPoint Format,Y\nHorizontal Units,s\nSample Interval,4e-09\n"
    "Gating,0.0% to 100.0%\nVertical Scale,0.5\nLabel,\nTIME,T\n"
)
INFLUX = (
    "#group,false,false,true,false\n#datatype,string,long,dateTime:RFC3339,double\n"
    "#default,_result,,,\n,result,table,_time,T\n"
)


HOBO = '"Plot Title: Tank"\n"#","Date Time, GMT-04:00","T, °C (LGR S/N: 1, SEN: 2)"\n'
AGILENT = "Name:,Benchlink\nOwner:,Bob\n\nDate:,2/13/2024 10:00:00\nScan,Time,T\n"
OPTIONS: dict[str, dict[str, Any]] = {
    "a.lvm": {"time_column": "X_Value", "columns": "V"},
    "keysight.csv": {"time_column": "x-axis", "header_row": 1},
    "influx.csv": {"columns": "T"},
    "frame.csv": {"time_column": "0"},
    "several.csv": {"header_row": 2, "time_column": "Force"},
    "skip.csv": {"skip_rows": 2},
    "both.csv": {"skip_rows": 3, "header_row": 1},
    "none.csv": {"header_row": 0, "time_column": 0},
}


@pytest.mark.parametrize(
    ("name", "head", "row", "step", "column"),
    [
        ("a.dat", TOA5, '"{at:%Y-%m-%d %H:%M:%S}",{i},{y}', 60, "T [Deg C]"),
        ("a.lvm", LVM, "{t:.6f}\t{y}\t", 1e-3, "V"),
        ("hobo.csv", HOBO, "{n},{at:%m/%d/%y %I:%M:%S %p},{y}", 600, "T, °C (LGR S/N: 1, SEN: 2)"),
        ("dewesoft.csv", f'{DEWESOFT}"Time","T"\n"s","V"\n', "{t},{y}", 0.01, "T [V]"),
        ("tek.csv", TEKTRONIX, "{before:.9e},{y}", 4e-9, "T"),
        ("keysight.csv", "x-axis,1\nsecond,Volt\n", "{t:.6E},{y}", 1e-6, "1 [Volt]"),
        ("influx.csv", INFLUX, ",,0,2024-01-01T10:00:{i:02d}Z,{y}", 1, "T"),
        ("r.csv", '"time","T"\n', '"{n}",{t},{y}', 0.5, "T"),
        ("canape.csv", "Time[s],T[km/h]\ns,km/h\n", "{t:.1f},{y}", 0.1, "T[km/h]"),
        ("pico.csv", "Time,T\n(ms),(mV)\n\n", "{i:.5f},{y}", 1e-3, "T [mV]"),
        ("agilent.csv", AGILENT, "{n},2/13/2024 10:00:{i:02d}:250,{y}", 1, "T"),
        ("sep.csv", "sep=|\ntime|T\n", "{i}|{y}", 1, "T"),
        ("excel.csv", "sep=\t\r\ntime\tT\r\n", "{i}\t{y}\r", 1, "T"),
        ("numpy.csv", "# time,T\n", "{i},{y}", 1, "T"),
        ("units.txt", "# time,T\n# ms,V\n", "{i},{y}", 1e-3, "T [V]"),
        ("frame.csv", ",0,1\n", "{i},{i},{y}", 1, "1"),
        ("several.csv", "X,1\nForce,T\ns,mm\n", "{i},{y}", 1, "T [mm]"),
        ("skip.csv", "1,2\n3,4\ntime,T\n", "{i},{y}", 1, "T"),
        ("german.csv", "Zeitstempel;x\n;°C\n", "{at:%d.%m.%Y %H:%M:%S};{y}", 1, "x [°C]"),
        ("both.csv", "time,T\nx,1\n3,4\n", "{i},{y}", 1, "T"),
        ("none.csv", "", "{i},{y}", 1, "1"),
    ],
)
def test_headers_of_instruments(
    tmp_path: Path, name: str, head: str, row: str, step: float, column: str
) -> None:
    found = read(text_file(tmp_path, head + table(row, step), name), **OPTIONS.get(name, {}))
    assert found.columns == (column,)
    assert found.sampling_time == pytest.approx(step, rel=1e-9)
    np.testing.assert_array_equal(found.y[:, 0], Y)


@pytest.mark.parametrize(
    ("text", "options", "words"),
    [
        ("time,y\n0,Bad\n1,2\n2,3\n", {}, "line 2 holds '0' and 'Bad'"),
        ("Rate,100 Hz\nu,y\n1,2\n2,3\n", {}, "each of the lines 1 and 2 may hold the names"),
        ("y\nmm\n1\n2\n", {}, "may hold the names of the columns: header_row=1"),
        ("Logger X1\n1,2\n2,3\n", {}, "line 1 holds 1 name, line 2 2 cells: skip_rows=1"),
        ("u,y\n0,5,1,5\n1,5,2,5\n", {}, "decimal commas need ; or tabs"),
        ("time x\n1 0.5 2\n2 1 3\n", {}, "line 1 holds 2 names, line 2 3 cells"),
        ("Name;a;Name;b\nUnit;;Unit;\n\n0;1;0;2\n1;2;1;3\n", {}, "'Name [Unit]' stands 2 times"),
        ("time,x,x\n0,1,2\n1,3,4\n", {}, "'x' stands 2 times; rename all but one"),
        ("time,y\n0,1\n1,2\ntime,y\n2,3\n", {}, "row 2 holds 'time' (line 4)"),
        ("time,y\n0,1\n1,2\n2,3\nEnd,\n", {}, "row 3 holds 'End' (line 5)"),
        ("# rig\n\ntime,y\n0,1\n1,OL\n2,3\n", {}, "row 1 holds 'OL' (line 5); missing (--missing)"),
        ("1,2\n3,4\ntime,y\n0,1\n1,2\n", {"sampling_time": 1}, "row 2 holds 'time' (line 3)"),
        ("time,y\n0,1\n1,2\n2,3\n", {"header_row": 0, "time_column": 0}, "holds 'time' (line 1)"),
        ("time,y\n1,0,5\n2,1,6\n", {"header_row": 1}, "a name for each column: it has 2, line 2"),
        ("time,y\n0,1\n1,2\n", {"header_row": 5}, "header_row is 5, but there are 4 lines"),
        ("time,y\n0,1\n1,2\n", {"skip_rows": 9}, "it holds no data"),
        ("time,y\n0,1\n1,2\n", {"skip_rows": -1}, "skip_rows must be a number of lines"),
        ('time,y,note\n0,1,"on\n1,2,ok\n2,3,"off"\n3,4,\n', {}, "line 2 has a quote"),
    ],
)
def test_what_is_left_open_is_refused_with_the_line(
    tmp_path: Path, text: str, options: dict[str, Any], words: str
) -> None:
    path = text_file(tmp_path, text)
    assert words in message(path, **options)


def test_cells_in_quotes_may_hold_separators_quotes_and_line_breaks(tmp_path: Path) -> None:
    text = 'time,note,y\n0,"pump on; valve open",1\n1,"a\nb, ""c"" 5\n",2\n2,,4\n3,x,bad\n'
    path = text_file(tmp_path, text)
    assert "row 3 holds 'bad' (line 7)" in message(path)
    with pytest.warns(ReadingWarning, match="'note'"):
        found = read(path, missing="bad", gaps="mask")
    np.testing.assert_array_equal(found.y_with_gaps[:, 0], [1, 2, 4, np.nan])


@pytest.mark.parametrize(
    ("text", "missing", "values"),
    [
        ("t,y\n0,Bad\n1,2\n2,--\n3,4\n", ["Bad", "--"], [np.nan, 2, np.nan, 4]),
        ("t,y\n0,1\n1,-9999\n2,3\n3,4\n", ["-9999"], [1, np.nan, 3, 4]),
        ("t;y\n0;1,5\n1;-200\n2;3,5\n3;-200,0\n", "-200", [1.5, np.nan, 3.5, np.nan]),
        ('t,y\n0,1\n1,"NAN"\n2,3\n3,4\n', (), [1, np.nan, 3, 4]),
        ("t,y\n0,1\n1,Bad\n2,-9999.00\n3,4\n", ["Bad", "-9999"], [1, np.nan, np.nan, 4]),
    ],
)
def test_words_for_missing_values(
    tmp_path: Path, text: str, missing: Any, values: list[float]
) -> None:
    found = read(text_file(tmp_path, text), missing=missing, gaps="mask")
    np.testing.assert_array_equal(found.y_with_gaps[:, 0], values)


def test_a_frame_may_have_words_for_missing_values_but_no_lines() -> None:
    frame = pd.DataFrame({"t": [0, 1, 2], "y": [1, "Bad", 3]})
    np.testing.assert_array_equal(
        read(frame, missing="Bad", gaps="mask").y_with_gaps[:, 0], [1, np.nan, 3]
    )
    with pytest.raises(ValueError, match="skip_rows and header_row are for text"):
        read(frame, skip_rows=1)


UNITS = "time,u,y\ns,V,mm\n0,1,2\n1,2,3\n2,3,5\n"


@pytest.mark.parametrize(
    ("text", "options", "columns", "values"),
    [
        ("0,1\n1,4\n2,9\n", {"sampling_time": 1}, "01", [[0, 1], [1, 4], [2, 9]]),
        ("\ufeff1,2\n3,4\n", {"sampling_time": 1}, "01", [[1, 2], [3, 4]]),
        ("Record,time,y\n7,0,2\n8,1,4\n9,2,5\n", {}, "y", [[2], [4], [5]]),  # numbers of rows
        ("time;y\n0;1\n1;2\n2;4\n;\n;\n", {}, "y", [[1], [2], [4]]),  # empty rows at the end
        (UNITS, {"columns": "y", "inputs": "u [V]"}, ["y [mm]"], [[2], [3], [5]]),
    ],
)
def test_what_is_data_and_what_is_not(
    tmp_path: Path, text: str, options: dict[str, Any], columns: Sequence[str], values: Any
) -> None:
    found = read(text_file(tmp_path, text), **options)
    assert found.columns == (*columns,)
    np.testing.assert_array_equal(found.y, values)

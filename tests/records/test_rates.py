"""Uneven stamps, columns at several rates and logged changes become an even record."""

from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

import splitband as sb
from splitband.records.signals import ReadingWarning
from splitband.runtime.arrays import Array
from tests.cli.support import call

pytestmark = pytest.mark.filterwarnings("ignore::splitband.records.signals.ReadingWarning")
STEP, N = 0.1, 2000


def plant(changes: Array, levels: Array, times: Array) -> Array:
    """The exact response of x' = 2 (u - x) at some times, u constant between its changes."""
    every = np.union1d(changes, times)
    x = np.zeros(len(every))
    for i, (begin, end) in enumerate(pairwise(every), 1):
        u = levels[np.searchsorted(changes, begin, side="right") - 1]
        x[i] = u + (x[i - 1] - u) * np.exp(-2 * (end - begin))
    return x[np.searchsorted(every, times)]


def logged(jitter: float, seed: int = 0, n: int = N) -> pd.DataFrame:
    """A table of a plant whose input is changed, and logged, with stamps that jitter."""
    g = np.random.default_rng(seed)
    times = STEP * (np.arange(n) + g.uniform(-jitter, jitter, n))
    levels = g.uniform(-1, 1, n // 20)
    x = plant(times[::20], levels, times)
    return pd.DataFrame({"time": times, "u": np.repeat(levels, 20), "x": x})


def fit_of(record: sb.Record) -> float:
    """The fit of a linear model on the last quarter, in %."""
    train = 3 * len(record) // 4
    model = sb.Linear().fit(record[:train])
    found = model.predict(len(record) - train, u=record.u[train:]).y
    seen = record.complete[train:]
    return float(sb.fit_percent(record.y[train:][seen], found[seen])[0])


@pytest.mark.parametrize("jitter", [0.03, 0.1, 0.3])
def test_stamps_that_jitter(jitter: float) -> None:
    table = logged(jitter)
    with pytest.raises(sb.InputError, match=r"step=0\.1 \(--step 0\.1\) puts .* up to \d"):
        sb.read(table, inputs="u")
    record = sb.read(table, inputs="u", step="auto")
    assert record.sampling_time == STEP
    assert record.start == pytest.approx(0.0, abs=1e-9)
    assert abs(len(record) - N) <= 1
    assert record.complete.mean() > 0.99
    assert record.reading.grid == STEP
    assert record.reading.hold == ("u",)
    assert "uneven stamps put on a grid of 0.1 s; u held between values" in repr(record)
    np.testing.assert_allclose(
        record.y[:, 0], np.interp(record.time, table["time"], table["x"]), atol=1e-9
    )
    assert fit_of(record) > 99


def test_even_stamps_stay_as_they_are() -> None:
    table = logged(0.0)
    plain, even = sb.read(table, inputs="u"), sb.read(table, inputs="u", step="auto")
    np.testing.assert_array_equal(even.y, plain.y)
    assert even.reading == plain.reading
    longer = sb.read(table, inputs="u", step=0.5)
    np.testing.assert_array_equal(longer.y, plain.resample(0.5).y)


def test_values_far_from_a_stamp_are_not_measured() -> None:
    table = logged(0.1)
    holed = table.drop(index=range(500, 540)).reset_index(drop=True)
    record = sb.read(holed, inputs="u", step=STEP)
    assert 38 <= (~record.complete).sum() <= 43
    assert not record.complete[501:539].any()
    assert record.complete[:499].all()
    assert record.complete[542:].all()


def holed_after(late: float, hole: int = 40) -> pd.DataFrame:
    """A table with a hole, and its first stamp after the hole so many s beside the grid."""
    table = logged(0.1)
    table.loc[540, "time"] = 54.0 + late
    return table.drop(index=range(540 - hole, 540)).reset_index(drop=True)


@pytest.mark.parametrize("hold", ["u", ()])
@pytest.mark.parametrize("late", [-0.002, 0.002])
def test_the_first_stamp_after_a_hole_gives_the_input_of_its_sample(hold: Any, late: float) -> None:
    table = holed_after(late)
    record = sb.read(table, inputs="u", step=STEP, hold=hold)
    at = int(np.rint((54.0 - record.time[0]) / STEP))
    np.testing.assert_allclose(record.u[at : at + 2, 0], table["u"][500], rtol=1e-12)
    assert record.complete[at + 1]


@pytest.mark.parametrize("hold", ["u", ()])
def test_a_hole_is_filled_alike_in_records_and_in_planned_inputs(tmp_path: Path, hold: Any) -> None:
    """The oracle is the table with the rows of the hole, filled by pandas and by NumPy."""
    holed, whole = holed_after(0.0), holed_after(0.0, hole=0)
    seen = whole["u"].mask(whole.index.isin(range(500, 540)))
    between = np.interp(whole["time"], whole["time"][seen.notna()], seen.dropna())
    whole["u"] = seen.ffill() if hold else between
    files = {}
    for name, table in {"holed": holed, "whole": whole}.items():
        files[name] = tmp_path / f"{name}.csv"
        table.to_csv(files[name], index=False)
    read = [sb.read(file, inputs="u", step=STEP, hold=hold) for file in files.values()]
    np.testing.assert_allclose(read[0].u, read[1].u, atol=1e-9)
    sb.Linear().fit(read[1][:400]).save(tmp_path / "model")
    found = []
    for file in files.values():
        line = f"simulate {tmp_path / 'model'} --steps 400 --future-inputs {file}"
        call(line, tmp_path / "ahead.csv")
        found.append(pd.read_csv(tmp_path / "ahead.csv"))
    np.testing.assert_allclose(found[0]["x"], found[1]["x"], atol=1e-9)


def test_a_further_file_is_read_as_the_first_one_or_refused() -> None:
    first, table = sb.read(logged(0.2), inputs="u", step=STEP), logged(0.2, seed=1)
    table["u"] = np.sin(0.3 * table["time"])
    model, other = sb.Linear().fit(first), sb.read(table, inputs="u", step=STEP)
    says = r"'u' of history must be held between .* got interpolated.*reading=.*hold \(--hold\)"
    with pytest.raises(sb.InputError, match=says):
        model.predict(3, history=other[:100], u=other.u[100:103])
    for how in ({"reading": first.reading}, {"hold": "u"}):
        other = sb.read(table, inputs="u", step=STEP, **how)
        model.predict(3, history=other[:100], u=other.u[100:103], other_record=True)


def test_a_command_with_sweeps_is_held() -> None:
    """Most of its variance is smooth, but most of its values repeat the last one."""
    table = logged(0.2)
    sweep = 20 * np.sin(table["time"])
    table["u"] = table["u"].where(table["time"] < 120, sweep)
    assert sb.read(table, inputs="u", step=STEP).reading.hold == ("u",)


def test_events_are_put_on_a_grid() -> None:
    g = np.random.default_rng(2)
    times = np.cumsum(g.exponential(0.1, 3000))
    table = pd.DataFrame({"time": times, "x": np.sin(times)})
    record = sb.read(table, step=0.05)
    assert 0.3 < record.complete.mean() < 0.6
    error = record.y[:, 0] - np.sin(record.time)
    assert np.abs(error[record.complete]).max() < 0.03

    usual = sb.read(table, step="auto")  # with which most of them are near to others
    assert usual.complete.mean() > 0.75


def test_even_stamps_with_one_row_twice_keep_every_value() -> None:
    table = logged(0.0, n=400)
    record = sb.read(pd.concat([table, table[100:110]]).sort_values("time"), step="auto")
    assert (record.start, len(record)) == (0.0, 400)
    np.testing.assert_array_equal(record.y, table[["u", "x"]])


def test_a_longer_step_does_not_alias() -> None:
    """A tone above half of the new rate folds down where samples are picked, hardly in means."""
    g = np.random.default_rng(3)
    times = 0.01 * (np.arange(6000) + g.uniform(-0.1, 0.1, 6000))
    tone = np.sin(2 * np.pi * 9.3 * times)  # folds to 0.7 Hz at 10 Hz
    table = pd.DataFrame({"time": times, "x": np.sin(2 * np.pi * 0.2 * times) + tone})
    record = sb.read(table, step=0.1)
    assert record.reading.step == pytest.approx(0.01)
    middle = record.time - 0.045
    left = record.y[:, 0] - np.sinc(0.02) * np.sin(2 * np.pi * 0.2 * middle)
    assert np.std(left) < 0.1 * np.std(tone)


@pytest.mark.parametrize("jitter", [0.0, 0.2])
def test_a_slow_output_is_measured_at_its_own_stamps(jitter: float) -> None:
    table = logged(jitter)
    slow = table.assign(x=table["x"].where(table.index % 10 == 0))
    record = sb.read(slow, inputs="u", step="auto" if jitter else None)
    assert record.complete.sum() == N / 10
    own = np.flatnonzero(record.complete)
    np.testing.assert_array_equal(np.diff(own), 10)
    np.testing.assert_allclose(record.y[own, 0], table["x"][::10], atol=0.1 if jitter else 1e-12)
    assert fit_of(record) > 98


def test_an_input_logged_on_change_is_held_from_cell_to_cell() -> None:
    table = logged(0.0)
    changes = table.assign(u=table["u"].where(table["u"].diff() != 0))
    with pytest.warns(ReadingWarning, match="inputs held between their values: u"):
        record = sb.read(changes, inputs="u")
    np.testing.assert_array_equal(record.u, table[["u"]])
    assert record.measured is None
    assert record.reading.hold == ("u",)
    irregular = changes.assign(u=changes["u"].mask(changes.index == 40))
    with pytest.raises(sb.InputError, match=r"inputs='u' \(--inputs u\)"):
        sb.read(irregular.assign(u=irregular["u"].mask(np.arange(N) % 60 == 0)))


@pytest.mark.parametrize(("hold", "held"), [(None, ("u",)), ("v", ("v",)), ((), ())])
def test_inputs_are_held_or_interpolated(hold: Any, held: tuple[str, ...]) -> None:
    table = logged(0.2)
    table["v"] = np.sin(0.3 * table["time"])
    record = sb.read(table, inputs=["u", "v"], step=STEP, hold=hold)
    assert record.reading.hold == held
    if hold is None:
        np.testing.assert_allclose(record.u[1:-1, 1], np.sin(0.3 * record.time)[1:-1], atol=1e-3)


def test_an_angle_goes_on_before_it_is_interpolated() -> None:
    times = logged(0.3)["time"]
    table = pd.DataFrame({"time": times, "heading": 100 * times % 360})
    record = sb.read(table, step=STEP, unwrap={"heading": 360})
    np.testing.assert_allclose(np.diff(record.y[1:-1, 0]), 10, rtol=1e-6)


def test_runs_are_read_alike() -> None:
    parts = [logged(0.2, seed).assign(run=f"r{seed}") for seed in range(3)]
    records = sb.read(pd.concat(parts), inputs="u", runs="run", step="auto")
    assert [record.name for record in records] == ["r0", "r1", "r2"]
    assert {record.sampling_time for record in records} == {STEP}
    sb.Linear().fit(*records)
    smooth = [logged(jitter, i).assign(run=i) for i, jitter in enumerate((0.0, 0.2, 0.0, 0.2))]
    table = pd.concat(smooth).assign(u=lambda each: np.sin(each["time"]))
    held = sb.read(table, inputs="u", runs="run", step="auto", hold="u")
    assert [record.reading.hold for record in held] == [None, ("u",)] * 2
    again = sb.read(pd.concat(parts).drop(columns="run"), inputs="u", runs="time", step="auto")
    for one, other in zip(records, again, strict=True):
        np.testing.assert_array_equal(one.y, other.y)


@pytest.mark.parametrize("dates", [False, True])
@pytest.mark.parametrize("offset", [None, 1.5])
def test_files_of_one_run_are_joined(tmp_path: Path, dates: bool, offset: float | None) -> None:
    table = logged(0.1)
    smooth = np.sin(table["time"])
    begin = pd.Timestamp("2024-05-01")
    clock = [table["time"], table["time"] - 1.5]
    if dates:
        clock = [begin + pd.to_timedelta(each, unit="s") for each in clock]
    one = pd.DataFrame({"time": clock[0], "x": table["x"], "p": smooth})
    two = pd.DataFrame({"time": clock[1], "u": table["u"], "p": smooth})[:-50]
    one.to_csv(tmp_path / "rig.csv", index=False)
    two.drop(columns=[] if offset is None else "p").to_csv(tmp_path / "pump.csv", index=False)
    record = sb.read(
        tmp_path / "rig.csv",
        columns="x",
        inputs="u",
        join={tmp_path / "pump.csv": offset},
    )
    whole = sb.read(table, inputs="u", step=STEP)
    assert record.sampling_time == pytest.approx(STEP)
    assert fit_of(record) > 98
    assert abs(len(record) - len(whole)) <= 1
    assert 45 < (~record.complete).sum() < 55  # the pump's record ends before


def test_clocks_of_joined_files_need_an_offset(tmp_path: Path) -> None:
    table = logged(0.1)
    dates = pd.Timestamp("2024-05-01") + pd.to_timedelta(table["time"], unit="s")
    table[["time", "x"]].to_csv(tmp_path / "rig.csv", index=False)
    other = table[["u"]].assign(time=dates)
    other.to_csv(tmp_path / "pump.csv", index=False)
    with pytest.raises(sb.InputError, match="only one of them has dates"):
        sb.read(tmp_path / "rig.csv", join=tmp_path / "pump.csv")
    table[["u"]].assign(time=table["time"] + 3600).to_csv(tmp_path / "pump.csv", index=False)
    with pytest.raises(sb.InputError, match=r"3400\.\d+ s apart; pump\.csv@\+1\.5 \(--join\)"):
        sb.read(tmp_path / "rig.csv", join=tmp_path / "pump.csv")
    assert sb.read(tmp_path / "rig.csv", join={tmp_path / "pump.csv": -3600}).complete.all()


def test_words_are_held_between_changes_in_a_file_of_their_own_and_in_runs(tmp_path: Path) -> None:
    """The oracle is pandas.get_dummies; the first run lacks a word that the second one has."""
    words = np.repeat(np.resize(["auto", "heat", "auto", "cool"], 12), 10)
    y, time = np.sin(np.arange(120.0)), np.arange(120.0)
    expected = pd.get_dummies(pd.Series(words), drop_first=True).to_numpy(np.float64)
    changed = np.arange(0, 120, 10)
    logged = pd.DataFrame({"time [s]": time[changed], "mode": words[changed]})
    logged.to_csv(tmp_path / "mode.csv", index=False)
    table = pd.DataFrame({"time": time, "y": y})
    with pytest.warns(ReadingWarning):
        joined = sb.read(table, inputs="mode", join=str(tmp_path / "mode.csv"))
    assert joined.inputs == ("mode=cool", "mode=heat")
    np.testing.assert_array_equal(joined.u, expected)
    first, second = (table.assign(mode=words, run=run) for run in "ab")
    first["mode"] = first["mode"].replace("cool", "heat")
    with pytest.warns(ReadingWarning):
        runs = sb.read(pd.concat([first, second]), inputs="mode", runs="run")
    assert [run.inputs for run in runs] == [joined.inputs] * 2
    np.testing.assert_array_equal(runs[1].u, expected)
    assert runs[0].reading.categories == {"mode": ("auto", "cool", "heat")}


def test_the_sampling_time_decides_on_the_unit_of_a_joined_file_too(tmp_path: Path) -> None:
    """Whole steps of 10 may be seconds or milliseconds; the message names the argument."""
    names = {"a.csv": ("time [s]", "u"), "b.csv": ("time", "y")}
    for file, columns in names.items():
        values = {columns[0]: 10 * np.arange(50), columns[1]: np.arange(50) % 7}
        pd.DataFrame(values).to_csv(tmp_path / file, index=False)
    joined = {tmp_path / "b.csv": 0.0}
    with pytest.raises(ValueError, match=r"10 s.*sampling_time \(--sampling-time\)"):
        sb.read(tmp_path / "a.csv", inputs="u", join=joined)
    record = sb.read(tmp_path / "a.csv", inputs="u", join=joined, sampling_time=10.0)
    assert (len(record), record.sampling_time) == (50, 10.0)

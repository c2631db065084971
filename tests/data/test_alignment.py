"""Files are put together by their time stamps; the oracles are signals known at any time."""

import json
import shlex
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import scipy.signal

from splitband import Record, read
from splitband.cli import main
from splitband.cli.options.records import RecordOptions
from splitband.cli.options.simulators import SimulatorOptions
from splitband.cli.simulators import load_further, with_simulator
from splitband.data import Grid, aligned, resampled
from splitband.data.alignment import reach
from splitband.data.timing import seconds_between
from splitband.metrics import rmse
from splitband.simulators import Function, Recorded, run
from tests.support import load_model as load
from tests.support import simulated

Array = npt.NDArray[np.float64]
DT, SAMPLES = 0.1, 240
QUICK = "--recipe paper --epochs 2 --hidden 4,3 --window 30 --warmup 10"
FUNCTIONS = """
import numpy as np


def exact(time):
    return np.sin(2 * np.pi * 0.3 * time) + 0.4 * np.sin(2 * np.pi * 0.7 * time + 1)


def late(time):
    return exact(0.97 * time)


def slow_start(time):
    return exact(0.97 * (time - 20))


def ramp(time):
    return time
"""


def signal(time: Array) -> Array:
    """A simulator that is right, as `exact` above."""
    return np.asarray(
        np.sin(2 * np.pi * 0.3 * time) + 0.4 * np.sin(2 * np.pi * 0.7 * time + 1), dtype=np.float64
    )


def times(start: float = 0.0, step: float = DT, samples: int = SAMPLES) -> Array:
    return start + step * np.arange(samples, dtype=np.float64)


def write(path: Path, time: Any, **columns: Any) -> Path:
    stamps = time.round(7) if isinstance(time, np.ndarray) else time
    pd.DataFrame({"time": stamps, **columns}).to_csv(path, index=False)
    return path


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("functions.py").write_text(FUNCTIONS)


def call(line: str) -> dict[str, Any]:
    """Run a command that must succeed; what it writes to out/results.json, if it does."""
    assert main(shlex.split(line)) == 0
    found = Path("out/results.json")
    facts: dict[str, Any] = json.loads(found.read_text()) if found.exists() else {}
    return facts


def refused(line: str, capsys: pytest.CaptureFixture[str]) -> str:
    """The one line that a command ends with."""
    assert main(shlex.split(line)) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


def simulator_error(simulator: str, time_column: str | None = None) -> float:
    """RMSE of what --simulator comes to beside record.csv."""
    record = read("record.csv", time_column=time_column)
    reading = RecordOptions(time_column=time_column)
    found = with_simulator(record, SimulatorOptions(simulator), reading)
    assert found.y_sim is not None
    return rmse(found.y, found.y_sim)


# ---------------------------------------------------------------- a record and its time stamps


def test_time_stamps_go_through_slices_and_replacements() -> None:
    record = Record(np.arange(50.0), DT, start=20)
    np.testing.assert_allclose(record.time, times(20, samples=50))
    part = replace(record[10:40][5:-1], name="part")
    assert part.start == pytest.approx(21.5)
    np.testing.assert_array_equal(part.stamps, np.round(times(21.5, samples=24), 9))
    assert record[-3:].start == pytest.approx(24.7)
    assert Record(np.arange(5.0), DT)[2:].start is None


def test_dates_go_through_slices_and_time_counts_from_the_first() -> None:
    record = Record(np.arange(50.0), 0.25, start=pd.Timestamp("2024-02-29 23:59:59", tz="UTC"))
    part = record[6:]
    expected = pd.date_range("2024-03-01 00:00:00.5", periods=44, freq="250ms", tz="UTC")
    assert part.start == expected[0]
    assert part.time[0] == 0
    assert list(part.stamps) == list(expected)


@pytest.mark.parametrize("start", [np.nan, np.inf, "soon", pd.NaT])
def test_what_is_no_time_stamp_is_refused(start: Any) -> None:
    with pytest.raises(ValueError, match="a time stamp must be"):
        Record(np.arange(5.0), DT, start=start)


@pytest.mark.parametrize("gaps", ["refuse", "mask"])
@pytest.mark.parametrize(
    ("name", "stamps", "start"),
    [
        ("time", [f"{20 + 0.1 * i:.1f}" for i in range(9)], 20.0),
        ("t [ms]", [f"{5000 + 40 * i}" for i in range(9)], 5.0),
        ("time", [f"{7 + i / 3:.2f}" for i in range(200)], 7.0),
        ("time", [f"00:01:{i:02d}.5" for i in range(9)], 60.5),
        ("time", [f"2024-05-01 10:00:0{i}" for i in range(9)], pd.Timestamp("2024-05-01 10:00")),
        (
            "date",
            [f"2024-05-01T10:00:0{i}+02:00" for i in range(9)],
            pd.Timestamp("2024-05-01 10:00", tz="UTC+02:00"),
        ),
    ],
)
def test_reading_keeps_the_first_time_stamp(
    name: str, stamps: list[str], start: Any, gaps: Any
) -> None:
    pd.DataFrame({name: stamps, "y": np.arange(float(len(stamps)))}).to_csv("r.csv", index=False)
    found = read("r.csv", gaps=gaps).start
    assert found is not None
    assert seconds_between(start, found) == pytest.approx(0, abs=2e-3)
    if isinstance(start, pd.Timestamp):
        assert str(found) == str(start)  # dates are shown as the file has them


def test_a_file_without_a_time_column_has_no_time_stamps() -> None:
    np.savetxt("r.txt", np.arange(9.0))
    assert read("r.txt", sampling_time=DT).start is None
    write(Path("r.csv"), times(3), y=times())
    assert read("r.csv", sampling_time=DT, time_column="").start is None


def test_rows_do_not_drift_away_from_the_time_stamps_over_many_gaps() -> None:
    """Each time the logger starts again 2.4 samples later; rounded one by one, 8 samples by now."""
    stretches = [times(20 * DT * i + 1.4 * DT * i, samples=20) for i in range(21)]
    time = np.concatenate(stretches)
    found = read(write(Path("r.csv"), time, y=time), gaps="mask")
    seen = found.complete
    assert seen.sum() == len(time)
    assert np.abs(found.time[seen] - found.y[seen, 0]).max() <= 0.5 * DT + 1e-6


def test_stamps_that_wander_from_an_even_step_by_more_than_half_a_sample_are_refused() -> None:
    step = DT * (1 + 0.009 * np.sin(2 * np.pi * np.arange(2000) / 2000))
    write(Path("r.csv"), np.cumsum(step), y=np.cumsum(step))
    with pytest.raises(ValueError, match=r"wander by 2\.9 samples from an even step of 0\.1 s"):
        read("r.csv")


def test_a_sampling_time_given_beside_time_stamps_may_not_drift_from_them() -> None:
    write(Path("r.csv"), times(step=0.1009), y=times())
    with pytest.raises(ValueError, match=r"is 0\.1 s, but time column 'time' steps by 0\.1009 s"):
        read("r.csv", sampling_time=0.1)


# ---------------------------------------------------------------- two signals


@pytest.mark.parametrize(
    ("start", "step", "note"),
    [
        (-3.0, 0.1, ""),
        (-0.03, 0.1, "0.3 of a step beside the record's: interpolated"),
        (-1.0, 0.1009, "every 0.1009 s, interpolated at the record's times, every 0.1 s"),
        (-1.0, 0.0999999, ""),
        (-2.0, 0.02, "every 0.02 s, taken at the record's times, every 0.1 s"),
        (-1.0, 0.2, "every 0.2 s, interpolated"),
    ],
)
def test_a_signal_is_aligned_by_its_time_stamps(start: float, step: float, note: str) -> None:
    own = Grid(20 + start, step, 3000)
    values = signal(times(20 + start, step, 3000))[:, None]
    found = aligned("it", values, own, Grid(20.0, DT, SAMPLES))
    # A cubic spline's error is of the fourth order in the step times the frequency.
    np.testing.assert_allclose(found.values[:, 0], signal(times(20)), atol=2e-2 * max(step, DT))
    assert note in found.note
    assert bool(note) == bool(found.note)


def test_dates_are_aligned_across_time_zones() -> None:
    utc = pd.Timestamp("2024-05-01 08:00", tz="UTC")
    own = Grid(utc - pd.Timedelta(3, unit="s"), DT, 300)
    onto = Grid(pd.Timestamp("2024-05-01 10:00", tz="Europe/Berlin"), DT, 200)
    found = aligned("it", times(-3, samples=300)[:, None], own, onto)
    np.testing.assert_allclose(found.values[:, 0], times(samples=200), atol=1e-12)


def test_dates_with_and_without_a_time_zone_are_not_mixed() -> None:
    zoned = Grid(pd.Timestamp("2024-05-01 10:00", tz="UTC+02:00"), DT, 200)
    naive = Grid(pd.Timestamp("2024-05-01 10:00"), DT, 200)
    for own, onto in ((naive, zoned), (zoned, naive)):
        with pytest.raises(ValueError, match=r"^it: dates .* a time zone, or none: got ") as caught:
            aligned("it", times(samples=200)[:, None], own, onto)
        assert str(caught.value).count("2024-05-01 10:00:00") == 2
        assert "2024-05-01 10:00:00+02:00" in str(caught.value)


@pytest.mark.parametrize(
    "command",
    [
        "spectrum r.csv --simulator zoned.csv",
        "forecast r.csv --inputs u --steps 5 --method linear --future-inputs zoned.csv",
        "simulate m --history zoned.csv --steps 5 --out f.csv --future-inputs ahead.csv",
    ],
)
def test_files_with_and_without_a_time_zone_are_refused(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    dates = pd.date_range("2024-05-01 10:00", periods=120, freq="1s")
    y, u = np.random.default_rng(1).standard_normal((2, 120))
    pd.DataFrame({"date": dates, "y": y, "u": u}).to_csv("r.csv", index=False)
    zoned = dates.tz_localize("Europe/Berlin")
    pd.DataFrame({"date": zoned, "y": y, "u": u}).to_csv("zoned.csv", index=False)
    after = pd.date_range(zoned[-1], periods=6, freq="1s")[1:]
    pd.DataFrame({"date": after, "u": 0.0}).to_csv("ahead.csv", index=False)
    if command.startswith("simulate"):
        assert main(shlex.split("fit r.csv --inputs u --method linear --out m")) == 0
        capsys.readouterr()
    assert "must all have a time zone, or none: got 2024-05-01 10:0" in refused(command, capsys)


@pytest.mark.parametrize(
    ("own", "both"),
    [
        (Grid(22.0, DT, 500), ("20 s to 29.9 s", "22 s to 71.9 s")),
        (Grid(15.0, DT, 100), ("20 s to 29.9 s", "15 s to 24.9 s")),
        (Grid(20.06, DT, 500), ("20 s to 29.9 s", "20.06 s to 69.96 s")),
        (Grid(pd.Timestamp("2024-05-01"), DT, 500), ("20 s", "2024-05-01")),
    ],
)
def test_what_does_not_cover_the_times_is_refused_with_both_time_stamps(
    own: Grid, both: tuple[str, str]
) -> None:
    with pytest.raises(ValueError, match=r"it must cover|must all be dates") as caught:
        aligned("it", np.zeros((own.samples, 1)), own, Grid(20.0, DT, 100))
    assert all(stamp in str(caught.value) for stamp in both)


@pytest.mark.parametrize("start", [20.04, 19.97])
def test_half_a_sample_may_lack_at_the_ends(start: float) -> None:
    found = aligned("it", np.ones((100, 1)), Grid(start, DT, 100), Grid(20.0, DT, 100))
    np.testing.assert_allclose(found.values, 1)


def test_without_time_stamps_on_both_sides_they_begin_together() -> None:
    values = times(samples=50)[:, None]
    for own, onto, note in (
        (None, None, ""),
        (5.0, None, "it has time stamps, the record has none"),
        (None, 5.0, "the record has time stamps, it has none"),
    ):
        found = aligned("it", values, Grid(own, DT, 50), Grid(onto, DT, 30))
        np.testing.assert_array_equal(found.values, values[:30])
        assert note in found.note
        assert bool(note) == bool(found.note)


def test_inputs_are_interpolated_by_straight_lines() -> None:
    steps = np.repeat([0.0, 1.0], 10)[:, None]
    found = aligned("u", steps, Grid(0.0, 0.2, 20), Grid(0.0, DT, 39), smooth=False)
    np.testing.assert_allclose(found.values[:, 0], np.interp(times(samples=39), times(step=0.2,
        samples=20), steps[:, 0]), atol=1e-12)  # fmt: skip


@pytest.mark.parametrize(("start", "step"), [(0.0, 0.1), (-3.0, 0.1), (0.0, 0.0999), (-2.0, 0.25)])
def test_what_is_in_reach_is_covered_and_no_more(start: float, step: float) -> None:
    own = Grid(start, step, 100)
    count = reach(own, Grid(0.0, DT, 1))
    end = start + step * 99
    assert DT * (count - 1) <= end + 0.01 * DT < DT * count + 0.01 * DT
    aligned("it", np.zeros((100, 1)), own, Grid(0.0, DT, count))


def test_a_record_is_resampled_with_all_its_signals() -> None:
    time = times(20, 0.1009)
    measured = np.ones((SAMPLES, 1), dtype=np.bool_)
    measured[100] = False
    record = Record(signal(time), 0.1009, u=time, y_true=signal(time), y_sim=2 * signal(time),
                        measured=measured, start=20.0)  # fmt: skip
    found = resampled(record, DT)
    assert (found.start, found.sampling_time) == (20.0, DT)
    assert found.time[-1] <= time[-1] < found.time[-1] + DT
    for values, factor in ((found.y, 1), (found.y_true, 1), (found.y_sim, 2)):
        assert values is not None
        np.testing.assert_allclose(values[:, 0], factor * signal(found.time), atol=1e-3)
    assert found.u is not None
    np.testing.assert_allclose(found.u[:, 0], found.time, atol=1e-9)
    lost = found.time[~found.complete]
    assert len(lost) == 2
    assert (np.abs(lost - time[100]) < 0.1009).all()


def test_an_exported_trajectory_runs_beside_a_record_by_its_time_stamps() -> None:
    exported = Recorded.of(Record(signal(times(15)), DT, start=15.0))
    found = run(exported, 100, DT, start=20.0)
    np.testing.assert_allclose(found[:, 0], signal(times(20, samples=100)), atol=1e-12)
    with pytest.raises(ValueError, match=r"must cover 0 s to 9\.9 s"):
        run(exported, 100, DT, start=0.0)


def test_a_function_is_called_with_the_time_stamps_and_with_seconds_where_they_are_dates() -> None:
    for start, first in ((20.0, 20.0), (pd.Timestamp("2024-05-01"), 0.0), (None, 0.0)):
        found = run(Function(lambda t: t), 5, DT, start=start)
        np.testing.assert_allclose(found[:, 0], times(first, samples=5))


# ---------------------------------------------------------------- simulators beside a record


@pytest.mark.parametrize(
    ("start", "step", "told"),
    [
        pytest.param(15.0, 0.1, None, id="earlier"),
        pytest.param(19.97, 0.1, "0.3 of a step", id="beside"),
        pytest.param(20.0, 0.1009, "every 0.1009 s", id="another step"),
        pytest.param(20.0, 0.05, "every 0.05 s", id="twice as fine"),
    ],
)
def test_a_perfect_simulator_has_no_error_whatever_its_time_stamps(
    start: float, step: float, told: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    write(Path("record.csv"), times(20), y=signal(times(20)))
    write(Path("sim.csv"), times(start, step, 800), y=signal(times(start, step, 800)))
    assert simulator_error("sim.csv") < 2e-3  # by row, it is 0.2 to 1.1
    said = capsys.readouterr().out
    assert ("sim.csv: " in said) == (told is not None)
    assert told is None or told in said


def test_a_simulator_that_begins_later_than_the_record_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    write(Path("record.csv"), times(), y=signal(times()))
    write(Path("sim.csv"), times(2), y=signal(times(2)))
    said = refused("compare record.csv --methods simulator,mean --simulator sim.csv", capsys)
    assert all(words in said for words in ("sim.csv", "0 s to 23.9 s", "2 s to 25.9 s"))


def test_dates_beside_seconds_are_refused_with_the_name_of_the_file(
    capsys: pytest.CaptureFixture[str],
) -> None:
    dates = pd.Timestamp("2024-05-01") + pd.to_timedelta(times(), unit="s")
    write(Path("record.csv"), dates, y=signal(times()))
    write(Path("sim.csv"), times(20), y=signal(times()))
    said = refused("compare record.csv --methods simulator,mean --simulator sim.csv", capsys)
    assert all(words in said for words in ("sim.csv", "20 s", "2024-05-01", "all be dates"))


def test_a_named_time_column_is_that_of_the_simulator_too() -> None:
    for name, start, samples in (("record.csv", 20, SAMPLES), ("sim.csv", 15, SAMPLES + 100)):
        time = times(start, samples=samples)
        write(Path(name), time, y=signal(time)).write_text(
            Path(name).read_text().replace("time", "stamp")
        )
    assert simulator_error("sim.csv", "stamp") < 1e-6
    time = times(15, samples=SAMPLES + 200)
    write(Path("sim.csv"), time, y=signal(time))
    assert simulator_error("sim.csv", "stamp") < 1e-6


def test_a_function_runs_on_the_time_stamps_of_the_record(
    capsys: pytest.CaptureFixture[str],
) -> None:
    write(Path("record.csv"), times(20), y=signal(times(20)))
    assert simulator_error("functions.py:exact") < 1e-6
    assert "run on the record's time stamps, 20 s to 43.9 s" in capsys.readouterr().out
    dates = pd.Timestamp("2024-05-01") + pd.to_timedelta(times(), unit="s")
    write(Path("record.csv"), dates, y=signal(times()))
    assert simulator_error("functions.py:exact") < 1e-6
    assert "seconds since the record's first sample, 2024-05-01" in capsys.readouterr().out


def test_further_records_are_resampled_and_have_simulators_of_their_own_time(
    capsys: pytest.CaptureFixture[str],
) -> None:
    record = Record(signal(times(20)), DT, start=20.0)
    other = times(50, 0.1009)
    write(Path("more.csv"), other, y=signal(other))
    write(Path("sim.csv"), times(48, samples=400), y=signal(times(48, samples=400)))
    (found,) = load_further(
        "--more", ["more.csv"], ["sim.csv"], record, RecordOptions(), SimulatorOptions()
    )
    assert (
        "more.csv: sampled every 0.1009 s, interpolated to every 0.1 s" in capsys.readouterr().out
    )
    assert (found.sampling_time, found.start) == (DT, 50)
    assert found.y_sim is not None
    np.testing.assert_allclose(found.y_sim, found.y, atol=1e-3)


# ---------------------------------------------------------------- what is written


def test_predictions_and_forecasts_go_on_with_the_time_stamps() -> None:
    write(Path("record.csv"), times(20), y=signal(times(20)))
    write(Path("sim.csv"), times(15, samples=400), y=signal(times(15, samples=400)))
    facts = call("compare record.csv --methods simulator,mean --simulator sim.csv --out out")
    assert facts["methods"]["simulator"]["total_rmse"][0] < 1e-6
    assert facts["record"]["start"] == 20
    np.testing.assert_array_equal(pd.read_csv("out/predictions.csv")["time"], times(20).round(9))
    call("forecast record.csv --method persistence --steps 5 --out out")
    found = pd.read_csv("out/forecast.csv")["time"]
    np.testing.assert_allclose(found, times(20, samples=SAMPLES + 5)[-5:], rtol=0, atol=1e-9)


@pytest.mark.usefixtures("drawn")
def test_dates_are_written_as_they_were_read() -> None:
    dates = pd.Timestamp("2024-05-01 10:00") + pd.to_timedelta(np.arange(SAMPLES + 5), unit="s")
    stamps = [f"{date}+02:00" for date in dates]
    write(Path("record.csv"), stamps[:SAMPLES], y=signal(times()))
    call("compare record.csv --methods mean,persistence --out out")
    assert pd.read_csv("out/predictions.csv")["time"].tolist() == stamps[:SAMPLES]
    assert Path("out/rollouts.png").exists()
    stamps = [str(date) for date in dates]
    write(Path("record.csv"), stamps[:SAMPLES], y=signal(times()))
    call("forecast record.csv --method persistence --steps 5 --out out")
    assert pd.read_csv("out/forecast.csv")["time"].tolist() == stamps[SAMPLES:]
    assert Path("out/forecast.png").exists()


# ---------------------------------------------------------------- inputs to come


@pytest.fixture
def driven() -> Callable[[Array], Array]:
    """A record of a linear system from 20 s on, in record.csv; its forecast for given inputs."""
    u = np.sign(np.sin(np.arange(SAMPLES) ** 1.3 / 20))
    filtered = [0.3, 0.1], [1, -1.6, 0.8]
    write(Path("record.csv"), times(20), y=scipy.signal.lfilter(*filtered, u), force=u)
    return lambda coming: np.asarray(
        scipy.signal.lfilter(*filtered, np.concatenate([u, coming]))[SAMPLES:]
    )


COMING = np.sign(np.cos(np.arange(200) / 7))
LINEAR = "forecast record.csv --columns y --inputs force --method linear --steps 40 --out out"


def test_inputs_to_come_follow_the_record_by_their_time_stamps(
    driven: Callable[[Array], Array],
) -> None:
    """Rows before the record's end are left out."""
    time = times(20 + DT * (SAMPLES - 50), samples=100)
    write(Path("coming.csv"), time, force=COMING[:100])
    call(f"{LINEAR} --future-inputs coming.csv")
    expected = driven(COMING[50:90])
    np.testing.assert_allclose(pd.read_csv("out/forecast.csv")["y"], expected, atol=1e-5)


def test_inputs_to_come_at_another_step_are_interpolated(
    driven: Callable[[Array], Array], capsys: pytest.CaptureFixture[str]
) -> None:
    time = times(20 + DT * SAMPLES, 2 * DT, 21)
    write(Path("coming.csv"), time, force=COMING[:21])
    call(f"{LINEAR} --future-inputs coming.csv")
    assert "coming.csv: sampled every 0.2 s, interpolated" in capsys.readouterr().out
    expected = driven(np.interp(np.arange(40) / 2, np.arange(21), COMING[:21]))
    np.testing.assert_allclose(pd.read_csv("out/forecast.csv")["y"], expected, atol=1e-5)


@pytest.mark.parametrize("off", [20.0, -20.0, 0.1])
def test_inputs_to_come_that_do_not_follow_the_record_are_refused(
    driven: Callable[[Array], Array], off: float, capsys: pytest.CaptureFixture[str]
) -> None:
    time = times(44 + off, samples=60)
    write(Path("coming.csv"), time, force=COMING[:60])
    said = refused(f"{LINEAR} --future-inputs coming.csv", capsys)
    assert all(words in said for words in ("coming.csv", "44 s to 47.9 s", f"{44 + off:g} s to"))


# ---------------------------------------------------------------- saved models


@pytest.fixture(scope="module")
def late_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hybrid model whose simulator is 3 % too slow, of a record that begins at 20 s."""
    folder = tmp_path_factory.mktemp("late")
    (folder / "functions.py").write_text(FUNCTIONS)
    write(folder / "record.csv", times(20), y=signal(times(0)))
    line = (
        f"fit {folder}/record.csv --method filtered-gru --calibrate {QUICK} --out {folder}/model "
        f"--simulator {folder}/functions.py:slow_start"
    )
    assert main(shlex.split(line)) == 0
    return folder / "model"


def ahead(model: Path, history: str, options: str) -> Array:
    call(f"simulate {model} --history {history} --steps 60 --out ahead.csv {options}")
    return pd.read_csv("ahead.csv").to_numpy()


@pytest.mark.parametrize("simulator", ["functions.py:slow_start", "cut.csv"])
def test_a_later_history_is_simulated_on_as_the_whole_one_is(
    late_model: Path, simulator: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The clock that was found counts from the training record, wherever the history begins."""
    assert load(late_model)[1]["calibration"]["clock"] == pytest.approx(1 / 0.97, abs=5e-3)
    write(Path("whole.csv"), times(20)[:180], y=signal(times())[:180])
    write(Path("later.csv"), times(20)[100:180], y=signal(times())[100:180])
    simulated = signal(0.97 * times(samples=400))
    write(Path("cut.csv"), times(20, samples=400)[150:], y=simulated[150:])
    whole = ahead(late_model, "whole.csv", "--simulator functions.py:slow_start")
    capsys.readouterr()
    later = ahead(late_model, "later.csv", f"--simulator {simulator}")
    np.testing.assert_allclose(later[:, 0], times(38, samples=60), rtol=0, atol=1e-9)
    np.testing.assert_allclose(later, whole, rtol=0, atol=2e-4)
    assert "begins +10 s after the training record" in capsys.readouterr().out


def test_a_history_between_the_samples_of_the_training_record_is_simulated_on(
    late_model: Path,
) -> None:
    time = times(30.03, samples=80)
    write(Path("later.csv"), time, y=signal(time - 20))
    simulated = signal(0.97 * times(samples=400))
    write(Path("sim.csv"), times(20, samples=400), y=simulated)
    asked = ahead(late_model, "later.csv", "--simulator functions.py:slow_start")
    exported = ahead(late_model, "later.csv", "--simulator sim.csv")
    np.testing.assert_allclose(asked, exported, rtol=0, atol=1e-3)


def test_a_history_before_the_training_record_is_refused_where_the_clock_was_calibrated(
    late_model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(Path("early.csv"), times()[:80], y=signal(times())[:80])
    said = refused(
        f"simulate {late_model} --history early.csv --steps 9 --out a.csv "
        "--simulator functions.py:exact",
        capsys,
    )
    assert all(words in said for words in ("--history", "20 s", "0 s", "clock 1.03"))


def test_a_history_without_time_stamps_begins_where_the_training_record_did(
    late_model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(Path("whole.csv"), times(20)[:180], y=signal(times())[:180])
    whole = ahead(late_model, "whole.csv", "--simulator functions.py:slow_start")
    np.savetxt("plain.txt", signal(times())[:180])
    plain = ahead(late_model, "plain.txt", "--simulator functions.py:slow_start")
    assert "begin where the training record did, at 20 s" in capsys.readouterr().out
    np.testing.assert_allclose(plain[:, 1], whole[:, 1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(plain[:, 0], DT * np.arange(1, 61))


def changed(model: Path, folder: Path, start: Any) -> None:
    """Copy a saved model, with another time stamp of its training record's beginning."""
    shutil.copytree(model, folder)
    description = json.loads((folder / "forecaster.json").read_text())

    def change(part: Any) -> None:
        if isinstance(part, dict) and part.get("class") == "Fitted":
            part["fields"]["start"] = start
        for each in part.values() if isinstance(part, dict) else ():
            change(each)

    change(description["forecaster"])
    (folder / "forecaster.json").write_text(json.dumps(description))


def test_a_model_of_a_record_without_time_stamps_begins_with_the_history(
    late_model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(Path("whole.csv"), times(20)[:180], y=signal(times())[:180])
    whole = ahead(late_model, "whole.csv", "--simulator functions.py:slow_start")
    capsys.readouterr()
    changed(late_model, Path("old"), None)
    old = ahead(Path("old"), "whole.csv", "--simulator functions.py:slow_start")
    assert "does not know when its training record began" in capsys.readouterr().out
    np.testing.assert_array_equal(old, whole)


@pytest.mark.parametrize("start", ["soon", True, [1.0], "NaT", {"date": "NaT"}])
def test_a_damaged_start_is_one_line(
    late_model: Path, start: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    changed(late_model, Path("bad"), start)
    write(Path("h.csv"), times(20), y=signal(times()))
    said = refused("simulate bad --history h.csv --steps 5 --out a.csv", capsys)
    assert "bad" in said


def test_a_history_of_a_slightly_other_sampling_time_is_resampled(
    late_model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    time = times(20, 0.1009, 180)
    write(Path("h.csv"), time, y=signal(time - 20))
    found = ahead(late_model, "h.csv", "--simulator functions.py:slow_start")
    assert "h.csv: sampled every 0.1009 s, interpolated to every 0.1 s" in capsys.readouterr().out
    exact = times(20, DT, 181)
    assert exact[-1] <= time[-1] < exact[-1] + DT
    write(Path("exact.csv"), exact, y=signal(exact - 20))
    expected = ahead(late_model, "exact.csv", "--simulator functions.py:slow_start")
    np.testing.assert_allclose(found, expected, rtol=0, atol=2e-3)


# ---------------------------------------------------------------- files of one column


def test_a_model_of_a_file_of_one_nameless_column_simulates_such_a_file() -> None:
    np.savetxt("one.txt", signal(times()))
    call(f"fit one.txt --sampling-time {DT} --method gru --more one.txt --out out {QUICK}")
    call("simulate out --history one.txt --steps 5 --out ahead.csv")
    found = pd.read_csv("ahead.csv")
    assert list(found) == ["time", "y"]
    expected = simulated(load(Path("out"))[0], signal(times())[-10:, None], 5)
    np.testing.assert_allclose(found[["y"]], expected, atol=1e-6)
    assert read("one.txt", columns="y", sampling_time=DT).columns == ("y",)
    assert read("one.txt", columns=0, sampling_time=DT).columns == ("y",)

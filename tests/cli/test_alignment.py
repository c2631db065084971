"""Commands put files together by their time stamps; the oracles are signals known at any time."""

import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import scipy.signal

from splitband import Record, read
from splitband.cli.options import RecordOptions, SimulatorOptions
from splitband.cli.printing import saying
from splitband.cli.records import load_further, simulator_of
from splitband.metrics import rmse
from splitband.simulators.open_simulator import simulated
from tests.cli.support import QUICK, call
from tests.records.support import SAMPLES, signal, times, write
from tests.support import edit
from tests.support import load_model as load

Array = npt.NDArray[np.float64]
DT = 0.1
FUNCTIONS = """
import numpy as np


def exact(time):
    return np.sin(2 * np.pi * 0.3 * time) + 0.4 * np.sin(2 * np.pi * 0.7 * time + 1)


def slow_start(time):
    return exact(0.97 * (time - 20))
"""
SLOW = "functions.py:slow_start --simulator-start record"
"""A function of the time that the record's stamps have."""

pytestmark = pytest.mark.usefixtures("simulated_here")


@pytest.fixture(autouse=True)
def inside_own_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("functions.py").write_text(FUNCTIONS)
    write(Path("whole.csv"), times(20)[:180], y=signal(times())[:180])


def simulator_error(
    simulator: str, time_column: str | None = None, start: str | None = None
) -> float:
    """RMSE of what --simulator comes to beside record.csv."""
    record = read("record.csv", time_column=time_column)
    options = SimulatorOptions(simulator, simulator_start=start)
    with saying(quiet=False, json=False):
        found = simulated(record, simulator_of(options, record, time_column))
    assert found.y_sim is not None
    return rmse(found.y, found.y_sim)


# ---------------------------------------------------------------- simulators beside a record


@pytest.mark.parametrize(
    ("start", "step", "told"),
    [
        pytest.param(15.0, 0.1, None, id="earlier"),
        pytest.param(20.0, 0.1009, "every 0.1009 s", id="another step"),
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


def test_a_named_time_column_is_that_of_the_simulator_too() -> None:
    for name, start, samples in (("record.csv", 20, SAMPLES), ("sim.csv", 15, SAMPLES + 100)):
        time = times(start, samples=samples)
        write(Path(name), time, y=signal(time)).write_text(
            Path(name).read_text().replace("time", "stamp")
        )
    assert simulator_error("sim.csv", "stamp") < 1e-6


def test_a_function_runs_on_the_time_stamps_of_the_record(
    capsys: pytest.CaptureFixture[str],
) -> None:
    write(Path("record.csv"), times(20), y=signal(times(20)))
    with pytest.raises(ValueError, match="start must be given"):
        simulator_error("functions.py:exact")
    assert simulator_error("functions.py:exact", start="record") < 1e-6
    assert "runs from 20 s on" in capsys.readouterr().out
    dates = pd.Timestamp("2024-05-01") + pd.to_timedelta(times(), unit="s")
    write(Path("record.csv"), dates, y=signal(times()))
    assert simulator_error("functions.py:exact") < 1e-6
    assert "runs from 0 s on, at the record's first sample, 2024-05-01" in capsys.readouterr().out


def test_further_records_are_resampled_and_have_simulators_of_their_own_time(
    caplog: pytest.LogCaptureFixture,
) -> None:
    caplog.set_level("INFO", "splitband")
    record = Record(signal(times(20)), DT, start=20.0)
    other = times(50, 0.1009)
    write(Path("more.csv"), other, y=signal(other))
    write(Path("sim.csv"), times(48, samples=400), y=signal(times(48, samples=400)))
    (found,) = load_further(
        "--more", ["more.csv"], ["sim.csv"], record, RecordOptions(), SimulatorOptions()
    )
    assert "more.csv: sampled every 0.1009 s, interpolated to every 0.1 s" in caplog.text
    assert (found.sampling_time, found.start) == (DT, 50)
    assert found.y_sim is not None
    np.testing.assert_allclose(found.y_sim[: len(found)], found.y, atol=1e-3)


# ---------------------------------------------------------------- what is written


def test_dates_are_written_as_they_were_read() -> None:
    dates = pd.Timestamp("2024-05-01 10:00") + pd.to_timedelta(np.arange(SAMPLES + 5), unit="s")
    stamps = [f"{date}+02:00" for date in dates]
    write(Path("record.csv"), stamps[:SAMPLES], y=signal(times()))
    call("compare record.csv --methods mean,persistence --out out")
    assert pd.read_csv("out/predictions.csv")["time"].tolist() == stamps[:SAMPLES]
    stamps = [str(date) for date in dates]
    write(Path("record.csv"), stamps[:SAMPLES], y=signal(times()))
    call("forecast record.csv --method persistence --steps 5 --out out")
    assert pd.read_csv("out/forecast.csv")["time"].tolist() == stamps[SAMPLES:]


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


@pytest.mark.parametrize(
    ("begin", "step", "samples", "coming", "told"),
    [
        # Rows before the record's end are left out.
        (SAMPLES - 50, 1, 100, COMING[50:90], ""),
        (SAMPLES, 2, 21, np.interp(np.arange(40) / 2, np.arange(21), COMING[:21]), "every 0.2 s"),
    ],
)
def test_inputs_to_come_follow_the_record_by_their_time_stamps(
    driven: Callable[[Array], Array],
    begin: int,
    step: int,
    samples: int,
    coming: Array,
    told: str,
    capsys: pytest.CaptureFixture[str],
) -> None:
    time = times(20 + DT * begin, step * DT, samples)
    write(Path("coming.csv"), time, force=COMING[:samples])
    call(f"{LINEAR} --future-inputs coming.csv")
    assert ("coming.csv: sampled" in (said := capsys.readouterr().out)) == bool(told)
    assert told in said
    np.testing.assert_allclose(pd.read_csv("out/forecast.csv")["y"], driven(coming), atol=1e-5)


# ---------------------------------------------------------------- saved models


@pytest.fixture(scope="module")
def late_model(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A hybrid model whose simulator is 3 % too slow, of a record that begins at 20 s."""
    folder = tmp_path_factory.mktemp("late")
    (folder / "functions.py").write_text(FUNCTIONS)
    write(folder / "record.csv", times(20), y=signal(times(0)))
    line = f"fit {folder}/record.csv --method filtered-gru-calibrated {QUICK}"
    call(f"{line} --simulator {folder}/{SLOW}", folder / "model")
    return folder / "model"


def ahead(model: Path, history: str, options: str) -> Array:
    call(f"simulate {model} --history {history} --steps 60 --out ahead.csv {options}")
    return pd.read_csv("ahead.csv").to_numpy()


@pytest.mark.parametrize("simulator", [SLOW, "cut.csv"])
def test_a_later_history_is_simulated_on_as_the_whole_one_is(
    late_model: Path, simulator: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """The clock that was found counts from the training record, wherever the history begins."""
    assert load(late_model)[1]["calibration"]["clock"] == pytest.approx(1 / 0.97, abs=5e-3)
    write(Path("later.csv"), times(20)[100:180], y=signal(times())[100:180])
    simulated = signal(0.97 * times(samples=400))
    write(Path("cut.csv"), times(20, samples=400)[150:], y=simulated[150:])
    whole = ahead(late_model, "whole.csv", f"--simulator {SLOW}")
    capsys.readouterr()
    later = ahead(late_model, "later.csv", f"--simulator {simulator}")
    np.testing.assert_allclose(later[:, 0], times(38, samples=60), rtol=0, atol=1e-9)
    np.testing.assert_allclose(later, whole, rtol=0, atol=2e-4)
    assert "begins +10 s after the training record" in capsys.readouterr().out


def test_a_history_without_time_stamps_begins_where_the_training_record_did(
    late_model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = ahead(late_model, "whole.csv", f"--simulator {SLOW}")
    Path("plain.csv").write_text(Path("whole.csv").read_text().replace("time", "when"))
    capsys.readouterr()
    plain = ahead(late_model, "plain.csv", f"--simulator {SLOW}")
    said = capsys.readouterr().out
    assert "plain.csv: no time stamps" in said
    assert "begin where the training record did, at 20 s" in said
    np.testing.assert_allclose(plain[:, 1], whole[:, 1], rtol=0, atol=1e-6)
    np.testing.assert_allclose(plain[:, 0], DT * np.arange(1, 61))
    named = ahead(late_model, "plain.csv", f"--simulator {SLOW} --time-column when")
    np.testing.assert_array_equal(named, whole)


def test_a_model_of_a_record_without_time_stamps_begins_with_the_history(
    late_model: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    whole = ahead(late_model, "whole.csv", f"--simulator {SLOW}")
    shutil.copytree(late_model, "old")
    edit(Path("old"), lambda d: d["forecaster"]["facts"].pop("fitted.start"))
    old = ahead(Path("old"), "whole.csv", f"--simulator {SLOW}")
    assert "does not know when its training record began" in capsys.readouterr().out
    np.testing.assert_array_equal(old, whole)

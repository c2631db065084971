"""`splitband simulate` and `splitband forecast`: what comes after a history or a record."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from splitband import read
from splitband.models import FilteredModel
from splitband.simulators.calibration import Calibration
from tests.cli.support import DT, FORCE, SIMULATED, WARMUP, A, call, results, written
from tests.support import load_model as load
from tests.support import simulated

pytestmark = pytest.mark.usefixtures("inside", "simulated_here")


def test_simulate_writes_time_and_columns_of_the_loaded_model(model: Path, tmp_path: Path) -> None:
    call(f"simulate {model} --history history.csv --steps 25", tmp_path / "new" / "ahead.csv")
    table = written(tmp_path / "new" / "ahead.csv")
    assert list(table) == ["time", "a", "b"]
    np.testing.assert_allclose(table["time"], DT * np.arange(50, 75))
    history = read("history.csv", columns=["a", "b"]).y
    expected = simulated(load(model)[0], history[-WARMUP:], 25)
    np.testing.assert_array_equal(table[["a", "b"]], expected)


@pytest.mark.skipif(not Path("/dev/stdout").exists(), reason="Windows has no such file")
def test_simulate_writes_into_the_standard_output(
    model: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    call(f"simulate {model} --steps 3", Path("/dev/stdout"))
    said = capfd.readouterr().out.splitlines()
    assert said[0] == "time,a,b"
    assert said[4].startswith("3 samples after the training record")


def test_a_hybrid_model_simulates_on_with_any_simulator(hybrid_model: Path, tmp_path: Path) -> None:
    loaded, facts = load(hybrid_model)
    assert isinstance(loaded, FilteredModel)
    calibration = Calibration(**facts["calibration"])
    y, y_sim = A[40:50, None], calibration.apply(SIMULATED[:, None], 75, DT)[40:]
    for simulator in ("simulated.csv", "functions.py:good"):
        line = f"simulate {hybrid_model} --history history.csv --steps 25 --simulator {simulator}"
        call(line, tmp_path / "ahead.csv")
        table = written(tmp_path / "ahead.csv")
        assert table.shape == (25, 2)
        np.testing.assert_allclose(table[["a"]], simulated(loaded, y, 25, y_sim=y_sim), atol=1e-5)
    line = f"simulate {hybrid_model} --history history.csv --steps 150 --simulator simulated.csv"
    call(line, tmp_path / "all.csv")
    assert len(written(tmp_path / "all.csv")) == 150  # as far as the exported trajectory goes


def test_future_inputs_drive_a_model_that_has_inputs(driven_model: Path, tmp_path: Path) -> None:
    pd.read_csv("future.csv").assign(force=9.0).to_csv(tmp_path / "push.csv", index=False)
    no_stamps = "future_bare.csv --time-column ''"
    for to, name in (
        ("plain", "future.csv"),
        ("strong", tmp_path / "push.csv"),
        ("bare", no_stamps),
    ):
        line = f"simulate {driven_model} --history history.csv --steps 20 --future-inputs {name}"
        call(line, tmp_path / f"{to}.csv")
    plain, strong, bare = (
        written(tmp_path / f"{to}.csv")["a"] for to in ("plain", "strong", "bare")
    )
    expected = simulated(load(driven_model)[0], A[40:50, None], 20, FORCE[40:70, None])
    np.testing.assert_allclose(plain, expected[:, 0], atol=1e-6)
    np.testing.assert_array_equal(bare, plain)
    assert np.abs(plain - strong)[0] > 1e-3  # an input acts on its own sample already


def test_forecast_goes_on_from_the_end_of_a_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    methods = ["gru", "harmonic", "mean"]
    monkeypatch.setattr("splitband.comparison.defaults.usual_names", lambda *_: methods)
    pd.read_csv("record.csv").iloc[:150].to_csv(tmp_path / "begun.csv", index=False)
    call(
        f"forecast {tmp_path}/begun.csv --columns a --steps 50 --seeds 1 --jobs 1 --epochs 2",
        tmp_path / "out",
    )
    table, found = written(tmp_path / "out" / "forecast.csv"), results(tmp_path / "out")
    assert list(table) == ["time", "a", "a, lower", "a, upper"]
    np.testing.assert_allclose(table["time"], DT * np.arange(150, 200))
    errors = {name: of["held_out_rmse"] for name, of in found["methods"].items()}
    assert found["recommended"] == min(errors, key=errors.__getitem__) == "harmonic"
    assert (found["command"], found["arguments"]["steps"]) == ("forecast", 50)
    np.testing.assert_allclose(table["a"], A[150:], atol=1e-4)  # the record is two sinusoids

"""`--simulator` is driven by the inputs of each record, in every command."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy.signal

import splitband as sb
from splitband.simulators.open_simulator import open_simulator
from tests.cli.support import call, results
from tests.simulators.fmus import COMPILES, built

DT, SAMPLES, TRAIN = 0.1, 160, 120
TIME = DT * np.arange(SAMPLES)
RNG = np.random.default_rng(0)
VALVE, HEATER = (np.repeat(RNG.uniform(-1, 1, SAMPLES // 8), 8) for _ in range(2))

needs_gcc = pytest.mark.skipif(not COMPILES, reason="no gcc to compile an FMU with")


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Records whose clock shows seconds since 1970, by SciPy, and the plant as a simulator."""
    pytest.importorskip("fmpy")
    monkeypatch.chdir(tmp_path)
    y = scipy.signal.lsim(([1.0], [1.0, 1.0]), VALVE, TIME, interp=False)[1]
    frame = pd.DataFrame({"time": 1.7e9 + TIME, "heater": HEATER, "valve": VALVE, "level": y})
    frame.to_csv("rig.csv", index=False)
    frame[:TRAIN].to_csv("past.csv", index=False)
    frame[TRAIN:].to_csv("ahead.csv", index=False)
    frame.rename(columns={"valve": "opening"}).to_csv("other.csv", index=False)


def fmu() -> Path:
    return built(Path("Plant.fmu").resolve(), inputs=("valve", "heater"), output="level")


@needs_gcc
def test_a_record_drives_an_fmu_by_names(tmp_path: Path) -> None:
    fmu()
    call("inspect rig.csv --inputs heater,valve --columns level --simulator Plant.fmu", tmp_path)
    assert results(tmp_path)["simulator"]["total_rmse"] < 1e-6
    line = "inspect other.csv --inputs opening --columns level --simulator Plant.fmu"
    call(f"{line} --simulator-inputs valve --simulator-columns x", tmp_path)
    assert results(tmp_path)["simulator"]["total_rmse"] < 1e-6
    call("inspect rig.csv --columns level --simulator Plant.fmu --simulator-inputs ''", tmp_path)
    assert results(tmp_path)["simulator"]["total_rmse"] > 0.1  # as it was asked for: at rest
    record = sb.read("rig.csv", inputs=["heater", "valve"], columns=["level"])
    model = sb.Simulation(open_simulator("Plant.fmu", record)).fit(record[:TRAIN])
    found = model.predict(10, u=np.stack([HEATER, VALVE], axis=1)[TRAIN:])
    assert abs(found.y - record.y[TRAIN:][:10]).max() < 1e-6
    other = sb.read("other.csv", inputs=["heater", "opening"], columns=["level"])
    with pytest.raises(ValueError, match=r"inputs, heater, opening, .* it has valve, heater"):
        open_simulator("Plant.fmu", other)


@needs_gcc
def test_an_fmu_without_parameters_to_fit_runs_as_it_was_fitted(tmp_path: Path) -> None:
    """In Python it is in a grey box, whose inputs are held and whose values are all given."""
    built(Path("Plant.fmu").resolve(), ["ModelExchange"], inputs=("valve",), output="level")
    files = "past.csv", "ahead.csv"
    past, ahead = (sb.read(file, inputs=["valve"], columns=["level"]) for file in files)
    model = sb.GreyBox(sb.Fmu("Plant.fmu", hold="zoh")).fit(past)
    model.save("model")
    line = "simulate model --simulator Plant.fmu --future-inputs ahead.csv --steps 40"
    call(line, tmp_path / "sim.csv")
    np.testing.assert_allclose(pd.read_csv(tmp_path / "sim.csv")["level"], ahead.y[:, 0], atol=1e-6)


@needs_gcc
def test_a_plant_compares_and_simulates_without_error(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With its training part, beyond it, and on a record that tests it, here with known samples."""
    fmu()
    rig = "--inputs heater,valve --columns level --simulator Plant.fmu"
    line = f"compare rig.csv {rig} --methods simulator,mean --train {TRAIN} --test rig.csv"
    call(line, tmp_path / "out")
    assert "The test record rig (2) contains training samples" in capsys.readouterr().out
    found = results(tmp_path / "out")["methods"]["simulator"]
    assert max(*found["forecast_rmse"], *found["total_rmse"], *found["test_rmse"][0]) < 1e-6
    call(f"fit past.csv {rig} --method simulator", tmp_path / "model")
    line = f"simulate {tmp_path / 'model'} --simulator Plant.fmu --future-inputs ahead.csv"
    call(f"{line} --steps {SAMPLES - TRAIN}", tmp_path / "ahead-sim.csv")
    line = f"forecast past.csv {rig} --method simulator --future-inputs ahead.csv"
    call(f"{line} --steps {SAMPLES - TRAIN}", tmp_path / "forecast")
    for file in ("ahead-sim.csv", "forecast/forecast.csv"):
        said = pd.read_csv(tmp_path / file)["level"]
        np.testing.assert_allclose(said, pd.read_csv("ahead.csv")["level"], atol=1e-6)

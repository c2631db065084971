"""`splitband forecast`: what comes after the end of a record."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from tests.cli.support import DT, SAMPLES, SLOW, A, call, results, written
from tests.records import rms

pytestmark = pytest.mark.usefixtures("inside", "simulated_here")


def test_forecast_goes_on_from_the_end_of_a_record(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    methods = ["gru", "harmonic", "mean"]
    monkeypatch.setattr("splitband.evaluation.plan.usual_names", lambda *_: methods)
    pd.read_csv("record.csv").iloc[:150].to_csv(tmp_path / "begun.csv", index=False)
    call(
        f"forecast {tmp_path}/begun.csv --columns a --steps 50 --seeds 1 --jobs 1 --epochs 2",
        tmp_path / "out",
    )
    table, found = written(tmp_path / "out" / "forecast.csv"), results(tmp_path / "out")
    assert list(table) == ["time", "a", "a, lower", "a, upper"]
    np.testing.assert_allclose(table["time"], DT * np.arange(150, 200))
    assert found["method"] == min(found["held_out_rmse"], key=found["held_out_rmse"].get)
    assert found["method"] == "harmonic"
    np.testing.assert_allclose(table["a"], A[150:], atol=1e-4)  # the record is two sinusoids


def test_forecast_takes_known_inputs_and_several_seeds(tmp_path: Path) -> None:
    pd.DataFrame({"force": [1.0] * 20}).to_csv(tmp_path / "coming.csv", index=False)
    line = f"forecast record.csv --columns a,b --inputs force --steps 20 --future-inputs {tmp_path}"
    call(f"{line}/coming.csv --method gru --seeds 2 --jobs 1 --epochs 2", tmp_path / "out")
    found = results(tmp_path / "out")
    assert (found["method"], found["seeds"]) == ("gru", [0, 1])
    table = written(tmp_path / "out" / "forecast.csv")
    assert table.shape == (20, 7)
    assert np.isfinite(table.to_numpy()).all()


def test_forecast_asks_a_simulator_for_what_is_to_come(tmp_path: Path) -> None:
    call("forecast record.csv --columns a --steps 30 --method simulator-affine "
         "--simulator functions.py:good", tmp_path)  # fmt: skip
    time = DT * np.arange(SAMPLES, SAMPLES + 30)
    good = 0.8 * np.sin(2 * np.pi * 0.3 * time + 0.2) + 0.3
    found = written(tmp_path / "forecast.csv")["a"]
    assert rms(found - np.sin(2 * np.pi * SLOW * time)) < rms(
        good - np.sin(2 * np.pi * SLOW * time)
    )

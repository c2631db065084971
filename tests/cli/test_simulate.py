"""`splitband simulate`: free runs of a saved model."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import splitband as sb
from splitband import read
from splitband.models import Filtered
from splitband.simulators.calibration import Calibration
from tests.cli.support import DT, FORCE, QUICK, SIMULATED, SLOW, TIME, WARMUP, A, call, written
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


def test_simulate_needs_no_more_history_than_the_warmup(model: Path, tmp_path: Path) -> None:
    pd.read_csv("history.csv").iloc[-WARMUP:].to_csv(tmp_path / "end.csv", index=False)
    for name in ("history.csv", str(tmp_path / "end.csv")):
        call(f"simulate {model} --history {name} --steps 9", tmp_path / f"to-{Path(name).stem}.csv")
    assert (tmp_path / "to-history.csv").read_text() == (tmp_path / "to-end.csv").read_text()


def test_a_hybrid_model_simulates_on_with_any_simulator(hybrid_model: Path, tmp_path: Path) -> None:
    loaded, facts = load(hybrid_model)
    assert isinstance(loaded, Filtered)
    calibration = Calibration(**facts["calibration"])
    y, y_sim = A[40:50, None], calibration.apply(SIMULATED[:, None], 75, DT)[40:]
    for simulator in ("simulated.csv", "functions.py:good"):
        call(f"simulate {hybrid_model} --history history.csv --steps 25 --simulator {simulator}",
             tmp_path / "ahead.csv")  # fmt: skip
        table = written(tmp_path / "ahead.csv")
        assert table.shape == (25, 2)
        np.testing.assert_allclose(table[["a"]], simulated(loaded, y, 25, y_sim=y_sim), atol=1e-5)
    call(f"simulate {hybrid_model} --history history.csv --steps 150 --simulator simulated.csv",
         tmp_path / "all.csv")  # fmt: skip
    assert len(written(tmp_path / "all.csv")) == 150  # as far as the exported trajectory goes


def test_a_fitted_calibration_and_conditioning_are_simulated_with(tmp_path: Path) -> None:
    """The simulator is 3 % too slow, and known in closed form at any time."""
    call(f"fit record.csv --columns a --method filtered-gru --calibrate --conditioned {QUICK} "
         "--simulator functions.py:late", tmp_path / "model")  # fmt: skip
    call(f"simulate {tmp_path / 'model'} --history history.csv --steps 150 "
         "--simulator functions.py:late", tmp_path / "ahead.csv")  # fmt: skip
    model, facts = load(tmp_path / "model")
    assert isinstance(model, Filtered)
    assert (facts["method"], model.conditioned) == ("filtered-gru-calibrated-conditioned", True)
    saved = facts["calibration"]
    assert saved["clock"] == pytest.approx(1 / 0.97, abs=5e-3)
    (gain,), (offset,) = saved["gain"] or [1.0], saved["offset"] or [0.0]
    time = np.maximum(saved["clock"] * TIME - saved["delay"], 0)
    late = 0.8 * np.sin(2 * np.pi * SLOW * 0.97 * time + 0.2) + 0.3
    y_sim = (gain * late + offset)[40:, None]
    found = written(tmp_path / "ahead.csv")[["a"]].to_numpy()
    np.testing.assert_allclose(found, simulated(model, A[40:50, None], 150, y_sim=y_sim), atol=1e-3)
    raw = simulated(model, A[40:50, None], 150, y_sim=late[40:, None])
    assert np.abs(found - raw).max() > 0.05


def test_future_inputs_drive_a_model_that_has_inputs(driven_model: Path, tmp_path: Path) -> None:
    pd.DataFrame({"force": [9.0] * 20}).to_csv(tmp_path / "strong.csv", index=False)
    for name in ("future.csv", str(tmp_path / "strong.csv")):
        call(f"simulate {driven_model} --history history.csv --steps 20 --future-inputs {name}",
             tmp_path / f"to-{Path(name).stem}.csv")  # fmt: skip
    plain, strong = (written(tmp_path / f"to-{name}.csv") for name in ("future", "strong"))
    expected = simulated(load(driven_model)[0], A[40:50, None], 20, FORCE[40:70, None])
    np.testing.assert_allclose(plain[["a"]], expected, atol=1e-6)
    assert np.abs(plain["a"] - strong["a"])[0] > 1e-3  # an input acts on its own sample already


@pytest.mark.parametrize("method", ["harmonic", "residual-linear-gru"])
def test_what_is_fitted_in_closed_form_goes_on_as_python_says(method: str, tmp_path: Path) -> None:
    out = tmp_path / "model"
    call(f"fit record.csv --columns a --inputs force --method {method} {QUICK}", out)
    call(f"simulate {out} --history history.csv --steps 25 --future-inputs record.csv",
         tmp_path / "ahead.csv")  # fmt: skip
    history = read("history.csv", columns=["a"], inputs=["force"])
    expected = sb.load(out).predict(25, history, u=FORCE[50:75]).y
    np.testing.assert_allclose(written(tmp_path / "ahead.csv")[["a"]], expected, rtol=1e-12)
    assert np.corrcoef(expected[:, 0], A[50:75])[0, 1] > 0.9


def test_simulate_warms_up_on_one_sample_where_the_model_does(tmp_path: Path) -> None:
    call("fit record.csv --columns a --method gru --epochs 1 --hidden 4,3 --window 20 --warmup 1",
         tmp_path / "model")  # fmt: skip
    call(f"simulate {tmp_path / 'model'} --history history.csv --steps 3", tmp_path / "ahead.csv")

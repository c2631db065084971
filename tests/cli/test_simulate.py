"""`splitband simulate`: free runs of a saved model."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import splitband as sb
from splitband import read
from splitband.cli import main
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


def test_simulate_warms_up_on_one_sample_where_the_model_does(tmp_path: Path) -> None:
    call("fit record.csv --columns a --method gru --epochs 1 --hidden 4,3 --window 20 --warmup 1",
         tmp_path / "model")  # fmt: skip
    call(f"simulate {tmp_path / 'model'} --history history.csv --steps 3", tmp_path / "ahead.csv")


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


def test_the_simulator_makes_the_low_band_of_a_hybrid_model(
    hybrid_model: Path, tmp_path: Path
) -> None:
    found = []
    for name in ("good", "shifted"):
        call(f"simulate {hybrid_model} --history history.csv --steps 150 "
             f"--simulator functions.py:{name}", tmp_path / f"{name}.csv")  # fmt: skip
        found.append(written(tmp_path / f"{name}.csv")["a"].to_numpy())
    (gain,) = load(hybrid_model)[1]["calibration"]["gain"] or (1.0,)
    assert (found[1] - found[0])[-1] == pytest.approx(5 * gain, rel=1e-3)


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


def test_an_exported_trajectory_has_to_reach_the_last_step_and_no_further(tmp_path: Path) -> None:
    call(f"fit record.csv --columns a --method residual-gru --simulator simulated.csv {QUICK}",
         tmp_path / "model")  # fmt: skip
    call(f"simulate {tmp_path / 'model'} --history history.csv --steps 150 "
         "--simulator simulated.csv", tmp_path / "ahead.csv")  # fmt: skip
    assert len(written(tmp_path / "ahead.csv")) == 150


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


def test_an_interval_that_is_saved_with_a_model_is_written(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    model, history = sb.Mean().fit(read("record.csv", columns="a")), "history.csv"
    model.save(tmp_path / "plain")
    model.predict(1, level=0.9)
    model.save(tmp_path / "model")
    call(f"simulate {tmp_path / 'model'} --history {history} --steps 25 --level 0.8",
         tmp_path / "ahead.csv")  # fmt: skip
    table = written(tmp_path / "ahead.csv")
    expected = model.predict(25, read(history, columns="a"), level=0.8)
    assert list(table) == ["time", "a", "a, lower", "a, upper"]
    assert expected.lower is not None
    assert expected.upper is not None
    np.testing.assert_allclose(table["a, lower"], expected.lower[:, 0], rtol=1e-12)
    np.testing.assert_allclose(table["a, upper"], expected.upper[:, 0], rtol=1e-12)
    for folder, level, said in (
        (
            "plain",
            0.8,
            "--level must be left out for a model that was saved without held-out errors",
        ),
        ("model", 2, "--level must be between 0 and 1, got 2"),
    ):
        line = f"simulate {tmp_path / folder} --history {history} --steps 25 --level {level}"
        assert main([*line.split(), "--out", str(tmp_path / "none.csv")]) == 2
        assert capsys.readouterr().err.startswith(f"error: {said}")
    assert not (tmp_path / "none.csv").exists()


def test_a_simulator_that_the_model_does_not_ask_for_is_refused(
    model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line = f"simulate {model} --history history.csv --steps 5 --simulator functions.py:good"
    assert main([*line.split(), "--out", str(tmp_path / "x.csv")]) == 2
    assert "--simulator must be left out for gru" in capsys.readouterr().err


def test_what_a_simulator_said_is_kept_for_the_next_simulation(
    hybrid_model: Path, tmp_path: Path
) -> None:
    line = (f"simulate {hybrid_model} --history history.csv --steps 25 --simulator "
            f"functions.py:good --simulator-cache {tmp_path / 'cache'}")  # fmt: skip
    call(line, tmp_path / "one.csv")
    (kept,) = (tmp_path / "cache").iterdir()
    found = dict(np.load(kept))
    np.savez(kept, **found | {"y": found["y"] + 1})
    call(line, tmp_path / "two.csv")
    one, two = (written(tmp_path / f"{name}.csv")["a"] for name in ("one", "two"))
    assert np.abs(one - two).max() > 0.1


def test_a_model_takes_the_place_of_another_kind(model: Path, tmp_path: Path) -> None:
    network, mean = sb.load(model), sb.Mean().fit(read("record.csv", columns=["a", "b"]))
    for forecaster in (network, mean, network):
        forecaster.save(tmp_path)
        assert sb.load(tmp_path).name == forecaster.name
        assert len([*tmp_path.iterdir()]) == 2

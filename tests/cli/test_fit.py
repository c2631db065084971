"""`splitband fit` and `splitband export`: the model and the program that they write."""

import json
from dataclasses import replace
from pathlib import Path

import fmpy
import numpy as np
import pandas as pd
import pytest

import splitband as sb
from splitband.comparison.clock import Clock
from splitband.comparison.plan import Plan
from tests.cli.support import QUICK, SAMPLES, WARMUP, A, B, call, files, results
from tests.signals import rms
from tests.support import load_model as load
from tests.support import simulated

pytestmark = pytest.mark.usefixtures("inside")


def test_fit_writes_a_model_and_what_it_reached(model: Path) -> None:
    (weights,) = (path.name for path in model.glob("weights-*"))
    assert set(files(model)) == {"forecaster.json", weights, "results.json"}
    found = results(model)
    assert (found["method"], found["columns"], found["inputs"]) == ("gru", ["a", "b"], [])
    assert found["setup"]["train"] == SAMPLES
    loaded, _ = load(model)
    y = np.stack([A, B], axis=1)
    error = simulated(loaded, y[:WARMUP], SAMPLES - WARMUP) - y[WARMUP:]
    assert found["training_rmse"] == pytest.approx(rms(*error.T))


def test_intervals_are_saved_where_they_are_asked_for(tmp_path: Path) -> None:
    call("fit record.csv --columns a --method harmonic --intervals", tmp_path / "model")
    call(f"simulate {tmp_path / 'model'} --steps 5 --level 0.8", tmp_path / "ahead.csv")
    expected = sb.Harmonic().fit(sb.read("record.csv", columns="a")).predict(5, level=0.8)
    found = pd.read_csv(tmp_path / "ahead.csv")
    np.testing.assert_allclose(found, expected.to_frame())


def test_a_split_model_is_trained_on_windows_of_the_filtered_record(tmp_path: Path) -> None:
    how = "--window 40 --warmup 10 --epochs 1 --cutoff 1 --downsampling 2 --own-warmup no"
    call(f"fit record.csv --columns a --method split-gru --train 120 {how}", tmp_path / "model")
    found = sb.load(tmp_path / "model")
    assert isinstance(found, sb.Split)
    settings = replace(sb.TrainingSettings.of(120), window=40, warmup=10, epochs=1)
    low, high = found.low, found.high
    bands = sb.Bands(1, found.bands.order, 2)
    same = sb.Split(low, high, bands, settings=settings, own_warmup=False)
    same.fit(sb.read("record.csv", columns="a")[:120], seed=0)
    np.testing.assert_array_equal(found.predict(20).y, same.predict(20).y)


def test_a_record_too_short_for_intervals_still_has_its_model(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pd.read_csv("record.csv")[:2].to_csv(tmp_path / "short.csv", index=False)
    call(f"fit {tmp_path}/short.csv --columns a --method persistence --intervals", tmp_path / "m")
    assert "the model has no intervals: " in capsys.readouterr().out


def test_what_a_deadline_has_changed_is_said_and_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def late(plan: Plan, clock: Clock, **_: object) -> sb.Forecaster:
        clock.notes.append("results are of three quarters of it")
        return plan.methods[0].fit(plan.training)

    monkeypatch.setattr("splitband.cli.fit.fit_planned", late)
    call("fit record.csv --columns a --method mean --budget 1m", tmp_path)
    assert "warning: results are of three quarters of it" in capsys.readouterr().out
    assert results(tmp_path)["notes"] == ["results are of three quarters of it"]


def test_inputs_that_are_a_matrix_are_known_by_their_columns(tmp_path: Path) -> None:
    u = np.random.default_rng(0).standard_normal((SAMPLES, 2))
    y = 0.1 * np.cumsum(u @ [1.0, -0.5])
    np.savez(tmp_path / "rig.npz", y=y, u=u, dt=0.1)
    np.savez(tmp_path / "ahead.npz", u=u[:20], dt=0.1)
    call(f"fit {tmp_path}/rig.npz --inputs u --method linear", tmp_path / "model")
    assert results(tmp_path / "model")["inputs"] == ["u[0]", "u[1]"]
    line = f"simulate {tmp_path}/model --history {tmp_path}/rig.npz --steps 20"
    call(f"{line} --future-inputs {tmp_path}/ahead.npz", tmp_path / "ahead.csv")
    expected = y[-1] + 0.1 * np.cumsum(u[:20] @ [1.0, -0.5])
    found = pd.read_csv(tmp_path / "ahead.csv")["y"]
    np.testing.assert_allclose(found, expected, atol=0.05)


def test_a_base_takes_a_simulators_place(tmp_path: Path) -> None:
    call(f"fit record.csv --columns a --method residual-gru --simulator harmonic {QUICK}", tmp_path)
    assert results(tmp_path)["method"] == "residual-harmonic-gru"


def test_a_model_of_a_file_of_one_nameless_column_simulates_such_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    np.savetxt("one.txt", A)
    call(f"fit one.txt --sampling-time 0.1 --method gru --more one.txt {QUICK}", Path("model"))
    call("simulate model --history one.txt --steps 5", Path("ahead.csv"))
    found = pd.read_csv("ahead.csv")
    assert list(found) == ["time", "y"]
    expected = simulated(load(Path("model"))[0], A[-WARMUP:, None], 5)
    np.testing.assert_allclose(found[["y"]], expected, atol=1e-6)


def test_export_says_where_an_fmu_runs(
    driven_model: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"export {driven_model} {tmp_path}/rig.fmu")
    said = " ".join(capsys.readouterr().out.split())
    assert "the FMU runs on" in said
    assert 'pip install "splitband[everywhere]"' in said
    call(f"export {driven_model} {tmp_path}/rig.fmu --json")
    assert json.loads(capsys.readouterr().out)["platforms"] == [fmpy.platform]


def test_export_says_what_it_writes(
    driven_model: Path, workspace: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    history = f"--history {workspace}/record.csv --other-run"
    call(f"export {driven_model} {tmp_path}/later.c {history}")
    assert "begins at the end of " in capsys.readouterr().out
    assert "Go on from the end of the history" in (tmp_path / "later.h").read_text()
    call(f"export {driven_model} {tmp_path}/new/rig.c --precision float")
    assert sorted(file.name for file in (tmp_path / "new").iterdir()) == ["rig.c", "rig.h"]
    said = " ".join(capsys.readouterr().out.split())
    assert said.startswith("gru is written to ")
    header = (tmp_path / "new" / "rig.h").read_text()
    assert "u[1]: force" in header
    assert "int rig_step(rig_state *s, const float *u, float *y);" in header

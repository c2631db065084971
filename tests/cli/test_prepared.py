"""Commands read a history as the training record of a model was read, by what was decided there."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy

import splitband as sb
from splitband.cli import main
from tests.cli.support import call, results

pytestmark = pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")
N, TRAIN = 1500, "fit train.csv --columns tank --inputs flow --method linear"
AHEAD = "simulate model --history history.csv --future-inputs other.csv --steps 20 --other-run"


def table(seed: int, level: float) -> pd.DataFrame:
    """A tank, which a flow with this level fills, from rest at its own level."""
    rng = np.random.default_rng(seed)
    flow = np.repeat(rng.uniform(-2, 2, N // 10), 10) + level
    tank = 30 + scipy.signal.lfilter([0, 0.2], [1, -0.9], flow)
    return pd.DataFrame({"time": 0.1 * np.arange(N), "flow": flow, "tank": tank}).round(6)


@pytest.fixture
def other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> pd.DataFrame:
    """Another run of the tank, of another mean: its history has a spike and a word."""
    monkeypatch.chdir(tmp_path)
    table(1, 1.0)[300:].to_csv("train.csv", index=False)
    run = table(2, 2.0)
    run.to_csv("other.csv", index=False)
    history = run[:1203].copy()
    history.loc[1199, "tank"] = 900.0
    history = history.astype({"tank": object})
    history.loc[1100, "tank"] = "Bad"
    history.to_csv("history.csv", index=False)
    run[:1203].to_csv("clean.csv", index=False)
    return run


@pytest.mark.parametrize("prepared", ["--detrend", "--step 0.5 --detrend"])
def test_a_history_of_another_mean_is_prepared_by_the_levels_of_the_training(
    other: pd.DataFrame, prepared: str, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"{TRAIN} {prepared}", Path("model"))
    capsys.readouterr()
    call(AHEAD.replace("history.csv", "clean.csv"), Path("ahead.csv"))
    said = capsys.readouterr().out
    k = 5 if "step" in prepared else 1
    levels = pd.read_csv("train.csv").mean()
    assert f"tank (minus {levels['tank']:.6g}); {1203 // k} samples every {0.1 * k:g} s" in said
    assert f"20 samples of tank (minus {levels['tank']:.6g}) after clean.csv" in said
    # A mean is that of the samples since the last one, and has the time of its last sample.
    ahead = other[1203 : 1203 + 20 * k].to_numpy().reshape(20, k, 3)
    u, y = (ahead.mean(axis=1)[:, i] - levels[name] for i, name in ((1, "flow"), (2, "tank")))
    found = pd.read_csv("ahead.csv")
    np.testing.assert_allclose(found["time"], ahead[:, -1, 0])
    np.testing.assert_allclose(found["tank"], y, atol=0.02 if k == 1 else 0.5)
    model = sb.load("model")
    assert model.fitted is not None
    known = sb.read("clean.csv", columns="tank", inputs="flow").like(model.fitted.record)
    expected = model.predict(20, known, u=u, other_record=True).y
    np.testing.assert_allclose(found["tank"], expected[:, 0], atol=1e-5)


def test_a_history_has_the_limits_and_missing_words_of_the_training(other: pd.DataFrame) -> None:
    call(f"{TRAIN} --clip-outliers tank --missing Bad", Path("model"))
    call(f"{AHEAD} --gaps mask", Path("ahead.csv"))
    model = sb.load("model")
    assert model.fitted is not None
    record = model.fitted.record
    past = sb.read("history.csv", columns="tank", inputs="flow", missing="Bad", gaps="mask")
    assert record.reading.limits["tank"][1] < 60
    known = past.clip_outliers(limits=record.reading.limits)
    u = other[["flow"]][1203:1223]
    expected = model.predict(20, known, u=u, other_record=True)
    np.testing.assert_allclose(pd.read_csv("ahead.csv")["tank"], expected.y[:, 0])


def test_like_and_check_prepare_a_record_alike(
    other: pd.DataFrame, capsys: pytest.CaptureFixture[str]
) -> None:
    call(f"{TRAIN} --detrend", Path("model"))
    capsys.readouterr()
    call("check model --record clean.csv", Path("checked"))
    call("fit clean.csv --like model", Path("again"))
    said = capsys.readouterr().out
    # Beside the other methods, of which it is a usual one.
    call("compare clean.csv --like model --train 1000", Path("compared"))
    level = pd.read_csv("train.csv")["tank"].mean()
    assert said.count(f"tank (minus {level:.6g}); 1203 samples") == 2
    assert results(Path("checked"))["fit"]["simulation"]["tank"] > 99
    assert main(["fit", "clean.csv", "--like", "model", "--detrend", "--out", "m"]) == 2
    assert "must be given as it was measured, to be prepared like" in capsys.readouterr().err

"""Signals that go beyond what was seen of them in training are said to."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest

from splitband import GRU, Record, Single, TrainingSettings, check, load
from splitband.metrics import ExtrapolationWarning, extrapolations
from tests.cli.support import call, results

LENGTH, TRAIN = 120, 80


def record(u: npt.NDArray[np.float64]) -> pd.DataFrame:
    """A first-order lag of the input."""
    y = np.zeros(len(u))
    for n in range(1, len(u)):
        y[n] = 0.9 * y[n - 1] + 0.1 * u[n - 1]
    noise = 0.01 * np.random.default_rng(0).standard_normal(len(u))
    return pd.DataFrame({"time": 0.1 * np.arange(len(u)), "y": y + noise, "force": u})


def test_a_constant_may_not_change_and_others_may_go_a_tenth_beyond() -> None:
    low, high = np.array([2.0, -1.0, 0.0]), np.array([2.0, 1.0, 10.0])
    u = np.array([[2.0, 1.19, 5.0], [2.0, -1.19, -0.9], [2.1, 1.3, 10.9], [50.0, -2.0, 11.1]])
    found = extrapolations(low, high, u)
    assert [(e.channel, e.farthest, e.after) for e in found] == [
        (0, 50.0, 2),
        (1, -2.0, 2),
        (2, 11.1, 3),
    ]
    assert found[0].describe("force") == (
        "input force is beyond its range in training (2 only) from sample 2 on, up to 50: "
        "predictions from there on are extrapolations"
    )
    assert not extrapolations(low, high, u[:2])


def test_a_forecaster_warns_of_signals_that_it_was_not_trained_on(tmp_path: Path) -> None:
    u = np.random.default_rng(0).uniform(-1, 1, (LENGTH, 1))
    training = Record(np.cumsum(u, axis=0), 0.1, u=u)
    model = Single(GRU(4), TrainingSettings.paper(30, 10, 1)).fit(training)
    model.save(tmp_path / "model")
    for trained in (model, load(tmp_path / "model")):
        with pytest.warns(
            ExtrapolationWarning, match=r"u .* from sample 19 of the prediction on, up to 10000"
        ):
            trained.predict(20, u=np.r_[u[:19], [[1e4]]])
        assert not any("beyond" in said for said in trained.predict(20, u=u[:20]).warnings)
    fahrenheit = replace(training, y=1.8 * training.y + 320)
    with pytest.warns(ExtrapolationWarning, match="output y is beyond its range"):
        model.predict(20, fahrenheit, u[:20], other_record=True)
    assert "Output y is beyond its range" in str(check(model, fahrenheit))


def test_commands_warn_of_inputs_beyond_training(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    rng = np.random.default_rng(1)
    force = np.r_[rng.uniform(-1, 1, TRAIN), rng.uniform(-1, 1, 20), np.full(20, 50.0)]
    record(force).to_csv("record.csv", index=False)
    record(force)[:TRAIN].to_csv("past.csv", index=False)
    record(force)[TRAIN:].to_csv("future.csv", index=False)
    said = "nput force is beyond its range in training"
    quick = "--epochs 1 --window 30 --warmup 10"
    ahead = "--future-inputs future.csv --steps 40"
    few = "--seeds 1 --jobs 1 --methods gru,mean"

    call(f"compare record.csv --inputs force --train {TRAIN} {quick} {few}", Path("out"))
    shown = capsys.readouterr().out
    assert said in shown
    assert "from sample 20 of the prediction on, up to 50" in shown
    assert [e["after"] for e in results(Path("out"))["inputs_beyond_training"]] == [20]

    call(
        f"forecast past.csv --inputs force {ahead} --method gru --epochs 1 --seeds 1", Path("next")
    )
    assert said in (shown := capsys.readouterr().out)
    assert "from sample 20 of the prediction on, up to 50" in shown

    call(f"fit past.csv --inputs force --method gru {quick}", Path("model"))
    capsys.readouterr()
    call(f"simulate model --history past.csv {ahead}", Path("y.csv"))
    assert said in capsys.readouterr().out

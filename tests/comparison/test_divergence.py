"""Trainings that diverge, and methods that cannot be fitted: said so, and never the others' end."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import torch

from splitband import GRU, Record, TrainingSettings
from splitband.cli import main
from splitband.comparison.methods import Sizes
from splitband.comparison.run import compare as compared
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.baselines import Mean
from splitband.forecasters.hybrid import Single
from splitband.forecasters.prediction import ForecastContext
from splitband.forecasters.simulation import Calibrated
from splitband.models import ResidualModel
from splitband.report import words
from splitband.runtime.deadlines import DeadlineError
from splitband.training import fit
from tests.signals import Setup
from tests.support import compare

DT, TRAIN, LENGTH = 0.1, 120, 200
TIME = DT * np.arange(LENGTH)[:, None]
SIMULATED = np.sin(2 * np.pi * 0.2 * TIME) + 0.4 * np.sin(2 * np.pi * 1.13 * TIME)
RECORD = Record(np.round(2 * SIMULATED + 1, 4), DT, y_sim=SIMULATED)
QUICK = TrainingSettings.paper(40, 10, 3, 16)
SETUP = Setup(TRAIN, QUICK, bands=Bands(0.6, 1, 2), sizes=Sizes(hidden_high=4, hidden_low=3))
DIVERGING = Single(GRU(7), replace(QUICK, learning_rate=1e30))
CALIBRATED = "simulator-affine"
"""Fitted by least squares, where a clock and a delay are searched for in each of many fits."""


def _raising(*_: Any, **__: Any) -> Any:
    raise np.linalg.LinAlgError("SVD did not\nconverge")


@pytest.fixture
def broken_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Mean, "learn", _raising)


def test_a_residual_much_smaller_than_an_untrained_networks_output_is_trained() -> None:
    torch.manual_seed(0)
    model = ResidualModel(GRU(8, 1))
    almost = replace(RECORD, y_sim=RECORD.y + 1e-5 * np.cos(TIME))[:TRAIN]
    history = fit(model, almost, QUICK)
    losses = history.losses["network"]
    assert losses[0] > 100 * 1e-5
    assert losses[-1] < losses[0]
    assert history.notes == []


def failing_last(monkeypatch: pytest.MonkeyPatch, error: Exception) -> None:
    """The simulator's fit to the whole training part fails."""
    learn = Calibrated.learn

    def learn_from_less(self: Calibrated, records: Any, **options: Any) -> Any:
        if len(records[0]) == TRAIN:
            raise error
        return learn(self, records, **options)

    monkeypatch.setattr(Calibrated, "learn", learn_from_less)


def test_what_fails_on_the_whole_training_part_alone_is_not_recommended(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    methods = ["persistence", CALIBRATED]
    assert compare(RECORD, methods, SETUP).recommended == CALIBRATED
    failing_last(monkeypatch, np.linalg.LinAlgError("SVD did not converge"))
    found = compare(RECORD, methods, SETUP)
    assert (found.recommended, [*found.require_trial().failed]) == ("persistence", [CALIBRATED])
    assert CALIBRATED in found.require_trial().scores


def test_a_simulator_without_time_for_its_last_fit_has_the_results_of_the_one_before(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    failing_last(monkeypatch, DeadlineError())
    found = compare(RECORD, ["persistence", CALIBRATED], SETUP)
    assert found.recommended == CALIBRATED
    (fit,) = found.fits[CALIBRATED]
    assert len(fit.fitted.require_fitted().record) < TRAIN
    (said,) = found.clock.notes
    assert said.startswith(f"{CALIBRATED}: could not be fitted to the whole training part")


def test_where_every_method_fails_each_reason_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Mean, "learn", _raising)
    expected = "no method could be fitted; gru: training of the network diverged.*; mean: SVD did"
    with pytest.raises(ValueError, match=expected):
        compare(RECORD, [DIVERGING, "mean"], SETUP)


def test_a_full_disk_is_no_failure_of_a_method(monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: Any, **__: Any) -> Any:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Mean, "learn", full)
    with pytest.raises(OSError, match="No space left"):
        compare(RECORD, ["mean", "persistence"], SETUP)


@pytest.fixture
def files(tmp_path: Path) -> Callable[[str], list[str]]:
    """Arguments of a command for the record and its simulator."""
    for name, y in (("record", RECORD.y), ("simulator", SIMULATED)):
        pd.DataFrame({"time": TIME[:, 0].round(9), "y": y[:, 0]}).to_csv(
            tmp_path / f"{name}.csv", index=False
        )
    pd.read_csv(tmp_path / "record.csv")[:TRAIN].to_csv(tmp_path / "begun.csv", index=False)

    def command(text: str) -> list[str]:
        simulator = ["--simulator", str(tmp_path / "simulator.csv")]
        name, record, *rest = text.split()
        out = ["--out", str(tmp_path / "out")]
        return [name, str(tmp_path / record), *rest, *simulator, *out, "--jobs", "1"]

    return command


@pytest.mark.usefixtures("broken_mean")
def test_compare_has_a_row_for_what_could_not_be_fitted(
    tmp_path: Path, files: Callable[[str], list[str]], capsys: pytest.CaptureFixture[str]
) -> None:
    methods = f"mean,persistence,{CALIBRATED}"
    assert main(files(f"compare record.csv --train {TRAIN} --methods {methods}")) == 0
    said = capsys.readouterr().out
    assert "no result: SVD did not converge" in said
    found = json.loads((tmp_path / "out" / "results.json").read_text())
    assert found["recommended"] == CALIBRATED
    assert found["methods"]["mean"] == {"failed": "SVD did not converge"}
    assert "forecast_rmse" in found["methods"]["persistence"]
    assert not pd.read_csv(tmp_path / "out" / "predictions.csv").filter(like="mean").size


class Growing(Forecaster):
    """It has the inputs as outputs, and an error that grows as of an unstable model."""

    random, name = True, "growing"
    pole = 1.02

    def learn(self, records: Any, **_: Any) -> None:
        self.fitted = self.require_fitted().reporting(growth=self.pole)

    def extrapolate(self, known: ForecastContext) -> np.ndarray:
        assert known.u is not None
        ahead = np.arange(known.steps)[:, None]
        return known.u[len(known.y) :][: known.steps] + 1e-3 * self.pole**ahead


class Settled(Growing):
    """Its error is the same at each sample, and larger on the samples that are held out."""

    name, pole = "settled", 1.0

    def extrapolate(self, known: ForecastContext) -> np.ndarray:
        return super().extrapolate(known) + 0.02


@pytest.mark.parametrize(("train", "tests", "best"), [(400, 1, "settled"), (790, 0, "growing")])
def test_a_network_that_drifts_from_the_training_samples_is_not_recommended(
    train: int, tests: int, best: str
) -> None:
    """On the held-out quarter, shorter than a test record, it is the best one."""
    u = np.random.default_rng(0).standard_normal((800, 1))
    record, other = Record(u, DT, u=u), Record(u[::-1], DT, u=u[::-1])
    found = compared(record, train, [Growing(), Settled()], tests=[other] * tests)
    trial = found.require_trial()
    assert trial.errors["growing"] < trial.errors["settled"]
    assert found.recommended == best
    said = " ".join(words.why(trial, train, {}))
    assert "The score of growing, which drifts, is the larger error of its simulation" in said

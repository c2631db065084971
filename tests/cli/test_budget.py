"""`--budget`, and what is put in a simulator's place."""

from pathlib import Path

import pandas as pd
import pytest

import splitband as sb
from splitband.cli.comparing import Request, planned
from splitband.cli.options.simulators import SimulatorOrBaseOptions
from splitband.cli.setups import seconds
from splitband.evaluation.setup import default_names
from splitband.forecasters.names import BASED, NAMES, named, with_base
from tests.cli.support import assert_fails, call, results
from tests.support import slowed

pytestmark = pytest.mark.usefixtures("inside")


@pytest.mark.parametrize(
    ("text", "expected"), [("90s", 90), ("10m", 600), ("1.5h", 5400), (" 2M ", 120)]
)
def test_a_duration_has_a_unit(text: str, expected: float) -> None:
    assert seconds(text) == expected


@pytest.mark.parametrize("text", ["", "10", "m", "-1m", "0s", "infh", "nanm", "2 weeks"])
def test_what_is_no_duration_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="--budget must be a time such as 90s, 10m or 1h"):
        seconds(text)


@pytest.mark.parametrize("option", ["--epochs 2", "--window 40", "--recipe constant-rate"])
def test_a_budget_and_a_training_of_ones_own_exclude_each_other(
    option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    says = ("--budget is for finding out how to train", option.split(maxsplit=1)[0], "1m")
    assert_fails(f"compare record.csv --columns a --budget 1m {option}", says, capsys)


def test_the_effort_decides_what_is_tried(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("splitband.evaluation.candidates.LADDER", (3, 6))
    monkeypatch.setattr("splitband.evaluation.candidates.FIRST_STEPS", 4)
    monkeypatch.setattr("splitband.training.settings.STEPS", 20)
    line = "compare record.csv --columns a --methods gru,mean --jobs 1 --effort"
    tried = []
    for budget in ("0.1s", "0.3s"):
        call(f"{line} {budget}", tmp_path / budget)
        found = results(tmp_path / budget)
        tried.append(len(found["search"]))
        assert found["settings"]["search"]["core_seconds"] in (0.1, 0.3)
        assert "hidden units" in found["methods"]["gru"]["description"]
    assert tried[0] < tried[1]


def test_what_is_fitted_to_the_record_takes_a_simulators_place() -> None:
    methods = "simulator,residual-gru-calibrated,filtered-gru,mean"
    asked = Request("record.csv", simulator=SimulatorOrBaseOptions("harmonic"), methods=methods)
    assert [method.name for method in planned(asked, 1).methods] == [
        "harmonic", "residual-harmonic-gru", "filtered-harmonic-gru", "mean"
    ]  # fmt: skip


def test_names_on_a_base_are_those_of_what_they_name() -> None:
    for name in BASED:
        assert named(name).name == name
        assert "simulator" not in named(name).needs
    names = ["gru", "filtered-gru-calibrated-conditioned", "simulator-calibrated", "mean"]
    found = with_base(names, "linear")
    assert found == ["gru", "filtered-linear-gru-conditioned", "linear", "mean"]
    assert set(found) <= set(NAMES)


def test_the_default_has_a_result_and_a_model_when_its_two_minutes_are_over(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Nothing is limited here but the clock, of which each look takes a second."""
    record = pd.read_csv("record.csv")[["time", "a"]][:48]
    record.to_csv(tmp_path / "short.csv", index=False)
    slowed(monkeypatch, 1.0)
    call(f"compare {tmp_path}/short.csv --jobs 1", tmp_path / "out")
    found = results(tmp_path / "out")
    limits = found["settings"]["search"]
    assert (limits["core_seconds"], limits["seconds"]) == (240, 120)
    assert {*found["methods"]} == {*default_names(with_simulator=False)}
    assert "forecast_rmse" in found["methods"][found["recommended"]]
    assert sb.load(tmp_path / "out" / "model").predict(5).y.shape == (5, 1)

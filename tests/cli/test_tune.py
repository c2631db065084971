"""`splitband tune`, and what the other commands make of its settings."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from typing import Any

import pytest

from splitband.cli import main
from splitband.cli.comparing import Request, prepared
from splitband.cli.options.records import RecordOptions
from splitband.evaluation import search, space, study
from splitband.evaluation.setup import default_names
from splitband.evaluation.tuned import Tuned
from splitband.forecasters.bands import Bands
from splitband.forecasters.names import TRAINED, Sizes
from splitband.forecasters.network import Network
from splitband.runtime.files import CHECKPOINTS
from splitband.training import Settings
from tests.cli.support import assert_fails, assert_pictures, call, files, results

pytestmark = pytest.mark.usefixtures("inside", "undrawn")

TUNE = "tune record.csv --columns a --methods gru,split-gru --jobs 1"
SETTINGS = Settings(40, 15, 2, 16, 5e-3, most_batches=2, quasi_newton=2)
SAVED = Tuned("split-gru", SETTINGS, Bands(0.7, 1, 2), Sizes(4, 3))


@pytest.fixture
def short(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trainings of a few steps."""
    for name, limits in (("STEPS", (2, 4)), ("ITERATIONS", (1, 3)), ("HIDDEN", (4, 6))):
        monkeypatch.setattr(space, name, limits)
    monkeypatch.setattr(search, "LADDER", (2,))
    monkeypatch.setattr(search, "FIRST_STEPS", 2)
    monkeypatch.setattr("splitband.training.settings.STEPS", 2)


@pytest.fixture
def untrained(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Nothing is trained: the error is a function of the settings. The methods that were tried."""
    tried: list[str] = []

    def score(record: Any, share: float, network: Network, *others: Any) -> float:
        assert network.settings is not None
        if share == 1:
            tried.append(network.name)
        return 1 + abs(math.log(network.settings.learning_rate / 0.02))

    monkeypatch.setattr(study, "score", score)
    return tried


@pytest.fixture
def saved(tmp_path: Path) -> Path:
    SAVED.save(tmp_path / "settings.json")
    return tmp_path / "settings.json"


@pytest.mark.usefixtures("short", "drawn")
def test_it_writes_settings_results_and_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "tuned"
    call(f"{TUNE} --trials 4", out)
    said, found = capsys.readouterr().out, results(out)
    assert_pictures(out, "history.png", "importances.png")
    assert {path.name for path in out.iterdir()} == {
        "settings.json", "results.json", "history.png", "importances.png",
    }  # fmt: skip
    assert [trial["number"] for trial in found["trials"]] == [0, 1, 2, 3]
    assert found["held_out"] <= found["held_out_default"]
    assert found["environment"]["versions"]["optuna"]
    best = Tuned.read(out / "settings.json")
    assert best.found["held_out"] == found["held_out"]
    assert (best.columns, best.inputs) == (("a",), ())
    assert ("nothing better than the default recipe was found" in said) != found["improved"]
    assert f"{best.method} " in said
    trial = found["trials"][found["best"]]
    assert trial["training"] == as_written(best)["training"]


def as_written(tuned: Tuned) -> dict[str, Any]:
    facts: dict[str, Any] = json.loads(json.dumps(tuned.as_json()))
    return facts


def as_saved(settings: dict[str, Any]) -> bool:
    expected = as_written(SAVED)
    return (
        settings["settings"] == expected["training"]
        and all(settings[name] == value for name, value in expected["bands"].items())
        and all(settings[name] == value for name, value in expected["sizes"].items())
        and "search" not in settings
    )


def test_compare_trains_as_the_settings_say(saved: Path, tmp_path: Path) -> None:
    reading = RecordOptions(columns="a")
    task = prepared(Request("record.csv", reading, settings=saved), 1)
    assert as_saved(json.loads(json.dumps(task.setup.as_json())))
    assert task.names == ["split-gru", *(n for n in default_names(False) if n not in TRAINED)]
    line = f"compare record.csv --columns a --seeds 1 --jobs 1 --settings {saved}"
    call(f"{line} --methods gru,mean --epochs 1 --hidden 3,2 --cutoff 0.9", tmp_path / "other")
    found = results(tmp_path / "other")
    assert [*found["methods"]] == ["gru", "mean"]
    said = found["settings"]
    assert said["settings"] == as_written(SAVED)["training"] | {"epochs": 1}
    assert (said["hidden_high"], said["hidden_low"], said["cutoff"]) == (3, 2, 0.9)


def test_fit_and_forecast_train_as_the_settings_say(
    saved: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    call(f"fit record.csv --columns a --jobs 1 --settings {saved}", tmp_path / "model")
    found = results(tmp_path / "model")
    assert found["method"] == "split-gru"
    assert as_saved(found["setup"])
    call(f"fit record.csv --columns a --jobs 1 --method gru --epochs 1 --settings {saved}",
         tmp_path / "gru")  # fmt: skip
    assert results(tmp_path / "gru")["method"] == "gru"
    few = ["gru", "split-gru-conditioned", "mean", "persistence"]
    monkeypatch.setattr("splitband.cli.forecast.default_names", lambda *known: few)
    line = "forecast record.csv --columns a --steps 5 --seeds 1 --jobs 1"
    call(f"{line} --settings {saved}", tmp_path / "ahead")
    tried = results(tmp_path / "ahead")["held_out_rmse"]
    assert {*tried} == {"split-gru", "mean", "persistence"}


@pytest.mark.usefixtures("untrained")
def test_a_storage_is_gone_on_with(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = f"{TUNE} --storage sqlite:///{tmp_path}/tune.db --trials"
    call(f"{line} 3", tmp_path / "first")
    capsys.readouterr()
    call(f"{line} 5 --json", tmp_path / "second")
    assert json.loads(capsys.readouterr().out) == results(tmp_path / "second")
    first, second = (results(tmp_path / name)["trials"] for name in ("first", "second"))
    assert len(second) == 5
    assert second[:3] == first


def test_ctrl_c_is_one_line_and_the_same_command_goes_on(
    tmp_path: Path,
    untrained: list[str],
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    out, whole = tmp_path / "out", vars(study)["score"]

    def interrupted(*arguments: Any) -> float:
        if len(untrained) == 2:
            raise KeyboardInterrupt
        found: float = whole(*arguments)
        return found

    monkeypatch.setattr(study, "score", interrupted)
    line = shlex.split(f"{TUNE} --trials 5 --out {out}")
    assert main(line) == 130
    assert capsys.readouterr().err == (
        "error: stopped; no file is half written, and the same command goes on from here\n"
    )
    assert {path.name for path in out.iterdir()} == {CHECKPOINTS}
    monkeypatch.setattr(study, "score", whole)
    before = len(untrained)
    assert main(line) == 0
    assert len(results(out)["trials"]) == 5
    assert len(untrained) - before == 4  # of five; one had been finished
    assert CHECKPOINTS not in {path.name for path in out.iterdir()}


@pytest.mark.usefixtures("untrained")
def test_no_password_is_written_down(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    opened = study._opened
    local = f"sqlite:///{tmp_path}/tune.db"
    monkeypatch.setattr(study, "_opened", lambda address, new: opened(local, new))
    call(f"{TUNE} --trials 1 --storage postgresql://me:secret@host/tune", tmp_path / "out")
    assert not [name for name, content in files(tmp_path / "out").items() if b"secret" in content]


@pytest.mark.parametrize(
    ("line", "says"),
    [
        (f"{TUNE} --storage nowhere", ("--storage must be a database", "got nowhere")),
        (f"{TUNE} --budget soon", ("--budget must be a time such as 90s, 10m or 1h", "soon")),
        (f"{TUNE} --trials 0", ("--trials",)),
        (f"{TUNE} --methods mean --trials 1", ("--methods must be among those", "got mean")),
        (f"{TUNE} --train 9 --trials 1", ("--warmup must have more than 6 samples",)),
        ("compare record.csv --columns a --settings no.json",
         ("--settings must be a file", "no.json")),
        ("fit record.csv --columns a --settings record.csv", ("settings must be a JSON file",)),
        ("forecast record.csv --columns a --steps 5 --settings bad.json",
         ("bad.json: training.window must be a whole number", '"long"')),
        ("compare record.csv --columns a --settings good.json --budget 1m",
         ("--budget is for finding out how to train, which --settings decides",)),
        ("compare record.csv --columns a --settings good.json --recipe paper",
         ("--recipe and --settings exclude each other, got paper",)),
        ("compare record.csv --columns a --settings good.json --warmup 90",
         ("window must be longer than the warm-up of 90",)),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_line(
    line: str, says: tuple[str, ...], saved: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    facts = SAVED.as_json()
    Path("good.json").write_text(json.dumps(facts))
    facts["training"]["window"] = "long"
    Path("bad.json").write_text(json.dumps(facts))
    folder = "tune-out"
    assert_fails(f"{line} --out {folder}", says, capsys)

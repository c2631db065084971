"""Commands read files of uneven stamps, several rates, runs and parts, and other files alike."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import splitband as sb
from splitband.cli import main
from tests.cli.support import call, results
from tests.records.test_rates import STEP, logged

pytestmark = [
    pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning"),
    pytest.mark.filterwarnings("ignore::splitband.records.signals.ReadingWarning"),
]


def fit(asked: str, folder: str = "model") -> None:
    call(f"fit {asked} --columns x --inputs u --method linear", Path(folder))


@pytest.fixture(autouse=True)
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.mark.parametrize("step", ["auto", "0.2"])
def test_a_history_is_put_on_the_grid_of_the_training(step: str) -> None:
    logged(0.2).to_csv("rig.csv", index=False)
    table = logged(0.2, seed=1)
    table[:500].to_csv("now.csv", index=False)
    table[["time", "u"]][480:].to_csv("plan.csv", index=False)
    fit(f"rig.csv --step {step}")
    line = "simulate model --history now.csv --future-inputs plan.csv --steps 300 --other-run"
    call(line, Path("ahead.csv"))
    found = pd.read_csv("ahead.csv")
    longer = 2 if step == "0.2" else 1
    np.testing.assert_allclose(np.diff(found["time"]), longer * STEP, rtol=1e-6)
    times = found["time"] - 0.5 * (longer - 1) * STEP  # means lie half of their step before
    truth = np.interp(times, table["time"], table["x"])
    assert sb.fit_percent(truth, found["x"].to_numpy()) > (97 if longer == 1 else 90)


def test_the_refusal_names_the_option_that_reads_the_file(
    capsys: pytest.CaptureFixture[str],
) -> None:
    logged(0.2).to_csv("rig.csv", index=False)
    line = ["fit", "rig.csv", "--inputs", "u", "--method", "linear", "--out", "model"]
    assert main(line) == 2
    said = capsys.readouterr().err
    assert "--step 0.1" in said
    assert main([*line, "--step", "0.1"]) == 0
    assert "put on an even grid of 0.1 s" in capsys.readouterr().out


def test_runs_of_one_file_are_trained_on_together() -> None:
    parts = [logged(0.0, seed, 200).assign(run=seed) for seed in range(4)]
    pd.concat(parts).to_csv("runs.csv", index=False)
    logged(0.0, 9, 400).assign(run="a").to_csv("other.csv", index=False)
    fit("runs.csv --runs run --more other.csv")
    assert results(Path("model"))["more"] == ["runs 1", "runs 2", "runs 3", "other a"]
    records = sb.read("runs.csv", columns="x", inputs="u", runs="run")
    last = sb.read("other.csv", columns="x", inputs="u")
    found, expected = sb.load("model"), sb.Linear().fit(*records, last)
    u = np.ones((30, 1))
    np.testing.assert_allclose(
        found.predict(30, records[0], u=u, other_record=True).y,
        expected.predict(30, records[0], u=u, other_record=True).y,
    )


def test_inspect_of_several_runs_shows_the_longest_one(capsys: pytest.CaptureFixture[str]) -> None:
    parts = [logged(0.0, seed, 180 + 20 * seed).assign(run=seed) for seed in range(2)]
    pd.concat(parts).to_csv("runs.csv", index=False)
    assert main(["inspect", "runs.csv"]) == 2  # the message names the option
    assert "--runs run" in capsys.readouterr().err
    assert main(["inspect", "runs.csv", "--runs", "run"]) == 0
    said = capsys.readouterr().out
    assert "2 runs of 180 to 200 samples, of which runs 1:" in said
    assert "splitband compare runs.csv --inputs u --runs run" in said


def test_parts_of_a_run_in_files_and_in_a_long_table() -> None:
    table = logged(0.0)
    table[["time", "x"]].to_csv("rig.csv", index=False)
    table[["time", "u"]].assign(time=table["time"] - 1.5).to_csv("pump.csv", index=False)
    fit("rig.csv --join pump.csv@+1.5")
    long = table.melt("time", var_name="tag").sort_values("time")
    long.to_csv("long.csv", index=False)
    fit("long.csv --long tag,time,value", "of-long")
    errors = [results(Path(each))["training_rmse"] for each in ("model", "of-long")]
    assert errors[0] == pytest.approx(errors[1], rel=1e-3)
    assert max(errors) < 0.01


def test_a_slow_output_trains_a_network_and_is_scored_at_its_own_samples() -> None:
    table = logged(0.0)
    table["x"] = table["x"].where(table.index % 10 == 0)
    table.to_csv("slow.csv", index=False)
    call("fit slow.csv --inputs u --method gru --hidden 4,8 --epochs 40", Path("model"))
    call("check model --record slow.csv", Path("checked"))
    assert results(Path("checked"))["fit"]["simulation"]["x"] > 95

"""What is wrong in records is said before anything is trained, with the options that help."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import scipy

from splitband.cli import printing
from tests.cli.support import call, results

N = 2000


def write(name: str, seed: int, spoilt: int = 0) -> None:
    """A heading, from 0 to 360 degrees, a speed with missing samples, and what drives both."""
    rng = np.random.default_rng(seed)
    rudder = np.repeat(rng.uniform(-25, 25, N // 40), 40)
    pedal = np.repeat(rng.uniform(0, 60, N // 40), 40)
    turning = scipy.signal.lfilter([0, 0.02], [1, -0.9], rudder)
    speed = scipy.signal.lfilter([0, 0.05], [1, -0.95], pedal) + rng.normal(0, 0.2, N)
    speed[rng.choice(N, spoilt, replace=False)] = 6553.5
    heading = (180 + 0.5 * np.cumsum(turning) + rng.normal(0, 0.2, N)) % 360
    table = {"time": 0.5 * np.arange(N), "rudder": rudder, "pedal": pedal, "speed": speed}
    pd.DataFrame(table | {"heading [deg]": heading}).round(2).to_csv(name, index=False)


@pytest.fixture
def sea(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    write("sea.csv", 1, 8)
    write("test.csv", 2)
    return tmp_path


COMPARE = "compare sea.csv --inputs rudder,pedal --test test.csv --methods linear,mean"


@pytest.mark.usefixtures("drawn")
def test_the_first_lines_name_the_faults_and_the_options(
    sea: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    call(COMPARE.replace("linear,", ""), sea / "out")
    said = capsys.readouterr().out
    before, after = said.split("recommended: ")
    warned = [line for line in before.splitlines() if line.startswith("warning: ")]
    assert [line.split("'")[0].split()[1] for line in warned] == ["sea:", "sea:", "test:"]
    assert "'heading [deg]' jumps by 360 " in warned[1]
    assert "outliers" not in after
    assert "wraps" not in after
    assert results(sea / "out")["warnings"] == [line.removeprefix("warning: ") for line in warned]
    page = (sea / "out" / "report.html").read_text()
    assert "has outliers, 6553.5 in 8 of 2000 samples" in page
    shown = shlex.split(warned[1])
    option = shown[shown.index("(--unwrap") + 1].rstrip(")")
    assert option == "heading [deg]=360"


def fits(folder: Path) -> list[float]:
    table = results(folder)["table"]
    return [c["values"]["linear"] for c in table if c["heading"] == "test fit %"]


def test_limited_outliers_lead_to_the_right_model(sea: Path) -> None:
    call(f"{COMPARE} --columns speed --clip-outliers speed", sea / "out")
    assert results(sea / "out")["warnings"] == []
    assert min(fits(sea / "out")) > 95


@pytest.mark.usefixtures("drawn")
def test_missing_values_and_periods_lead_to_the_right_model(sea: Path) -> None:
    call(f"{COMPARE} --unwrap heading --missing 6553.5 --gaps mask", sea / "out")
    assert results(sea / "out")["warnings"] == []
    assert min(fits(sea / "out")) > 95
    assert "--unwrap heading" in (sea / "out" / "report.html").read_text()
    # The saved model does with a history what was done with its record.
    pd.read_csv("test.csv")[: N - 100].to_csv("history.csv", index=False)
    line = "simulate out/model --history history.csv --steps 100 --future-inputs test.csv"
    call(f"{line} --other-run", sea / "ahead.csv")
    found = pd.read_csv("ahead.csv")["heading [deg]"].to_numpy()
    measured = pd.read_csv("test.csv")["heading [deg]"].to_numpy()[-100:]
    assert np.abs((found - measured + 180) % 360 - 180).max() < 5


def test_inputs_to_come_of_an_angle_go_on_after_the_record(sea: Path) -> None:
    table = pd.read_csv("sea.csv")
    table["wind"] = (3.0 * np.arange(N)) % 360
    table["drift"] = np.cumsum(np.full(N, 0.3)) + np.random.default_rng(1).normal(0, 0.01, N)
    table[:1900].to_csv("wind.csv", index=False)
    table.to_csv("all.csv", index=False)
    call("fit wind.csv --columns drift --inputs wind --unwrap wind=360 --method linear", sea / "m")
    call("simulate m --steps 100 --future-inputs all.csv", sea / "ahead.csv")
    found = pd.read_csv("ahead.csv")["drift"]
    np.testing.assert_allclose(found, table["drift"][1900:], atol=1)


@pytest.mark.parametrize("verbose", [False, True])
def test_the_first_warning_is_said_and_the_others_are_counted(
    verbose: bool, capsys: pytest.CaptureFixture[str]
) -> None:
    with printing.saying(False, False, verbose):
        printing.warn_of(["the first", "another", "a third"], 1)
    first, *others = capsys.readouterr().out.splitlines()
    assert first == "warning: the first"
    assert others == (
        ["warning: another", "warning: a third"] if verbose else ["2 more warnings: --verbose"]
    )

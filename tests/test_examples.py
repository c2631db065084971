"""The documented examples run as they stand, and their hybrid models are worth their training."""

import json
import re
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy

import splitband as sb
from splitband.cli import main

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"


def train_shortly(patch: pytest.MonkeyPatch, epochs: int) -> None:
    """Let an example train for so many epochs, whatever it says."""
    settings = sb.TrainingSettings
    patch.setattr(sb, "TrainingSettings", lambda **given: settings(**given | {"epochs": epochs}))


@pytest.mark.parametrize(("name", "off"), [("ode", 0.213), ("csv", 2.12), ("fmu", 0.212)])
def test_an_example_prints_a_hybrid_model_that_beats_its_simulator(
    name: str,
    off: float,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    if name == "fmu":
        for package in ("fmpy", "pythonfmu"):
            pytest.importorskip(package)
    train_shortly(monkeypatch, 90)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [f"{name}_simulator.py"])
    runpy.run_path(str(EXAMPLES / f"{name}_simulator.py"), run_name="__main__")
    printed = capfd.readouterr()
    assert printed.err == ""
    assert not [*tmp_path.iterdir()]
    found = {key: float(value) for key, value in re.findall(r"(\w+) RMSE (\S+)", printed.out)}
    assert set(found) == {"simulator", "hybrid"}
    assert found["simulator"] == pytest.approx(off, rel=0.03)
    assert found["hybrid"] < 0.8 * found["simulator"]


def test_a_predictive_controller_keeps_two_tanks_at_their_targets(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    train_shortly(monkeypatch, 15)
    runpy.run_path(str(EXAMPLES / "mpc_tanks.py"), run_name="__main__")
    printed = capfd.readouterr()
    assert printed.err == ""
    (fit,) = re.findall(r"model fit (\S+) %", printed.out)
    (off,) = re.findall(r"settled (\S+)", printed.out)
    ((low, high),) = re.findall(r"pump from (\S+) V to (\S+) V", printed.out)
    assert float(fit) > 80
    assert float(off) < 0.15
    assert 0.5 <= float(low) <= float(high) <= 5.5


@pytest.mark.parametrize(
    ("name", "best"), [("own_forecaster", "drift"), ("own_cell", "split-lstm")]
)
def test_what_users_add_is_compared_like_any_other(
    name: str, best: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    train_shortly(monkeypatch, 5)
    monkeypatch.setattr(sys, "argv", [f"{name}.py"])
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    printed = capfd.readouterr()
    assert printed.err == ""
    assert f"recommended: {best}\n" in printed.out


def test_many_records_are_compared_one_by_one_and_summed_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As jobs of an array do it, with a network that is trained shortly."""
    for name in ("FIRST_ROUND", "FIRST_STEPS"):
        monkeypatch.setattr(f"splitband.comparison.candidates.{name}", 2)
    monkeypatch.setattr(
        "splitband.comparison.defaults.usual_names", lambda *_: ["gru", "linear", "mean"]
    )
    (tmp_path / "records").mkdir()
    for i, name in enumerate(("arm", "pump")):
        u = np.random.default_rng(i).uniform(-1, 1, 300)
        y = scipy.signal.lfilter([0.0, 0.1], [1.0, -0.9], u)
        table = pd.DataFrame({"time": 0.1 * np.arange(300), "u": u, "y": y})
        table.to_csv(tmp_path / f"records/{name}.csv", index=False)
    monkeypatch.chdir(tmp_path)
    for index in "011":
        monkeypatch.setattr(sys, "argv", ["many_records.py", "records", "results", index])
        runpy.run_path(str(EXAMPLES / "many_records.py"), run_name="__main__")
    said = capsys.readouterr().out.splitlines()
    assert said == ["arm.csv: linear", "pump.csv: linear", "pump.csv: is there"]
    assert main(["summary", "results/arm", "results/pump", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [row["record"] for row in rows] == ["arm", "pump"]
    assert all(row["forecast fit %"] > 99 for row in rows)


def test_the_python_of_the_readme_runs_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a driven system; fewer methods are compared here."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    monkeypatch.setattr(
        "splitband.comparison.defaults.usual_names", lambda *_: ["linear", "mean", "persistence"]
    )
    monkeypatch.chdir(tmp_path)
    force = np.random.default_rng(0).uniform(-1, 1, 2000)
    position = scipy.signal.lfilter([0.0, 0.1], [1.0, -0.9], force)
    table = {"time": 0.1 * np.arange(2000), "force": force, "position": position}
    pd.DataFrame(table).to_csv("rig.csv", index=False)
    found: dict[str, Any] = {}
    exec(code, found)
    assert {*found["result"].table.index} == {"linear", "mean", "persistence"}
    assert found["result"].table["forecast fit %"]["linear"] > 99
    assert Path("rig.fmu").stat().st_size > 0

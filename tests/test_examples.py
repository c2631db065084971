"""The documented examples run as they stand, and their hybrid models are worth their training."""

import math
import re
import runpy
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = ROOT / "examples"


@pytest.mark.parametrize("name", ["ode", "csv", "fmu"])
def test_an_example_prints_a_hybrid_model_that_beats_its_simulator(
    name: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    if name == "fmu":
        for package in ("fmpy", "pythonfmu"):
            pytest.importorskip(package)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", [f"{name}_simulator.py"])
    runpy.run_path(str(EXAMPLES / f"{name}_simulator.py"), run_name="__main__")
    printed = capfd.readouterr()
    assert printed.err == ""
    assert not [*tmp_path.iterdir()]
    found = {key: float(value) for key, value in re.findall(r"(\w+) RMSE (\S+)", printed.out)}
    assert set(found) == {"simulator", "hybrid"}
    assert all(math.isfinite(value) for value in found.values())
    assert found["hybrid"] < 0.8 * found["simulator"]


def test_the_examples_are_short_and_say_what_they_are() -> None:
    scripts = sorted(EXAMPLES.glob("*.py"))
    assert [path.stem for path in scripts] == ["csv_simulator", "fmu_simulator", "ode_simulator"]
    for path in scripts:
        lines = path.read_text().splitlines()
        assert len(lines) <= 40
        assert lines[0].startswith('"""')


def test_the_python_of_the_readme_runs_as_it_stands(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a record of two sinusoids; the default recipe takes fewer steps here."""
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    monkeypatch.setattr("splitband.training.settings.STEPS", 20)
    monkeypatch.chdir(tmp_path)
    time = 0.1 * np.arange(2000)
    y = np.sin(0.4 * time) + 0.3 * np.sin(7 * time)
    pd.DataFrame({"time": time, "y": y}).to_csv("record.csv", index=False)
    found: dict[str, Any] = {}
    exec(code, found)
    assert found["forecast"].shape == (500, 1)
    assert np.isfinite(found["forecast"]).all()

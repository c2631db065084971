"""The documented examples run as they stand, and their hybrid models are worth their training."""

import math
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[1] / "examples"


def run(script: str, *arguments: str, folder: Path) -> dict[str, float]:
    """Run an example elsewhere; return the RMSE it prints, by name."""
    found = subprocess.run(
        [sys.executable, "-W", "error", str(EXAMPLES / script), *arguments],
        cwd=folder, capture_output=True, text=True, check=False, timeout=120,
        env=os.environ | {"OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert (found.returncode, found.stderr) == (0, "")
    assert not list(folder.iterdir())
    return {name: float(value) for name, value in re.findall(r"(\w+) RMSE (\S+)", found.stdout)}


@pytest.mark.parametrize("name", ["ode", "csv", "fmu"])
def test_an_example_prints_a_hybrid_model_that_beats_its_simulator(
    name: str, tmp_path: Path
) -> None:
    if name == "fmu":
        for package in ("fmpy", "pythonfmu"):
            pytest.importorskip(package)
    found = run(f"{name}_simulator.py", folder=tmp_path)
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

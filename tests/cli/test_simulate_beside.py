"""`splitband simulate --record`: a simulator is run once, and its file stands for it."""

from __future__ import annotations

import shlex
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import splitband as sb
from splitband.cli import main
from splitband.simulators.open_simulator import open_simulator, simulated
from tests.simulators.fmus import COMPILES, built

pytestmark = pytest.mark.filterwarnings("ignore::splitband.records.signals.ReadingWarning")
TIME = 0.1 * np.arange(120)
STEPS = np.repeat([1.0, -0.5, 2.0, 0.0], 30)
RIG = """
import numpy as np

def driven(time, u):
    return np.sin(time) + u[:, 0] / 3

def alone(time):
    return np.sin(time) / 3
"""
# The simulator, its options, and the options of the record.
RUN = {
    "a function of time and inputs": ("rig.py:driven", "", "--inputs u --columns y"),
    "a function of time": ("rig.py:alone", "--simulator-start 2", "--columns y"),
    "an equation with values": ("ode.py:lag", "--parameters k=2,x0_1=1", "--inputs u --columns y"),
    "an FMU": ("rig.fmu", "", "--inputs u --columns y"),
}


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    stamps = pd.Timestamp("2024-05-01") + pd.to_timedelta(TIME, "s")
    table = pd.DataFrame({"time": stamps, "u": STEPS, "y": np.cos(TIME)})
    table.to_csv("rig.csv", index=False)
    Path("rig.py").write_text(RIG)
    Path("ode.py").write_text("def lag(t, x, u, p): return [p.k * (u[0] - x[0])]\n")
    return tmp_path


@pytest.mark.parametrize("what", RUN)
def test_the_file_stands_for_the_simulator(what: str) -> None:
    """With the numbers of a run here, to the last bit, also where a calibration looks beyond."""
    simulator, how, columns = RUN[what]
    if simulator.endswith(".fmu"):
        if not COMPILES:
            pytest.skip("no gcc to compile an FMU with")
        built(Path(simulator).resolve())
    inputs = ["u"] if "--inputs" in columns else None
    record = sb.read("rig.csv", columns=["y"], inputs=inputs)
    start, parameters = 2.0 if "start" in how else None, "k=2,x0_1=1" if "k=" in how else None
    opened = open_simulator(simulator, record, start=start, parameters=parameters)
    expected = simulated(record, opened, longer=True)
    line = f"simulate --record rig.csv --simulator {simulator} {how} {columns} --out ran.csv"
    assert main(shlex.split(line)) == 0
    found = simulated(record, open_simulator("ran.csv", record), longer=True)
    np.testing.assert_array_equal(found.y_sim, expected.y_sim)
    assert expected.y_sim is not None
    assert (len(expected.y_sim) > len(record)) == (inputs is None)
    for each in ("rig.py", "ode.py"):
        Path(each).unlink()
    line = f"fit rig.csv {columns} --method simulator-calibrated --simulator ran.csv --out model"
    assert main(shlex.split(line)) == 0

"""What needs no network starts without the libraries of networks and pictures."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import splitband as sb

SLOW = "torch", "numba", "matplotlib"
LOADED = f"print([name for name in {SLOW} if name in sys.modules])"
"""The last line of a program: the libraries that it has loaded."""

BASELINES = """
import sys
import numpy as np
import splitband as sb
from splitband.filters.cutoff import choose
from splitband.filters.spectrum import oracle
from splitband.forecasters.held_out import held_out_of
from splitband.comparison.methods import NAMES, forecasters, named

record, u = sb.read("rig.csv", inputs=["force"]), np.zeros((5, 1))
for model in (sb.Mean(), sb.Persistence(), sb.Linear(), sb.Harmonic()):
    y = model.fit(record).predict(5, u=u).y
    assert np.isfinite(y).all()
model = named("linear").fit(record)
held_out_of(model)
model.save("model")
again = sb.load("model").predict(5, u=u, level=0.9)
assert (again.y == model.predict(5, u=u).y).all()
assert len(again.to_frame()) == 5
model.stream().step(u[0])
chosen = choose(record.y, record.sampling_rate, warmup=30)
pair = sb.ComplementaryPair.butterworth(chosen.cutoff, record.sampling_rate, chosen.order)
low, high = pair.split(record.y)
oracle(record.y, low, record.sampling_rate, chosen.cutoff)
(hybrid,) = forecasters(["filtered-gru"], base="linear")
assert hybrid.name == "filtered-linear-gru"
assert len(forecasters(["filtered-gru"], calibrate=True)) == 2
assert all(method.in_words() for method in NAMES.values())
sb.Ode, sb.Fmu, sb.TrainingSettings
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with a record of 400 samples."""
    time = 0.1 * np.arange(400)
    force = np.sign(np.sin(0.7 * time))
    angle = np.convolve(force, 0.1 * 0.9 ** np.arange(60))[:400] + 0.1 * np.sin(2 * time)
    table = np.column_stack([time, force, angle])
    np.savetxt(tmp_path / "rig.csv", table, "%.9g", ",", header="time,force,angle", comments="")
    return tmp_path


def run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True, check=False)


def test_baselines_and_filters_need_no_torch_and_a_network_does(folder: Path) -> None:
    done = run(folder, "-c", f"{BASELINES}{LOADED}\nnamed('gru')\n{LOADED}")
    assert done.stdout == "[]\n['torch']\n", done.stderr


def test_a_saved_network_loads_where_nothing_else_has_loaded_its_parts(folder: Path) -> None:
    record, short = (
        sb.read(folder / "rig.csv", inputs=["force"]),
        sb.TrainingSettings.paper(40, 10, 1),
    )
    model = sb.Filtered(sb.Linear(), sb.GRU(4), sb.Bands(0.5, 1), settings=short).fit(record)
    model.save(folder / "model")
    ask = "import splitband as sb; print(sb.load('model').predict(5, u=[[0.0]] * 5).y.tolist())"
    loaded = run(folder, "-c", ask)
    assert loaded.stdout == f"{model.predict(5, u=[[0.0]] * 5).y.tolist()}\n", loaded.stderr


@pytest.mark.parametrize(
    ("options", "status"),
    [("--inputs force --methods linear,mean", 0), ("--inputs voltage", 2)],
    ids=["baselines and their page", "a wrong column"],
)
def test_a_command_without_networks_needs_no_torch(folder: Path, options: str, status: int) -> None:
    words = ["compare", "rig.csv", *options.split(), "--quiet"]
    program = f"import sys\nfrom splitband.cli import main\nprint(main({words}))\n"
    done = run(folder, "-c", program + LOADED)
    assert done.stdout == f"{status}\n[]\n", done.stderr

"""Where torch is not installed, all works but the training of networks, which says what to do."""

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import splitband as sb

# Python finds torch in no place; `find_spec` returns None, as where it is not installed.
BLOCKED = """
import sys
from importlib.machinery import PathFinder

class Without(PathFinder):
    @classmethod
    def find_spec(cls, name, path=None, target=None):
        hidden = name.partition(".")[0] == "torch"
        return None if hidden else super().find_spec(name, path, target)

sys.meta_path[sys.meta_path.index(PathFinder)] = Without
"""
HOW = 'pip install "splitband[networks]"'
TRAIN, AHEAD = 100, 30
USED = f"""
import sys
import numpy as np
import splitband as sb

known = np.load("record.npz")
record = sb.Record(known["y"], 0.1, u=known["u"], y_sim=known["y_sim"])
coming = {{"u": record.u[{TRAIN}:], "y_sim": record.y_sim[{TRAIN}:]}}
found = {{}}
for name in sys.argv[1:]:
    model = sb.load(name)
    found[name] = model.predict({AHEAD}, **coming).y
    given = [coming["u"], *([coming["y_sim"]] if "simulator" in model.needs else [])]
    stream = model.stream(record[:{TRAIN}])
    found[name + " stream"] = [stream.step(*rows) for rows in zip(*given)]
    model.export(f"{{name}}.c")
    model.save(name + "-again")
np.savez("found.npz", **found)
try:
    model.predict(2, history=record[:5], **coming)
except sb.InputError as error:
    print(error)
assert "torch" not in sys.modules
"""
COMMANDS = f"""
import sys
from splitband.cli import main

given = "rig.csv --inputs force --train {TRAIN}"
for line, status in (
    (f"compare {{given}} --jobs 1", 0),
    (f"compare {{given}} --methods linear,gru", 2),
    (f"fit {{given}} --method gru --out model", 2),
    ("demo", 2),
):
    sys.argv = ["splitband", *line.split()]
    assert main() == status, line
"""


def _run(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run Python without torch in a folder."""
    (folder / "sitecustomize.py").write_text(BLOCKED)
    path = os.pathsep.join([str(folder), os.environ.get("PYTHONPATH", "")])
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": path, "COLUMNS": "300"},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def record() -> sb.Record:
    u = np.sign(np.sin(0.07 * np.arange(TRAIN + AHEAD)))
    y = np.convolve(u, 0.1 * 0.9 ** np.arange(60))[: len(u)] + 0.1 * np.sin(0.2 * np.arange(len(u)))
    return sb.Record(y, 0.1, u=u, y_sim=0.9 * y, inputs=("force",))


def test_saved_networks_predict_stream_and_export_without_torch(
    record: sb.Record, tmp_path: Path
) -> None:
    short = sb.TrainingSettings(window=40, warmup=10, epochs=1)
    bands = sb.Bands(0.5, 1, 2)
    models = {
        "gru": sb.Single(sb.GRU(4), short),
        "state_space": sb.Single(sb.StateSpace(4, 3), short),
        "euler": sb.Single(sb.networks.EulerMLP(hidden_size=8, recognition_size=6), short),
        "split": sb.Split(sb.GRU(3), sb.GRU(3), bands, settings=short),
        "linear": sb.Filtered(sb.Linear(), sb.StateSpace(4, 3), bands, True, short),
        "high": sb.Filtered(None, sb.GRU(3), bands, True, short, simulator_band="high"),
        "residual": sb.Residual(None, sb.GRU(3), True, short),
    }
    expected = {}
    for name, model in models.items():
        model.fit(record[:TRAIN], seed=0).save(tmp_path / name)
        coming: dict[str, Any] = {"u": record.u[TRAIN:], "y_sim": record.y_sim[TRAIN:]}
        expected[name] = model.predict(AHEAD, **coming).y
    np.savez(tmp_path / "record.npz", y=record.y, u=record.u, y_sim=record.y_sim)
    done = _run(tmp_path, "-c", USED, *models)
    assert not done.returncode, done.stderr
    assert done.stdout.startswith("a history shorter than the warm-up")
    assert HOW in done.stdout
    found = np.load(tmp_path / "found.npz")
    for name, y in expected.items():
        largest = 2e-6 * record.y.std()  # single precision in torch
        np.testing.assert_allclose(found[name], y, rtol=0, atol=largest)
        np.testing.assert_allclose(found[f"{name} stream"], y, rtol=0, atol=largest)
        assert (tmp_path / f"{name}.c").is_file()
        saved = sb.load(tmp_path / f"{name}-again")
        np.testing.assert_array_equal(saved.predict(AHEAD, **coming).y, y)


def test_commands_leave_networks_out_and_refuse_those_that_are_named(
    record: sb.Record, tmp_path: Path
) -> None:
    table = np.column_stack([record.time, record.u, record.y])
    np.savetxt(tmp_path / "rig.csv", table, "%.9g", ",", header="time,force,angle", comments="")
    done = _run(tmp_path, "-c", COMMANDS)
    assert not done.returncode, done.stderr
    said = done.stdout + done.stderr
    assert said.count(f"networks are left out, as torch is not installed: {HOW}") == 1
    assert "recommended: linear model" in said
    assert said.count(f"error: gru needs torch, which is not installed: {HOW}") == 3

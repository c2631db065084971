"""Records, and what tests of several commands ask for."""

import json
import os
import shlex
import subprocess
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from splitband.cli import main
from splitband.cli.display import Display
from splitband.comparison.running import RunningComparison

Files = dict[str, bytes]

SAMPLES, TRAIN, WARMUP, DT = 200, 150, 10, 0.1

TIME = DT * np.arange(SAMPLES)

SLOW, FAST = 0.3, 2.0  # Hz, both on a bin of the record's spectrum

A = np.sin(2 * np.pi * SLOW * TIME) + 0.3 * np.sin(2 * np.pi * FAST * TIME)

B = 2 + 0.5 * np.cos(2 * np.pi * SLOW * TIME)

FORCE = np.sign(np.sin(TIME))

SIMULATED = 0.8 * np.sin(2 * np.pi * SLOW * TIME + 0.2) + 0.3

QUICK = "--recipe constant-rate --epochs 2 --hidden 3,4 --window 30 --warmup 10"

FUNCTIONS = """
import time as clock

import numpy as np


def good(time):
    return 0.8 * np.sin(2 * np.pi * 0.3 * time + 0.2) + 0.3


def constant(time):
    return np.ones_like(time)


def raising(time):
    raise RuntimeError("no convergence\\nafter 7 steps")


def hanging(time):
    clock.sleep(1.5)
    return time


def interrupted(time):
    raise KeyboardInterrupt


def equation(t, x, u, p):
    return [u[0] - x[0]]


def driven(time, u):
    return u[:, 0]
"""


def write_records(folder: Path) -> None:
    """A good record and simulator, and what can be wrong with either."""
    stamps = TIME.round(9)
    record = pd.DataFrame({"time": stamps, "a": A, "b": B, "force": FORCE})
    simulated = pd.DataFrame({"time": stamps, "a": SIMULATED, "b": B + 0.1})
    worded = record.copy()
    worded["a"] = worded["a"].astype(object)
    worded.loc[9, "a"] = "oops"
    slow = record.iloc[:50].copy()
    slow["time"] *= 2
    history, future = record[:50], record[50:70][["time", "force"]]
    tables = {"record": record, "worded": worded, "untimed": record[["a"]], "simulated": simulated}
    tables |= {"history": history, "history_renamed": history.rename(columns={"a": "z"})}
    tables |= {"history_slow": slow, "simulated_short": simulated[:190]}
    tables |= {"simulated_names": simulated.rename(columns={"a": "p", "b": "q"})}
    tables |= {"future": future, "future_bare": future[["force"]], "future_short": future[:10]}
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.csv", index=False)
    (folder / "functions.py").write_text(FUNCTIONS)
    (folder / "broken.py").write_text("def good(:\n")
    (folder / "folder").mkdir()
    (folder / "damaged.fmu").write_bytes(b"PK junk")
    with zipfile.ZipFile(folder / "hollow.fmu", "w") as archive:
        archive.writestr("modelDescription.xml", "<fmi")


def call(line: str, folder: Path | None = None) -> None:
    """Run a command that must succeed."""
    assert main([*shlex.split(line), *(["--out", str(folder)] if folder else [])]) == 0


def watched(monkeypatch: pytest.MonkeyPatch, look: Callable[[RunningComparison], None]) -> None:
    """Let a test look, too, whenever the display is told where a comparison stands."""
    shown = Display.__call__

    def both(display: Display, run: RunningComparison) -> None:
        shown(display, run)
        look(run)

    monkeypatch.setattr(Display, "__call__", both)


def results(folder: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads((folder / "results.json").read_text())
    return found


def files(folder: Path) -> Files:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


def written(path: Path) -> pd.DataFrame:
    return pd.read_csv(path, dtype=str).astype(float)  # to the last bit


def process(*arguments: str) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "error"}
    return subprocess.run(
        arguments, capture_output=True, text=True, check=False, timeout=600, env=environment
    )


def complaints(said: str) -> list[str]:
    """Lines of the error stream, without what is said once after installation."""
    return [line for line in said.splitlines() if "compiling" not in line]


SPLIT = f"compare record.csv --columns a --methods split-gru {QUICK} --seeds 1 --jobs 1 --out out "

GRU = SPLIT.replace("split-gru", "gru")

SIMULATOR = "compare record.csv --columns a --methods simulator --warmup 10 --out out --simulator "

FIT = f"fit record.csv --columns a --method gru {QUICK} --out out "

AHEAD = "simulate gru --steps 5 --out ahead.csv --history "

HYBRID_AHEAD = "simulate filtered --steps 20 --out ahead.csv --history history.csv "

DRIVEN_AHEAD = "simulate driven --steps 20 --out ahead.csv --history history.csv "


def assert_fails(line: str, says: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    """Status 2, one line that says what it must, and every file as it was."""
    before = files(Path())
    try:
        status = main(shlex.split(line))
    finally:
        found, after = capsys.readouterr(), files(Path())
        for name in after.keys() - before.keys():
            Path(name).unlink()
    assert status == 2
    assert found.err.startswith("error: ")
    assert found.err.count("\n") == 1
    assert "Traceback" not in found.err + found.out
    assert not [word for word in says if word not in found.err], found.err
    assert after == before

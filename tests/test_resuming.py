"""Commands that are killed at any moment: the same command ends with the same numbers."""

import json
import os
import shlex
import signal
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from splitband.cli import main
from splitband.files import CHECKPOINTS

KILLS = 20
QUICK = "--epochs 40 --hidden 8,6 --window 40 --warmup 12 --train 150"

pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="kills a forked process")


@pytest.fixture
def record(tmp_path: Path) -> Path:
    t = 0.1 * np.arange(200)
    y = np.sin(2 * np.pi * 0.2 * t) + 0.4 * np.sin(2 * np.pi * 1.3 * t)
    y += 0.05 * np.random.default_rng(0).standard_normal(200)
    pd.DataFrame({"time": t, "a": y}).to_csv(tmp_path / "record.csv", index=False)
    return tmp_path / "record.csv"


def forked(line: str) -> int:
    """Begin a command in a process of its own, which says nothing."""
    child = os.fork()
    if child:
        return child
    try:
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        os._exit(main(shlex.split(line)))
    finally:
        os._exit(99)


def killed_many_times(line: str, seed: int, seconds: float = 2.0, kills: int = KILLS) -> list[bool]:
    """Whether each kill came before the end."""
    rng = np.random.default_rng(seed)
    came = []
    for _ in range(kills):
        child = forked(line)
        time.sleep(rng.uniform(0, seconds))
        os.kill(child, signal.SIGKILL)
        came.append(os.WIFSIGNALED(os.waitpid(child, 0)[1]))
    return came


def finish(line: str) -> None:
    """Run to the end."""
    assert os.waitpid(forked(line), 0)[1] == 0


@pytest.mark.skipif(sys.platform == "darwin", reason="forking after threads is unsafe there")
def test_fit_killed_at_random_moments_has_the_same_weights(record: Path, tmp_path: Path) -> None:
    line = f"fit {record} --method split-gru-conditioned {QUICK} --out"
    finish(f"{line} {tmp_path / 'whole'}")
    came = killed_many_times(f"{line} {tmp_path / 'killed'}", seed=1)
    assert any(came)
    finish(f"{line} {tmp_path / 'killed'}")
    for name in ("weights.safetensors", "model.json"):
        assert (tmp_path / "killed" / name).read_bytes() == (tmp_path / "whole" / name).read_bytes()
    left = {path.name for path in (tmp_path / "killed").iterdir()}
    assert {"weights.safetensors", "model.json", "results.json"} <= left
    assert CHECKPOINTS not in left


@pytest.mark.skipif(sys.platform == "darwin", reason="forking after threads is unsafe there")
def test_compare_killed_at_random_moments_has_the_same_results(
    record: Path, tmp_path: Path
) -> None:
    methods = "gru,split-gru,mean"
    line = f"compare {record} --methods {methods} {QUICK} --seeds 1 --jobs 1 --out"
    finish(f"{line} {tmp_path / 'whole'}")
    came = killed_many_times(f"{line} {tmp_path / 'killed'}", seed=2)
    assert any(came)
    finish(f"{line} {tmp_path / 'killed'}")
    whole, killed = (tmp_path / name / "predictions.csv" for name in ("whole", "killed"))
    assert killed.read_bytes() == whole.read_bytes()
    whole_facts, facts = (
        json.loads((tmp_path / name / "results.json").read_text()) for name in ("whole", "killed")
    )
    for method in methods.split(","):
        for found in (whole_facts, facts):
            del found["methods"][method]["seconds"]
    assert facts["methods"] == whole_facts["methods"]
    assert facts["recommended"] == whole_facts["recommended"]


@pytest.mark.skipif(sys.platform == "darwin", reason="forking after threads is unsafe there")
def test_a_run_of_the_paper_goes_on_too(tmp_path: Path) -> None:
    line = "paper table learning-based --systems i --seeds 1 --epochs 8 --jobs 1 --out"
    finish(f"{line} {tmp_path / 'whole'}")
    came = killed_many_times(f"{line} {tmp_path / 'killed'}", seed=3, kills=5)
    assert any(came)
    finish(f"{line} {tmp_path / 'killed'}")
    runs = [tmp_path / name / "runs" for name in ("whole", "killed")]
    files = [sorted(p.relative_to(folder) for p in folder.rglob("*.json")) for folder in runs]
    assert files[0] == files[1]
    assert not [*runs[1].rglob("*checkpoints*")]
    for file in files[0]:
        whole, killed = (json.loads((folder / file).read_text()) for folder in runs)
        for facts in (whole, killed):
            facts.pop("seconds", None)
        assert killed == whole, file

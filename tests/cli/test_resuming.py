"""Commands that are killed at any moment: the same command ends with the same numbers."""

import json
import os
import shlex
import shutil
import signal
import sys
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from reproduction.__main__ import main as reproduce
from splitband.cli import main
from splitband.runtime.files import CHECKPOINTS

pytestmark = pytest.mark.skipif(
    not hasattr(os, "fork") or sys.platform == "darwin",
    reason="kills a forked process; on macOS forking after threads is unsafe",
)

COMMANDS = {
    "fit": "fit record.csv --method split-gru-conditioned --epochs 10 --hidden 8,6 --window 40 "
    "--warmup 12 --train 150",
    "compare": "compare record.csv --methods gru,split-gru,mean --hidden 4,3 --rounds 1 --jobs 1",
    "reproduction": "reproduction table learning-based --systems i --methods split-gru "
    "--seeds 1 --epochs 8 --jobs 1",
}
OPERATIONS = {"open", "os.mkdir", "os.rename", "os.remove", "shutil.rmtree"}
"""Audit events of Python for what can be done to a file."""


@pytest.fixture(autouse=True)
def inside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every command runs beside a record, and writes a checkpoint after each epoch."""
    t = 0.1 * np.arange(200)
    y = np.sin(2 * np.pi * 0.2 * t) + 0.4 * np.sin(2 * np.pi * 1.3 * t)
    y += 0.05 * np.random.default_rng(0).standard_normal(200)
    pd.DataFrame({"time": t, "a": y}).to_csv(tmp_path / "record.csv", index=False)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("splitband.training.checkpoints.MOST_OVERHEAD", 1e9)
    monkeypatch.setattr("splitband.evaluation.candidates.FIRST_ROUND", 3)
    monkeypatch.setattr("splitband.evaluation.candidates.FIRST_STEPS", 3)


def begin(line: str, operation: Callable[[], None] | None = None) -> int:
    """Begin a command in a process of its own, which says nothing; its id.

    `operation` is called in that process before each operation on a file of the output.
    """
    child = os.fork()
    if child:
        return child
    words = shlex.split(line)

    def hook(event: str, arguments: tuple[Any, ...]) -> None:
        if event in OPERATIONS and any(words[-1] in str(each) for each in arguments):
            assert operation is not None
            operation()

    try:
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        if operation is not None:
            sys.addaudithook(hook)
        run = reproduce if words[0] == "reproduction" else main
        os._exit(run(words[run is reproduce :]))
    finally:
        os._exit(99)


def killed(child: int) -> bool:
    """Whether a process was killed when it ended; otherwise it must have ended well."""
    status = os.waitpid(child, 0)[1]
    assert os.WIFSIGNALED(status) or status == 0
    return os.WIFSIGNALED(status)


def operations_of(line: str, killed_before: int | None = None) -> int:
    """How many file operations a command does; it is killed before the given one."""
    reading, writing = os.pipe()
    number = count(1)

    def operation() -> None:
        if next(number) == killed_before:
            os.kill(os.getpid(), signal.SIGKILL)
        os.write(writing, b".")

    assert killed(begin(line, operation)) == (killed_before is not None)
    os.close(writing)
    with os.fdopen(reading, "rb") as pipe:
        return len(pipe.read())


def assert_same(command: str, folder: Path, whole: Path) -> None:
    """The results of a command that was killed, and of one that was not."""
    if command == "fit":
        names = [path.name for path in whole.iterdir() if path.name != "results.json"]
        assert len(names) == 2
        for name in names:
            assert (folder / name).read_bytes() == (whole / name).read_bytes()
    for path in whole.rglob("predictions.csv"):
        assert (folder / path.relative_to(whole)).read_bytes() == path.read_bytes()
    files, expected = (
        {
            path.relative_to(each): json.loads(path.read_text())
            for path in each.rglob("*.json")
            if not path.name.startswith(".")  # what was being written when it was killed
        }
        for each in (folder, whole)
    )
    assert [*map(without_times, files.items())] == [*map(without_times, expected.items())]
    assert not [*folder.rglob(f"*{CHECKPOINTS}*")]


def without_times(found: Any) -> Any:
    """Facts without what an interruption changes (times, mark, folder), and without the commit."""
    if isinstance(found, dict):
        kept = found.keys() - {"seconds", "cpu_seconds", "resumed", "out", "commit", "time"}
        return {key: without_times(found[key]) for key in sorted(kept, key=str)}
    return [*map(without_times, found)] if isinstance(found, list | tuple) else found


@pytest.mark.parametrize("command", [each for each in COMMANDS if each != "compare"])
def test_a_training_killed_between_file_operations_ends_with_the_same_numbers(
    command: str, tmp_path: Path
) -> None:
    line, kills = f"{COMMANDS[command]} --out {tmp_path}", 2
    operations = operations_of(f"{line}/whole")
    for _ in range(kills):
        operations_of(f"{line}/killed", killed_before=operations // (kills + 1))
    rest = operations_of(f"{line}/killed")
    assert rest < 0.6 * operations  # it has gone on, and not begun anew
    assert_same(command, tmp_path / "killed", tmp_path / "whole")


def test_a_comparison_goes_on_from_its_finished_trainings(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    line, out = f"{COMMANDS['compare']} --out", tmp_path / "killed"
    assert main(shlex.split(f"{line} {tmp_path / 'whole'}")) == 0

    def finished() -> set[Path]:
        found = (out / CHECKPOINTS).glob("*.safetensors")
        return {path for path in found if path.name[0] != "."}

    def kill() -> None:
        if len(finished()) == 2:
            os.kill(os.getpid(), signal.SIGKILL)

    assert killed(begin(f"{line} {out}", kill))
    kept = {path: path.stat().st_mtime_ns for path in finished()}
    assert len(kept) == 2
    capsys.readouterr()
    assert main(shlex.split(f"{line} {out}")) == 0
    assert "going on: 2 finished trainings kept" in capsys.readouterr().out
    assert_same("compare", out, tmp_path / "whole")


@pytest.mark.soak
@pytest.mark.parametrize("command", COMMANDS)
def test_a_command_killed_at_random_moments_ends_with_the_same_numbers(
    command: str, tmp_path: Path
) -> None:
    line, rng = f"{COMMANDS[command]} --out {tmp_path}", np.random.default_rng()
    began = time.monotonic()
    assert not killed(begin(f"{line}/whole"))
    most = time.monotonic() - began
    kills = 0
    while kills < 20 or (tmp_path / "killed").exists():
        child = begin(f"{line}/killed")
        if kills < 20:
            time.sleep(rng.uniform(0, most))
            os.kill(child, signal.SIGKILL)
        if killed(child):
            kills += 1
        else:
            assert_same(command, tmp_path / "killed", tmp_path / "whole")
            shutil.rmtree(tmp_path / "killed")

"""Commands that are killed at any moment: the same command ends with the same numbers."""

import json
import os
import shlex
import shutil
import signal
import sys
import time
from collections.abc import Callable
from functools import partial
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from scipy.signal import lfilter

from reproduction.__main__ import main as reproduce
from splitband.cli import main
from splitband.runtime.files import CHECKPOINTS
from tests.cli.test_interrupting import command_line
from tests.runtime.test_processes import eventually

pytestmark = pytest.mark.skipif(
    not hasattr(os, "fork") or sys.platform == "darwin",
    reason="kills a forked process; on macOS forking after threads is unsafe",
)

QUICK = "--epochs 10 --hidden 8,6 --window 40 --warmup 12 --train 150"
COMMANDS = {
    "fit": f"fit record.csv --method split-gru-conditioned {QUICK}",
    "compare": f"compare record.csv --methods gru,split-gru,mean {QUICK} --seeds 1 --jobs 1",
    "benchmark": "benchmark list.csv --methods gru,mean --epochs 12 --hidden 4,3 --window 40 "
    "--warmup 12 --seeds 1 --jobs 1",
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
    (tmp_path / "list.csv").write_text("record,name,train\nrecord.csv,a,150\nrecord.csv,b,120\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr("splitband.training.checkpoints.MOST_OVERHEAD", 1e9)


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


@pytest.mark.parametrize(
    ("command", "kills"),
    [
        *[(command, 2) for command in COMMANDS if command != "compare"],  # a list is compared, too
        *[pytest.param(command, 20, marks=pytest.mark.soak) for command in COMMANDS],
    ],
)
def test_a_command_killed_between_file_operations_ends_with_the_same_numbers(
    command: str, kills: int, tmp_path: Path
) -> None:
    line = f"{COMMANDS[command]} --out {tmp_path}"
    operations = operations_of(f"{line}/whole")
    for _ in range(kills):
        operations_of(f"{line}/killed", killed_before=operations // (kills + 1))
    rest = operations_of(f"{line}/killed")
    assert rest < 0.6 * operations  # it has gone on, and not begun anew
    assert_same(command, tmp_path / "killed", tmp_path / "whole")


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


def write_driven(cases: int) -> None:
    """Resonances, each faster than the one before, under a force that jumps; and a list of them."""
    rng = np.random.default_rng(0)
    for i in range(cases):
        force = np.repeat(rng.choice([-1.0, 1.0], 20), 10)
        y = lfilter([0.1], [1, -1.9 * np.cos(0.1 + 0.02 * i), 0.9], force)
        y += 0.02 * rng.standard_normal(200)
        table = pd.DataFrame({"time": 0.1 * np.arange(200), "a": y, "force": force})
        table.to_csv(f"driven-{i}.csv", index=False)
    rows = [f"driven-{i}.csv,force" for i in range(cases)]
    Path("driven.csv").write_text("\n".join(["record,inputs", *rows]))


@pytest.mark.soak
def test_a_list_of_24_cases_killed_twice_ends_with_the_same_table(tmp_path: Path) -> None:
    write_driven(24)
    line = (
        "benchmark driven.csv --methods gru,linear,mean,persistence --epochs 3 --seeds 1 --jobs 1"
    )
    stopped, whole = tmp_path / "stopped", tmp_path / "whole"
    with command_line(f"{line} --out {whole}") as running:
        assert running.wait() == 0

    def finished() -> dict[Path, bytes]:
        return {path: path.read_bytes() for path in stopped.glob("*/results.json")}

    def at_work_after(cases: int) -> bool:
        """Whether so many are finished, and the network of the next one is trained in part."""
        trained = stopped.glob(f"*/{CHECKPOINTS}/**/*.safetensors")
        return len(finished()) >= cases and any(trained)

    kept: dict[Path, bytes] = {}
    for cases in (8, 16):
        with command_line(f"{line} --out {stopped}") as running:
            eventually(partial(at_work_after, cases), seconds=3600)
            os.killpg(running.pid, signal.SIGKILL)
        assert running.returncode == -signal.SIGKILL
        assert kept.items() <= finished().items()
        kept = finished()
        assert cases <= len(kept) < 24
        assert not (stopped / "table.csv").exists()
    with command_line(f"{line} --out {stopped}") as running:
        assert running.wait() == 0
    assert kept.items() <= finished().items()  # none of them was computed again
    found, expected = (
        pd.read_csv(each / "table.csv", index_col="name").drop(columns="seconds")
        for each in (stopped, whole)
    )
    assert len(found) == 24
    pd.testing.assert_frame_equal(found, expected, check_exact=True)
    assert_same("benchmark", stopped, whole)

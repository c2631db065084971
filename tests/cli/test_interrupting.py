"""Ctrl-C stops a command in one line and leaves nothing half written."""

import os
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import pytest

from splitband.cli import main
from splitband.runtime.files import CHECKPOINTS
from tests.cli.support import QUICK, SIMULATOR, complaints, files
from tests.runtime.test_processes import eventually

pytestmark = pytest.mark.usefixtures("inside")


def test_an_interrupt_says_so_and_leaves_no_file(capsys: pytest.CaptureFixture[str]) -> None:
    before = files(Path())
    assert main(shlex.split(SIMULATOR + "functions.py:interrupted")) == 130
    said = capsys.readouterr().err
    assert said == (
        "error: stopped; no file is half written, and the same command goes on from here\n"
    )
    assert files(Path()) == before


def test_a_batch_system_that_ends_the_command_is_heard_as_ctrl_c(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    line = f"compare record.csv --columns a --methods gru {QUICK} --seeds 1 --out {tmp_path}/out"
    monkeypatch.setattr(sys, "argv", ["splitband", *shlex.split(line)])
    monkeypatch.setattr("rich.progress.Progress.update", lambda *_, **__: terminated())
    before = signal.getsignal(signal.SIGTERM)
    try:
        assert main() == 130
    finally:
        signal.signal(signal.SIGTERM, before)
    assert capsys.readouterr().err.startswith("error: stopped; no file is half written")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {CHECKPOINTS}


def terminated() -> None:
    os.kill(os.getpid(), signal.SIGTERM)


TRAINED = "out/*/*/*.safetensors"

# In the process whose copies train, it runs before anything else is loaded.
ANNOUNCE = """
import os, pathlib, sys
if "multiprocessing.forkserver" in " ".join(sys.orig_argv):
    pathlib.Path(__file__).with_name(f"{os.getpid()}.loading").touch()
"""


@pytest.mark.skipif(sys.platform == "win32", reason="sends a signal to a group of processes")
@pytest.mark.parametrize(
    ("jobs", "files", "count"),
    [
        pytest.param(1, TRAINED, 1, id="while it trains", marks=pytest.mark.soak),
        pytest.param(2, "*.loading", 1, id="while it loads", marks=pytest.mark.soak),
        pytest.param(2, TRAINED, 2, id="while its processes train"),
    ],
)
def test_ctrl_c_stops_at_once_and_leaves_nothing_half_written(
    workspace: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    jobs: int,
    files: str,
    count: int,
) -> None:
    temporary = Path(tempfile.mkdtemp())  # its name is short enough for sockets
    monkeypatch.setenv("TMPDIR", str(temporary))
    (tmp_path / "sitecustomize.py").write_text(ANNOUNCE)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    line = (
        f"compare {workspace}/record.csv --columns a --methods gru --epochs 100000 "
        f"--cutoff 1 --hidden 4,3 --window 30 --seeds 2 --jobs {jobs} --out {tmp_path / 'out'}"
    )
    with command_line(line) as running:
        eventually(lambda: len([*tmp_path.glob(files)]) >= count)
        assert interrupted(running) == [
            "error: stopped; no file is half written, and the same command goes on from here"
        ]
    temporary.rmdir()  # nothing is left in it
    assert {path.name for path in (tmp_path / "out").iterdir()} == {CHECKPOINTS}


@pytest.mark.skipif(sys.platform == "win32", reason="sends a signal to a group of processes")
def test_ctrl_c_stops_it_while_it_loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # What takes long to load, by a module that does.
    (tmp_path / "typer.py").write_text(
        "import pathlib, time\npathlib.Path(__file__).with_name('here').touch()\ntime.sleep(600)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    with command_line("data list") as running:
        eventually((tmp_path / "here").exists)
        assert interrupted(running) == ["error: stopped before anything was begun"]


@contextmanager
def command_line(line: str) -> Iterator[subprocess.Popen[str]]:
    """A command that runs, and is ended with all of its processes whatever the test finds."""
    running = subprocess.Popen(
        [sys.executable, "-m", "splitband", *shlex.split(line)],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        start_new_session=True,
        text=True,
        # A shell's job in the background would pass on that Ctrl-C is nothing to it.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),  # noqa: PLW1509
    )
    with running:
        try:
            yield running
        finally:
            with suppress(ProcessLookupError):
                os.killpg(running.pid, signal.SIGKILL)


def interrupted(running: subprocess.Popen[str]) -> list[str]:
    """What it says after Ctrl-C, and that it stops as shells expect."""
    os.killpg(running.pid, signal.SIGINT)
    _, said = running.communicate(timeout=300)
    # Python ends by the signal itself where it came in an `exec`: shells show 130 for both.
    assert running.returncode in (130, -signal.SIGINT)
    return complaints(said)

"""Ctrl-C ends a command with what there is, a second one at once, and nothing is half written."""

import os
import shlex
import signal
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest

import splitband as sb
from splitband.cli import main
from splitband.report import results as written
from tests.cli.support import SIMULATOR, complaints, files, results, watched
from tests.runtime.test_workers import eventually

pytestmark = pytest.mark.usefixtures("inside", "short_rounds")

LINE = "compare record.csv --columns a --methods gru,mean --hidden 3,4 --rounds 9 --jobs 1"


def assert_stopped(said: str) -> None:
    assert said == "error: stopped; no file is half written\n"


def pressed() -> None:
    """What Ctrl-C does."""
    raise KeyboardInterrupt


def terminated() -> None:
    """What a batch system does."""
    os.kill(os.getpid(), signal.SIGTERM)


def ending(monkeypatch: pytest.MonkeyPatch, end: Callable[[], None], doing: str) -> None:
    """End the command where a comparison has come so far."""
    watched(monkeypatch, lambda run: end() if run.doing.startswith(doing) else None)


def test_an_interrupt_before_the_first_result_leaves_no_file(
    capsys: pytest.CaptureFixture[str],
) -> None:
    before = files(Path())
    assert main(shlex.split(SIMULATOR + "functions.py:interrupted")) == 130
    assert_stopped(capsys.readouterr().err)
    assert files(Path()) == before


@pytest.mark.parametrize("end", [pressed, terminated])
def test_ctrl_c_ends_with_the_result_and_the_model_so_far(
    end: Callable[[], None],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """SIGTERM is heard by a process of its own alone."""
    ending(monkeypatch, end, "round 2, 0 of")
    line, before = f"{LINE} --out {tmp_path}", signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(sys, "argv", ["splitband", *shlex.split(line)])
    try:
        assert main() == 130
    finally:
        signal.signal(signal.SIGTERM, before)
    said = capsys.readouterr()
    assert_stopped(said.err)
    assert "recommended: " in said.out
    found = results(tmp_path)
    assert found["interrupted"] is True
    assert found["methods"].keys() == {"gru", "mean"}
    assert sb.load(tmp_path / "model").name == found["recommended"]


def test_a_second_ctrl_c_leaves_what_was_written_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It comes while the result is written."""
    kept: dict[str, bytes] = {}

    def again(*_: Any) -> None:
        kept.update(files(tmp_path))
        pressed()

    def first() -> None:
        monkeypatch.setattr(written, "save", again)
        pressed()

    ending(monkeypatch, first, "round 2, 0 of")
    assert main(shlex.split(f"{LINE} --out {tmp_path}")) == 130
    assert_stopped(capsys.readouterr().err)
    assert results(tmp_path)["unfinished"] == "round 1"
    assert sb.load(tmp_path / "model").name == results(tmp_path)["recommended"]
    after = files(tmp_path)
    assert {name: after.get(name) for name in kept if "lock" not in name} == {
        name: content for name, content in kept.items() if "lock" not in name
    }


@pytest.mark.skipif(sys.platform == "win32", reason="sends a signal to a group of processes")
def test_ctrl_c_reaches_the_processes_that_train(
    workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    temporary = Path(tempfile.mkdtemp())  # its name is short enough for sockets
    monkeypatch.setenv("TMPDIR", str(temporary))
    line = LINE.replace("record.csv", f"{workspace}/history.csv").replace("--jobs 1", "--jobs 2")
    with command_line(f"{line} --out {tmp_path / 'out'}") as running:
        eventually((tmp_path / "out/results.json").exists)
        assert_stopped("\n".join([*interrupted(running), ""]))
    temporary.rmdir()  # nothing is left in it
    assert results(tmp_path / "out")["interrupted"] is True


@pytest.mark.skipif(sys.platform == "win32", reason="sends a signal to a group of processes")
def test_ctrl_c_stops_it_while_it_loads(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    # What takes long to load, by a module that does.
    (tmp_path / "typer.py").write_text(
        "import pathlib, time\npathlib.Path(__file__).with_name('here').touch()\ntime.sleep(600)\n"
    )
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    with command_line("data") as running:
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

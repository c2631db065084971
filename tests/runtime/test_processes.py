"""Work over several processes."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from splitband.runtime.processes import map_jobs

# What the scripts below import instead of torch, which every process would take seconds to load.
NO_TORCH = "def set_num_threads(count): pass\n\n\ndef get_num_threads(): return 1\n"


def eventually(condition: Callable[[], bool], seconds: float = 300) -> None:
    """Wait until it holds; the limit is for what never comes, not for what is slow."""
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


def square(job: int, report: Callable[[int], None]) -> int:
    report(job)
    return job**2


def test_every_job_is_done_and_reported() -> None:
    seen: list[int] = []
    assert sorted(map_jobs(square, [1, 2, 3], 1, seen.append)) == [1, 4, 9]
    assert sorted(seen) == [1, 2, 3]


def leave(job: int, report: Callable[[int], None]) -> str:
    """Leave a temporary folder, and end the process of the second job."""
    folder = tempfile.mkdtemp(prefix="left-")
    if job:
        os._exit(job)
    return folder


def test_temporary_files_of_processes_are_removed_however_they_end(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (folder,) = (Path(each) for each in map_jobs(leave, [0], 1))
    assert folder.parent == tmp_path  # that of this process stays
    folder.rmdir()
    with pytest.raises(OSError, match="ended from outside"):
        list(map_jobs(leave, [0, 1], 2))
    assert not [path.name for path in tmp_path.iterdir() if not path.name.startswith("pymp-")]


@pytest.mark.skipif(not hasattr(os, "killpg"), reason="POSIX")
def test_processes_end_when_their_parent_is_killed(tmp_path: Path) -> None:
    (tmp_path / "torch.py").write_text(NO_TORCH)
    script = tmp_path / "script.py"
    script.write_text(
        """
import os, sys, time
from splitband.runtime.processes import map_jobs

def work(job, report):
    open(f"{sys.path[0]}/{job}", "w").write(str(os.getpid()))
    time.sleep(600)

if __name__ == "__main__":
    list(map_jobs(work, [1, 2], 2))
"""
    )
    parent = subprocess.Popen([sys.executable, str(script)])
    marks = [tmp_path / "1", tmp_path / "2"]
    eventually(lambda: all(mark.exists() and mark.read_text() for mark in marks))
    pids = [int(mark.read_text()) for mark in marks]
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    eventually(lambda: not any(alive(pid) for pid in pids))


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="POSIX")
def test_a_process_does_not_hear_ctrl_c_while_it_loads(tmp_path: Path) -> None:
    (tmp_path / "torch.py").write_text(NO_TORCH)
    script = tmp_path / "script.py"
    script.write_text(
        """
import os, pathlib, time
from splitband.runtime.processes import map_jobs

here = pathlib.Path(__file__).parent
if __name__ == "__mp_main__":
    (here / f"{os.getpid()}.loading").touch()
    while not (here / "go on").exists():
        time.sleep(0.05)

def work(job, report):
    return job

if __name__ == "__main__":
    print(sorted(map_jobs(work, [1, 2], 2)))
"""
    )
    parent = subprocess.Popen(
        [sys.executable, str(script)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    eventually(lambda: len([*tmp_path.glob("*.loading")]) == 2)
    for path in tmp_path.glob("*.loading"):
        os.kill(int(path.stem), signal.SIGINT)
    (tmp_path / "go on").touch()
    assert parent.communicate(timeout=300) == ("[1, 2]\n", "")


@pytest.mark.parametrize("temporary", ["t", 80 * "t"], ids=["short", "too long for sockets"])
def test_processes_have_the_modules_and_the_environment_of_this_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, temporary: str
) -> None:
    (tmp_path / "torch.py").write_text(NO_TORCH)
    script = tmp_path / "script.py"
    script.write_text(
        """
import os
from splitband.runtime.processes import map_jobs

def work(job, report):
    return os.environ["SIMULATOR"], os.environ.get("PYTHONSAFEPATH")

if __name__ == "__main__":
    for os.environ["SIMULATOR"] in ("a", "b"):
        print(sorted(map_jobs(work, [1, 2], 2)))
"""
    )
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (elsewhere / "csv.py").write_text("raise RuntimeError('not what is meant')")
    (folder := Path(tempfile.gettempdir()) / temporary).mkdir()
    monkeypatch.setenv("TMPDIR", str(folder))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    command = [sys.executable, "-P", str(script)]
    run = subprocess.run(command, cwd=elsewhere, capture_output=True, text=True, check=False)
    assert run.stderr == ""
    assert run.stdout.splitlines() == [f"{[(value, None)] * 2}" for value in "ab"]
    folder.rmdir()


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended may still have an entry (a zombie)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except FileNotFoundError:
        return False

"""Jobs in worker processes, in this process and on any executor."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import tempfile
import time
import weakref
from collections.abc import Callable, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest
import threadpoolctl
import torch

from splitband.runtime.deadlines import Deadline
from splitband.runtime.workers import Queue, Workers, ended_from_outside, result_of, run_jobs

# What the scripts below import instead of torch, which every process would take seconds to load.
NO_TORCH = "def set_num_threads(count): pass\n\n\ndef get_num_threads(): return 1\n"


def eventually(condition: Callable[[], bool], seconds: float = 300) -> None:
    """Wait until it holds; the limit is for what never comes, not for what is slow."""
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


def square(job: int) -> int:
    if job < 0:
        raise ValueError(f"job must not be negative, got {job}")
    return job**2


@pytest.mark.parametrize("executor", [None, ThreadPoolExecutor(2)], ids=["here", "threads"])
def test_every_job_comes_with_its_result_or_its_error(executor: Executor | None) -> None:
    found = dict(run_jobs(square, [1, 2, -3], executor))
    assert {job: future.result() for job, future in found.items() if job > 0} == {1: 1, 2: 4}
    with pytest.raises(ValueError, match="must not be negative, got -3"):
        found[-3].result()


def test_a_wait_for_a_result_ends_with_its_time() -> None:
    with pytest.raises(TimeoutError):
        result_of(Future(), 0.01)
    done: Future[int] = Future()
    done.set_result(3)
    assert result_of(done) == result_of(done, 1.0) == 3


def leave(job: int) -> str:
    """Leave a temporary folder, and end the process of the second job."""
    folder = tempfile.mkdtemp(prefix="left-")
    if job == 1:
        os._exit(job)
    if job == 2:
        Path(folder, "begun").touch()
        time.sleep(600)
    return folder


class Once(Deadline):
    """A deadline that comes with the first result."""

    def __init__(self, done: list[int]) -> None:
        super().__init__()
        object.__setattr__(self, "done", done)

    @property
    def over(self) -> bool:
        return bool(self.done)  # type: ignore[attr-defined]


def test_a_job_whose_process_ends_or_hangs_takes_no_other_with_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    with Workers(2) as workers:
        found = dict(run_jobs(leave, [0, 1, 3], workers))
        assert Path(found[0].result()).parent.parent == tmp_path
        assert "ended from outside" in ended_from_outside(found[1].exception() or ValueError())
        assert found[3].exception() is None
        queue, done = Queue[int, str](workers), list[int]()
        queue.begin(leave, [2, 0], Once(done))
        ended = dict[int, Future[str]]()
        for job, future in queue.ended():
            ended[job] = future
            done.append(job)
        assert ended[0].result()
        assert ended[2].cancelled()  # and its process is ended
    assert not [path.name for path in tmp_path.iterdir() if not path.name.startswith("pymp-")]


def test_a_process_that_begins_while_the_others_are_ended_complains_of_nothing(
    capfd: pytest.CaptureFixture[str],
) -> None:
    """As at the end of a budget: one computes in C, another one has just been replaced."""
    with Workers(2) as workers:
        computing, waiting = workers.submit(sum, range(10**10)), workers.submit(time.sleep, 600)
        eventually(lambda: computing.running() and waiting.running())
        before = {*multiprocessing.active_children()}
        waiting.cancel()
        eventually(lambda: bool({*multiprocessing.active_children()} - before))
    assert capfd.readouterr().err == ""


def as_files(arrays: Sequence[np.ndarray]) -> tuple[list[bool], Sequence[np.ndarray]]:
    """Whether a process has arrays as files, and the arrays."""
    return [isinstance(getattr(each.base, "base", None), np.memmap) for each in arrays], arrays


def test_a_large_array_that_never_changes_is_sent_once_and_comes_back_as_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    fixed, free = np.tile(np.arange(200_000.0), (2, 1)).T.copy(), np.ones(200_000)
    fixed.setflags(write=False)
    given = fixed[7:-3], fixed, fixed[1_000:], free
    with Workers(1) as workers:
        for _ in range(2):
            said, back = workers.submit(as_files, given).result()
            assert said == [True, True, True, False]
            for ours, theirs in zip(given, back, strict=True):
                np.testing.assert_array_equal(theirs, ours)
                assert np.shares_memory(theirs, ours) == (ours is not free)
        assert len([*tmp_path.glob("splitband-*/*.npy")]) == 1


class Large:
    """A result of which a process knows how many it has."""

    kept: ClassVar[weakref.WeakSet[object]] = weakref.WeakSet()

    def __init__(self) -> None:
        self.kept.add(self)


def results_kept(_: object) -> tuple[Large, int]:
    """A result, and how many of earlier jobs the process still has."""
    before = len(Large.kept)
    return Large(), before


def test_a_worker_keeps_no_result_of_an_earlier_job() -> None:
    with Workers(1) as workers:
        assert [workers.submit(results_kept, job).result()[1] for job in range(2)] == [0, 0]


def test_a_job_that_another_process_cannot_import_is_done_here() -> None:
    with Workers(1) as workers:
        ((_, future),) = run_jobs(lambda job: os.getpid() + job, [1], workers)
    assert future.result() == os.getpid() + 1


def alive(pid: int) -> bool:
    """Whether a process runs; one that has ended may still have an entry (a zombie)."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] not in "ZX"
    except FileNotFoundError:
        return False


SCRIPT = """
import os, pathlib, time
from splitband.runtime.workers import Workers, run_jobs

here = pathlib.Path(__file__).parent
if __name__ == "__mp_main__":
    (here / f"{os.getpid()}.loading").touch()
    while (here / "wait").exists():
        time.sleep(0.05)

def work(job):
    (here / f"{job}").write_text(str(os.getpid()))
    if (here / "hang").exists():
        time.sleep(600)
    return os.environ["SIMULATOR"], job

if __name__ == "__main__":
    os.environ["SIMULATOR"] = "a"
    with Workers(2) as workers:
        print(sorted(future.result() for _, future in run_jobs(work, [1, 2], workers)))
"""


@pytest.fixture
def script(tmp_path: Path) -> Path:
    """Where the script is to be written, without torch."""
    (tmp_path / "torch.py").write_text(NO_TORCH)
    (tmp_path / "script.py").write_text(SCRIPT)
    return tmp_path / "script.py"


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="asks Linux for processes")
def test_processes_end_when_their_parent_is_killed(script: Path, tmp_path: Path) -> None:
    (tmp_path / "hang").touch()
    parent = subprocess.Popen([sys.executable, str(script)])
    marks = [tmp_path / "1", tmp_path / "2"]
    eventually(lambda: all(mark.exists() and mark.read_text() for mark in marks))
    pids = [int(mark.read_text()) for mark in marks]
    parent.send_signal(signal.SIGKILL)
    parent.wait()
    eventually(lambda: not any(alive(pid) for pid in pids))


@pytest.mark.skipif(not hasattr(signal, "pthread_sigmask"), reason="POSIX")
def test_a_process_has_the_environment_and_does_not_hear_ctrl_c_while_it_loads(
    script: Path, tmp_path: Path
) -> None:
    (tmp_path / "wait").touch()
    command = [sys.executable, str(script)]
    parent = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    eventually(lambda: len([*tmp_path.glob("*.loading")]) == 2)
    for path in tmp_path.glob("*.loading"):
        os.kill(int(path.stem), signal.SIGINT)
    (tmp_path / "wait").unlink()
    assert parent.communicate(timeout=300) == ("[('a', 1), ('a', 2)]\n", "")


def test_a_script_without_a_guard_is_told_so(script: Path, tmp_path: Path) -> None:
    script.write_text(
        "from splitband.runtime.workers import Workers, ended_from_outside, run_jobs\n"
        "for job, future in run_jobs(abs, [1, 2], Workers(2)):\n"
        "    print(ended_from_outside(future.exception()))\n"
    )
    where = os.environ | {"TMPDIR": str(tmp_path)}
    done = subprocess.run(
        [sys.executable, str(script)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
        env=where,
    )
    assert 'if __name__ == "__main__":' in done.stdout


def blas() -> list[int]:
    pools = threadpoolctl.threadpool_info()
    return [pool["num_threads"] for pool in pools if pool["user_api"] == "blas"]


def seen(_: int) -> tuple[int, list[int]]:
    return torch.get_num_threads(), blas()


def test_a_job_has_one_thread_and_blas_and_torch_have_theirs_again_afterwards() -> None:
    np.ones((2, 2)) @ np.ones((2, 2))
    torchs = torch.get_num_threads()
    with threadpoolctl.threadpool_limits(3, user_api="blas"):
        torch.set_num_threads(2)
        before = 2, blas()
        inside = [future.result() for _, future in run_jobs(seen, [0, 1])]
        after = torch.get_num_threads(), blas()
    torch.set_num_threads(torchs)
    assert after == before
    assert inside == [(1, [1] * len(before[1]))] * 2

"""Commands whose trainings are done by the workers of a Dask scheduler, or end in one line."""

from __future__ import annotations

import json
import os
import shlex
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from reproduction.__main__ import main as reproduce
from splitband import Work, compare
from splitband.cli import main
from splitband.evaluation.work import RunProgress
from splitband.runtime.cluster import Cluster
from splitband.runtime.files import CHECKPOINTS
from tests.cli.support import QUICK, call, results
from tests.records import SETUP, record
from tests.runtime.test_processes import eventually
from tests.support import forecasters

distributed = pytest.importorskip("distributed")

pytestmark = [
    pytest.mark.usefixtures("inside"),
    pytest.mark.filterwarnings("default"),  # Dask has its own
    pytest.mark.skipif(sys.platform == "win32", reason="sends signals"),
]


class Running:
    """A scheduler and its workers, each a process."""

    def __init__(self, folder: Path) -> None:
        self.folder, self.file = folder, folder / "scheduler.json"
        self.scheduler: subprocess.Popen[bytes] | None = None
        self.workers: dict[str, subprocess.Popen[bytes]] = {}

    @property
    def address(self) -> str:
        found: str = json.loads(self.file.read_text())["address"]
        return found

    def whole(self, *names: str) -> None:
        """Start what does not run: the scheduler, and workers of one thread each."""
        if self.scheduler is None or self.scheduler.poll() is not None:
            self.file.unlink(missing_ok=True)
            self.scheduler = self._begin("scheduler", "--port", "0", "--no-dashboard")
        eventually(self.file.exists)
        for name in names:
            if name not in self.workers or self.workers[name].poll() is not None:
                self.add(name)
        self.expect(len(names))

    def add(self, name: str) -> None:
        words = "worker", "--no-nanny", "--nthreads", "1", "--no-dashboard", "--name", name
        place = "--local-directory", str(self.folder)
        self.workers[name] = self._begin(*words, *place)

    def expect(self, workers: int) -> None:
        """Wait until there are so many at least, as the scheduler knows them."""
        with distributed.Client(self.address, set_as_default=False) as client:
            eventually(lambda: len(client.nthreads()) >= workers)

    def end(self, name: str) -> None:
        self.workers[name].kill()
        self.workers.pop(name).wait()

    def _begin(self, *words: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", *words, "--host", "127.0.0.1"]
        path = {"PYTHONPATH": os.pathsep.join(sys.path), "TMPDIR": str(self.folder)}
        return subprocess.Popen(
            [*command, "--scheduler-file", str(self.file)],
            cwd=self.folder, env=os.environ | path,
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True,
        )  # fmt: skip


@pytest.fixture(scope="module")
def running(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Running]:
    there = Running(tmp_path_factory.mktemp("dask"))
    yield there
    for process in [*there.workers.values(), there.scheduler]:
        if process is not None:
            process.kill()
            process.wait()


@pytest.fixture
def whole(running: Running) -> Running:
    running.whole("a", "b")
    return running


COMPARE = f"compare record.csv --columns a --methods gru,split-gru,mean {QUICK} --seeds 2 "
LONG = "compare record.csv --columns a --methods gru --cutoff 1 --hidden 4,3 --window 30 --seeds 2 "


def same(found: Any, expected: Any) -> bool:
    """Equal but for rounding, times and where it was computed."""
    if isinstance(expected, dict):
        keys = expected.keys() - {"seconds", "cpu_seconds", "arguments", "environment", "time"}
        return set(keys) <= set(found) and all(same(found[key], expected[key]) for key in keys)
    if isinstance(expected, list):
        return len(found) == len(expected) and all(map(same, found, expected))
    if isinstance(expected, float):
        return bool(np.isclose(found, expected, rtol=1e-5, atol=1e-7))
    return bool(found == expected)


def compared(executor: Any, watch: Callable[[RunProgress], None]) -> Any:
    methods = forecasters(["gru", "split-gru", "mean"], SETUP)
    work = Work(executor=executor, progress=watch)
    return compare(record(), methods=methods, setup=SETUP, seeds=2, work=work).table


def complaint(capsys: pytest.CaptureFixture[str]) -> str:
    """What the command said on its error stream: one line."""
    said = capsys.readouterr().err
    assert said.count("\n") == 1, said
    return said.removeprefix("error: ").rstrip()


# ---------------------------------------------------------------- results


def test_workers_find_the_numbers_of_this_machine(whole: Running, tmp_path: Path) -> None:
    call(f"{COMPARE} --jobs 1", tmp_path / "here")
    call(f"{COMPARE} --cluster {whole.address}", tmp_path / "there")
    assert same(results(tmp_path / "there"), results(tmp_path / "here"))


@pytest.mark.soak
def test_the_papers_tables_are_those_of_this_machine(whole: Running, tmp_path: Path) -> None:
    line = "table learning-based --systems i --methods split-gru --seeds 2 --epochs 2 "
    for workers, out in (("--jobs 1", "here"), (f"--cluster {whole.address}", "there")):
        assert reproduce(f"{line} {workers} --out {tmp_path / out}".split()) == 0
    file = "runs/i/split-gru/epochs2-seed1.json"
    here, there = (json.loads((tmp_path / each / file).read_text()) for each in ("here", "there"))
    assert same(there, here)
    assert not [*tmp_path.rglob("*.safetensors")]


def test_reports_come_while_trainings_run_and_when_they_end(whole: Running) -> None:
    seen: list[RunProgress] = []
    with Cluster(whole.address) as cluster:
        assert cluster.cores == 2
        compared(cluster, seen.append)
    last = {(at.stage, at.method, at.seed): at.share for at in seen}
    assert len(last) == 10
    assert set(last.values()) == {1.0}
    assert len(seen) > len(last)


# ---------------------------------------------------------------- what goes wrong


def test_ctrl_c_ends_in_one_line_and_frees_the_workers(
    whole: Running, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    reported = threading.Event()

    def interrupt(*_: Any, **__: Any) -> None:
        if not reported.is_set():
            reported.set()
            signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGINT)

    monkeypatch.setattr("rich.progress.Progress.add_task", lambda *a, **k: 0)
    monkeypatch.setattr("rich.progress.Progress.update", interrupt)
    line = f"{LONG} --epochs 1000000 --cluster {whole.address} --out {tmp_path / 'out'}"
    before = signal.signal(
        signal.SIGINT, signal.default_int_handler
    )  # not that of a background job
    try:
        assert main(shlex.split(line)) == 130
    finally:
        signal.signal(signal.SIGINT, before)
    assert complaint(capsys).startswith("stopped; no file is half written")
    assert {path.name for path in (tmp_path / "out").iterdir()} == {CHECKPOINTS}
    with distributed.Client(whole.address, set_as_default=False) as client:
        # A lambda, as workers do not have the tests.
        at_work = lambda dask_worker: len(dask_worker.state.executing)  # noqa: E731
        eventually(lambda: not any(client.run(at_work).values()))


def test_other_versions_and_missing_packages_are_named_with_the_worker(
    whole: Running, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    """As if one worker had an old torch, and the other no splitband."""
    versions = distributed.Client.get_versions

    def others(*arguments: Any, **options: Any) -> Any:
        found = versions(*arguments, **options)
        old, lacking = found["workers"].values()
        old["packages"]["torch"], lacking["packages"]["splitband"] = "1.0.0", None
        return found

    monkeypatch.setattr(distributed.Client, "get_versions", others)
    assert main(shlex.split(f"{COMPARE} --cluster {whole.address} --out {tmp_path}/out")) == 2
    said = complaint(capsys)
    assert "has torch 1.0.0 and not " in said
    assert "has no splitband" in said
    assert said.count("worker tcp://127.0.0.1:") == 2
    assert not (tmp_path / "out").exists()


def test_a_job_that_ends_its_workers_is_said_to(whole: Running) -> None:
    with Cluster(whole.address) as cluster:
        error = cluster.explained(distributed.KilledWorker("a job", None, 3))
    assert str(error).startswith(f"4 workers of {whole.address} ended while")


@pytest.mark.parametrize(
    ("line", "address"),
    [
        (COMPARE, "tcp://127.0.0.1:9"),
        ("forecast record.csv --columns a --steps 5 --method gru ", "nonsense"),
        ("benchmark list.csv --methods gru ", "http://127.0.0.1:9"),
    ],
)
def test_nobody_listening_is_one_line(
    line: str, address: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Any
) -> None:
    monkeypatch.setattr("splitband.runtime.cluster.PATIENCE", 0.5)
    (tmp_path / "list.csv").write_text(f"record,name\n{Path('record.csv').absolute()},a\n")
    line = line.replace("list.csv", f"{tmp_path}/list.csv")
    assert main(shlex.split(f"{line} --cluster {address} --out {tmp_path}/out")) == 2
    assert complaint(capsys) == (
        "--cluster must be the address of a Dask scheduler that answers, such as "
        f"tcp://10.0.0.5:8786, got {address}"
    )
    assert not (tmp_path / "out").exists()


def test_a_worker_is_no_scheduler(whole: Running) -> None:
    with distributed.Client(whole.address, set_as_default=False) as client:
        worker = next(iter(client.nthreads()))
    with pytest.raises(ConnectionError, match=f"no Dask scheduler answers at {worker}"):
        Cluster(worker)


def test_a_missing_extra_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    assert main(shlex.split(f"{COMPARE} --cluster tcp://127.0.0.1:9")) == 2
    assert complaint(capsys) == "a cluster needs Dask: pip install 'splitband[cluster]'"


def test_jobs_of_this_machine_and_a_cluster_exclude_each_other(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(shlex.split(f"{COMPARE} --jobs 2 --cluster tcp://127.0.0.1:9")) == 2
    assert complaint(capsys).startswith("--jobs must be left out with --cluster")


# ---------------------------------------------------------------- the last two, as they end them


def test_a_worker_that_is_killed_changes_no_number(whole: Running) -> None:
    assert killed_after(0, whole)


@pytest.mark.soak
def test_workers_killed_at_random_moments_change_no_number(running: Running) -> None:
    rng, kills = np.random.default_rng(), 0
    while kills < 20:
        running.whole("a", "b")
        kills += killed_after(int(rng.integers(8)), running)


def killed_after(reports: int, running: Running) -> bool:
    """Whether a worker was killed while trainings ran; checks that it has changed no number."""
    expected = compared(None, lambda _: None)
    seen = count()

    def kill(_: RunProgress) -> None:
        if next(seen) == reports:
            running.end("a")

    with Cluster(running.address) as cluster:
        found = compared(cluster, kill)
    numbers = [c for c in found if found[c].dtype.kind == "f" and c != "fit (s)"]
    np.testing.assert_allclose(found[numbers], expected[numbers], rtol=1e-6)
    return next(seen) > reports


@pytest.mark.soak
def test_the_end_of_the_scheduler_is_one_line_and_finished_work_is_kept(
    running: Running, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    running.whole("b")
    out = tmp_path / "out"
    line = f"{LONG} --recipe constant-rate --warmup 10 --epochs 40 --out {out}"

    def killed(*_: Any, **__: Any) -> None:
        if [*out.rglob("held*/*-0.safetensors")] and running.scheduler is not None:
            running.scheduler.kill()

    with monkeypatch.context() as patched:
        patched.setattr("rich.progress.Progress.update", killed)
        assert main([*shlex.split(line), "--cluster", running.address]) == 2
    assert complaint(capsys) == (
        f"the Dask scheduler at {running.address} is gone; what is finished is kept, and the same "
        "command goes on from here"
    )
    assert {path.name for path in out.iterdir()} == {CHECKPOINTS}
    assert [*out.rglob("*.safetensors")]
    call(line + " --jobs 1")
    call(f"{LONG} --recipe constant-rate --warmup 10 --epochs 40 --jobs 1", tmp_path / "whole")
    assert same(results(out), results(tmp_path / "whole"))

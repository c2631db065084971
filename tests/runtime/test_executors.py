"""Jobs given to executors of somebody else's."""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import threadpoolctl
import torch

from splitband import Work, compare
from splitband.evaluation.work import RunProgress
from splitband.runtime.processes import map_jobs
from splitband.runtime.threads import one_thread, seeded
from tests.records import SETUP, record
from tests.support import forecasters

TOLD = 3


class Elsewhere(Executor):
    """What is given to it arrives as it would on another machine, and so do the results."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        there, given = pickle.loads(pickle.dumps((fn, args)))
        try:
            future.set_result(pickle.loads(pickle.dumps(there(*given, **kwargs))))
        except Exception as error:
            future.set_exception(error)
        return future


class GivingUp(Executor):
    """One that ends before its jobs do."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.cancel()
        future.set_running_or_notify_cancel()
        return future


def square(job: int, report: Callable[[int], None]) -> int:
    for i in range(TOLD):
        report(10 * job + i)
    return job**2


def refuse(job: int, report: Callable[[int], None]) -> int:
    raise ZeroDivisionError


@pytest.mark.parametrize("executor", [Elsewhere(), ThreadPoolExecutor(2)], ids=["away", "threads"])
def test_the_last_report_of_a_job_comes_with_its_result(executor: Executor) -> None:
    seen: list[int] = []
    with executor:
        assert sorted(map_jobs(square, [1, 2, 3], executor, seen.append)) == [1, 4, 9]
    assert sorted(seen) == [10 * job + TOLD - 1 for job in (1, 2, 3)]


def test_the_error_of_a_job_is_raised_and_the_others_are_given_up() -> None:
    held, begun = threading.Event(), threading.Event()
    with ThreadPoolExecutor(1) as executor:
        executor.submit(held.wait)
        results = map_jobs(refuse, [1, 2, 3], executor)
        executor.submit(begun.set)
        held.set()
        with pytest.raises(ZeroDivisionError):
            next(results)
    assert begun.is_set()


def test_an_executor_that_gives_up_is_an_error_in_one_line() -> None:
    with pytest.raises(OSError, match=r"^the executor has given up a job$"):
        list(map_jobs(square, [1], GivingUp()))


# ---------------------------------------------------------------- comparisons


def compared(**work: Any) -> tuple[Any, list[RunProgress]]:
    """A comparison by some executor, and what it reported."""
    seen: list[RunProgress] = []
    setup = replace(SETUP, search=None)
    methods = forecasters(["gru", "split-gru", "mean"], setup)
    result = compare(
        record(), methods=methods, setup=setup, seeds=2, work=Work(progress=seen.append, **work)
    )
    return result.table.drop(columns="fit (s)"), seen


@pytest.mark.parametrize("executor", [Elsewhere(), ThreadPoolExecutor(4)], ids=["away", "threads"])
def test_a_comparison_is_the_same_by_any_executor(executor: Executor, tmp_path: Path) -> None:
    expected, _ = compared()
    with executor:
        found, seen = compared(executor=executor, checkpoints=tmp_path)
    numbers = [column for column in found if found[column].dtype.kind == "f"]
    np.testing.assert_allclose(found[numbers], expected[numbers], rtol=1e-6)
    assert found.drop(columns=numbers).equals(expected.drop(columns=numbers))
    trained = {"gru", "split-gru"}
    done = [(at.stage, at.method, at.seed) for at in seen if at.share == 1 and at.method in trained]
    assert sorted(done) == sorted(
        (stage, method, seed)
        for stage in ("held-out fit", "final fit")
        for method in trained
        for seed in (0, 1)
    )


def test_workers_that_share_no_disk_train_without_checkpoints(tmp_path: Path) -> None:
    class Unshared(Elsewhere):
        def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
            fit, *others = args
            return super().submit(fn, replace(fit, checkpoints=Path("not here")), *others, **kwargs)

    expected, _ = compared(executor=Elsewhere())
    found, _ = compared(executor=Unshared(), checkpoints=tmp_path)
    assert found.equals(expected)
    assert not [*tmp_path.rglob("*.safetensors")]


# ---------------------------------------------------------------- threads of one process


def blas() -> list[int]:
    return [pool["num_threads"] for pool in threadpoolctl.threadpool_info()
            if pool["user_api"] == "blas"]  # fmt: skip


def test_blas_has_its_threads_again_when_the_last_job_has_ended() -> None:
    np.ones((2, 2)) @ np.ones((2, 2))
    with threadpoolctl.threadpool_limits(3, user_api="blas"), ThreadPoolExecutor(1) as other:
        before = blas()
        job = one_thread()
        other.submit(job.__enter__).result()
        with one_thread():
            other.submit(job.__exit__, None, None, None).result()
            assert blas() == [1] * len(before)
        assert blas() == before


def test_weights_are_drawn_by_one_thread_at_a_time() -> None:
    def drawn(seed: int) -> float:
        with seeded(seed):
            return float(sum(torch.rand(1) for _ in range(500)))

    expected = [drawn(seed) for seed in range(40)]
    with ThreadPoolExecutor(4) as executor:
        assert [*executor.map(drawn, range(40))] == expected

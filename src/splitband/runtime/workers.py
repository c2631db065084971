"""Run jobs in worker processes, with cancellation, or by any other executor."""

from __future__ import annotations

import math
import multiprocessing
import os
import shutil
import signal
import tempfile
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Executor, Future, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from multiprocessing.connection import wait as wait_for
from multiprocessing.context import SpawnContext
from multiprocessing.reduction import ForkingPickler
from multiprocessing.synchronize import RLock
from typing import Any, Generic, ParamSpec, TypeVar, final

import numpy as np
from pebble import ProcessExpired, ProcessPool

from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import NEVER, Deadline
from splitband.runtime.memory import return_freed
from splitband.runtime.system import interrupts_blocked, start_resource_tracker
from splitband.runtime.threads import one_thread

Job = TypeVar("Job")
Result = TypeVar("Result")
Parameters = ParamSpec("Parameters")
LARGE = 2**20
"""Least size in bytes of an array sent to worker processes by a file. Bounds time and memory."""
TICK = 1.0
"""Longest wait in s for a job before the next check of Ctrl-C and deadlines."""


@final
class Workers(Executor):
    """Processes of this machine with one thread; cancellation ends a job at once.

    Processes start with the first job, and end with this process, however it ends. They begin by
    importing the main script: a script keeps its code under `if __name__ == "__main__":`.

    `count`: number of processes.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._context = _Spawn()
        self._folder: tempfile.TemporaryDirectory[str] | None = None
        self._pool: ProcessPool | None = None

    def submit(
        self,
        fn: Callable[Parameters, Result],
        /,
        *args: Parameters.args,
        **kwargs: Parameters.kwargs,
    ) -> Future[Result]:
        """Submit a job; `Future.cancel` also ends a running job."""
        if self._pool is None or self._folder is None:
            # The worker processes remove the folder if this process is killed.
            self._folder = tempfile.TemporaryDirectory(
                prefix="splitband-", ignore_cleanup_errors=True
            )
            arguments = self._folder.name, dict(os.environ)
            self._pool = ProcessPool(self._count, 0, _begin, arguments, self._context)
            start_resource_tracker()
        future: Future[Result] = Future()
        folder = self._folder.name
        try:
            _Pickler(packed := BytesIO(), folder).dump((fn, args, kwargs))
        except Exception as error:
            future.set_exception(NotSentError(str(error)))
        else:
            with interrupts_blocked():
                future = self._pool.schedule(_unpacked, (packed.getvalue(),))
        return future

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """End the processes, those with a job in the middle of it."""
        if self._pool is not None:
            self._pool.stop()  # type: ignore[no-untyped-call]
            self._pool.join()
            self._context.locks.clear()
        if self._folder is not None:
            for path in [path for path in _SHARED if path.startswith(self._folder.name)]:
                del _SHARED[path]
            self._folder.cleanup()


class _Spawn(SpawnContext):
    """A context that keeps the locks of a pool until its processes, which need them, have ended."""

    def __init__(self) -> None:
        self.locks: list[RLock] = []

    def RLock(self) -> RLock:  # noqa: N802  the name of the standard library
        """Return a new lock."""
        lock = super().RLock()
        self.locks.append(lock)
        return lock


def _begin(folder: str, environment: Mapping[str, str]) -> None:
    """Prepare a worker process."""
    # The pool's own handler would wait for the end of a compiled kernel.
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    os.environ.update(environment)
    tempfile.tempdir = folder
    # The names on POSIX and on Windows.
    os.environ.update(dict.fromkeys(("TMPDIR", "TEMP", "TMP"), folder))
    ForkingPickler.register(np.ndarray, partial(_sent_back, folder))
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # at Ctrl-C the parent ends the workers
    threading.Thread(target=_end_with_parent, args=(folder,), daemon=True).start()


_SHARED: dict[str, Array] = {}
"""Arrays shared with the parent or the workers, by the paths of their files."""


class _Pickler(ForkingPickler):
    """A pickler that writes every large read-only array, such as a record's, to a file once."""

    def __init__(self, packed: BytesIO, folder: str) -> None:
        super().__init__(packed)
        self._folder = folder

    def reducer_override(self, value: Any) -> Any:
        """Return the reduction of a value: a large array by its file, another value as usual."""
        if type(value) is not np.ndarray or value.nbytes < LARGE or value.flags.writeable:
            return NotImplemented
        if (reduction := _by_file(self._folder, value)) is not None:
            return reduction
        whole, base = value, value.base
        if type(base) is np.ndarray and not base.flags.writeable and _has_rows(base, value):
            whole = base
        number = sum(other.startswith(self._folder) for other in _SHARED)
        path = os.path.join(self._folder, f"{number}.npy")
        np.save(path, whole)
        _SHARED[path] = whole
        return _by_file(self._folder, value)


def _by_file(folder: str, value: Array) -> tuple[Any, ...] | None:
    """Return the reduction of an array with its rows in a file of the folder; None for others."""
    for path, whole in _SHARED.items():
        ours = path.startswith(folder) and (whole is value or whole is value.base)
        if ours and _has_rows(whole, value):
            begin = (value.ctypes.data - whole.ctypes.data) // whole.strides[0]
            return _mapped, (path, begin, begin + len(value))
    return None


def _has_rows(whole: Array, part: Array) -> bool:
    """Return whether a view of an array consists of successive rows."""
    alike = whole.dtype == part.dtype and whole.strides == part.strides
    return alike and whole.shape[1:] == part.shape[1:]


def _sent_back(folder: str, value: Array) -> Any:
    """Return the reduction of a worker's array: by its file if the array came from one."""
    return _by_file(folder, value) or value.__reduce__()


def _mapped(path: str, begin: int, end: int) -> Array:
    """Return rows of the array of a file, in memory shared by all processes."""
    if path not in _SHARED:
        _SHARED[path] = np.asarray(np.load(path, mmap_mode="r"))
    return _SHARED[path][begin:end]


def _unpacked(packed: bytes) -> Any:
    """Run a job in a worker process; its functions and classes may be missing there."""
    return_freed()
    try:
        fn, args, kwargs = ForkingPickler.loads(packed)
    except Exception as error:
        raise NotSentError(str(error)) from error
    return _Sent(fn(*args, **kwargs))


class _Sent:
    """Hold a result until it is sent: the pool would keep it as long as the next job runs."""

    def __init__(self, result: Any) -> None:
        self._result = result

    def __reduce__(self) -> tuple[Any, ...]:
        return _itself, (vars(self).pop("_result"),)


def _itself(result: Any) -> Any:
    return result


def _end_with_parent(folder: str) -> None:
    """End this process after the death of its parent, as its result is of no use."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait_for([parent.sentinel])
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(1)


def result_of(future: Future[Result], seconds: float | None = None) -> Result:
    """Return the result of a job; Ctrl-C takes effect within a `TICK`, on Windows too."""
    until = math.inf if seconds is None else time.monotonic() + seconds
    while not future.done() and (left := until - time.monotonic()) > 0:
        wait([future], min(TICK, left))
    return future.result(0)


class NotSentError(Exception):
    """A job cannot be sent to another process, as its classes are not in a module."""


@dataclass(eq=False)
class _Begun:
    """A job of a queue; `future` is None while the job waits for a core."""

    work: Callable[[Any], Any]
    job: Any
    patience: Deadline
    future: Future[Any] | None = None

    @property
    def over(self) -> bool:
        """Return whether the job is done, or its `patience` is over."""
        return self.patience.over or (self.future is not None and self.future.done())

    def result(self) -> Future[Any]:
        """Return the result; cancel a job without one."""
        future = self.future or Future()
        future.cancel()
        return future

    def here(self) -> Future[Any]:
        """Run the job in this process and return the result."""
        future: Future[Any] = Future()
        try:
            future.set_result(_on_one_thread(self.work, self.job))
        except Exception as error:
            future.set_exception(error)
        return future


@final
class Queue(Generic[Job, Result]):
    """Jobs on an executor or, one after the other on demand, in this process.

    `executor`: None for this process; `cores`: number of simultaneous jobs of the executor.
    """

    def __init__(self, executor: Executor | None = None, cores: float = math.inf) -> None:
        self._executor, self._cores = executor, cores
        self._begun: list[_Begun] = []

    def begin(
        self,
        work: Callable[[Job], Result],
        jobs: Sequence[Job],
        patience: Deadline = NEVER,
        first: bool = False,
    ) -> None:
        """Begin jobs.

        work : A module-level function, or a partial of one: other processes have to import it.
        jobs : Jobs in the order of their starts.
        patience : Deadline of the results; `Workers` then end the job.
        first : Whether the jobs start before others in the queue.
        """
        begun = [_Begun(work, job, patience) for job in jobs]
        self._begun = [*begun, *self._begun] if first else [*self._begun, *begun]
        if self._executor is not None:
            self._submit(self._executor)

    def ended(self) -> Iterator[tuple[Job, Future[Result]]]:
        """Yield jobs with their results in the order of their ends; not done after `patience`."""
        while self._begun:
            if self._executor is None:
                job = self._begun.pop(0)
                yield job.job, job.here()
                continue
            self._submit(self._executor)
            soonest = min(begun.patience for begun in self._begun)
            futures = [begun.future for begun in self._begun if begun.future is not None]
            wait(futures, min(TICK, max(soonest.left, 0.0)), FIRST_COMPLETED)
            for begun in [begun for begun in self._begun if begun.over]:
                self._begun.remove(begun)
                yield begun.job, begun.here() if _not_sent(begun.result()) else begun.result()

    def drop(self) -> None:
        """Cancel all jobs."""
        for begun in self._begun:
            begun.result()
        self._begun = []

    def _submit(self, executor: Executor) -> None:
        """Submit jobs to the executor, up to the number of cores."""
        running = sum(begun.future is not None for begun in self._begun)
        for begun in self._begun:
            if begun.future is None and running < self._cores:
                begun.future = executor.submit(_on_one_thread, begun.work, begun.job)
                running += 1


def _not_sent(future: Future[Any]) -> bool:
    done = future.done() and not future.cancelled()
    return done and isinstance(future.exception(), NotSentError)


def run_jobs(
    work: Callable[[Job], Result], jobs: Sequence[Job], executor: Executor | None = None
) -> Iterator[tuple[Job, Future[Result]]]:
    """Yield jobs with their results in the order of their ends; see `Queue`."""
    queue = Queue[Job, Result](executor)
    try:
        queue.begin(work, jobs)
        yield from queue.ended()
    finally:
        queue.drop()


def ended_from_outside(error: BaseException) -> str:
    """Return the message for the end of a worker process; empty for any other error."""
    if isinstance(error, BrokenProcessPool):
        return (
            "the worker processes did not begin: a script has to keep what it does under "
            '`if __name__ == "__main__":`'
        )
    message = "its process was ended from outside, perhaps for memory"
    return message if isinstance(error, ProcessExpired) else ""


def _on_one_thread(work: Callable[[Job], Result], job: Job) -> Result:
    with one_thread():
        return work(job)

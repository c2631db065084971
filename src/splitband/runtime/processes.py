"""Run the same work over many inputs, in this process, in several or by an executor."""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.context
import multiprocessing.forkserver
import multiprocessing.resource_tracker
import os
import shutil
import signal
import sys
import tempfile
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from multiprocessing.queues import SimpleQueue
from typing import Any, final

from splitband.runtime.deadlines import NEVER, Deadline
from splitband.runtime.executors import (
    Job,
    Message,
    Parameters,
    Report,
    Result,
    Work,
    Workers,
    run_on,
)
from splitband.runtime.threads import one_thread, use_one_thread

LONGEST = 50
"""Longest name, in bytes, of a temporary folder for sockets: their names have at most 107 bytes,
of which `multiprocessing` takes some, twice if processes start further ones."""


def map_jobs(
    work: Work[Job, Message, Result],
    jobs: Sequence[Job],
    workers: int | Executor = 1,
    progress: Callable[[Message], None] | None = None,
    patience: Deadline = NEVER,
) -> Iterator[Result]:
    """Yield `work(job, report)` for each job as it is done, each on one thread.

    Raises OSError if a process is killed, or an executor loses a job.

    Parameters
    ----------
    work : A module-level function, as other processes have to import it.
    jobs : In the order in which they are started.
    workers : Number of processes on this machine (1: this process), or any executor.
    progress : Called in this process with each message that the work reports.
    patience : Deadline at which unfinished jobs of other processes are given up, without a result.
    """
    progress = progress or _ignore
    if isinstance(workers, Executor):
        yield from run_on(workers, work, jobs, progress, patience)
    elif workers > 1 and len(jobs) > 1:
        with Processes(min(workers, len(jobs))) as processes:
            yield from run_on(processes, work, jobs, progress, patience)
    else:
        for job in jobs:
            with one_thread():
                result = work(job, progress)
            yield result


def _ignore(_: Any) -> None:
    pass


@final
class Processes(Workers):
    """Run jobs in processes of this machine, which end with this one.

    Where forks are safe, they are forked from a server process that has loaded the package: all but
    the first start at once and share its memory. The server stays until this process ends.
    Temporary files are in a folder that is removed at the end, however a process ends.

    `count`: largest number of processes.
    """

    def __init__(self, count: int) -> None:
        self._count = count
        self._folder = tempfile.TemporaryDirectory(prefix="splitband-", ignore_cleanup_errors=True)
        self._begin()

    def _begin(self) -> None:
        context = _context()
        self._queue: SimpleQueue[Any] = context.SimpleQueue()
        given = self._queue, self._folder.name, dict(os.environ)
        self._pool = ProcessPoolExecutor(self._count, context, _start_worker, given)

    def submit(
        self,
        fn: Callable[Parameters, Result],
        /,
        *args: Parameters.args,
        **kwargs: Parameters.kwargs,
    ) -> Future[Result]:
        """Submit a job to the processes."""
        try:
            with _no_interrupts():  # a half-started process would complain
                return self._pool.submit(fn, *args, **kwargs)
        except EOFError as error:
            raise BrokenProcessPool("the process that they are copies of has ended") from error

    @contextlib.contextmanager
    def listening(self, progress: Callable[[Any], None]) -> Iterator[Report]:
        """Yield a report function that sends messages through a queue to this process."""
        listener = threading.Thread(target=_forward, args=(self._queue, progress), daemon=True)
        listener.start()
        try:
            yield _to_parent
        finally:
            self._queue.put(None)
            listener.join()

    def abandon(self, jobs: Sequence[Future[Any]]) -> None:
        """End the processes with their jobs, and start new ones for later jobs."""
        ended = [*(self._pool._processes or {}).values()]
        for worker in ended:
            worker.terminate()
        self._pool.shutdown(wait=False, cancel_futures=True)
        self._begin()  # with a new queue: an ended process may hold the lock of the old one

    def explained(self, error: BaseException) -> BaseException:
        """Return an error that explains that a process was killed or did not start."""
        if isinstance(error, BrokenProcessPool):
            return OSError(
                "a training process was ended from outside, perhaps for memory, or did not begin: "
                'a script has to keep what it does under `if __name__ == "__main__":`'
            )
        return super().explained(error)

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = True) -> None:
        """End the processes."""
        self._pool.shutdown(wait, cancel_futures=cancel_futures)
        self._folder.cleanup()


def _context() -> multiprocessing.context.BaseContext:
    """Return how processes start: from a fork server, or spawned on macOS and Windows.

    They are also spawned if the temporary folder has a long name: a server needs a socket in it.
    """
    long = len(os.fsencode(tempfile.gettempdir())) > LONGEST
    if sys.platform in {"darwin", "win32"} or long:
        return multiprocessing.get_context("spawn")
    context = multiprocessing.get_context("forkserver")
    package = __name__.partition(".")[0]
    loaded = [name for name in [*sys.modules] if name.partition(".")[0] == package]
    context.set_forkserver_preload(loaded)
    multiprocessing.resource_tracker.ensure_running()  # which unblocks signals
    with _no_interrupts(), _same_path():
        multiprocessing.forkserver.ensure_running()
    return context


@contextlib.contextmanager
def _same_path() -> Iterator[None]:
    """Give Python processes that start in this context the import path of this one alone."""
    own = {"PYTHONSAFEPATH": "1", "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}
    before = {name: os.environ.get(name) for name in own}
    os.environ.update(own)
    try:
        yield
    finally:
        for name, value in before.items():
            os.environ.pop(name)
            if value is not None:
                os.environ[name] = value


_queue: Any = None


def _start_worker(queue: Any, folder: str, environment: dict[str, str]) -> None:
    global _queue  # noqa: PLW0603  set once, when the process starts
    _queue = queue
    os.environ.clear()
    os.environ.update(environment)  # replaces the environment of the server
    tempfile.tempdir = os.environ["TMPDIR"] = folder
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends them
    use_one_thread()
    threading.Thread(target=_end_with_parent, args=(folder,), daemon=True).start()


def _end_with_parent(folder: str) -> None:
    """End this process when its parent has been killed, as its result is of no use."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        shutil.rmtree(folder, ignore_errors=True)
        os._exit(1)


def _to_parent(message: Any) -> bool:
    _queue.put(message)
    return True


@contextlib.contextmanager
def _no_interrupts() -> Iterator[None]:
    """Block Ctrl-C in processes that start in this context, which inherit the blocked signal."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _forward(queue: SimpleQueue[Any], progress: Callable[[Any], None]) -> None:
    while (at := queue.get()) is not None:
        progress(at)

"""The same work over many inputs, in this process or in several."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import wait
from multiprocessing.queues import SimpleQueue
from typing import Any, TypeVar

from splitband.runtime.threads import one_thread, use_one_thread

Job = TypeVar("Job")
Result = TypeVar("Result")
Message = TypeVar("Message")
Work = Callable[[Job, Callable[[Message], None]], Result]


def over(
    work: Work[Job, Message, Result],
    jobs: Sequence[Job],
    processes: int = 1,
    progress: Callable[[Message], None] | None = None,
) -> Iterator[Result]:
    """Yield `work(job, report)` for each job as it is done, each on one thread.

    Parameters
    ----------
    work : A function of a module, as other processes have to find it.
    jobs : In the order in which they are begun.
    processes : How many at once; 1 is this process.
    progress : Called in this process with whatever the work reports.

    Raises
    ------
    OSError
        When a process is ended from outside.
    """
    if processes > 1 and len(jobs) > 1:
        yield from _in_processes(work, jobs, min(processes, len(jobs)), progress)
        return
    for job in jobs:
        with one_thread():
            result = work(job, progress or _ignore)
        yield result


def _ignore(_: Any) -> None:
    pass


_to_parent: Any = None


def _start_worker(queue: Any) -> None:
    global _to_parent  # noqa: PLW0603  set once, when the process starts
    _to_parent = queue
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent, which ends them
    use_one_thread()
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """End this process when its parent has been killed, as nobody waits for its result."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)


def _work(work: Work[Job, Message, Result], job: Job) -> Result:
    return work(job, _to_parent.put)


def _in_processes(
    work: Work[Job, Message, Result],
    jobs: Sequence[Job],
    processes: int,
    progress: Callable[[Message], None] | None,
) -> Iterator[Result]:
    context = multiprocessing.get_context("spawn")
    queue: SimpleQueue[Message | None] = context.SimpleQueue()
    listener = threading.Thread(target=_forward, args=(queue, progress or _ignore), daemon=True)
    listener.start()
    others = multiprocessing.active_children()
    pool = ProcessPoolExecutor(processes, context, _start_worker, (queue,))
    try:
        with _no_interrupts():  # again: multiprocessing's tracker has reset it
            results = [pool.submit(_work, work, job) for job in jobs]
        for done in as_completed(results):
            yield done.result()
    except BrokenProcessPool:
        raise OSError("a training process was ended from outside, perhaps for memory") from None
    except BaseException:
        # After Ctrl-C or a failure, do not wait for the jobs that still run.
        for worker in multiprocessing.active_children():
            if worker not in others:
                worker.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)
        queue.put(None)
        listener.join()


@contextlib.contextmanager
def _no_interrupts() -> Iterator[None]:
    """A process begun in here does not hear Ctrl-C, not even while it imports; it inherits that."""
    if not hasattr(signal, "pthread_sigmask"):
        yield
        return
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _forward(queue: SimpleQueue[Message | None], progress: Callable[[Message], None]) -> None:
    while (at := queue.get()) is not None:
        progress(at)

"""Run jobs on any executor, and receive the progress that they report."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, as_completed
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Any, ParamSpec, TypeVar, final

from splitband.runtime.deadlines import NEVER, Deadline
from splitband.runtime.threads import one_thread

Job = TypeVar("Job")
Result = TypeVar("Result")
Message = TypeVar("Message")
Parameters = ParamSpec("Parameters")
Work = Callable[[Job, Callable[[Message], None]], Result]
Report = Callable[[Any], bool]
"""Sends a message of a running job; returns whether it was sent."""


class Workers(Executor, ABC):
    """Extend an executor by progress messages from jobs and a way to give up jobs."""

    @abstractmethod
    def listening(self, progress: Callable[[Any], None]) -> AbstractContextManager[Report]:
        """Yield the function by which jobs report; this process passes messages to `progress`."""

    @abstractmethod
    def abandon(self, jobs: Sequence[Future[Any]]) -> None:
        """End jobs whose results are no longer needed, or at least stop waiting for them."""

    def shared(self, value: Any) -> Any:
        """Return what jobs are sent in place of an argument that they all share, as a reference."""
        return value

    def explained(self, error: BaseException) -> BaseException:
        """Return the error to raise in place of the one with which a job ended."""
        if isinstance(error, CancelledError):
            return OSError("the executor has given up a job")
        return error


@final
class ExecutorAdapter(Workers):
    """Adapt any other executor: the last report of a job comes with its result."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    def submit(
        self,
        fn: Callable[Parameters, Result],
        /,
        *args: Parameters.args,
        **kwargs: Parameters.kwargs,
    ) -> Future[Result]:
        """Submit a job to the adapted executor."""
        return self._executor.submit(fn, *args, **kwargs)

    @contextmanager
    def listening(self, progress: Callable[[Any], None]) -> Iterator[Report]:
        """Yield a report function that never sends: messages come with the results."""
        yield _unsent

    def abandon(self, jobs: Sequence[Future[Any]]) -> None:
        """Cancel jobs that have not started; running ones go on."""
        for job in jobs:
            job.cancel()


def run_on(
    executor: Executor,
    work: Work[Job, Message, Result],
    jobs: Sequence[Job],
    progress: Callable[[Message], None],
    patience: Deadline,
) -> Iterator[Result]:
    """Yield `work(job, report)` for each job as the executor completes it, each on one thread.

    Jobs that are not done at the deadline `patience` are given up.
    """
    workers = executor if isinstance(executor, Workers) else ExecutorAdapter(executor)
    waiting: set[Future[tuple[Result, list[Message]]]] = set()
    try:
        with workers.listening(progress) as report:
            shared = workers.shared(work)
            for job in jobs:
                waiting.add(workers.submit(_done, shared, report, job))
            for future in _until(patience, [*waiting]):
                waiting.remove(future)
                result, unsent = future.result()
                for message in unsent:
                    progress(message)
                yield result
        if waiting:
            workers.abandon([*waiting])
    except BaseException as error:  # or the caller needs no more results
        workers.abandon([*waiting])
        explained = workers.explained(error)
        if explained is error:
            raise
        raise explained from error


def _until(patience: Deadline, jobs: Sequence[Future[Any]]) -> Iterator[Future[Any]]:
    """Yield the jobs as they finish, until the deadline."""
    with suppress(TimeoutError):
        yield from as_completed(jobs, None if patience == NEVER else max(patience.left, 0.0))


def _done(
    work: Work[Job, Message, Result], report: Report, job: Job
) -> tuple[Result, list[Message]]:
    """Return the result of a job, and its last message if that has not been sent."""
    unsent: deque[Message] = deque(maxlen=1)

    def tell(message: Message) -> None:
        unsent.clear()
        if not report(message):
            unsent.append(message)

    with one_thread():
        return work(job, tell), [*unsent]


def _unsent(_: Any) -> bool:
    return False

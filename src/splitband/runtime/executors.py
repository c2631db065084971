"""Jobs given to an executor, whichever it is, and what they report on their way."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import CancelledError, Executor, Future, as_completed
from contextlib import AbstractContextManager, contextmanager
from typing import Any, ParamSpec, TypeVar, final

from splitband.runtime.deadlines import Deadline
from splitband.runtime.threads import one_thread

Job = TypeVar("Job")
Result = TypeVar("Result")
Message = TypeVar("Message")
Parameters = ParamSpec("Parameters")
Work = Callable[[Job, Callable[[Message], None]], Result]
Report = Callable[[Any], bool]
"""Sends a message while its job runs; says whether that could be done."""


class Workers(Executor, ABC):
    """An executor that knows how its jobs can report, and how they are given up."""

    @abstractmethod
    def listening(self, progress: Callable[[Any], None]) -> AbstractContextManager[Report]:
        """What jobs report by; `progress` is called in this process with the messages."""

    @abstractmethod
    def abandon(self, jobs: Sequence[Future[Any]]) -> None:
        """End jobs whose results nobody waits for any more, or at least do not wait for them."""

    def shared(self, value: Any) -> Any:
        """What jobs are given in place of an argument that is the same for all of them."""
        return value

    def explained(self, error: BaseException) -> BaseException:
        """The error to raise in place of one that a job ended with."""
        if isinstance(error, CancelledError):
            return OSError("the executor has given up a job")
        return error


@final
class ExecutorAdapter(Workers):
    """An executor of somebody else's: the last report of a job comes with its result."""

    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    def submit(
        self,
        fn: Callable[Parameters, Result],
        /,
        *args: Parameters.args,
        **kwargs: Parameters.kwargs,
    ) -> Future[Result]:
        """See `Executor`."""
        return self._executor.submit(fn, *args, **kwargs)

    @contextmanager
    def listening(self, progress: Callable[[Any], None]) -> Iterator[Report]:
        """See `Workers`."""
        yield _unsent

    def abandon(self, jobs: Sequence[Future[Any]]) -> None:
        """See `Workers`; what runs already goes on."""
        for job in jobs:
            job.cancel()


def given_to(
    executor: Executor,
    work: Work[Job, Message, Result],
    jobs: Sequence[Job],
    progress: Callable[[Message], None],
    patience: Deadline | None = None,
) -> Iterator[Result]:
    """Yield `work(job, report)` for each job as it is done by the executor, each on one thread.

    What is not done when the `patience` is over is given up.
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
    except BaseException as error:  # or nobody asks for the other results
        workers.abandon([*waiting])
        explained = workers.explained(error)
        if explained is error:
            raise
        raise explained from error


def _until(patience: Deadline | None, jobs: Sequence[Future[Any]]) -> Iterator[Future[Any]]:
    """The jobs as they are done, as long as somebody waits for them."""
    limited = patience is not None and patience != Deadline()
    timeout = max(patience.left, 0.0) if patience is not None and limited else None
    try:
        yield from as_completed(jobs, timeout)
    except TimeoutError:
        return


def _done(
    work: Work[Job, Message, Result], report: Report, job: Job
) -> tuple[Result, list[Message]]:
    """The result of a job, and its last message where that has not been sent."""
    unsent: deque[Message] = deque(maxlen=1)

    def tell(message: Message) -> None:
        unsent.clear()
        if not report(message):
            unsent.append(message)

    with one_thread():
        return work(job, tell), [*unsent]


def _unsent(_: Any) -> bool:
    return False

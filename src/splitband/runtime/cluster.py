"""Send jobs to the workers of a Dask scheduler; only this file uses Dask."""

from __future__ import annotations

import asyncio
import logging
import pickle
import time
import uuid
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError, Future, ThreadPoolExecutor
from contextlib import contextmanager, suppress
from typing import Any, final

from splitband.runtime.executors import Parameters, Report, Result, Workers

PATIENCE = 5.0
"""Seconds to wait for the answer of a scheduler. By eye."""
BETWEEN_REPORTS = 1.0
"""Least seconds between two reports of a job, as all reports pass the scheduler. By eye."""
COMPARED = ("python", "splitband", "torch", "numpy", "distributed")
"""Packages that need the same version on all workers; for Python, the same minor version."""
NAMED = 3
"""Largest number of workers with other versions that an error names. By eye."""


@final
class Cluster(Workers):
    """Use the workers of a Dask scheduler as an executor (the extra `splitband[cluster]`).

    As a context manager it closes the connection at the end; the workers go on running.

    Parameters
    ----------
    address : Address of the scheduler, such as "tcp://10.0.0.5:8786".

    Raises
    ------
    ValueError
        If `distributed` is not installed here, or a worker lacks a package or has other versions
        than this process.
    ConnectionError
        If no scheduler answers within `PATIENCE` seconds.
    """

    def __init__(self, address: str) -> None:
        try:
            from distributed import Client  # noqa: PLC0415
        except ImportError:
            raise ValueError("a cluster needs Dask: pip install 'splitband[cluster]'") from None
        self.address = address
        with ThreadPoolExecutor(1) as aside:  # this thread may have an event loop, as in notebooks
            answers = aside.submit(lambda: asyncio.run(_is_scheduler(address))).result()
        if not answers:
            raise ConnectionError(f"no Dask scheduler answers at {address}")
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", "Mismatched versions")  # an error, below
            self._client: Any = Client(address, timeout=PATIENCE, set_as_default=False)
        self._executor = self._client.get_executor(pure=False)
        try:
            self._check_versions()
        except BaseException:
            self.shutdown()
            raise

    @property
    def cores(self) -> int:
        """Return how many jobs the workers run at once; 0 before the first worker connects."""
        return sum(self._client.nthreads().values())

    def submit(
        self,
        fn: Callable[Parameters, Result],
        /,
        *args: Parameters.args,
        **kwargs: Parameters.kwargs,
    ) -> Future[Result]:
        """Submit a job; jobs start in the order in which they were submitted."""
        return self._executor.submit(fn, *args, **{**kwargs, "fifo_timeout": 0})

    def shared(self, value: Any) -> Any:
        """Send a value to the cluster once, and return its reference.

        The scheduler keeps a copy, in case the worker that holds the value is lost; workers fetch
        it from each other.
        """
        import cloudpickle  # noqa: PLC0415  it comes with Dask

        with warnings.catch_warnings():  # it is sent on its own because it is large
            warnings.filterwarnings("ignore", "Sending large graph")
            return self._client.submit(pickle.loads, cloudpickle.dumps(value), pure=False)

    @contextmanager
    def listening(self, progress: Callable[[Any], None]) -> Iterator[Report]:
        """Yield a report function that sends messages through the scheduler."""
        topic = f"splitband-{uuid.uuid4().hex}"
        self._client.subscribe_topic(topic, lambda event: progress(pickle.loads(event[1])))
        try:
            yield _ToScheduler(topic)
        finally:
            with suppress(Exception):  # the connection may be lost
                self._client.unsubscribe_topic(topic)

    def abandon(self, jobs: Sequence[Future[Any]]) -> None:
        """Give up jobs; a running training ends with its epoch."""
        if self._connected:
            self._executor.shutdown(wait=False)
            self._executor = self._client.get_executor(pure=False)

    def explained(self, error: BaseException) -> BaseException:
        """Return an error that names lost workers or a lost scheduler."""
        from distributed import KilledWorker  # noqa: PLC0415

        if isinstance(error, KilledWorker):
            return OSError(
                f"{error.allowed_failures + 1} workers of {self.address} ended while they carried "
                "out the same job, perhaps for memory"
            )
        lost = isinstance(error, Exception) and not self._connected
        if lost or isinstance(error, CancelledError):
            return ConnectionError(
                f"the Dask scheduler at {self.address} is gone; what is finished is kept, and the "
                "same command goes on from here"
            )
        return error

    def shutdown(self, wait: bool = True, *, cancel_futures: bool = False) -> None:
        """Close the connection; the scheduler gives up unfinished jobs."""
        self._client.close(timeout=PATIENCE)

    @property
    def _connected(self) -> bool:
        return bool(self._client.status == "running")

    def _check_versions(self) -> None:
        """Raise ValueError if a worker has other package versions than this process."""
        found = self._client.get_versions(packages=COMPARED[1:])
        here = found["client"]["packages"]
        others = {
            address: said
            for address, of_worker in found["workers"].items()
            if (said := _difference(here, of_worker["packages"]))
        }
        if others:
            named = [f"worker {address} {said}" for address, said in [*others.items()][:NAMED]]
            more = [f"{len(others) - NAMED} more do, too"] if len(others) > NAMED else []
            raise ValueError(f"{'; '.join(named + more)}; all must have the same versions")


async def _is_scheduler(address: str) -> bool:
    """Return whether a scheduler answers; with any other server a client would wait for ever."""
    from distributed.comm.core import connect  # noqa: PLC0415
    from distributed.core import send_recv  # noqa: PLC0415
    from distributed.security import Security  # noqa: PLC0415

    try:
        async with asyncio.timeout(PATIENCE):
            comm = await connect(address, **Security().get_connection_args("client"))
            try:
                said = await send_recv(comm, op="identity")
            finally:
                comm.abort()
    except Exception:  # another server may answer anything
        return False
    return bool(said["type"] == "Scheduler")


def silence() -> None:
    """Keep Dask from logging to the error stream, for programs that report errors themselves."""
    with suppress(ImportError):
        import distributed  # noqa: F401, PLC0415  which sets its loggers up
    for name in [*logging.root.manager.loggerDict]:
        if name.split(".")[0] in ("distributed", "tornado"):
            logging.getLogger(name).handlers = [logging.NullHandler()]
            logging.getLogger(name).propagate = False


def _difference(here: Mapping[str, str | None], there: Mapping[str, str | None]) -> str:
    """Describe how a worker's versions differ from those of this process; empty if they do not."""
    if missing := [package for package in COMPARED if there.get(package) is None]:
        return f"has no {' and no '.join(missing)}"
    for package in COMPARED:
        # Without a build suffix such as "+cpu".
        parts = [str(each[package]).partition("+")[0].split(".") for each in (there, here)]
        found, wanted = (".".join(p[:2] if package == "python" else p) for p in parts)
        if found != wanted:
            return f"has {package} {found} and not {wanted}"
    return ""


class _ToScheduler:
    """Send reports of one job through the scheduler to whoever has subscribed to the topic."""

    def __init__(self, topic: str) -> None:
        self._topic, self._next = topic, 0.0

    def __call__(self, message: Any) -> bool:
        from distributed import get_worker  # noqa: PLC0415

        worker, now = get_worker(), time.monotonic()
        task = worker.state.tasks.get(worker.get_current_task())
        if task is None or task.state == "cancelled":
            raise RuntimeError("nobody waits for this job any more")
        if now < self._next:
            return False
        self._next = now + BETWEEN_REPORTS
        worker.log_event(self._topic, pickle.dumps(message))
        return True

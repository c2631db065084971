"""What carries out the trainings of a command: cores of this machine, or a cluster."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from splitband.cli import showing
from splitband.evaluation.budget import TimeBudget
from splitband.evaluation.work import RunProgress, Work
from splitband.runtime.cluster import Cluster, silence
from splitband.runtime.files import CHECKPOINTS
from splitband.runtime.threads import available_cores


@dataclass(frozen=True)
class WorkerPool:
    """Cores, of this machine where there is no executor."""

    cores: int
    executor: Executor | None = None

    def work(
        self, progress: Callable[[RunProgress], None], out: Path, time: TimeBudget | None = None
    ) -> Work:
        """How a comparison is computed by them, with checkpoints in the folder `out`."""
        checkpoints = out / CHECKPOINTS
        time = time or TimeBudget()
        return Work(self.cores, progress, checkpoints, executor=self.executor, time=time)


CORES_OF_A_CASE = 2
"""Cores that the work of a comparison is planned for by default (`evaluation.search`)."""
PROCESSES_OF_A_CORE = 4
"""Cases of a cluster for each core of this machine, which reads records and draws pictures."""


def cases_at_once(cases: int, cores: int, asked: int | None, commanding: int | None = None) -> int:
    """Return how many cases are compared side by side; each has a process, and its record in it.

    Parameters
    ----------
    cases : There are so many.
    cores : That carry out the trainings of all of them.
    asked : By the user; None where nobody has.
    commanding : Cores of the machine on which the processes are, where that is not the same one.
    """
    most = cores if commanding is None else PROCESSES_OF_A_CORE * commanding
    return max(1, min(cases, asked or min(cores // CORES_OF_A_CASE, most)))


@contextmanager
def worker_pool(jobs: int | None, cluster: str | None) -> Iterator[WorkerPool]:
    """What --jobs and --cluster ask for."""
    if cluster is None:
        yield WorkerPool(jobs or available_cores())
        return
    if jobs is not None:
        raise ValueError(
            f"--jobs must be left out with --cluster, where each thread has one, got {jobs}"
        )
    silence()
    try:
        executor = Cluster(cluster)
    except ConnectionError:
        raise ValueError(
            "--cluster must be the address of a Dask scheduler that answers, such as "
            f"tcp://10.0.0.5:8786, got {cluster}"
        ) from None
    with executor:
        cores = executor.cores
        if cores == 0:
            showing.console.print(f"{cluster} has no worker yet: waiting for the first one")
        yield WorkerPool(max(cores, 1), executor)

"""Define how a comparison is computed: processes, deadlines and progress reports."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path

from splitband.evaluation.budget import TimeBudget
from splitband.runtime.deadlines import Deadline
from splitband.runtime.processes import Processes

HALF = 0.5
"""Share of the time that is left for computing what several jobs share. By eye."""


@dataclass(frozen=True)
class RunProgress:
    """Report the end of an epoch of one run; `share` of its training is done, `overall` of all.

    `stage` is "search" with the number of the round, "held-out fit" for the trial of all methods on
    held-out samples, "on a baseline" for the trial of a network on top of one, "final fit" for fits
    to the whole training part, and "refit" for one to the whole record.
    """

    method: str
    seed: int
    share: float
    loss: float
    stage: str = "final fit"
    overall: float = 0.0


@dataclass(frozen=True)
class Work:
    """Define how a comparison is computed; only a deadline changes results beyond rounding.

    Attributes
    ----------
    jobs : Number of parallel processes, each with one thread. With several, a script must keep its
        code under `if __name__ == "__main__":`, as each process begins by importing it. With an
        executor, the number of parallel trainings for which a budget is planned, if more than one.
    progress : Called in this process after each epoch of each run; with an executor that cannot
        send while a job runs, at the end of each run.
    checkpoints : Folder from which interrupted trainings resume; created if necessary. Workers that
        cannot see it train without checkpoints.
    stage : Stage named in progress reports.
    executor : Runs the jobs in place of processes of this machine: any executor of
        `concurrent.futures`, for instance Dask's (`Cluster`) or mpi4py's. It stays open.
    time : Time budget of the whole command, with the measured pace of the machine.
    deadline : When the trainings of this stage stop with the weights that they have; those that
        have not started are left out.
    span : Shares of the whole command that are done before and after this stage, for `progress`.
    """

    jobs: int = 1
    progress: Callable[[RunProgress], None] | None = None
    checkpoints: str | Path | None = None
    stage: str = "final fit"
    executor: Executor | None = None
    time: TimeBudget = field(default_factory=TimeBudget)
    deadline: Deadline = field(default_factory=Deadline)
    span: tuple[float, float] = (0.0, 1.0)

    @property
    def cores(self) -> int:
        """Return how many trainings run in parallel."""
        return self.jobs if self.jobs > 1 else max(getattr(self.executor, "cores", 1), 1)

    def limited(self, seconds: float | None, core_seconds: float) -> Work:
        """Return the work with a time budget: its own, if limited, else these `seconds` from now.

        The same work may serve several comparisons, one after the other.
        """
        time = self.time
        if not time.limited:
            time = TimeBudget.of(seconds, self.cores, time.began if seconds is None else None)
        time.requested_limits = seconds, core_seconds
        return replace(self, time=time, deadline=time.deadline)

    def for_stage(
        self,
        stage: str,
        deadline: Deadline | None = None,
        span: tuple[float, float] | None = None,
    ) -> Work:
        """Return the work of one stage, with a separate folder for checkpoints."""
        below = None if self.checkpoints is None else Path(self.checkpoints) / stage
        until, span = deadline or self.deadline, span or self.span
        return replace(self, checkpoints=below, stage=stage, deadline=until, span=span)

    def alone(self) -> Work:
        """Return the same work in this process alone, which saves the start of others."""
        return replace(self, jobs=1, executor=None)

    @contextmanager
    def staffed(self) -> Iterator[Work]:
        """Yield the work with processes that all stages share, as starting them takes time."""
        if self.executor is not None or self.jobs == 1:
            yield self
            return
        if not self.time.allows_processes(self.time.share(HALF)):
            self.time.cores = 1
            yield self.alone()
            return
        with Processes(self.jobs) as processes:
            yield replace(self, executor=processes)

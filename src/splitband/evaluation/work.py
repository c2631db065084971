"""Say how a comparison is computed: where, until when, and who is told of it."""

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
"""Share of the time until which what is shared by several jobs must be computed. By eye."""


@dataclass(frozen=True)
class RunProgress:
    """Tell that an epoch of one run is over; `share` of the run's training is done.

    `stage` is "search" and a number where ways to train are tried, "held-out fit" where methods
    are, "on a baseline" where a network is put on one of them, and "final fit" where a method is
    fitted to the whole training part.
    """

    method: str
    seed: int
    share: float
    loss: float
    stage: str = "final fit"
    overall: float = 0.0


@dataclass(frozen=True)
class Work:
    """Say how a comparison is computed; none of it changes a number by more than rounding.

    Attributes
    ----------
    jobs : Processes at once, each on one thread. With several, a script has to keep what it does
        under `if __name__ == "__main__":`, as each process begins by importing it. With an
        executor, for how many trainings at once a budget is planned, if more than one.
    progress : Called in this process after each epoch of each run; with an executor that cannot
        send while a job runs, at the end of each run.
    checkpoints : Folder, created if need be, from which trainings that were cut off go on. Workers
        that do not see it train without.
    stage : What the progress is reported as.
    executor : What carries out the jobs in place of processes of this machine: any executor of
        `concurrent.futures`, Dask's (`Cluster`) or mpi4py's, for instance. It stays open.
    time : The time of the whole command, and what is known of the machine's pace.
    deadline : When the trainings of this stage end with what they have, and what has not begun yet
        is left out.
    span : Shares of the whole command that are done before this stage and after it, for `progress`.
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
        """Return how many trainings are carried out side by side."""
        return self.jobs if self.jobs > 1 else max(getattr(self.executor, "cores", 1), 1)

    def limited(self, seconds: float | None, core_seconds: float) -> Work:
        """Return it with a time budget: its own, or from now on so many seconds of wall time."""
        time = self.time
        if not time.limited:
            time = TimeBudget.of(seconds, self.cores, time.began)
        time.asked = seconds, core_seconds
        return replace(self, time=time, deadline=time.deadline)

    def for_stage(
        self,
        stage: str,
        deadline: Deadline | None = None,
        span: tuple[float, float] | None = None,
    ) -> Work:
        """Return one of several parts of the work, with a folder of its own for checkpoints."""
        below = None if self.checkpoints is None else Path(self.checkpoints) / stage
        until, span = deadline or self.deadline, span or self.span
        return replace(self, checkpoints=below, stage=stage, deadline=until, span=span)

    def alone(self) -> Work:
        """Return the work in this process, where starting others would take longer."""
        return replace(self, jobs=1, executor=None)

    @contextmanager
    def staffed(self) -> Iterator[Work]:
        """Yield it with processes for one stage after the other, as starting them takes time."""
        if self.executor is not None or self.jobs == 1:
            yield self
            return
        if not self.time.allows_processes(self.time.share(HALF)):
            self.time.cores = 1
            yield self.alone()
            return
        with Processes(self.jobs) as processes:
            yield replace(self, executor=processes)

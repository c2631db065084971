"""Run fits as jobs: in this process, in worker processes, or by any executor."""

from __future__ import annotations

import errno
import math
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, Self

from splitband.comparison.backtest import BacktestSpec, Fit, as_it_is, backtest
from splitband.comparison.methods import NAMES, TRAINED
from splitband.forecasters.base import Forecaster, all_parts, cells_of, fitted_like, same
from splitband.networks.cell import label_of
from splitband.records import Record
from splitband.runtime.arguments import whole
from splitband.runtime.deadlines import Deadline, DeadlineError, now, within
from splitband.runtime.optional import has_torch
from splitband.runtime.workers import Queue, Workers, ended_from_outside

if TYPE_CHECKING:
    from splitband.comparison.plan import Plan

BATCH = 8
"""Rows of the batch with which kernels of trainings are compiled; any number of several will do."""
GRACE = 2.0
"""Least seconds after its deadline in which a job computes its forecasts before it is ended; twice
what the forecasts of a job have taken, if that is more. Bounds the time."""


@dataclass(frozen=True, eq=False)
class Job:
    """Hold what a fit is asked for."""

    forecaster: Forecaster  # with its settings; not fitted
    spec: BacktestSpec  # what to fit it to and to forecast
    seed: int = 0  # of the fit
    start: Forecaster | None = None  # trained, to go on from; None for a new training
    trains: bool = True  # False to forecast with `start` as it is
    needed: bool = False  # whether it starts even after the deadline, so that there is a result
    seconds: float = 0.0  # that it is expected to take
    limit: float = math.inf  # seconds from its start after which its fits end with what they have
    bases: Sequence[Forecaster] = ()  # fitted ones, see `backtest`

    @property
    def method(self) -> str:
        """Return the name of the method."""
        return self.forecaster.name

    def run(self) -> Fit:
        """Return the fit, or one that says why it failed."""
        began, failure = now(), ""
        try:
            if not self.trains and self.start is not None:
                return as_it_is(self.start, self.spec, self.seed)
            return backtest(self.forecaster, self.spec, self.seed, self.start, bases=self.bases)
        except DeadlineError:
            return self.late()
        except (FloatingPointError, ValueError) as error:
            failure = " ".join(str(error).split())
        except Exception as error:
            if getattr(error, "errno", None) in (errno.ENOSPC, errno.EROFS):
                raise  # a full disk concerns every method
            failure = f"{type(error).__name__}: {' '.join(str(error).split())}"
        return Fit(self.method, self.seed, failure=failure, seconds=now() - began)

    def late(self) -> Fit:
        """Return the fit of a job for which there was no time."""
        return late(self.method, self.seed)


def late(method: str, seed: int = 0) -> Fit:
    """Return the fit of a method for which there was no time."""
    return Fit(method, seed, failure="left out, as the time was over", cut=True)


def held_out_job(
    plan: Plan, forecaster: Forecaster, seed: int = 0, start: Forecaster | None = None
) -> Job:
    """Return the job that fits a method to three quarters of the training part."""
    shorter = forecaster.for_trial(plan.train)
    return Job(shorter, plan.held_out_spec(shorter), seed, start)


def run_until(deadline: Deadline, job: Job) -> Fit:
    """Run a job in any process, with what it has at the deadline."""
    if deadline.over and job.trains and not job.needed:
        return job.late()
    began = now()
    with within(min(deadline, Deadline.after(job.limit))):
        return replace(job.run(), began=began)


def compile_kernels(
    cell: Any, rows: int, dtype: str = "float32", with_gradient: bool = True
) -> None:
    """Run a cell on a batch of so many rows and differentiate it, which compiles its kernels."""
    import torch  # noqa: PLC0415  in a worker

    from splitband.networks.rollout import jacobians, rollout  # noqa: PLC0415

    kind = getattr(torch, dtype)
    y, u = torch.zeros(rows, 4, 1, dtype=kind), torch.zeros(rows, 12, 2, dtype=kind)
    network = cell.sized(1, 2, 4).to(kind)
    with torch.set_grad_enabled(with_gradient):
        simulated = rollout(network, y, 8, u)
    if with_gradient:
        simulated.sum().backward()
        next(jacobians(network, y, 8, u) or iter(()), None)


def compile_filter() -> None:
    """Filter a tensor, which compiles the recurrence; filters compute in float64 alone."""
    import torch  # noqa: PLC0415  in a worker

    from splitband.filters import lfilter  # noqa: PLC0415

    lfilter([0.5], [1.0, -0.5], torch.arange(3.0))


def compile_solver() -> None:
    """Compile the solver of all equations."""
    from splitband.kernels.ode import compiled  # noqa: PLC0415  in a worker

    compiled()


def kernels_of(forecasters: Sequence[Forecaster]) -> list[Callable[[], None]]:
    """Return what compiles the kernels of first trainings and forecasts of these methods.

    Trainings come first. The kernels of few rows, with which forecasts are made, take longest.
    """
    cells = _cells_of(forecasters)
    return [
        *(partial(compile_kernels, cell, BATCH) for cell in cells),
        *(partial(compile_kernels, cell, 1, "float32", False) for cell in cells),
    ]


def every_kernel() -> list[Callable[[], None]]:
    """Return what compiles the solver of equations and, with torch, all networks' kernels."""
    if not has_torch():
        return [compile_solver]
    return [
        compile_solver,
        *(
            partial(compile_kernels, cell, rows, dtype)
            for rows in (1, BATCH)
            for cell in _cells_of([NAMES[name] for name in TRAINED])
            for dtype in ("float32", "float64")
        ),
        compile_filter,
    ]


def _cells_of(forecasters: Sequence[Forecaster]) -> list[Any]:
    """Return the cells of these methods, one of each kind."""
    cells = [cell for each in forecasters for cell in cells_of(each).values()]
    return [*{label_of(cell): cell for cell in cells}.values()]


class Runner:
    """Run jobs on the cores of this machine, or on an executor.

    With one core, jobs run in this process. An executor of `concurrent.futures`, such as
    Dask's, stays open; `cores` then says how many jobs it runs side by side.
    """

    def __init__(self, cores: int = 1, executor: Executor | None = None) -> None:
        self.cores = cores = whole("cores", cores)
        self._own = Workers(cores) if executor is None and cores > 1 else None
        self.executor: Executor | None = executor or self._own
        self._queue = Queue[Job, Fit](self.executor, cores + 1)  # none waits for this process
        self._late: list[tuple[Job, Fit]] = []
        self._starting: list[Future[None]] = []

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.drop()
        if self._own is not None:
            self._own.shutdown()

    def start(self, forecasters: Sequence[Forecaster]) -> None:
        """Start the workers, which load what the networks need; do not wait for them.

        They compile, side by side, kernels that are not on the disk yet.
        """
        if self.executor is None:
            return
        # A user's cell may fail here; its training says why.
        self._starting = [self.executor.submit(each) for each in kernels_of(forecasters)]

    @property
    def starting(self) -> bool:
        """Return whether workers still load or compile what they were started with."""
        return not all(each.done() for each in self._starting)

    def begin(
        self,
        jobs: Sequence[Job],
        deadline: Deadline,
        patience: Deadline | None = None,
        first: bool = False,
    ) -> None:
        """Begin jobs, of which `ended` yields the fits; see `Queue.begin`.

        They have to end at their `deadline`, and are ended when `patience` is over, by default
        `GRACE` later.
        """
        todo = []
        for job in jobs:
            if deadline.over and job.trains and not job.needed:
                self._late.append((job, job.late()))
            else:
                todo.append(job)
        patience = patience or deadline.earlier(-GRACE)
        self._queue.begin(partial(run_until, deadline), todo, patience, first)

    def ended(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, Fit]]:
        """Yield every job that was begun with its fit, as it ends, until all of these have."""
        left = {*jobs}
        while left:
            job, fit = self._late.pop(0) if self._late else self._next()
            left.discard(job)
            yield job, fit

    def _next(self) -> tuple[Job, Fit]:
        """Wait for the next job, and return it with its fit."""
        job, future = next(self._queue.ended())
        if future.cancelled() or not future.done():
            return job, job.late()
        error = future.exception()
        if error is None:
            return job, future.result()
        if said := ended_from_outside(error):
            return job, Fit(job.method, job.seed, failure=said)
        raise error

    def drop(self) -> None:
        """Cancel all jobs that have begun."""
        self._late = []
        self._queue.drop()


class Bases:
    """Fit the simulators that several methods share, once for each span of the records.

    The fitted forecasters are part of the jobs that need them.
    """

    def __init__(self, runner: Runner) -> None:
        self._runner = runner
        self._fitted: list[Forecaster] = []

    def fit(self, forecaster: Forecaster, records: Sequence[Record], deadline: Deadline) -> None:
        """Fit what a method has of them, from starting points side by side on all cores.

        What fails here is not lost: the job that needs it fits it again and says why.
        """
        for part in all_parts(forecaster):
            if part.fits_simulator and fitted_like(part, records, self._fitted) is None:
                with suppress(Exception), within(deadline):
                    workers = self._runner.executor or 1
                    self._fitted.append(part.fitted_copy(records, workers=workers))

    def given_to(self, job: Job) -> Job:
        """Return a job with those that were fitted to its spans."""
        spans, parts = {at.fitted for at in job.spec.origins}, [*all_parts(job.forecaster)]
        bases = [
            each
            for each in self._fitted
            if len(each.require_fitted().record) in spans and any(same(each, p) for p in parts)
        ]
        return replace(job, bases=bases)

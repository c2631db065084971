"""Run fits as jobs: in this process, in worker processes, or by any executor.

A finished job is a file, by which an interrupted command goes on: asked again for the same, it
finds the fit. A job that a deadline cut short is not finished.
"""

from __future__ import annotations

import errno
import hashlib
import json
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, Future
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import cached_property, partial
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

from splitband.data import Record
from splitband.forecasters.backtest import (
    BacktestSpec,
    Fit,
    Origin,
    as_it_is,
    backtest,
    for_trial,
)
from splitband.forecasters.base import Forecaster, all_parts, cells_of
from splitband.forecasters.names import NAMES, TRAINED
from splitband.forecasters.saving import packed, unpacked
from splitband.forecasters.simulation import simulations, with_simulators_of
from splitband.networks.cell import label_of
from splitband.runtime.caching import KEPT, Kept, keep
from splitband.runtime.deadlines import Deadline, DeadlineError, now, within
from splitband.runtime.errors import InputError
from splitband.runtime.files import replacing
from splitband.runtime.workers import Queue, Workers, ended_from_outside
from splitband.simulators.base import identity
from splitband.simulators.code import code_digest

if TYPE_CHECKING:
    from splitband.evaluation.plan import Plan

LATE = "left out, as the time was over"
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

    @property
    def method(self) -> str:
        """Return the name of the method."""
        return self.forecaster.name

    @cached_property
    def key(self) -> str:
        """Return a hash of all that the result depends on, the deadline excepted.

        Raises ValueError for a forecaster of the user that cannot be described.
        """
        digest = hashlib.sha256(version("splitband").encode())
        asked = self.spec
        plain = {
            "seed": self.seed, "end": asked.end, "warmup": asked.warmup, "initial": asked.initial,
            "origins": [(each.fitted, each.at) for each in asked.origins], "trains": self.trains,
            "others": len(asked.others), "tests": len(asked.tests), "new": self.start is None,
        }  # fmt: skip
        digest.update(json.dumps(plain, sort_keys=True).encode())
        own = _classes_of_users(self.forecaster)
        if (code := code_digest(*own)) is None:
            raise InputError(f"{self.method} must have code that can be told from another's")
        digest.update(code.encode())
        for simulator in (part.simulator for part in simulations(self.forecaster)):
            digest.update(str(identity(simulator)).encode())
        records = [asked.record, *asked.others, *asked.tests]
        for part in [self.forecaster, *([] if self.start is None else [self.start]), *records]:
            digest.update(packed(part))
        return digest.hexdigest()

    def run(self) -> Fit:
        """Return the fit, or one that says why it failed."""
        began, failure = now(), ""
        try:
            if not self.trains and self.start is not None:
                return as_it_is(self.start, self.spec, self.seed)
            return backtest(self.forecaster, self.spec, self.seed, self.start)
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
        return Fit(self.method, self.seed, failure=LATE, cut=True)


def _classes_of_users(forecaster: Forecaster) -> list[type]:
    """Return the classes of a forecaster, its parts and its cells that are not of the package."""
    every = [type(each) for part in all_parts(forecaster)
             for each in (part, *cells_of(part).values())]  # fmt: skip
    return [kind for kind in every if kind.__module__.split(".")[0] != "splitband"]


def held_out_job(
    plan: Plan, forecaster: Forecaster, seed: int = 0, start: Forecaster | None = None
) -> Job:
    """Return the job that fits a method to three quarters of the training part."""
    shorter = for_trial(forecaster, plan.train)
    return Job(shorter, plan.held_out_spec(shorter), seed, start)


def _run(known: Mapping[str, Kept], deadline: Deadline, job: Job) -> Fit:
    """Run a job in any process, with the simulators' fits that are `known`, for all jobs."""
    if deadline.over and job.trains and not job.needed:
        return job.late()
    keep(known)
    with within(min(deadline, Deadline.after(job.limit))):
        fit = job.run()
    if fit.model is not None and job.trains:  # the process that asked has the records
        fitted = fit.model.require_fitted()
        fit.model.fitted = replace(fitted, record=fitted.record[:2], others=())
    return fit


def compile_kernels(
    cell: Any, rows: int, dtype: str = "float32", with_gradient: bool = True
) -> None:
    """Run a cell on a batch of so many rows, forward and back, which compiles its kernels."""
    import torch  # noqa: PLC0415  in a worker

    from splitband.networks import rollout  # noqa: PLC0415

    kind = getattr(torch, dtype)
    y, u = torch.zeros(rows, 4, 1, dtype=kind), torch.zeros(rows, 12, 2, dtype=kind)
    with torch.set_grad_enabled(with_gradient):
        simulated = rollout(cell.sized(1, 2, 4).to(kind), y, 8, u)
    if with_gradient:
        simulated.sum().backward()


def compile_filter() -> None:
    """Filter a tensor, which compiles the recurrence; filters compute in float64 alone."""
    import torch  # noqa: PLC0415  in a worker

    from splitband.filters import lfilter  # noqa: PLC0415

    lfilter([0.5], [1.0, -0.5], torch.arange(3.0))


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
    """Return what compiles every kernel of the package, in each precision."""
    return [
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
    """Run jobs on the cores of this machine, or on an executor; keep what is finished in a folder.

    With one core, jobs run in this process. An executor of `concurrent.futures`, such as
    Dask's, stays open; `cores` then says how many jobs it runs side by side.
    """

    def __init__(
        self, cores: int = 1, executor: Executor | None = None, folder: Path | None = None
    ) -> None:
        self.cores, self.folder = cores, folder
        self._own = Workers(cores) if executor is None and cores > 1 else None
        self.executor: Executor | None = executor or self._own
        self._queue = Queue[Job, Fit](self.executor, cores + 1)  # none waits for this process
        self._parts: dict[tuple[int, int], tuple[Record, Record]] = {}
        self._found: list[tuple[Job, Fit]] = []  # by an earlier command, or too late
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
            found = self._kept(job)
            if found is None and deadline.over and job.trains and not job.needed:
                found = job.late()
            if found is None:
                todo.append(job)
            else:
                self._found.append((job, found))
        patience = patience or deadline.earlier(-GRACE)
        self._queue.begin(partial(_run, {**KEPT}, deadline), todo, patience, first)

    def ended(self, jobs: Sequence[Job]) -> Iterator[tuple[Job, Fit]]:
        """Yield every job that was begun with its fit, as it ends, until all of these have."""
        left = {*jobs}
        while left:
            job, fit = self._found.pop(0) if self._found else self._next()
            left.discard(job)
            yield job, fit

    def _next(self) -> tuple[Job, Fit]:
        """Wait for the next job, and return it with its fit."""
        job, future = next(self._queue.ended())
        if future.cancelled() or not future.done():
            return job, job.late()
        error = future.exception()
        if error is None:
            fit = future.result()
            if fit.model is not None and job.trains:
                self._put_records(job, fit.model, max(at.fitted for at in fit.forecasts))
            return job, self._put(job, fit)
        if said := ended_from_outside(error):
            return job, Fit(job.method, job.seed, failure=said)
        raise error

    def _put_records(self, job: Job, model: Forecaster, samples: int) -> None:
        """Put back the records that a model was fitted to, each of them once for all models."""
        record = job.spec.record
        if (key := (id(record), samples)) not in self._parts:
            self._parts[key] = record, record[:samples]  # while it is kept, nothing has its id
        others = tuple(job.spec.others)
        fitted = replace(model.require_fitted(), record=self._parts[key][1], others=others)
        model.fitted = fitted

    def drop(self) -> None:
        """Cancel all jobs that have begun."""
        self._found = []
        self._queue.drop()

    def _path(self, job: Job) -> Path | None:
        """Return the file of a job; None where it is not kept."""
        own = [part.simulator for part in simulations(job.forecaster)]
        known = all(each is None or identity(each) is not None for each in own)
        if self.folder is None or not job.forecaster.random or not known:
            return None
        with suppress(ValueError):
            return self.folder / f"{job.key}.safetensors"
        return None

    def _kept(self, job: Job) -> Fit | None:
        """Return the fit of a job that an earlier command has finished."""
        path = self._path(job)
        if path is None or not path.is_file():
            return None
        with suppress(OSError, ValueError, KeyError):
            said = unpacked(path.read_bytes())
            model = said["model"]
            # A saved model holds the end of its training record only, and no simulator.
            model.fitted = replace(model.require_fitted(), begin=0, whole=True)
            self._put_records(job, model, said["samples"])
            with_simulators_of(model, job.forecaster)
            forecasts = {Origin(*at): each for at, each in said["forecasts"]}
            return Fit(
                job.method, job.seed, model, forecasts, said["tests"], said["unfiltered"],
                said["seconds"], said["notes"],
            )  # fmt: skip
        return None

    def _put(self, job: Job, fit: Fit) -> Fit:
        """Keep a finished fit in its file, and return it; a full disk only loses the file."""
        path = None if fit.model is None or fit.cut else self._path(job)
        if path is None or fit.model is None:
            return fit
        said = {
            "model": fit.model,
            "samples": len(fit.model.require_fitted().record),
            "forecasts": [((at.fitted, at.at), each) for at, each in fit.forecasts.items()],
            "tests": [*fit.tests],
            "unfiltered": {**fit.unfiltered},
            "seconds": fit.seconds,
            "notes": fit.notes,
        }
        with suppress(OSError, ValueError):
            content = packed(said)
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path) as new:
                new.write_bytes(content)
        return fit


def prepare(
    forecasters: Sequence[Forecaster], records: Sequence[Record], runner: Runner, deadline: Deadline
) -> None:
    """Fit, once, the simulators that several methods share, side by side on all cores.

    What fails here is not lost: the job that needs it computes it again and says why.
    """
    for forecaster in forecasters:
        with suppress(Exception), within(deadline):
            for part in all_parts(forecaster):
                part._prepare(records, runner.executor or 1, runner.folder)

"""Running methods on a record over seeds, under both protocols.

*From the start*: warm up on the first R samples, simulate to the end; the error counts everything
after the warm-up. *Forecast*: warm up on the last R training samples, simulate beyond them.
"""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from multiprocessing.queues import SimpleQueue
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from splitband.data import Trajectory
from splitband.methods import FIXED, Setup, build, check
from splitband.metrics import rmse
from splitband.models import Model
from splitband.threads import use_threads
from splitband.training import Progress, fit

Array = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Run:
    """One method with one seed.

    Attributes
    ----------
    total_rmse, forecast_rmse : Of the two protocols, in the record's unit.
    seconds : Of the fit.
    from_start, forecast : The predictions `(time, ny)`, to the end of the record.
    components : What `from_start` is the sum of, for a model of several parts.
    description : What a baseline settled on.
    losses : Mean training loss of each epoch, by network.
    """

    method: str
    seed: int
    total_rmse: float
    forecast_rmse: float
    seconds: float
    from_start: Array
    forecast: Array
    components: dict[str, Array] = field(default_factory=dict)
    description: str = ""
    losses: dict[str, list[float]] = field(default_factory=dict)


@dataclass(frozen=True)
class RunProgress:
    """An epoch of one run is over; `share` of the run's training is done."""

    method: str
    seed: int
    share: float
    loss: float


def run(
    method: str,
    record: Trajectory,
    setup: Setup,
    seed: int,
    progress: Callable[[RunProgress], None] | None = None,
) -> Run:
    """Fit one method on the first `setup.train` samples and predict under both protocols."""
    began = time.perf_counter()
    train, warmup = record[: setup.train], setup.settings.warmup
    losses: dict[str, list[float]] = {}
    components: dict[str, Array] = {}
    if method in FIXED:
        naive = FIXED[method](record, setup.train)
        seconds, description = time.perf_counter() - began, str(naive)
        from_start, forecast = (
            naive.predict(start, len(record) - start, record.y[start - 1])
            for start in (warmup, setup.train)
        )
    else:
        model = build(method, record, setup, seed)
        reporter = _reporter(method, seed, model, progress)
        history = fit(model, train, setup.settings_of(method), seed, reporter)
        seconds, losses, description = history.seconds, history.losses, ""
        components = predict(model, record, 0, warmup)
        from_start = sum(components.values(), np.zeros(record.ny))
        parts = predict(model, record, setup.train - warmup, setup.train)
        forecast = sum(parts.values(), np.zeros(record.ny))
    truth = record.y if record.y_true is None else record.y_true
    return Run(
        method,
        seed,
        rmse(truth[warmup:], from_start),
        rmse(truth[setup.train :], forecast),
        seconds,
        from_start,
        forecast,
        components if len(components) > 1 else {},
        description,
        losses,
    )


def compare(
    record: Trajectory,
    methods: Sequence[str],
    setup: Setup,
    seeds: Sequence[int] = (0,),
    jobs: int = 1,
    progress: Callable[[RunProgress], None] | None = None,
) -> dict[str, list[Run]]:
    """Run every method with every seed; `jobs` changes the numbers by rounding at most.

    Parameters
    ----------
    record : Training part and the rest; both protocols end where it ends.
    methods : Names out of `METHODS`.
    setup : Settings for all of them.
    seeds : Each gives one run of each method.
    jobs : Processes at once, each on one thread.
    progress : Called in this process after each epoch of each run.

    Returns
    -------
    dict
        The runs of each method, in the order of `seeds`.
    """
    check(record, methods, setup)
    # The longest first, so that no process is left with one of them at the end.
    todo = sorted(((m, s) for m in methods for s in seeds), key=lambda job: job[0] in FIXED)
    if jobs == 1:
        threads = torch.get_num_threads()
        use_threads(1)
        try:
            done = [run(method, record, setup, seed, progress) for method, seed in todo]
        finally:
            use_threads(threads)
    else:
        done = _run_in_processes(record, todo, setup, jobs, progress)
    found = {(r.method, r.seed): r for r in done}
    return {m: [found[m, s] for s in seeds] for m in methods}


def predict(model: Model, record: Trajectory, begin: int, start: int) -> dict[str, Array]:
    """Warm up on `begin`..`start - 1`, simulate to the end of the record; by component."""
    u, y_sim = (None if s is None else s[begin:] for s in (record.u, record.y_sim))
    return model.simulate_components(record.y[begin:start], len(record) - start, u, y_sim)


def _reporter(
    method: str, seed: int, model: Model, progress: Callable[[RunProgress], None] | None
) -> Callable[[Progress], None] | None:
    if progress is None:
        return None
    networks = len([*model.children()])
    finished: list[str] = []

    def report(at: Progress) -> None:
        if at.task not in finished:
            finished.append(at.task)
        share = (len(finished) - 1 + at.epoch / at.epochs) / networks
        progress(RunProgress(method, seed, share, at.loss))

    return report


_to_parent: Any = None


def _start_worker(queue: Any) -> None:
    global _to_parent  # noqa: PLW0603  set once, when the process starts
    _to_parent = queue
    use_threads(1)


def _work(record: Trajectory, method: str, setup: Setup, seed: int) -> Run:
    return run(method, record, setup, seed, _to_parent.put)


def _run_in_processes(
    record: Trajectory,
    todo: Sequence[tuple[str, int]],
    setup: Setup,
    jobs: int,
    progress: Callable[[RunProgress], None] | None,
) -> list[Run]:
    context = multiprocessing.get_context("spawn")
    queue: SimpleQueue[RunProgress | None] = context.SimpleQueue()
    listener = threading.Thread(target=_forward, args=(queue, progress), daemon=True)
    listener.start()
    pool = ProcessPoolExecutor(min(jobs, len(todo)), context, _start_worker, (queue,))
    try:
        futures = [pool.submit(_work, record, m, setup, s) for m, s in todo]
        return [future.result() for future in as_completed(futures)]
    except BrokenProcessPool:
        raise OSError("a training process was ended from outside, perhaps for memory") from None
    finally:
        pool.shutdown(cancel_futures=True)
        queue.put(None)
        listener.join()


def _forward(
    queue: SimpleQueue[RunProgress | None], progress: Callable[[RunProgress], None] | None
) -> None:
    while (at := queue.get()) is not None:
        if progress is not None:
            progress(at)

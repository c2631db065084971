"""Methods by name, run on a record over seeds, under both protocols.

*From the start*: warm up on the first R samples, simulate to the end; the error counts everything
after the warm-up. *Forecast*: warm up on the last R training samples, simulate beyond them.
"""

from __future__ import annotations

import multiprocessing
import threading
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, field
from queue import Queue
from typing import Any

import numpy as np
import numpy.typing as npt
import torch

from splitband.cells import GRU
from splitband.data import Trajectory
from splitband.filters import ComplementaryPair
from splitband.metrics import rmse
from splitband.models import Model, Recurrent, Split
from splitband.naive import HarmonicRegression, Naive, Persistence, SeasonalNaive
from splitband.spectrum import default_cutoff
from splitband.threads import use_threads
from splitband.training import Progress, Settings, fit

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Setup:
    """What a comparison is made under.

    Attributes
    ----------
    train : Samples at the beginning of the record that are trained on.
    settings : How the networks are trained.
    cutoff : Of the filter pair, in Hz.
    order : Of each Butterworth filter.
    downsampling : k of the low band.
    hidden_high, hidden_low : Sizes of the two networks; a single network has their sum.
    zero_phase : Filter in both directions.
    """

    train: int
    settings: Settings
    cutoff: float
    order: int = 1
    downsampling: int = 2
    hidden_high: int = 64
    hidden_low: int = 32
    zero_phase: bool = True


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


def _recurrent(record: Trajectory, setup: Setup) -> Model:
    return Recurrent(GRU(record.ny, setup.hidden_high + setup.hidden_low, record.nu))


def _split(record: Trajectory, setup: Setup, filter_output: bool = False) -> Model:
    pair = ComplementaryPair.butterworth(
        setup.cutoff, record.sampling_rate, setup.order, setup.zero_phase
    )
    low, high = (GRU(record.ny, n, record.nu) for n in (setup.hidden_low, setup.hidden_high))
    return Split(low, high, pair, setup.downsampling, filter_output)


MODELS: dict[str, Callable[[Trajectory, Setup], Model]] = {
    "gru": _recurrent,
    "split-gru": _split,
    "split-gru-hp": lambda record, setup: _split(record, setup, filter_output=True),
}
NAIVE: dict[str, Callable[[Array], Naive]] = {
    "persistence": lambda y: Persistence(),
    "seasonal-naive": SeasonalNaive.fit,
    "harmonic": HarmonicRegression.fit,
}
METHODS = (*MODELS, *NAIVE)


def default_setup(
    record: Trajectory, train: int, downsampling: int = 2, cutoff: float | None = None
) -> Setup:
    """A setup for a record of which nothing is known but its first `train` samples.

    Windows of up to 250 samples with up to 50 for the warm-up, and a cut-off with nine tenths of
    the power below.
    """
    y, rate = record.y[:train], record.sampling_rate
    window = min(250, max(2, train // 2))
    cutoff = default_cutoff(y, rate, downsampling) if cutoff is None else cutoff
    return Setup(train, Settings(window, default_warmup(window)), cutoff, downsampling=downsampling)


def default_warmup(window: int, most: int = 50) -> int:
    """At most a third of the window, and no more than `most`."""
    return min(most, max(1, window // 3))


def build(method: str, record: Trajectory, setup: Setup, seed: int) -> Model:
    """The untrained model of a method, its parameters drawn from `seed`."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        return MODELS[method](record, setup)


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
    if method in NAIVE:
        naive = NAIVE[method](train.y)
        seconds, description = time.perf_counter() - began, str(naive)
        from_start, forecast = (
            naive.predict(start, len(record) - start, record.y[start - 1])
            for start in (warmup, setup.train)
        )
    else:
        model = build(method, record, setup, seed)
        history = fit(model, train, setup.settings, seed, _reporter(method, seed, model, progress))
        seconds, losses, description = history.seconds, history.losses, ""
        components = _simulate(model, record, 0, warmup)
        from_start = sum(components.values(), np.zeros(record.ny))
        parts = _simulate(model, record, setup.train - warmup, setup.train)
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
    """Run every method with every seed; the numbers do not depend on `jobs`.

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
    todo = sorted(((m, s) for m in methods for s in seeds), key=lambda job: job[0] in NAIVE)
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


def check(record: Trajectory, methods: Sequence[str], setup: Setup) -> None:
    """Find what is wrong with a comparison before anything is computed."""
    unknown = [m for m in methods if m not in METHODS]
    if unknown or not methods:
        raise ValueError(f"methods must be out of {', '.join(METHODS)}, got {', '.join(unknown)}")
    check_train(record, setup.train)
    if setup.settings.window > setup.train:
        raise ValueError(
            f"window must fit into the {setup.train} training samples, got {setup.settings.window}"
        )
    for method in set(methods) & set(MODELS):
        build(method, record, setup, seed=0)


def check_train(record: Trajectory, train: int, ahead: int = 1) -> None:
    """Check that there is something to train on and `ahead` samples to predict."""
    if not 2 <= train <= len(record) - ahead:
        raise ValueError(
            f"train must be between 2 and {len(record) - ahead} for a record of {len(record)} "
            f"samples, got {train}"
        )


def _simulate(model: Model, record: Trajectory, begin: int, start: int) -> dict[str, Array]:
    """Warm up on `begin`..`start - 1`, simulate to the end of the record."""
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
    with context.Manager() as manager:
        queue: Queue[RunProgress | None] = manager.Queue()
        listener = threading.Thread(target=_forward, args=(queue, progress), daemon=True)
        listener.start()
        workers = min(jobs, len(todo))
        pool = ProcessPoolExecutor(workers, context, _start_worker, (queue,))
        try:
            futures = [pool.submit(_work, record, m, setup, s) for m, s in todo]
            return [future.result() for future in as_completed(futures)]
        finally:
            pool.shutdown(cancel_futures=True)
            queue.put(None)
            listener.join()


def _forward(
    queue: Queue[RunProgress | None], progress: Callable[[RunProgress], None] | None
) -> None:
    while (at := queue.get()) is not None:
        if progress is not None:
            progress(at)

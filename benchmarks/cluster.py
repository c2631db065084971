"""What a job of a cluster costs: overhead, what travels, and two workers against one.

python -m benchmarks.cluster [--out FILE.json] [--trainings 24] [--epochs 150] [--command]

With --command only what `splitband benchmark` itself computes for a record is measured again, and
put into the file.
"""

from __future__ import annotations

import argparse
import json
import pickle
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.timing import circumstances, write
from splitband import Cluster, Options, Record, Work
from splitband.cli import showing
from splitband.cli.comparing import Request, compared, planned, save
from splitband.cli.options.models import ModelOptions
from splitband.evaluation.jobs import run_all
from splitband.forecasters.backtest import Origin, Question, first_origin
from splitband.runtime.processes import map_jobs

SAMPLES, TRAIN, STEP = 4000, 2000, 0.1
"""Of the record, about as long as the drill string's."""
SHORT = 1000
"""Samples of the record by which the command itself is measured."""
EMPTY = 500
"""Jobs that do nothing, for what a job costs besides its work."""


class Weighed(Executor):
    """Carries jobs out here, and weighs what would travel."""

    def __init__(self) -> None:
        self.bytes: list[dict[str, int]] = []

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        """See `Executor`."""
        shared, _, job = args
        result = fn(*args)
        self.bytes.append({name: len(pickle.dumps(each)) for name, each in
                           (("shared", shared), ("job", job), ("result", result))})  # fmt: skip
        future: Future[Any] = Future()
        future.set_result(result)
        return future


def nothing(job: int, _: Callable[[Any], None]) -> int:
    """A job without any work."""
    return job


def commanding() -> float:
    """Processor seconds that a process of `splitband benchmark` itself computes for a record.

    That is reading, planning and writing results, pictures and the page; fits, which are jobs, do
    not count, nor does the first record, with which everything is loaded.
    """
    seconds = 0.0
    showing.console.quiet = True
    with TemporaryDirectory() as scratch:
        path, out = Path(scratch) / "record.csv", Path(scratch) / "out"
        y = signal()[:SHORT]
        columns = np.column_stack([STEP * np.arange(len(y)), y])
        np.savetxt(path, columns, delimiter=",", header="time,y", comments="")
        request = Request(str(path), model=ModelOptions(epochs=1, window=100), seeds=1)
        for _ in range(2):
            began = time.process_time()
            plan = planned(request, 1)
            before = time.process_time()
            result = compared(plan, Work(), out)
            after = time.process_time()
            save(result, out, {"command": "compare", "arguments": {"record": str(path)}})
            seconds = before - began + time.process_time() - after
    return seconds


def signal() -> Any:
    """Return the samples of the record."""
    t = STEP * np.arange(SAMPLES)
    noise = 0.05 * np.random.default_rng(0).standard_normal(SAMPLES)
    return np.sin(2 * np.pi * 0.05 * t) + 0.4 * np.sin(2 * np.pi * 1.1 * t) + noise


def trained(executor: Executor, seeds: int, epochs: int) -> None:
    """A network with each seed, and both protocols."""
    record = Record(signal()[:, None], STEP)
    setup = Options().decided(record, TRAIN)
    settings = replace(setup.settings, epochs=epochs, window=100, warmup=20, most_batches=4)
    network = replace(setup, settings=settings).forecaster("split-gru")
    origins = [first_origin(record, TRAIN, settings.warmup), Origin(TRAIN, TRAIN)]
    questions = {network.name: Question(record, origins, SAMPLES)}
    run_all([network], questions, range(seeds), Work(executor=executor))


def measured(workers: int, trainings: int, epochs: int) -> dict[str, float]:
    """Seconds of trainings, and of a job that does nothing, on workers of one thread each.

    Where the machine has other work, the processor seconds of all workers still say whether two of
    them spend more on the same trainings than one does.
    """
    from distributed import Client, LocalCluster  # noqa: PLC0415

    with (
        TemporaryDirectory() as scratch,
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            dashboard_address=":0",
            local_directory=scratch,
        ) as local,
        Cluster(local.scheduler_address) as cluster,
        Client(local, set_as_default=False) as client,
    ):
        trained(cluster, 2 * workers, 1)  # everything is loaded
        began = time.perf_counter()
        assert len([*map_jobs(nothing, range(EMPTY), cluster)]) == EMPTY
        empty = (time.perf_counter() - began) / EMPTY
        before = client.run(time.process_time)
        began = time.perf_counter()
        trained(cluster, trainings, epochs)
        seconds = time.perf_counter() - began
        used = [after - before[at] for at, after in client.run(time.process_time).items()]
        return {
            "trainings, s": seconds,
            "processor seconds": sum(used),
            "empty job, s": empty,
        }


def main() -> None:
    """Measure, print, and write what was found."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    parser.add_argument("--trainings", type=int, default=24)
    parser.add_argument("--epochs", type=int, default=150)
    parser.add_argument("--command", action="store_true", help="measure only that")
    arguments = parser.parse_args()
    if arguments.command:
        known = json.loads(arguments.out.read_text(encoding="utf-8")) if arguments.out else {}
        figures = known | {"command, s a record": commanding()}
        print(figures)
        write(figures, arguments.out)
        return
    weighed = Weighed()
    trained(weighed, 1, 1)
    figures = circumstances("torch", "numpy", "distributed")
    figures |= {"samples": SAMPLES, "trainings": arguments.trainings, "bytes": weighed.bytes[0]}
    one, two = (measured(n, arguments.trainings, arguments.epochs) for n in (1, 2))
    figures |= {"one worker": one, "two workers": two}
    figures["two workers / half of one"] = two["trainings, s"] / (one["trainings, s"] / 2)
    figures["processor seconds, two / one"] = two["processor seconds"] / one["processor seconds"]
    figures["command, s a record"] = commanding()
    print(figures)
    write(figures, arguments.out)


if __name__ == "__main__":
    main()

"""Error against CPU time on the public benchmarks: other packages and ours.

    python -m benchmarks.against [--sets silverbox,tanks] [--minutes 0.5,1,2,5,10] [--seeds 3]
        [--curves "splitband,splitband state space,splitband search,tsfast,jax-sysid"]
        [--jax-sysid PYTHON]

Side by side on this machine, one process of one thread. All train on the whole training file and
simulate the test files, whose first 50 samples are left out; nothing is chosen by a test file.
Minutes are CPU time, so that other work on the machine matters little, of the training alone; for
"splitband search" they are the budget of `compare` in whole, on one core.

tsfast lets its rate fall at the end, and is trained anew for each time; so is the search. L-BFGS
has no such plan: our networks and jax-sysid's are one training each, looked at on its way.

tsfast comes with the extra `bench`. jax-sysid needs older versions of jax and SciPy, and so an
environment of its own, whose Python is an option here:

    python -m venv peer && peer/bin/pip install jax-sysid==1.1.0
    python -m benchmarks.against --curves jax-sysid --jax-sysid peer/bin/python

Its settings stand in `benchmarks/jax_peer.py`. What is there already is not computed again, and
what is not installed is left out; `python -m benchmarks.public --no-run` puts the results into its
page.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import torch

import splitband as sb
from benchmarks.peers import installed
from benchmarks.plain import compared, errors_of
from benchmarks.sets import SETS, load
from splitband import Record
from splitband.report.environment import environment
from splitband.runtime.files import write_json
from splitband.runtime.threads import use_one_thread
from splitband.training import Settings
from splitband.training.settings import ROUND

GRU, STATE_SPACE, SEARCHED = "splitband", "splitband state space", "splitband search"
TSFAST, JAX_SYSID = "tsfast", "jax-sysid"
CURVES = {
    TSFAST: "tsfast's GRU",
    JAX_SYSID: "jax-sysid",
    GRU: "our GRU",
    STATE_SPACE: "our state-space network",
    SEARCHED: "splitband compare, one core",
}
"""What each is called in the picture."""
PEER = Path(__file__).with_name("jax_peer.py")
ENDLESS = 100_000
"""Iterations of L-BFGS that no training gets to."""
FOUND = {"silverbox": (32, 100, 3, ENDLESS), "tanks": (16, 400, 12, 100)}
"""Hidden units, window, epochs and the most iterations of L-BFGS after them, as `splitband compare`
finds them on the last quarter of the training file: on Silverbox the more the better."""
STATES = {"silverbox": (4, 10, 200, 0.0), "tanks": (4, 8, 200, 1e-4)}
"""States, tanh units, window and penalty of our state-space network, which begins as the linear
model and is trained by L-BFGS alone: the first that the search tries, on the tanks with its
penalty."""
LEFT_OUT = 50
"""Samples at the beginning of a test file that do not count; ours warms up on them."""
TABLE = {"silverbox": "BenchmarkSilverbox_Simulation", "tanks": "BenchmarkCascadedTanks_Simulation"}
"""Where tsfast keeps windows and batches for a benchmark."""
STEPS, TIMED_STEPS = 300, 40
"""Of tsfast: of an epoch, its default, and by which it is reckoned how many fit into a time."""

Point = dict[str, Any]
"""One curve after some time: its name (`library`), seed, minutes, CPU seconds, errors on tests."""


class _OverError(Exception):
    """There is no later moment to look at."""


class _Watch:
    """CPU time of this process, but for what is done while it is stopped."""

    def __init__(self) -> None:
        self._began = time.process_time()

    @property
    def seconds(self) -> float:
        return time.process_time() - self._began

    @contextmanager
    def stopped(self) -> Iterator[None]:
        """Leave out what the block takes."""
        at = time.process_time()
        yield
        self._began += time.process_time() - at


def _gru(name: str) -> tuple[sb.Single, Settings]:
    """Return our GRU, not fitted, and how it is trained."""
    (units, window, epochs, iterations) = FOUND[name]
    usual = sb.Settings.of(len(load(SETS[name].training)))
    settings = replace(usual, window=window, epochs=epochs, quasi_newton=iterations)
    return sb.Single(sb.GRU(units), settings), settings


def _state_space(name: str) -> tuple[sb.Single, Settings]:
    """Return our state-space network, not fitted, and how it is trained."""
    states, units, window, penalty = STATES[name]
    usual = sb.Settings.of(len(load(SETS[name].training)))
    settings = replace(usual, window=window, epochs=0, quasi_newton=ENDLESS, penalty=penalty)
    return sb.Single(sb.StateSpace(states, units), settings), settings


TRAINED: dict[str, Callable[[str], tuple[sb.Single, Settings]]] = {
    GRU: _gru,
    STATE_SPACE: _state_space,
}
"""Our networks that are trained once, and looked at on their way."""


def ours(
    library: str, name: str, seed: int, minutes: list[float], keep: Callable[[Point], None]
) -> None:
    """Train a network of ours once, and `keep` its errors as it passes each of the times."""
    benchmark = SETS[name]
    record, tests = load(benchmark.training), [load(test) for test in benchmark.tests]
    network, settings = TRAINED[library](name)
    compiling = replace(settings, epochs=1, most_batches=1, quasi_newton=1)
    network._trained_as(compiling).fit(record[: 3 * settings.window], seed=0)
    left, watch = sorted(minutes), _Watch()

    def look(progress: sb.Progress) -> None:
        while left and watch.seconds >= 60 * left[0]:
            seconds = watch.seconds
            with watch.stopped():
                errors = [_free_run(network, test) for test in tests]
                done = ROUND * max(0, progress.epoch - settings.epochs)
                keep(_point(library, seed, left.pop(0), seconds, errors, iterations=done))
        if not left:
            raise _OverError

    try:
        network.fit(record, seed=seed, progress=look)
    except _OverError:
        return
    seconds = watch.seconds  # it was over before the last moment
    errors = [_free_run(network, test) for test in tests]
    done = ROUND * (len(network.require_fitted().report.losses["network"]) - settings.epochs)
    for each in left:
        keep(_point(library, seed, each, seconds, errors, iterations=done))


def searched(name: str, seed: int, minutes: float) -> Point:
    """Let `compare` find and train its networks within so much wall time, on one core."""
    benchmark, watch = SETS[name], _Watch()
    run = compared(
        load(benchmark.training), tests=[*map(load, benchmark.tests)], seed=seed,
        budget=60 * minutes, cores=1,
    )  # fmt: skip
    found = run["recommended"]
    return _point(SEARCHED, seed, minutes, watch.seconds, errors_of(run), recommended=found)


def jax_sysids(
    name: str, seed: int, minutes: list[float], python: str, keep: Callable[[Point], None]
) -> None:
    """Train jax-sysid's model once, in its own environment, looked at on its way."""
    data = Path(os.environ["SPLITBAND_DATA_DIR"]) / "benchmarks"
    options = ["--data", str(data), "--seed", str(seed), "--minutes", ",".join(map(str, minutes))]
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    command = [python, str(PEER), name, *options]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=clean) as process:
        assert process.stdout is not None
        for line in process.stdout:
            if line.startswith("{"):  # it prints other things, too
                keep(json.loads(line))
    if process.returncode:
        raise RuntimeError(f"{PEER.name} ended with status {process.returncode}")


def _free_run(network: sb.Forecaster, test: Record) -> float:
    steps = len(test) - LEFT_OUT
    predicted = network.predict(steps, test[:LEFT_OUT], other_record=True)
    return sb.rmse(test.y[LEFT_OUT:], predicted.y)


def tsfasts(name: str, seed: int, minutes: float) -> Point:
    """Train tsfast's GRU with its own defaults for about so long."""
    from tsfast.training import RNNLearner  # noqa: PLC0415
    from tsfast.tsdata import create_dls  # noqa: PLC0415
    from tsfast.tsdata.benchmark import BENCHMARK_DL_KWARGS  # noqa: PLC0415

    benchmark, sizes = SETS[name], BENCHMARK_DL_KWARGS[TABLE[name]]
    record = load(benchmark.training)
    with tempfile.TemporaryDirectory() as folder:
        # It asks for something to validate on, too, but only shows the error on it.
        whole, part = Path(folder) / "train.hdf5", Path(folder) / "valid.hdf5"
        _write(record, whole)
        _write(record[-(len(record) // 4) :], part)
        files = {"train": [whole], "valid": [part], "test": []}

        def learner(steps: int) -> Any:
            torch.manual_seed(seed)
            dls = create_dls(["u"], ["y"], files, n_batches_train=steps, cache=True, **sizes)
            return RNNLearner(dls, n_skip=LEFT_OUT, show_bar=False)

        timed = learner(TIMED_STEPS)
        timed.fit_flat_cos(1)  # the first one is slower
        watch = _Watch()
        timed.fit_flat_cos(1)
        steps = round(60 * minutes * TIMED_STEPS / watch.seconds)
        epochs = max(1, round(steps / STEPS))
        training = learner(steps // epochs)
        watch = _Watch()
        training.fit_flat_cos(epochs)
        seconds = watch.seconds
    errors = []
    for test in map(load, benchmark.tests):
        u = torch.tensor(test.u, dtype=torch.float32)[None]
        with torch.no_grad():
            said = training.model.eval()(u)[0, LEFT_OUT:].double().numpy()
        errors.append(sb.rmse(test.y[LEFT_OUT:], said))
    return _point(TSFAST, seed, minutes, seconds, errors, steps=epochs * (steps // epochs))


def _write(record: Record, path: Path) -> None:
    """As tsfast reads records: a column each."""
    import h5py  # noqa: PLC0415

    assert record.u is not None
    with h5py.File(path, "w") as file:
        file["u"], file["y"] = (x[:, 0].astype("float32") for x in (record.u, record.y))


def _point(
    library: str,
    seed: int,
    minutes: float,
    seconds: float,
    errors: list[float],
    **facts: int | str,
) -> Point:
    of = version(TSFAST if library == TSFAST else "splitband")
    return {"library": library, "version": of, "seed": seed, "minutes": minutes,
            "cpu_seconds": round(seconds, 1), **facts, "test_rmse": errors}  # fmt: skip


def complete(
    name: str, libraries: list[str], seeds: int, minutes: list[float], path: Path, peer: str | None
) -> None:
    """Measure what the file lacks, the shorter trainings first, and write each to it."""

    def keep(point: Point) -> None:
        others = [p for p in _points(path) if _key(p) != _key(point)]
        write_json(path, {"environment": environment(), "points": [*others, point]})
        print(name, *point.values(), flush=True)

    for seed in range(seeds):
        there = {_key(point) for point in _points(path)}
        left = {
            library: [each for each in sorted(minutes) if (library, seed, each) not in there]
            for library in libraries
        }
        for each in left.get(TSFAST, ()):
            keep(tsfasts(name, seed, each))
        for each in left.get(SEARCHED, ()):
            keep(searched(name, seed, each))
        if left.get(JAX_SYSID) and peer is not None:
            jax_sysids(name, seed, left[JAX_SYSID], peer, keep)
        for library in TRAINED:
            if left.get(library):
                ours(library, name, seed, left[library], keep)


def _key(point: Point) -> tuple[str, int, float]:
    return point["library"], point["seed"], point["minutes"]


def path_of(out: Path, name: str) -> Path:
    """The file of a benchmark's points."""
    return out / f"against-{name}.json"


def _points(path: Path) -> list[Point]:
    return list(json.loads(path.read_text(encoding="utf-8"))["points"]) if path.exists() else []


def main() -> None:
    """Measure what is missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sets", default="silverbox", help="of silverbox, tanks")
    parser.add_argument("--minutes", default="0.5,1,2,5,10", help="of CPU time")
    parser.add_argument("--curves", default=",".join(CURVES), help=f"of {', '.join(CURVES)}")
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--jax-sysid", metavar="PYTHON", help="of an environment that has it")
    parser.add_argument("--out", type=Path, default=Path("docs/results/benchmarks"))
    arguments = parser.parse_args()
    curves = [each for each in arguments.curves.split(",") if each != TSFAST or installed(TSFAST)]
    use_one_thread()
    arguments.out.mkdir(parents=True, exist_ok=True)
    minutes = [float(each) for each in arguments.minutes.split(",")]
    for name in arguments.sets.split(","):
        path = path_of(arguments.out, name)
        complete(name, curves, arguments.seeds, minutes, path, arguments.jax_sysid)


if __name__ == "__main__":
    main()

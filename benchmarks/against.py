"""How the error falls inside one command: `splitband compare`, beside jax-sysid and tsfast.

    python -m benchmarks.against [--sets tanks silverbox Wiener-Hammerstein]
        [--seconds 10 20 40 80 120] [--seeds 3] [--jax-sysid PYTHON]

Of `splitband compare` all of the command counts, in seconds of wall time on two quiet cores, from
Python's start on: the model that lies in OUT at a time simulates the test files. Of the others the
training alone counts, in CPU seconds of one thread, so that other work on the machine matters
little. All train on the whole training file; the first samples of a test file are known, and
nothing is chosen by it.

tsfast lets its rate fall at the end, and is trained anew for each time; jax-sysid is trained once
and looked at on its way. tsfast comes with the extra `bench`. jax-sysid needs older versions of jax
and SciPy, and so an environment of its own, whose Python is an option here:

    python -m venv peer && peer/bin/pip install jax-sysid==1.1.0

Their settings stand in `benchmarks/jax_peer.py` and here. What is there already is not computed
again, and what is not installed is left out; `python -m benchmarks.page` makes the page.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Iterator, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

import splitband as sb
from benchmarks import claims
from benchmarks.commands import RECORDS
from benchmarks.driven import drawn
from benchmarks.peers import installed
from benchmarks.sets import SETS, load
from splitband import Record
from splitband.forecasters.held_out import after
from splitband.report.environment import environment
from splitband.runtime.files import write_json
from splitband.runtime.threads import use_one_thread

SPLITBAND, TSFAST, JAX_SYSID = "splitband", "tsfast", "jax-sysid"
LIBRARIES = SPLITBAND, JAX_SYSID, TSFAST
DRAWN = "Wiener-Hammerstein"
SAMPLES = 20_000
KNOWN = 50
"""Samples at the beginning of a test file that are known, and do not count."""
TABLE = {"silverbox": "BenchmarkSilverbox_Simulation", "tanks": "BenchmarkCascadedTanks_Simulation"}
"""Where tsfast keeps windows and batches for a benchmark; the drawn record has Silverbox's."""
STEPS, TIMED_STEPS = 300, 40
"""Of tsfast: of an epoch, its default, and by which it is reckoned how many fit into a time."""

Point = dict[str, Any]
"""One library after some time: its name, version, seed, seconds, errors on the tests."""


def records(name: str) -> list[Record]:
    """Return the training record and the test records."""
    if name == DRAWN:
        return drawn(DRAWN, 1000, SAMPLES)
    return [load(file) for file in (SETS[name].training, *SETS[name].tests)]


def _point(library: str, seed: int, seconds: float, errors: Iterable[float], **facts: Any) -> Point:
    point: Point = {"library": library, "version": version(library), "seed": seed}
    return point | {"seconds": round(seconds, 1), **facts, "test_rmse": [*errors]}


def _error(model: sb.Forecaster, test: Record) -> float:
    said = model.predict(**after(test, KNOWN), other_record=True)
    return sb.rmse(test.y[KNOWN:], said.y)


def ours(name: str, seed: int, longest: float) -> Iterator[Point]:
    """Run the command, and yield a point for each model that it leaves in OUT."""
    _, *tests = records(name)
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        out, words = folder / "out", RECORDS[name](folder)
        options = ["--budget", f"{longest:g}s", "--seed", str(seed), "--out", str(out)]
        copies: list[tuple[float, Path]] = []
        began, seen = time.perf_counter(), 0.0
        with subprocess.Popen(
            [sys.executable, "-m", "splitband", "--quiet", "compare", *words, *options]
        ) as process:
            while process.poll() is None:
                time.sleep(0.1)
                seconds = time.perf_counter() - began
                try:
                    at = (out / "results.json").stat().st_mtime
                    if at != seen:
                        copy = folder / f"model{len(copies)}"
                        shutil.copytree(out / "model", copy)
                        copies.append((seconds, copy))
                        seen = at
                except OSError:  # it is just being replaced
                    continue
        copies.append((time.perf_counter() - began, out / "model"))
        for seconds, copy in copies:
            model = sb.load(copy)
            errors = [_error(model, test) for test in tests]
            yield _point(SPLITBAND, seed, seconds, errors, recommended=model.name)


def jax_sysids(name: str, seed: int, seconds: Iterable[float], python: str) -> Iterator[Point]:
    """Train jax-sysid's model once, in its own environment, looked at on its way."""
    peer = Path(__file__).with_name("jax_peer.py")
    clean = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    with tempfile.TemporaryDirectory() as temporary:
        files = []
        for i, record in enumerate(records(name)):
            assert record.u is not None
            files.append(Path(temporary) / f"{i}.npy")
            np.save(files[-1], np.column_stack([record.u, record.y]))
        command = [python, str(peer), name, *map(str, files), "--seed", str(seed), "--seconds"]
        command += map(str, seconds)
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=clean) as process:
            assert process.stdout is not None
            for line in process.stdout:
                if line.startswith("{"):  # it prints other things, too
                    yield json.loads(line)
    if process.returncode:
        raise RuntimeError(f"{peer.name} ended with status {process.returncode}")


def tsfasts(name: str, seed: int, seconds: float) -> Point:
    """Train tsfast's GRU with its own defaults for about so long."""
    import torch  # noqa: PLC0415
    from tsfast.training import RNNLearner  # noqa: PLC0415
    from tsfast.tsdata import create_dls  # noqa: PLC0415
    from tsfast.tsdata.benchmark import BENCHMARK_DL_KWARGS  # noqa: PLC0415

    record, *tests = records(name)
    sizes = BENCHMARK_DL_KWARGS[TABLE.get(name, TABLE["silverbox"])]
    with tempfile.TemporaryDirectory() as folder:
        # It asks for something to validate on, too, but only shows the error on it.
        whole, part = Path(folder) / "train.hdf5", Path(folder) / "valid.hdf5"
        _write(record, whole)
        _write(record[-(len(record) // 4) :], part)
        files = {"train": [whole], "valid": [part], "test": []}

        def learner(steps: int) -> Any:
            torch.manual_seed(seed)
            dls = create_dls(["u"], ["y"], files, n_batches_train=steps, cache=True, **sizes)
            return RNNLearner(dls, n_skip=KNOWN, show_bar=False)

        timed = learner(TIMED_STEPS)
        timed.fit_flat_cos(1)  # the first one is slower
        began = time.process_time()
        timed.fit_flat_cos(1)
        steps = round(seconds * TIMED_STEPS / (time.process_time() - began))
        epochs = max(1, round(steps / STEPS))
        training = learner(steps // epochs)
        began = time.process_time()
        training.fit_flat_cos(epochs)
        took = time.process_time() - began
    errors = []
    for test in tests:
        u = torch.tensor(test.u, dtype=torch.float32)[None]
        with torch.no_grad():
            said = training.model.eval()(u)[0, KNOWN:].double().numpy()
        errors.append(sb.rmse(test.y[KNOWN:], said))
    return _point(TSFAST, seed, took, errors, asked=seconds, steps=epochs * (steps // epochs))


def _write(record: Record, path: Path) -> None:
    """As tsfast reads records: a column each."""
    import h5py  # noqa: PLC0415

    assert record.u is not None
    with h5py.File(path, "w") as file:
        file["u"], file["y"] = (x[:, 0].astype("float32") for x in (record.u, record.y))


def complete(
    name: str, libraries: Iterable[str], seeds: int, seconds: list[float], path: Path, peer: str
) -> None:
    """Measure what the file lacks, or has of older code, and write each to it."""

    def keep(new: Sequence[Point], instead_of: Sequence[Point] = ()) -> None:
        kept = [point for point in points(path) if point not in instead_of]
        write_json(path, {"environment": environment(), "points": [*kept, *new]})
        print(name, *new, sep="\n", flush=True)

    for library in libraries:
        for seed in range(seeds):
            there = [p for p in points(path) if (p["library"], p["seed"]) == (library, seed)]
            if library == TSFAST:
                for each in {*seconds} - {p["asked"] for p in there}:
                    keep([tsfasts(name, seed, each)])
            elif library == JAX_SYSID and not there:
                keep([*jax_sysids(name, seed, seconds, peer)])
            elif library == SPLITBAND and not (there and all(map(claims.current, there))):
                run = {"record": name, "commit": environment()["commit"]}
                about = claims.marked(run, claims.reference())
                keep([point | about for point in ours(name, seed, max(seconds))], there)


def path_of(out: Path, name: str) -> Path:
    """Return the file of a benchmark's points."""
    return out / f"against-{name}.json"


def points(path: Path) -> list[Point]:
    """Return what a file holds; points that do not say their commit are of that of the file."""
    found = json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"points": []}
    return [{"commit": found["environment"]["commit"]} | point for point in found["points"]]


def main() -> None:
    """Measure what is missing."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    names = [*TABLE, DRAWN]
    parser.add_argument("--sets", nargs="+", default=names, choices=names)
    parser.add_argument("--seconds", nargs="+", type=float, default=[10, 20, 40, 80, 120])
    parser.add_argument("--libraries", nargs="+", default=[*LIBRARIES], choices=LIBRARIES)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--jax-sysid", metavar="PYTHON", help="of an environment that has it")
    parser.add_argument("--out", type=Path, default=Path("docs/results/benchmarks"))
    given = parser.parse_args()
    use_one_thread()
    able = {SPLITBAND: True, TSFAST: installed(TSFAST), JAX_SYSID: given.jax_sysid is not None}
    for name in given.sets:
        libraries = [each for each in given.libraries if able[each]]
        path = path_of(given.out, name)
        complete(name, libraries, given.seeds, given.seconds, path, given.jax_sysid)


if __name__ == "__main__":
    main()

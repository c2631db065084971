"""Networks on a GPU: whether they learn the same as on the CPU, and how many at once make it pay.

    python -m benchmarks.gpu [--out docs/results/benchmarks/gpu.json] [--device cuda]

A rollout is a chain of small products. On the CPU it is one call of a compiled kernel; on a GPU it
is the plain loop, which starts some kernels for every sample, with one row to compute or with
thousands. Many trainings at once are measured as one whose batches have that many times the rows.
With weights of their own they would take longer: the number from which a GPU pays is a lower bound.
On the CPU, so many trainings take as long as one on one thread, times their number, shared by the
cores. It takes about five minutes, of which two compile kernels where there are none yet.

`--device cpu` compares the CPU with itself, to rehearse the script: all differences are zero.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import torch

import splitband as sb
from benchmarks.rollout import training_step
from benchmarks.timing import circumstances, medians, threads, write
from splitband.comparison.methods import BASED, GREY_BOX, TRAINED, Sizes, named
from splitband.forecasters.bands import Bands
from splitband.forecasters.network import Network, with_defaults
from splitband.networks import GRU, rollout
from splitband.runtime.arguments import check_device
from splitband.runtime.errors import InputError
from splitband.training import TrainingSettings, fit

SAMPLES, TRAIN = 400, 300
SETTINGS, BANDS = TrainingSettings.paper(60, 15, epochs=3, batch_size=16), Bands(0.3, 1, 2)
SIZES = Sizes(hidden_high=16, hidden_low=8)
_LEARNED = [name for name in TRAINED if name not in BASED and GREY_BOX not in name]
METHODS = [name for name in _LEARNED if "calibrated" not in name]
"""Every cell, hybrid and split model, each also conditioned."""
SAME = 1e-6
"""Largest relative difference of losses in float64 that counts as rounding."""
HIDDEN, BATCH, WARMUP, STEPS = 64, 25, 50, 100
TRAININGS, REHEARSED = (1, 4, 16, 64, 256, 1024), (1, 4)
"""Trainings at once on a GPU, and in a rehearsal on the CPU."""
REPEATS = 5


def record() -> sb.Record:
    """A driven system with a fast oscillation, and a simulator of its slow part."""
    t = 0.1 * np.arange(SAMPLES)
    u = np.sign(np.sin(0.31 * t))
    slow = np.convolve(u, 0.05 * 0.95 ** np.arange(120))[:SAMPLES]
    noise = 0.01 * np.random.default_rng(0).standard_normal(SAMPLES)
    y = slow + 0.2 * np.sin(5.1 * t) + noise
    return sb.Record(y[:, None], 0.1, u=u[:, None], y_sim=0.9 * slow[:, None])


def losses(name: str, device: str) -> list[float]:
    """The loss of each epoch of each network, trained in float64."""
    network, training = with_defaults(named(name, SIZES), SETTINGS, BANDS), record()[:TRAIN]
    assert isinstance(network, Network)
    model = network._built(training, SETTINGS, seed=0).double().to(device)
    history = fit(model, training, SETTINGS)
    return [loss for of_network in history.losses.values() for loss in of_network]


def difference(name: str, device: str) -> float:
    """The largest relative difference of a loss from the CPU's."""
    ours, theirs = (np.array(losses(name, each)) for each in ("cpu", device))
    return float(np.abs(theirs / ours - 1).max())


def compared(device: str) -> dict[str, float]:
    """The error of a GRU after one round of `compare`, and the seconds that it took."""
    began = time.perf_counter()
    result = sb.compare(
        record(), TRAIN, ["gru", "mean"], rounds=1, seeds=1, sizes=SIZES, device=device
    )
    error = result.errors(result.medians["gru"]).forecast
    return {"forecast RMSE": error, "seconds": time.perf_counter() - began}


def step_seconds(device: str, trainings: int) -> float:
    """The median time of a training step of so many trainings at once."""
    y = torch.randn(trainings * BATCH, WARMUP + STEPS, 1, device=device)
    cell = GRU(HIDDEN).to(device)
    step = training_step(
        lambda: rollout(cell, y[:, :WARMUP], STEPS), y[:, WARMUP:], cell.parameters()
    )

    def finished() -> None:
        step()
        if device != "cpu":
            torch.cuda.synchronize(device)

    return medians({"step": finished}, REPEATS)["step"]


def pays_from(on_gpu: Mapping[int, float], alone: float, cores: int) -> int | None:
    """The smallest number of trainings that take less time than on so many cores; None without."""
    return next((n for n, took in on_gpu.items() if took < n * alone / cores), None)


def side_by_side(device: str) -> dict[str, object]:
    """Print and return the times of a step, and from how many trainings on the GPU pays."""
    cores = os.cpu_count() or 1
    with threads(1):
        alone = step_seconds("cpu", 1)
    on_gpu: dict[int, float] = {}
    for n in REHEARSED if device == "cpu" else TRAININGS:
        try:
            on_gpu[n] = step_seconds(device, n)
        except torch.cuda.OutOfMemoryError:
            print(f"{n:5d} trainings: they do not fit into the memory of {device}")
            break
        print(
            f"{n:5d} trainings at once: {device} {1e3 * on_gpu[n]:8.1f} ms; CPU "
            f"{1e3 * n * alone:8.1f} ms on one core, {1e3 * n * alone / cores:8.1f} ms on {cores}"
        )
    figures: dict[str, object] = {"one training on one core, s": alone, f"on {device}, s": on_gpu}
    for count in (1, cores):
        first = pays_from(on_gpu, alone, count)
        said = "never" if first is None else f"from {first} trainings on"
        print(f"against {count} core(s) {device} pays {said}")
        figures[f"{device} pays against {count} cores from"] = first
    return figures


def main() -> None:
    """Print and, if asked to, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    parser.add_argument("--device", default="cuda", help="of torch, such as cuda or cuda:1")
    given = parser.parse_args()
    try:
        check_device(given.device)
    except InputError as error:
        parser.error(str(error))
    figures = circumstances("torch", "numba", "numpy")
    figures["device"] = "cpu" if given.device == "cpu" else torch.cuda.get_device_name(given.device)
    print(figures)
    figures["side by side"] = side_by_side(given.device)
    write(figures, given.out)  # so far, should the time be over before the rest
    found: dict[str, float] = {}
    figures["difference of losses"] = found
    for name in METHODS:
        found[name] = difference(name, given.device)
        print(f"{name:36s} {found[name]:.1e} {'same' if found[name] < SAME else 'DIFFERENT'}")
    rounds = {device: compared(device) for device in dict.fromkeys(("cpu", given.device))}
    figures["one round of compare"] = rounds
    print(rounds)
    write(figures, given.out)


if __name__ == "__main__":
    main()

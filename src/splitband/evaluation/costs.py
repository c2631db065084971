"""Estimate the cost of a training in seconds of a reference core, and this machine's speed.

The reference core is a notional core, for which the constants below hold: costs are the same on
every machine.
"""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from functools import cache

import torch

from splitband.data import Record
from splitband.forecasters.backtest import Question
from splitband.forecasters.base import Forecaster
from splitband.forecasters.network import Network
from splitband.networks import GRU, rollout
from splitband.runtime.threads import one_thread
from splitband.training.quasi_newton import samples_in_a_step

FOR_TRAINING = 0.4
"""Share of a wall-time budget that is planned for training networks. The rest is for other work,
and for trainings that take longer than estimated. By eye, checked with `python -m
benchmarks.budget`."""
STARTING = 8.0
"""Seconds of it that are reserved for starting the command and writing its results. By eye, checked
likewise."""
REFERENCE_SIZE, REFERENCE_BATCH, REFERENCE_STEPS = 32, 25, 400
"""Hidden units, windows and samples of the gradient whose run time measures a machine's speed.
By eye."""
SAMPLE, WEIGHT = 0.09e-6, 0.25e-9
"""Seconds of a reference core per sample (forward and backward pass), and per sample and weight."""
GRADIENT = 4e-3
"""Fixed overhead of each gradient, in seconds of a reference core."""
QUICK = 0.5
"""Seconds of a reference core for a closed-form fit, for progress bars. By eye."""
EVALUATIONS = 1.2
"""Gradients per iteration of L-BFGS."""


def reference_seconds(wall: float, cores: int) -> float:
    """Return the work to plan for a wall time on so many cores, in seconds of a reference core.

    The measured speed is rounded to a power of the square root of two, so that the same machine
    mostly plans the same work. The plan ends well before the time is over, so that results do not
    depend on the clock unless the machine is busy. `STARTING` takes at most half of a short wall
    time.
    """
    rounded = 2 ** (round(2 * math.log2(speed())) / 2)
    return FOR_TRAINING * max(wall - STARTING, wall / 2) * cores * rounded


@cache
def speed() -> float:
    """Measure the speed of a core of this machine on a gradient; the reference core has 1."""
    network = GRU(REFERENCE_SIZE)
    y = torch.zeros(REFERENCE_BATCH, REFERENCE_STEPS, 1)
    took = []
    with one_thread():
        for _ in range(4):  # the first call may compile
            began = time.perf_counter()
            rollout(network, y[:, :1], REFERENCE_STEPS - 1).sum().backward()
            took.append(time.perf_counter() - began)
    weights = sum(weight.numel() for weight in network.parameters())
    usual = GRADIENT + (SAMPLE + WEIGHT * weights) * REFERENCE_BATCH * REFERENCE_STEPS
    return usual / min(took)


def job_cost(forecaster: Forecaster, question: Question) -> float:
    """Estimate the cost of the fits that these forecasts need, in seconds of a reference core."""
    samples = max(origin.fitted for origin in question.origins)
    network = forecaster.of_one_seed.network
    if network is None or network.settings is None:
        return QUICK * len({origin.fitted for origin in question.origins})
    try:
        each = training_cost(network, question.record[:samples], question.others)
        return len(forecaster.seeds) * each
    except ValueError:  # it cannot be built for such a record; its fit reports why, at no cost
        return 0.0


def training_cost(network: Network, record: Record, others: Sequence[Record]) -> float:
    """Estimate the cost of a training, including that of its base, in seconds of a reference core.

    A base counts only if it is a network.
    """
    base = None if network.base is None else network.base.network
    below = 0.0 if base is None else training_cost(base, record, others)
    assert network.settings is not None
    seed = next(iter(network.earlier.weights), 0)
    settings = network.earlier.remaining(network.settings, seed)
    samples = len(record) + sum(map(len, others))
    batches = settings.batches_of(samples)
    adam = settings.epochs * batches * settings.batch_size * settings.window
    gradients = EVALUATIONS * (settings.quasi_newton or 0)
    in_all = gradients * samples_in_a_step(samples, settings.window, settings.warmup)
    of_samples = (SAMPLE + WEIGHT * network.weights(record)) * (adam + in_all)
    return (
        below + of_samples + GRADIENT * (settings.epochs * batches + gradients) * len(network.cells)
    )

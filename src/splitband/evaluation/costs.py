"""Estimate what a training costs, in seconds of a reference core, and what these take here."""

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

FOR_TRAINING, STARTING = 0.4, 8.0
"""Share of a budget of wall time that is planned for networks, and the seconds of it in which the
command begins and writes its results. The rest is for all other work, and for what trainings take
longer than estimated. By eye, held against `python -m benchmarks.budget`."""
REFERENCE_SIZE, REFERENCE_BATCH, REFERENCE_STEPS = 32, 25, 400
"""Hidden units, windows and samples of the gradient by which a machine's speed is measured.
By eye."""
SAMPLE, WEIGHT = 0.09e-6, 0.25e-9
"""Seconds of a reference core for a sample, forwards and backwards, and as much more per weight."""
GRADIENT = 4e-3
"""Seconds of a reference core for each gradient besides that, however small it is."""
QUICK = 0.5
"""Seconds of a reference core for a fit in closed form, for progress bars. By eye."""
EVALUATIONS = 1.2
"""Gradients to an iteration of L-BFGS."""


def reference_seconds(wall: float, cores: int) -> float:
    """Return the work that is planned for a wall time on so many cores, in s of a reference core.

    The speed of a core is rounded to half a power of two, so that the same machine mostly gives the
    same answer. It is as much as is done well before the time is over, so that the work and not the
    clock decides what is tried, unless the machine is busy.
    """
    rounded = 2 ** (round(2 * math.log2(speed())) / 2)
    return FOR_TRAINING * max(wall - STARTING, wall / 2) * cores * rounded


@cache
def speed() -> float:
    """Return how fast a core of this machine is, by the time of a gradient; the reference is 1."""
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
    """Return the seconds of a reference core to fit a forecaster and ask it, roughly."""
    samples = max(origin.fitted for origin in question.origins)
    network = forecaster.of_one_seed.network
    if network is None or network.settings is None:
        return QUICK * len({origin.fitted for origin in question.origins})
    try:
        each = training_cost(network, question.record[:samples], question.others)
        return len(forecaster.seeds) * each
    except ValueError:  # it cannot be built for such a record: its fit says why, at no cost
        return 0.0


def training_cost(network: Network, record: Record, others: Sequence[Record]) -> float:
    """Return the seconds of a reference core of a training, and of that of a network below."""
    base = None if network.base is None else network.base.network
    below = 0.0 if base is None else training_cost(base, record, others)
    assert network.settings is not None
    going_on = next(iter(network.earlier.weights), 0)
    settings = network.earlier.remaining(network.settings, going_on)
    samples = len(record) + sum(map(len, others))
    batches = settings.batches_of(samples)
    adam = settings.epochs * batches * settings.batch_size * settings.window
    gradients = EVALUATIONS * (settings.quasi_newton or 0)
    in_all = gradients * samples_in_a_step(samples, settings.window, settings.warmup)
    of_samples = (SAMPLE + WEIGHT * network.weights(record)) * (adam + in_all)
    return (
        below + of_samples + GRADIENT * (settings.epochs * batches + gradients) * len(network.cells)
    )

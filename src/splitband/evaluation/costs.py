"""What a training costs, in seconds of a reference core, and what a wall time is in these."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

import torch

from splitband.data import Trajectory
from splitband.forecasters.network import Network
from splitband.networks import GRU, rollout
from splitband.runtime.threads import one_thread
from splitband.training.quasi_newton import samples_in_a_step

FOR_TRAINING = 0.8
"""Share of a budget of wall time that goes into networks; the rest is for all other work."""
REFERENCE_SIZE, REFERENCE_BATCH, REFERENCE_STEPS = 32, 25, 400
"""Hidden units, windows and samples of the gradient by which a machine's speed is measured."""
SAMPLE, WEIGHT = 0.09e-6, 0.25e-9
"""Seconds of a reference core for a sample, forwards and backwards, and as much more per weight."""
GRADIENT = 4e-3
"""Seconds of a reference core for each gradient besides that, however small it is."""
EVALUATIONS = 1.2
"""Gradients to an iteration of L-BFGS."""


def reference_seconds(wall: float, cores: int) -> float:
    """What a wall time on so many cores of this machine is in seconds of a reference core.

    A small network's gradient is timed for it. The factor is rounded to half a power of two, so
    that the same machine mostly gives the same answer.
    """
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
    speed = 2 ** (round(2 * math.log2(usual / min(took))) / 2)
    return FOR_TRAINING * wall * cores * speed


def training_cost(network: Network, record: Trajectory, others: Sequence[Trajectory]) -> float:
    """Seconds of a reference core that a training takes, roughly; with that of a network below."""
    base = getattr(network, "base", None)
    below = training_cost(base, record, others) if isinstance(base, Network) else 0.0
    settings = network.settings
    assert settings is not None
    samples = len(record) + sum(map(len, others))
    batches = settings.batches_of(samples)
    adam = settings.epochs * batches * settings.batch_size * settings.window
    gradients = EVALUATIONS * (settings.quasi_newton or 0)
    in_all = gradients * samples_in_a_step(samples, settings.window, settings.warmup)
    of_samples = (SAMPLE + WEIGHT * network.weights(record)) * (adam + in_all)
    return (
        below + of_samples + GRADIENT * (settings.epochs * batches + gradients) * len(network.cells)
    )

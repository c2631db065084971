"""Simulations that begin with fewer samples than a network warms up on."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy

import splitband as sb
from splitband.forecasters.prehistory import Prehistory
from splitband.runtime.arrays import Array

B, A = [0.0, 0.2], [1.0, -1.6, 0.8]
"""A resonance: a deviation of its state from that at rest swings for some forty samples."""
WARMUP, FEW = 20, 3


def output(samples: int, seed: int) -> sb.Record:
    u = np.random.default_rng(seed).standard_normal(samples)
    return sb.Record(scipy.signal.lfilter(B, A, u), 0.1, u=u, inputs=("u",), columns=("y",))


@pytest.fixture(scope="module")
def network() -> sb.Forecaster:
    settings = sb.TrainingSettings.paper(warmup=WARMUP, window=60, epochs=0, lbfgs_iterations=20)
    return sb.Single(sb.StateSpace(2, 2), settings).fit(output(400, 1), seed=0)


def simulated(network: sb.Forecaster, test: Any, first: int) -> Array:
    """The 60 samples after the 40th, from what is known since the first."""
    y_sim = None if test.y_sim is None else test.y_sim[40:100]
    with pytest.warns(sb.ExtrapolationWarning, match=f"the history has {FEW} of the {WARMUP}"):
        found = network.predict(60, test[first:40], test.u[40:100], y_sim, other_record=True)
    return found.y


def test_a_few_samples_tell_the_state_of_a_system_that_is_not_at_rest(
    network: sb.Forecaster,
) -> None:
    test: Any = output(100, 2)
    left = simulated(network, test, 40 - FEW)[:, 0] - test.y[40:, 0]
    assert np.sqrt(np.mean(left**2)) < 0.02 * test.y.std()


def test_hybrids_tell_it_from_a_few_samples_too(tmp_path: Path) -> None:
    def driven(samples: int, seed: int) -> sb.Record:
        record = output(samples, seed)
        slow = np.sin(0.05 * np.arange(samples) + seed)[:, None]
        return sb.Record(record.y + slow, 0.1, u=record.u, y_sim=slow)

    settings = sb.TrainingSettings.paper(warmup=WARMUP, window=60, epochs=0, lbfgs_iterations=20)
    hybrid = sb.Residual(None, sb.StateSpace(2, 2), settings=settings)
    hybrid.fit(driven(400, 1), seed=0).save(tmp_path / "model")
    test = driven(100, 2)
    for network in (hybrid, sb.load(tmp_path / "model")):
        left = simulated(network, test, 40 - FEW)[:, 0] - test.y[40:, 0]
        assert np.sqrt(np.mean(left**2)) < 0.02 * test.y.std()


def test_a_network_beside_a_network_begins_with_a_few_samples() -> None:
    settings = sb.TrainingSettings.paper(warmup=WARMUP, window=60, epochs=0, lbfgs_iterations=20)
    inner = sb.Single(sb.StateSpace(2, 2), settings)
    hybrid = sb.Residual(inner, sb.GRU(2), settings=settings).fit(output(400, 1), seed=0)
    test: Any = output(100, 2)
    left = simulated(hybrid, test, 40 - FEW) - test.y[40:]
    known = hybrid.predict(60, test[:40], u=test.u[40:], other_record=True).y - test.y[40:]
    assert np.sqrt(np.mean(left**2)) < 2 * np.sqrt(np.mean(known**2))


def test_what_a_file_brings_must_fit(network: sb.Forecaster, tmp_path: Path) -> None:
    forged = network.clone().fit(output(400, 1), seed=0)
    vars(forged)["_prehistory"] = Prehistory(np.zeros((5, 2)), np.zeros((3, 5, 2)), 0.1)
    forged.save(tmp_path / "model")
    with pytest.raises(
        ValueError, match=r"mean of the prehistory must have .*20, 2\), got \(5, 2\)"
    ):
        sb.load(tmp_path / "model")

"""Simulations as torch modules: batches, gradients and the numbers of `predict`."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
import scipy
import torch

import splitband as sb
from splitband.runtime.threads import without_warnings

DT, TRAIN, STEPS = 0.1, 300, 25
SETTINGS = sb.Settings(warmup=20, window=60, epochs=0, quasi_newton=4)
BANDS = sb.Bands(0.5, 1, 2)


def driven(samples: int = 400) -> sb.Record:
    """Two inputs, one of which acts 12 samples late, and a slow oscillation that is simulated."""
    rng = np.random.default_rng(0)
    u = scipy.signal.lfilter([0.3], [1, -0.7], rng.standard_normal((samples, 2)), axis=0)
    late = np.vstack([np.zeros((12, 2)), u[:-12]])
    y = scipy.signal.lfilter([0.2], [1.0, -1.5, 0.7], late[:, 0]) + np.tanh(u[:, 1])
    slow = np.sin(0.05 * np.arange(samples))
    return sb.Record(y + slow, DT, u=u, y_sim=slow)


MODELS: dict[str, Callable[[], sb.Forecaster]] = {
    "linear": sb.Linear,
    "persistence": sb.Persistence,
    "state-space": lambda: sb.Single(sb.StateSpace(3, 4), SETTINGS),
    "median": lambda: sb.Ensemble([*(sb.Single(sb.GRU(n), SETTINGS) for n in (3, 2)), sb.Linear()]),
    "split": lambda: sb.Split(sb.GRU(3), sb.GRU(3), BANDS, settings=SETTINGS),
    "filtered": lambda: sb.Filtered(None, sb.GRU(3), BANDS, conditioned=True, settings=SETTINGS),
    "filtered high": lambda: sb.Filtered(
        None, sb.GRU(3), BANDS, conditioned=True, settings=SETTINGS, simulator_band="high"
    ),
    "residual": lambda: sb.Residual(sb.Linear(), sb.GRU(3), settings=SETTINGS),
}


@cache
def fitted(name: str) -> sb.Forecaster:
    return MODELS[name]().fit(driven()[:TRAIN], seed=0)


@pytest.fixture(scope="module", params=MODELS)
def model(request: pytest.FixtureRequest) -> sb.Forecaster:
    return fitted(request.param)


def futures(batch: int) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(1).uniform(-1, 1, (batch, STEPS, 2)))


@pytest.mark.parametrize("history", [None, driven()[:310], driven()[290:303]])
def test_each_of_a_batch_is_what_predict_says(
    model: sb.Forecaster, history: sb.Record | None
) -> None:
    u = futures(3)
    found = model.as_torch(history)(u)
    assert found.shape == (3, STEPS, 1)
    for each, y in zip(u, found.detach().numpy(), strict=True):
        with without_warnings(sb.ExtrapolationWarning):
            expected = model.predict(STEPS, history, u=each.numpy()).y
        np.testing.assert_allclose(y, expected, atol=2e-5)


def test_gradients_are_those_of_finite_differences(model: sb.Forecaster) -> None:
    simulate = model.as_torch().double()
    u = futures(1)[0].requires_grad_()
    weights = torch.linspace(-1, 1, STEPS, dtype=torch.float64)[:, None]
    (slope,) = torch.autograd.grad((weights * simulate(u)).sum(), u)
    direction = torch.from_numpy(np.random.default_rng(2).standard_normal((STEPS, 2)))
    with torch.no_grad():
        ends = [(weights * simulate(u + h * direction)).sum() for h in (1e-5, -1e-5)]
    np.testing.assert_allclose((slope * direction).sum(), (ends[0] - ends[1]) / 2e-5, rtol=1e-5)


def test_what_cannot_be_differentiated_says_so() -> None:
    record = driven()[:TRAIN]
    with pytest.raises(ValueError, match=r"u must be \(steps, 2\) or \(batch, steps, 2\), got"):
        fitted("linear").as_torch()(torch.zeros(5, 3))
    nested = sb.Residual(sb.Single(sb.GRU(2), SETTINGS), sb.GRU(2), settings=SETTINGS)
    with pytest.raises(ValueError, match="cannot be run by torch: its base, gru, is not affine"):
        nested.fit(record, seed=0).as_torch()
    with pytest.raises(ValueError, match="history must go on from the training record for harmon"):
        sb.Harmonic().fit(record).as_torch(record[:50], other_record=True)
    simulator = sb.Simulation().fit(record).as_torch(driven()[:390])
    with pytest.raises(ValueError, match=r"y_sim must hold the 25 samples to predict"):
        simulator(futures(1))
    with pytest.raises(ValueError, match="fitted to a record as it was measured"):
        sb.Persistence().fit(record.detrend()).as_torch()

"""A simulator in the high band, and a network on the down-sampled low band."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor

from splitband import ComplementaryPair
from splitband.filters import butterworth
from splitband.models import FilteredHighModel, Signals
from tests.support import Scripted

WARMUP, STEPS, RATE, CUTOFF = 20, 300, 20.0, 0.5
TIME = torch.arange(WARMUP + STEPS, dtype=torch.float64)[None, :, None]
Y = torch.sin(TIME / 40) + 0.3 * torch.sin(2 * TIME)
SILENCE = torch.zeros(WARMUP + STEPS, 1, dtype=torch.float64)


def model(script: Tensor, order: int = 1, k: int = 1, told: bool = False) -> FilteredHighModel:
    """With a network that says `script`."""
    pair = ComplementaryPair.perfect(*butterworth(CUTOFF, RATE, order, "high"), RATE, "high")
    return FilteredHighModel(Scripted(script, 0, 2 * told), pair, k, told).double()


def total(hybrid: FilteredHighModel, y_sim: Tensor) -> Tensor:
    low, high = hybrid.components(Signals(Y[:, :WARMUP], y_sim=y_sim), STEPS).values()
    return (low + high)[0].detach()


@pytest.mark.parametrize("order", [1, 2, 3])
def test_a_right_simulator_and_the_low_band_give_the_signal(order: int) -> None:
    """From the first sample on, however short the warm-up; an offset changes nothing."""
    low = model(SILENCE, order).pair.lowpass(Y)[0, WARMUP:]
    found = total(model(low, order), Y + 7.0)
    torch.testing.assert_close(found, Y[0, WARMUP:], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("order", "power"), [(1, 0), (2, 1), (3, 2)])
def test_a_drift_of_a_power_below_the_order_vanishes(order: int, power: int) -> None:
    drift, hybrid = 0.01 * TIME**power, model(SILENCE, order)
    moved = (total(hybrid, Y + drift) - total(hybrid, Y)).abs()
    assert moved[-50:].max() < 1e-3 * drift.max()


def test_a_ramp_leaves_its_slope_over_the_cut_off_behind_a_filter_of_order_1() -> None:
    slope, hybrid = 0.01, model(SILENCE)
    moved = total(hybrid, Y + slope * TIME) - total(hybrid, Y)
    assert moved[-1].item() == pytest.approx(slope * RATE / (2 * np.pi * CUTOFF), rel=0.05)


@pytest.mark.parametrize("k", [2, 3, 7])
def test_a_conditioned_network_is_given_means_of_value_and_slope_of_the_high_band(k: int) -> None:
    hybrid = model(SILENCE, k=k, told=True)
    hybrid.slope_scale.fill_(0.25)
    total(hybrid, Y)
    high = hybrid.pair.highpass(Y)[0, :, 0].numpy()
    slope = np.diff(high, prepend=high[0])
    slope[0] = slope[1]
    at = np.arange(WARMUP % k, len(high), k)
    rows = np.maximum(at[:, None] - np.arange(k), 0)  # before the record, its first row
    expected = np.stack([high[rows].mean(axis=1), slope[rows].mean(axis=1) / 0.25], axis=1)
    found = torch.cat(hybrid.cell.inputs).numpy()  # type: ignore[attr-defined]
    np.testing.assert_allclose(found, expected[: len(found)], rtol=0, atol=1e-12)
    assert len(found) > WARMUP // k


def test_windows_are_trained_as_they_are_simulated() -> None:
    hybrid = model(SILENCE, k=3, told=True)
    (task,) = hybrid.tasks(Signals(Y[0], y_sim=Y[0]))
    window = Signals(Y[:, :WARMUP], y_sim=0.9 * Y)
    low, high = hybrid.components(window, STEPS).values()
    assert torch.equal(task.simulate(window, STEPS), low + high)
    assert task.stride == 1

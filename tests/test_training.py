"""Training: windows, reproducibility, schedule, progress and what is refused."""

from typing import Any

import numpy as np
import pytest
import torch
from test_models import LENGTH, QUICK, SETUP, TRAIN, record

from splitband import GRU, History, Model, Progress, Recurrent, Settings, Trajectory, fit
from splitband.comparison import compare
from splitband.methods import build
from splitband.training import _windows


def parameters(model: Model) -> torch.Tensor:
    return torch.cat([p.detach().flatten() for p in model.parameters()])


def fitted(seed: int, method: str = "split-gru", **changes: Any) -> tuple[Model, History]:
    model = build(method, record(), SETUP, seed)
    settings = Settings(**{**vars(QUICK), "epochs": 3, **changes})
    history = fit(model, record()[:TRAIN], settings, seed)
    return model, history


def test_the_same_seed_gives_the_same_model_and_another_seed_another() -> None:
    first, again, other = (parameters(fitted(seed)[0]) for seed in (3, 3, 4))
    assert torch.equal(first, again)
    assert not torch.equal(first, other)


def test_a_seed_leaves_the_global_random_state_alone() -> None:
    before = torch.get_rng_state()
    fitted(5)
    assert torch.equal(torch.get_rng_state(), before)


@pytest.mark.parametrize("method", ["gru", "split-gru", "split-gru-hp", "filtered-gru"])
def test_training_reduces_the_loss(method: Any) -> None:
    _, history = fitted(0, method, epochs=30, learning_rate=2e-2)
    for losses in history.losses.values():
        assert len(losses) == 30
        assert losses[-1] < 0.8 * losses[0]


def test_windows_start_at_every_sample_and_are_views() -> None:
    model = build("split-gru", record(), SETUP, seed=0)
    low, high = model.tasks(model.normalised(record()[:TRAIN]))
    known, target = _windows(high, QUICK)
    assert len(target) == TRAIN - QUICK.window + 1
    assert known.y.shape[1:] == (QUICK.warmup, 1)
    assert target.shape[1:] == (QUICK.window - QUICK.warmup, 1)
    assert known.y.data_ptr() == high.known.y.data_ptr()
    torch.testing.assert_close(target[7], high.target[7 + QUICK.warmup : 7 + QUICK.window])
    _, slow = _windows(low, QUICK)
    torch.testing.assert_close(slow[7], low.target[7 + QUICK.warmup : 7 + QUICK.window : 2])


def test_the_learning_rate_follows_its_milestones() -> None:
    """With the rate at next to nothing from epoch 1 on, later epochs change nothing."""
    still, _ = fitted(0, milestones=((1, 1e-30),))
    once, _ = fitted(0, epochs=1)
    assert torch.equal(parameters(still), parameters(once))
    moved, _ = fitted(0)
    assert not torch.equal(parameters(moved), parameters(once))


def test_progress_reports_every_epoch_of_every_network() -> None:
    seen: list[Progress] = []
    model = build("split-gru", record(), SETUP, seed=0)
    fit(model, record()[:TRAIN], Settings(**{**vars(QUICK), "epochs": 2}), progress=seen.append)
    assert [(p.task, p.epoch, p.epochs) for p in seen] == [
        (task, epoch, 2) for task in ("low band", "high band") for epoch in (1, 2)
    ]
    assert all(np.isfinite(p.loss) for p in seen)


def test_a_constant_channel_trains_without_nan() -> None:
    flat = Trajectory(np.full(60, 7.0), 0.1)
    model = Recurrent(GRU(1, 4))
    history = fit(model, flat, Settings(window=20, warmup=5, epochs=3))
    assert np.isfinite(history.losses["network"]).all()
    assert np.isfinite(model.simulate(flat.y[:5], 10)).all()


def test_diverging_training_says_so() -> None:
    cell = GRU(1, 4)
    model = Recurrent(cell)
    with torch.no_grad():
        cell.observation.weight.fill_(float("nan"))
    with pytest.raises(FloatingPointError, match="diverged in epoch 1: the loss is nan"):
        fit(model, record(), QUICK)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"window": 12}, "window must be longer than the warm-up of 12 samples, got 12"),
        ({"window": LENGTH + 1}, f"training record of {LENGTH} samples, got {LENGTH + 1}"),
        ({"warmup": 0}, "warmup must be at least 1, got 0"),
        ({"epochs": 0}, "epochs must be at least 1, got 0"),
        ({"batch_size": 0}, "batch_size must be at least 1, got 0"),
        ({"learning_rate": -1.0}, "learning rates must be positive, got -1.0"),
        ({"milestones": ((3, 0.0),)}, "learning rates must be positive, got 0.0"),
    ],
)
def test_settings_that_cannot_be_are_refused(change: Any, message: Any) -> None:
    with pytest.raises(ValueError, match=message):
        fit(Recurrent(GRU(1, 4)), record(), Settings(**{**vars(QUICK), **change}))


def test_a_record_of_other_channels_is_refused() -> None:
    with pytest.raises(ValueError, match=r"model's 1 channel\(s\) and 0 input\(s\), got 2 and 1"):
        fit(Recurrent(GRU(1, 4)), record(2, 1), QUICK)


def test_comparing_in_processes_gives_the_numbers_of_comparing_in_one() -> None:
    methods = ["gru", "filtered-gru", "harmonic"]
    alone, together = (
        compare(record(), methods, SETUP, seeds=(0, 1), jobs=jobs) for jobs in (1, 2)
    )
    for method in methods:
        for a, b in zip(alone[method], together[method], strict=True):
            assert a.seed == b.seed
            # Not to the bit: torch rounds some sums by where in memory their terms lie.
            assert a.total_rmse == pytest.approx(b.total_rmse, rel=1e-6)
            np.testing.assert_allclose(a.forecast, b.forecast, rtol=1e-5, atol=1e-6)

"""Training: windows, reproducibility, schedule, progress and what is refused."""

from typing import Any

import numpy as np
import pytest
import torch

from splitband import GRU, Record, TrainingSettings
from splitband.models import Model, Recurrent
from splitband.training import History, Progress, fit
from tests.signals import LENGTH, QUICK, SETUP, TRAIN, record
from tests.support import Scripted, simulated, untrained
from tests.training.support import Watched, parameters, seen_by_adam


def fitted(seed: int, method: str = "split-gru", **changes: Any) -> tuple[Model, History]:
    model = untrained(method, record(), SETUP, seed)
    settings = TrainingSettings.paper(**{**vars(QUICK), "epochs": 3, **changes})
    history = fit(model, record()[:TRAIN], settings, seed)
    return model, history


def test_the_learning_rate_follows_its_milestones() -> None:
    """With the rate at next to nothing from epoch 1 on, later epochs change nothing."""
    still, _ = fitted(0, milestones=((1, 1e-30),))
    once, _ = fitted(0, epochs=1)
    assert torch.equal(parameters(still), parameters(once))
    moved, _ = fitted(0)
    assert not torch.equal(parameters(moved), parameters(once))


def test_the_one_cycle_rate_rises_in_a_straight_line_and_falls_as_torchs_cosine_does() -> None:
    schedule = TrainingSettings.paper(learning_rate=0.02, one_cycle=True)
    for share, tenths in ((0.0, 1.0), (0.025, 3.25), (0.05, 5.5), (0.1, 10.0), (1.0, 0.1)):
        assert schedule.rate(0, share) == pytest.approx(0.002 * tenths)
    optimizer = torch.optim.SGD([torch.zeros(1)], lr=0.02)
    torchs = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, T_max=90, eta_min=2e-4)
    for done in range(91):
        share = 0.1 + 0.9 * done / 90
        assert schedule.rate(0, share) == pytest.approx(torchs.get_last_lr()[0])
        optimizer.step()
        torchs.step()


def test_clipping_is_that_of_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    """On one step over all windows, whose gradient is the same with and without."""
    seen = seen_by_adam(monkeypatch, lambda group: [p.grad.clone() for p in group["params"]])
    for clip in (None, 1e-3, 1e6):
        fitted(0, "gru", epochs=1, batch_size=1000, clip=clip)
    whole, clipped, loose = seen
    assert torch.linalg.vector_norm(torch.cat([g.flatten() for g in whole])) > 1e-2
    by_hand = [torch.zeros_like(g) for g in whole]
    for p, gradient in zip(by_hand, whole, strict=True):
        p.grad = gradient.clone()
    torch.nn.utils.clip_grad_norm_(by_hand, 1e-3)
    for found, p, gradient, unchanged in zip(clipped, by_hand, whole, loose, strict=True):
        torch.testing.assert_close(found, p.grad, rtol=1e-5, atol=1e-12)
        torch.testing.assert_close(unchanged, gradient, rtol=1e-5, atol=1e-12)


@pytest.mark.parametrize(
    ("growth", "expected"),
    [
        (0.0, [30] * 10),
        (0.5, [3, 8, 14, 19, 25, 30, 30, 30, 30, 30]),
        (1.0, [3, 6, 8, 11, 14, 16, 19, 22, 25, 27]),
    ],
)
def test_the_free_run_grows_from_a_tenth_to_all_of_its_length(
    growth: float, expected: list[int]
) -> None:
    model = Watched()
    settings = TrainingSettings.paper(42, QUICK.warmup, 10, batch_size=1000, growth=growth)
    history = fit(model, record()[:TRAIN], settings)
    assert np.abs(np.array(model.asked) - expected).max() <= 1  # halves are rounded either way
    assert (model.asked[0], model.asked[-1]) == (expected[0], expected[-1])
    assert np.isfinite(history.losses["network"]).all()


@pytest.mark.parametrize("error", [0.0, 0.5])
def test_a_short_free_run_is_compared_with_the_beginning_of_the_window(error: float) -> None:
    """So that a network that knows the only window has no loss at any length."""
    script = torch.from_numpy(record().y[QUICK.warmup : 42] + error)
    model = Recurrent(Scripted(script, 0)).double()
    settings = TrainingSettings.paper(42, QUICK.warmup, 6, 1, 1e-30, growth=0.8, normalize=False)
    history = fit(model, record()[:42], settings)
    assert history.losses["network"] == pytest.approx([error] * 6, abs=1e-12)


def test_progress_reports_every_epoch_of_every_network() -> None:
    seen: list[Progress] = []
    model = untrained("split-gru", record(), SETUP, seed=0)
    fit(
        model,
        record()[:TRAIN],
        TrainingSettings.paper(**{**vars(QUICK), "epochs": 2}),
        progress=seen.append,
    )
    assert [(p.task, p.epoch, p.epochs) for p in seen] == [
        (task, epoch, 2) for task in ("low band", "high band") for epoch in (1, 2)
    ]
    assert all(np.isfinite(p.loss) for p in seen)


def test_a_constant_channel_trains_without_nan() -> None:
    flat = Record(np.full(60, 7.0), 0.1)
    model = Recurrent(GRU(4, 1))
    history = fit(model, flat, TrainingSettings.paper(window=20, warmup=5, epochs=3))
    assert np.isfinite(history.losses["network"]).all()
    assert np.isfinite(simulated(model, flat.y[:5], 10)).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"window": 12}, "window must be longer than the warm-up of 12 samples, got 12"),
        ({"window": LENGTH + 1}, f"training record of {LENGTH} samples, got {LENGTH + 1}"),
        ({"warmup": 0}, "warmup must be at least 1, got 0"),
        ({"epochs": 0}, "epochs must be positive without lbfgs_iterations, got 0"),
        ({"batch_size": 0}, "batch_size must be at least 1, got 0"),
        ({"milestones": ((3, 0.0),)}, "learning rates must be positive, got 0.0"),
        (
            {"milestones": ((3, 1e-4),), "one_cycle": True},
            r"milestones need one_cycle=False, got \(\(3, 0.0001\),\)",
        ),
        ({"clip": 0.0}, "clip must be positive, got 0.0"),
        ({"clip": float("nan")}, "clip must be positive, got nan"),
        ({"growth": -0.1}, "growth must be a share of the training, 0 to 1, got -0.1"),
    ],
)
def test_settings_that_cannot_be_are_refused(change: Any, message: Any) -> None:
    with pytest.raises(ValueError, match=message):
        fit(Recurrent(GRU(4, 1)), record(), TrainingSettings.paper(**{**vars(QUICK), **change}))


def test_a_network_that_has_learned_nothing_is_said_to_be_so() -> None:
    """At a learning rate that moves no weight; at a usual one it learns."""
    changes = {"epochs": 40, "window": 40}
    stuck = fitted(0, "gru", learning_rate=1e-9, **changes)[1]
    assert len(stuck.notes) == 1
    assert "network: nothing was learned: " in stuck.notes[0]
    assert fitted(0, "gru", learning_rate=1e-2, **changes)[1].notes == []

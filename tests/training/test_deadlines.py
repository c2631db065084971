"""A training that a deadline ends has what it had come to by then."""

from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import nn

from splitband.runtime.deadlines import Deadline, within
from splitband.training import History, fit
from splitband.training.checkpoints import Checkpoint
from splitband.training.quasi_newton import QuasiNewton
from tests.records import SETUP, TRAIN, record
from tests.support import slowed, untrained
from tests.training.test_checkpoints import RECIPE

LONG = replace(RECIPE, epochs=4, quasi_newton=60)


def run(deadline: Deadline, checkpoint: Checkpoint | None = None) -> tuple[nn.Module, History]:
    model = untrained("split-gru", record()[:TRAIN], SETUP, 0)
    with within(deadline):
        return model, fit(model, record()[:TRAIN], LONG, 0, None, checkpoint)


@pytest.mark.parametrize("looks", [0, 5, 80])
def test_it_ends_soon_and_its_weights_are_finite(
    looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = slowed(monkeypatch, 1.0)
    began = clock.at
    model, history = run(Deadline(began + looks))
    assert clock.at - began <= looks + 20
    assert history.cut
    assert all(losses for losses in history.losses.values())
    assert all("the time was over after" in note for note in history.notes if "time" in note)
    assert all(torch.isfinite(weights).all() for weights in model.parameters())


def test_a_training_that_was_cut_goes_on_as_if_it_had_not_been(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the deadline has ended early is not taken for the end of the training."""
    whole, expected = run(Deadline())
    assert not expected.cut
    assert not expected.notes
    with monkeypatch.context() as patch:
        clock = slowed(patch, 1.0)
        assert run(Deadline(clock.at + 10), Checkpoint(tmp_path / "run"))[1].cut
    again, history = run(Deadline(), Checkpoint(tmp_path / "run"))
    assert history.losses == expected.losses
    for ours, theirs in zip(again.parameters(), whole.parameters(), strict=True):
        assert torch.equal(ours, theirs)


def test_a_round_that_is_cut_keeps_the_best_weights(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = slowed(monkeypatch, 1.0)
    at = nn.Parameter(torch.tensor([-1.2, 1.0], dtype=torch.float64))

    def error() -> torch.Tensor:
        return 100 * (at[1] - at[0] ** 2) ** 2 + (1 - at[0]) ** 2

    before = float(error().detach())
    finish = QuasiNewton([at], error, Deadline(clock.at + 12))
    reached = finish.round()
    assert finish.cut
    assert reached == pytest.approx(float(error().detach()) ** 0.5)
    assert reached**2 < before

"""Trainings that go wrong are gone back from; those that a deadline ends have finite weights."""

from copy import deepcopy
from dataclasses import replace
from typing import Any

import pytest
import torch

from splitband import TrainingSettings
from splitband.models import Model
from splitband.runtime.deadlines import Deadline, within
from splitband.training import History, fit
from splitband.training.network import MOST_RESTARTS, NetworkTraining
from tests.signals import QUICK, SETUP, TRAIN, record
from tests.support import slowed, untrained
from tests.training.support import RECIPE, trained


def test_a_diverging_epoch_is_repeated_from_its_start_with_half_the_learning_rate(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """The second pass of the first network blows up, twice, and leaves NaN weights behind."""
    rates: list[float] = []
    begun: list[Any] = []
    whole_pass = NetworkTraining._pass

    def sabotaged(self: NetworkTraining) -> float:
        at = self.task.network.state_dict(), self.optimizer.state_dict()["state"]
        begun.append(deepcopy([*at, self.generator.get_state()]))
        loss = whole_pass(self)
        rates.append(self.optimizer.param_groups[0]["lr"])
        if len(rates) in (2, 3):
            for p in self.task.network.parameters():
                p.data.fill_(float("nan"))
            return float("nan")
        return loss

    monkeypatch.setattr(NetworkTraining, "_pass", sabotaged)
    plain = TrainingSettings.paper(40, QUICK.warmup, 4, 16, learning_rate=0.01)
    model, history = trained(plain)
    for again in begun[2:4]:
        torch.testing.assert_close(again, begun[1], rtol=0, atol=0)
    assert all(torch.isfinite(p).all() for p in model.parameters())
    assert [len(losses) for losses in history.losses.values()] == [4, 4]
    assert rates == pytest.approx([0.01, 0.01, 0.005, *[0.0025] * 3, *[0.01] * 4])
    note = "low band: the loss diverged in epoch 2, repeated with half the learning rate"
    assert history.notes == [note, note]


def test_a_training_that_always_diverges_is_given_up(monkeypatch: pytest.MonkeyPatch) -> None:
    passes = []

    def exploding(self: object) -> float:
        passes.append(1)
        return 1e9

    monkeypatch.setattr("splitband.training.network.NetworkTraining._pass", exploding)
    with pytest.raises(FloatingPointError, match=r"diverged in epoch 1: the loss is 1e\+09"):
        trained()
    assert len(passes) == MOST_RESTARTS + 1


LONG = replace(RECIPE, epochs=4, lbfgs_iterations=60)


def trained_until(deadline: Deadline) -> tuple[Model, History]:
    model = untrained("split-gru", record()[:TRAIN], SETUP, 0)
    with within(deadline):
        return model, fit(model, record()[:TRAIN], LONG, 0)


@pytest.mark.parametrize("looks", [0, 5, 80])
def test_at_its_deadline_a_training_ends_soon_and_its_weights_are_finite(
    looks: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = slowed(monkeypatch, 1.0)
    began = clock.at
    model, history = trained_until(Deadline(began + looks))
    assert clock.at - began <= looks + 20
    assert history.cut
    assert all(losses for losses in history.losses.values())
    assert all("stopped by the time limit at" in note for note in history.notes if "time" in note)
    assert all(torch.isfinite(weights).all() for weights in model.parameters())

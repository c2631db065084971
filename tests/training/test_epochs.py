"""Which windows an epoch takes, and how many."""

from itertools import chain

import numpy as np
import pytest
import torch

from splitband import GRU, Record, TrainingSettings
from splitband.models import Recurrent
from splitband.training import fit
from splitband.training.settings import MAX_BATCHES, STEPS
from tests.signals import (
    DT,
    TRAIN,
    record,
)
from tests.training.support import Watched, fitted, parameters, seen_by_adam


def watched(most: int | None, epochs: int = 4) -> Watched:
    torch.manual_seed(0)
    model = Watched(2)
    count = Record(np.arange(100.0), DT)
    few = TrainingSettings.paper(20, 5, epochs, 10, 1e-4, normalize=False, max_batches=most)
    history = fit(model, count, few, seed=1)
    assert np.isfinite(history.losses["network"]).all()
    return model


def test_an_epoch_of_a_long_record_takes_other_windows_each_time() -> None:
    batches = watched(3).batches
    assert [len(batch) for batch in batches] == [10] * 12
    epochs = [[*chain(*batches[i : i + 3])] for i in range(0, 12, 3)]
    for taken in epochs:
        assert len(set(taken)) == 30
        assert set(taken) <= set(range(81))
    assert len({frozenset(taken) for taken in epochs}) == 4
    assert len({*chain(*epochs)}) > 50


def test_an_epoch_of_a_short_record_takes_every_window() -> None:
    for most in (None, 9, 1000):
        model = watched(most, epochs=2)
        assert len(model.batches) == 2 * 9
        for epoch in (model.batches[:9], model.batches[9:]):
            assert sorted(chain(*epoch)) == [*range(81)]
        assert torch.equal(parameters(model), parameters(watched(None, epochs=2)))


def test_the_loss_of_an_epoch_is_the_mean_of_the_windows_that_were_taken() -> None:
    """Each is 0.5 for a network that always says 0.5 too little."""
    model = Recurrent(GRU(2, 1))
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.zero_()
    few = TrainingSettings.paper(20, 5, 3, 10, learning_rate=1e-30, normalize=False, max_batches=2)
    history = fit(model, Record(np.full(100, 0.5), DT), few)
    assert history.losses["network"] == pytest.approx([0.5] * 3, rel=1e-6)


def test_the_one_cycle_is_gone_through_once_by_the_steps_that_are_taken(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rates = seen_by_adam(monkeypatch, lambda group: group["lr"])
    fitted(record()[:TRAIN], epochs=5, max_batches=2, one_cycle=True, learning_rate=0.01)
    schedule = TrainingSettings.paper(learning_rate=0.01, one_cycle=True)
    assert rates == pytest.approx([schedule.rate(0, i / 10) for i in range(10)])


@pytest.mark.parametrize("samples", [100, 1000, 10_000, 1_000_000])
def test_the_default_recipe_takes_about_as_many_steps_of_any_record(samples: int) -> None:
    recipe = TrainingSettings.of(samples)
    whole = -(-(samples - recipe.window + 1) // recipe.batch_size)
    steps = recipe.epochs * min(whole, MAX_BATCHES)
    assert recipe.max_batches == min(whole, MAX_BATCHES)
    assert abs(steps - STEPS) <= 0.05 * STEPS

"""What was not measured moves no weight and counts in no loss."""

from typing import Any

import numpy as np
import pytest
import torch

from splitband import GRU, Record, TrainingSettings
from splitband.models import Recurrent
from splitband.training import fit
from tests.signals import DT, LENGTH, TRAIN, holed, record, standing_in, with_gaps
from tests.training.support import GAPS, fitted, parameters, starts_of


@pytest.mark.parametrize("channel", [slice(None), 1], ids=["both", "one"])
def test_what_stands_in_for_a_gap_moves_no_weight(channel: Any) -> None:
    r = record(ny=2, nu=1)[:TRAIN]
    y = holed(r.y, *GAPS, channel=channel)
    first, *others = (fitted(standing_in(y, value, u=r.u)) for value in (0.0, 2.0, -50.0))
    for other in others:
        assert torch.equal(parameters(other), parameters(first))
        assert torch.equal(other.y_mean, first.y_mean)
        assert torch.equal(other.y_std, first.y_std)
    without = fitted(Record(np.where(np.isfinite(y), y, 2.0), DT, u=r.u))
    assert not torch.equal(parameters(without), parameters(first))


@pytest.mark.parametrize("several", [False, True])
def test_the_loss_counts_what_was_measured(several: bool) -> None:
    """Of a network that says nothing, it is the size of the samples that are there."""
    y = holed(holed(record(ny=2).y, *GAPS), 45, slice(100, 104), channel=0)
    ys = [y[:60], y[60:]] if several else [y]
    model = Recurrent(GRU(3, 2))
    with torch.no_grad():
        for parameter in model.parameters():
            parameter.zero_()
    window, warmup = 20, 5
    quiet = TrainingSettings.paper(window, warmup, 2, 1, learning_rate=1e-30, normalize=False)
    history = fit(model, [with_gaps(each) for each in ys], quiet)
    whole = np.concatenate(ys)
    losses = [
        np.sqrt(np.nanmean(whole[start + warmup : start + window] ** 2))
        for start in starts_of(ys, window, warmup)
    ]
    assert history.losses["network"] == pytest.approx([np.mean(losses)] * 2, rel=1e-5)


def test_a_window_that_has_seen_nothing_yet_has_no_loss() -> None:
    """The free run grows: its first samples may all be in a gap."""
    y = holed(record().y[:30], slice(12, 20))
    history = fit(
        Recurrent(GRU(3, 1)), with_gaps(y), TrainingSettings.paper(30, 12, 2, 4, growth=1.0)
    )
    assert history.losses["network"][0] == 0
    assert 0 < history.losses["network"][1] < np.inf


def test_gaps_that_leave_no_warm_up_are_refused() -> None:
    y = holed(record().y, *range(5, LENGTH, 12))
    with pytest.raises(ValueError, match="between the gaps of the training record, got 12 samples"):
        fitted(with_gaps(y))
    fitted(with_gaps(y), warmup=11)

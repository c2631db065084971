"""Several records train one model."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from splitband import GRU, Record
from splitband.comparison.plan import plan
from splitband.comparison.request import PlanRequest
from splitband.forecasters.held_out import Origin
from splitband.models import Recurrent
from splitband.training.windows import joined, select, windows, windows_in
from tests.signals import DT, LENGTH, QUICK, SETUP, TRAIN, holed, record, with_gaps
from tests.support import asked, compare, untrained
from tests.training.support import GAPS, fitted, parameters


def test_the_units_are_those_of_all_records() -> None:
    a, b = (holed(record(2, 1, seed).y, *GAPS, channel=seed) for seed in (0, 1))
    b = 3 * b + 5
    u = [np.arange(LENGTH) / 10, -np.ones(LENGTH)]
    model = Recurrent(GRU(3, 2, 1))
    model.adapt_to([with_gaps(a, u=u[0]), with_gaps(b[:100], u=u[1][:100])])
    for channel in range(2):
        seen = [v for y in (a, b[:100]) for v in y[:, channel] if np.isfinite(v)]
        # A gap has an input all the same.
        mean = sum(seen) / len(seen)
        deviation = np.sqrt(sum((v - mean) ** 2 for v in seen) / len(seen))
        assert float(model.y_mean[channel]) == pytest.approx(mean, rel=1e-12)
        assert float(model.y_std[channel]) == pytest.approx(deviation, rel=1e-12)
    both = [*u[0], *u[1][:100]]
    assert float(model.u_mean) == pytest.approx(np.mean(both), rel=1e-12)
    assert float(model.u_std) == pytest.approx(np.std(both), rel=1e-12)


def test_several_records_train_another_model_than_each_alone() -> None:
    a, b = record(seed=0)[:TRAIN], record(seed=1)[:TRAIN]
    both, alone = fitted([a, b]), fitted(a)
    assert not torch.equal(parameters(both), parameters(alone))
    found = asked("gru", record(), SETUP, others=[b]).forecasts[Origin(TRAIN, TRAIN)].y
    compared = compare(record(), ["gru"], SETUP, others=[b])
    np.testing.assert_array_equal(found, compared.fits["gru"][0].ahead)
    assert not np.array_equal(found, asked("gru", record(), SETUP).ahead)


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (record(2), r"record's 1 channel\(s\) and 0 input\(s\), got 2 and 0"),
        (record(1, 1), r"record's 1 channel\(s\) and 0 input\(s\), got 1 and 1"),
        (replace(record(), sampling_time=2 * DT), "every 0.1 s, got every 0.2 s"),
        (record()[:30], "of 30 samples, got 40"),
    ],
)
def test_other_records_must_be_of_the_same_kind(other: Record, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        plan(PlanRequest(record(), TRAIN, ["gru"], others=[other], **SETUP.options))


def test_a_network_without_a_simulator_trains_on_records_with_and_without_one() -> None:
    a = record()[:TRAIN]
    assert torch.equal(parameters(fitted([a, replace(a, y_sim=None)])), parameters(fitted([a, a])))


@pytest.mark.parametrize("method", ["gru", "split-gru", "filtered-gru-conditioned"])
def test_two_records_have_the_windows_of_both(method: str) -> None:
    whole = record(nu=1)
    halves = [whole[:65], whole[65:]]
    model = untrained(method, whole, SETUP, 0)
    model.adapt_to(halves)
    window, warmup = QUICK.window, QUICK.warmup
    together = zip(*(model.tasks(model.normalised(half)) for half in halves), strict=True)
    starts = windows_in(halves, window, warmup).starts
    assert len(starts) == sum(len(half) - window + 1 for half in halves)
    for tasks in together:
        known, target = windows(joined(tasks), window, warmup)
        alone = [windows(task, window, warmup) for task in tasks]
        found = select(known, starts)
        assert torch.equal(target[starts], torch.cat([of_one for _, of_one in alone]))
        for name in ("y", "u", "y_sim"):
            signals = [getattr(known_of_one, name) for known_of_one, _ in alone]
            assert torch.equal(getattr(found, name), torch.cat(signals))

"""What is left open is chosen by the record of each fit, and given options are kept."""

from __future__ import annotations

import numpy as np
import pytest

import splitband as sb
from splitband import GRU, Bands, Record, Settings
from splitband.forecasters.network import Network

SETTINGS = Settings(window=40, warmup=16, epochs=1)
OPEN = {
    "split": sb.Split(GRU(3), GRU(3), settings=SETTINGS),
    "part of the bands": sb.Split(GRU(3), GRU(3), Bands(order=2), settings=SETTINGS),
    "filtered": sb.Filtered(sb.Function(lambda t: np.sin(2 * t)), GRU(3), settings=SETTINGS),
    "settings": sb.Single(GRU(3)),
}


def tones(step: float, samples: int = 160) -> Record:
    t = step * np.arange(samples)
    return Record(np.sin(2 * t) + 0.3 * np.sin(31 * t), step)


@pytest.mark.parametrize("name", OPEN)
def test_it_is_as_if_it_had_not_been_fitted_before(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("splitband.training.settings.STEPS", 4)
    slow, fast = tones(0.05), tones(0.02, 220)
    expected = OPEN[name].clone().fit(fast).predict(30).y
    again = OPEN[name].clone().fit(slow)
    assert np.shape(again.predict(30).y) == (30, 1)
    np.testing.assert_array_equal(again.fit(fast).predict(30).y, expected)
    np.testing.assert_array_equal(again.clone().fit(fast).predict(30).y, expected)


def test_the_interval_knows_nothing_of_what_is_held_out() -> None:
    """The bands of its fits are chosen by three quarters, as those of a comparison would be."""
    record = tones(0.05)
    model = OPEN["split"].clone().fit(record)
    part = OPEN["split"].clone().fit(record[:120])
    assert isinstance(model, sb.Split)
    assert isinstance(part, sb.Split)
    seen = []
    learn = Network.learn

    def watched(network: sb.Split, *args: object, **options: object) -> None:
        learn(network, *args, **options)  # type: ignore[arg-type]
        seen.append(network._trained_in)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Network, "learn", watched)
        model.predict(20, level=0.9)
    assert seen == [part._trained_in]


def test_the_ensembles_of_two_seeds_share_no_member() -> None:
    record = tones(0.05)
    model = sb.Ensemble(sb.Single(GRU(3), SETTINGS), 2)
    seeds = []
    for seed in (0, 1, 2):
        model.fit(record, seed=seed)
        seeds += [member.require_fitted().report.seed for member in model.members]
    assert seeds == [0, 1, 2, 3, 4, 5]

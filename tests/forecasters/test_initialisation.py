"""Where a training begins: as the linear model of the record, before any iteration."""

from __future__ import annotations

import numpy as np
import pytest
import scipy

import splitband as sb
from splitband.forecasters.initialisation import begin_as_linear
from tests.support import simulated

SAMPLES, TRAINED, AHEAD = 900, 600, 200


def lightly_damped(channels: int, noise: float) -> sb.Record:
    """Resonances, one for each channel, with feedthrough, beside an offset."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(SAMPLES)
    y = np.empty((SAMPLES, channels))
    for i in range(channels):
        pole = 0.97 * np.exp(0.4j * (i + 1))
        a = np.poly([pole, pole.conj()]).real
        y[:, i] = scipy.signal.lfilter([0.2, 1.0, 0.5], a, u) + 3.0
    seen = y + noise * y.std(axis=0) * rng.standard_normal(y.shape)
    return sb.Record(seen, 0.1, u=u, y_true=y)


@pytest.mark.parametrize(("states", "channels", "warmup"), [(5, 1, 30), (4, 2, 5)])
def test_before_training_it_forecasts_as_the_linear_model_does(
    states: int, channels: int, warmup: int
) -> None:
    record = lightly_damped(channels, 0.001)
    training = record[:TRAINED]
    settings = sb.TrainingSettings.paper(window=100, warmup=warmup, epochs=1)
    model = sb.Single(sb.StateSpace(states, 6))._build(training, settings)
    begin_as_linear(model, [training], True, seed=0)
    history = record[TRAINED : TRAINED + warmup]
    inputs = record.u
    coming = inputs[TRAINED + warmup :]
    linear = sb.Linear().fit(training).predict(AHEAD, history, coming, other_record=True)
    found = simulated(model, history.y, AHEAD, inputs[TRAINED : TRAINED + warmup + AHEAD])
    scale = training.y.std(axis=0)
    assert np.sqrt(np.mean(((found - linear.y) / scale) ** 2)) < 0.05


def test_more_poles_than_states_are_reduced_to_those_that_matter() -> None:
    """Of a resonance beside a weak fast pole, two states keep the resonance."""
    rng = np.random.default_rng(0)
    u = rng.standard_normal(SAMPLES)
    a = np.poly([0.97 * np.exp(0.4j), 0.97 * np.exp(-0.4j)]).real
    strong = scipy.signal.lfilter([0.0, 1.0], a, u)
    y = strong + 0.02 * strong.std() * scipy.signal.lfilter([1.0], [1, -0.5], u)
    training = sb.Record(y, 0.1, u=u)[:TRAINED]
    model = sb.Single(sb.StateSpace(2, 0))._build(
        training, sb.TrainingSettings.paper(window=100, warmup=20)
    )
    begin_as_linear(model, [training], True, seed=0)
    found = simulated(model, y[:20, None], SAMPLES - 20, u[:, None])
    assert np.std(found[:, 0] - y[20:]) < 0.1 * y.std()


def test_gaps_and_further_records_are_taken_account_of() -> None:
    record = lightly_damped(1, 0.001)
    first, second = record[:TRAINED], record[TRAINED:]
    y = first.y.copy()
    y[100:130] = np.nan
    holed = sb.Record.with_gaps(y, 0.1, u=first.u)
    model = sb.Single(sb.StateSpace(2, 4))._build(
        holed, sb.TrainingSettings.paper(window=100, warmup=10)
    )
    begin_as_linear(model, [holed, second], True, seed=0)
    inputs = second.u
    found = simulated(model, second.y[:10], AHEAD, inputs)
    assert np.std(found - second.truth[10 : 10 + AHEAD]) < 0.05 * y[~np.isnan(y)].std()

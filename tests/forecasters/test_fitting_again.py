"""A fit anew leaves nothing of the one before; one with `start=` goes on from another."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.signal

import splitband as sb
from splitband import GRU, Bands, Record, TrainingSettings
from splitband.forecasters.network import Network
from tests.support import known_after

SETTINGS = TrainingSettings.paper(window=40, warmup=16, epochs=1)
OPEN = {
    "split": sb.Split(GRU(3), GRU(3), settings=SETTINGS),
    "part of the bands": sb.Split(GRU(3), GRU(3), Bands(order=2), settings=SETTINGS),
    "filtered": sb.Filtered(sb.Function(lambda t: np.sin(2 * t)), GRU(3), settings=SETTINGS),
    "filtered high": sb.Filtered(
        sb.Function(lambda t: np.sin(31 * t) + t), GRU(3), settings=SETTINGS, simulator_band="high"
    ),
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


def test_the_interval_knows_nothing_of_what_is_held_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """The bands of its fits are chosen by three quarters, as those of a comparison would be."""
    model: Any = OPEN["split"].clone().fit(tones(0.05))
    part: Any = OPEN["split"].clone().fit(tones(0.05)[:120])
    learn, seen = Network.learn, list[Any]()

    def watched(network: Any, *args: Any, **options: Any) -> None:
        learn(network, *args, **options)
        seen.append(network._trained_in)

    monkeypatch.setattr(Network, "learn", watched)
    model.predict(20, level=0.9)
    assert seen == [part._trained_in]


SHORT = TrainingSettings.paper(40, 10, 1, 16)
ONE_MORE = replace(SHORT, epochs=0, lbfgs_iterations=1)


def rig(delay: int, scale: float = 1.0, samples: int = 300) -> Record:
    """A first-order lag that acts after some samples, in other units and about another level."""
    rng = np.random.default_rng(delay)
    u = np.repeat(rng.normal(size=samples // 10), 10)
    y = scipy.signal.lfilter([*np.zeros(delay), 0.1], [1, -0.9], u)
    return Record(scale * (y + 3 + 0.01 * rng.normal(size=samples)), 0.1, u=u)


@pytest.mark.parametrize(
    "network",
    [
        sb.Single(sb.GRU(4), SHORT),
        sb.Single(sb.StateSpace(2, 3), SHORT),
        sb.Split(sb.GRU(3), sb.GRU(3), conditioned=True, settings=SHORT),
        sb.Residual(sb.Linear(), sb.GRU(3), settings=SHORT),
    ],
    ids=["gru", "state-space", "split-gru-conditioned", "residual-linear-gru"],
)
def test_it_begins_with_weights_scaling_delays_and_bands(network: sb.Forecaster) -> None:
    """They mean the same after steps of no size on a record of another delay, level and scale."""
    start = network.clone().fit(rig(6), seed=3)
    hardly = network.clone().set_params(settings=replace(SHORT, learning_rate=1e-9))
    model = hardly.fit(rig(0, 2.0), start=start)
    assert model.delays == start.delays == (6,)
    assert getattr(model, "trained_in", None) == getattr(start, "trained_in", None)
    if getattr(start, "base", None) is None:  # a base is fitted to the other record
        history, coming = rig(6)[:100], known_after(rig(6), 100)
        before, after = (each.predict(50, history, **coming).y for each in (start, model))
        np.testing.assert_allclose(after, before, atol=1e-5)


def test_the_trainings_add_up_in_words() -> None:
    network = sb.Single(sb.GRU(4), replace(SHORT, lbfgs_iterations=20))
    start = network.clone().fit(rig(0))
    model = network.clone().set_params(settings=ONE_MORE).fit(rig(0), start=start)
    assert "1 epoch" in model.describe()
    assert "21 iterations" in model.describe()


def test_a_base_is_fitted_again_where_its_samples_or_its_options_differ() -> None:
    network, record = sb.Residual(sb.Linear(), sb.GRU(3), settings=SHORT), rig(6)
    start = network.clone().fit(record)

    def taken(other: sb.Residual, given: sb.Record) -> bool:
        bases = (each._fitted_base for each in (other.clone().fit(given, start=start), start))
        one, two = (each.model for each in bases if isinstance(each, sb.Linear))
        return one.a is two.a

    assert taken(network, record)
    third_order = sb.Residual(sb.Linear(order=3), sb.GRU(3), settings=SHORT)
    assert not taken(network, rig(6, samples=400))
    assert not taken(network, replace(record, u=-record.u))
    assert not taken(third_order, record)


@pytest.mark.parametrize(
    ("model", "start", "said"),
    [
        (sb.Single(sb.GRU(4), SHORT), sb.Mean(), "a trained gru, got"),
        (sb.Single(sb.GRU(4), SHORT), sb.Split(sb.GRU(3), sb.GRU(3)), "a trained gru, got"),
        (sb.Single(sb.GRU(5), SHORT), None, "the sizes and channels of gru: 5 hidden"),
        (sb.Ensemble(sb.Single(sb.GRU(4), SHORT), 2), None, "a trained median of 2, got"),
    ],
)
def test_another_kind_or_size_is_refused(
    model: sb.Forecaster, start: sb.Forecaster | None, said: str
) -> None:
    start = sb.Single(sb.GRU(4), SHORT).fit(rig(0)) if start is None else start
    start = start.fit(rig(0)) if not start.random else start
    with pytest.raises(ValueError, match=f"start must (be|have) {said}"):
        model.fit(rig(0), start=start)


def test_a_start_from_another_system_is_refused() -> None:
    network = sb.Single(sb.GRU(4), SHORT)
    start = network.clone().fit(replace(rig(0), columns=("speed",)))
    with pytest.raises(ValueError, match=r"columns of start must be .* record, level"):
        network.fit(replace(rig(0), columns=("level",)), start=start)


def test_another_function_is_not_taken_for_the_simulator_of_the_start() -> None:
    """Whose code says nothing of the parameters that it closes over."""

    def on(level: float) -> sb.Forecaster:
        simulator = sb.Function(lambda t: np.full(len(t), level))
        return sb.Residual(simulator, sb.GRU(3), settings=SHORT)

    start = on(1.0).fit(rig(0))
    other = on(2.0).fit(rig(0), start=start)
    said = other.predict(3, u=np.zeros((3, 1))).components["simulator"]
    np.testing.assert_allclose(said, 2.0, rtol=1e-6)


def stopped(_: Any) -> None:
    raise KeyboardInterrupt


@pytest.mark.parametrize("ensemble", [False, True])
def test_a_fit_that_is_interrupted_leaves_the_forecaster_as_it_was(ensemble: bool) -> None:
    single = sb.Single(sb.GRU(4), SHORT)
    model: Any = sb.Ensemble(single, 2) if ensemble else single
    with pytest.raises(KeyboardInterrupt):
        model.fit(rig(0), progress=stopped)
    with pytest.raises(ValueError, match="must be fitted first"):
        model.predict(3)
    expected = model.fit(rig(0)).predict(3, u=[1, 1, 1]).y
    with pytest.raises(KeyboardInterrupt):
        model.fit(rig(6), progress=stopped)
    np.testing.assert_array_equal(model.predict(3, u=[1, 1, 1]).y, expected)


@pytest.mark.parametrize("ensemble", [False, True])
def test_a_training_goes_on_from_the_forecaster_itself(ensemble: bool) -> None:
    single = sb.Single(sb.GRU(4), SHORT)
    model: Any = sb.Ensemble(single, 2) if ensemble else single
    start = model.fit(rig(0)).clone().fit(rig(0))
    expected = model.clone().fit(rig(6), start=start).predict(3, u=[1, 1, 1]).y
    found = model.fit(rig(6), start=model).predict(3, u=[1, 1, 1]).y
    np.testing.assert_array_equal(found, expected)

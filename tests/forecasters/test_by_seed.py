"""Networks of other settings that are trained in a forecaster's place, by seed."""

import numpy as np
import numpy.typing as npt
import pytest
import scipy

import splitband as sb
from splitband.forecasters.ensemble import over_seeds
from splitband.forecasters.initialisation import Earlier

Array = npt.NDArray[np.float64]
SHORT = sb.Settings(window=20, warmup=5, epochs=1)


def test_a_simulator_of_its_own_is_run_once_for_all_of_them() -> None:
    calls: list[int] = []

    def swing(t: Array) -> Array:
        calls.append(len(t))
        return np.asarray(np.sin(3 * t))

    record = sb.Record(np.sin(0.3 * np.arange(60) - 0.1), 0.1)
    networks = [
        sb.Residual(sb.Simulation(sb.Function(swing)), sb.GRU(units), settings=SHORT)
        for units in (2, 3)
    ]
    first = networks[0]
    first.by_seed = {1: networks[1]}
    ready = first.simulated(record, 0)
    assert calls
    calls.clear()
    for seed in (0, 1):
        ready.for_seed(seed).clone().fit(record, seed=seed)
    assert not calls


def delayed(samples: int) -> sb.Record:
    """A filter of white noise, with a dead time."""
    u = np.random.default_rng(0).standard_normal(200)
    x = scipy.signal.lfilter([0.3], [1, -0.8], u)
    return sb.Record(np.append(np.zeros(samples), x)[:200], 0.1, u=u)


def test_each_seed_goes_on_with_its_own_weights() -> None:
    """Also where the members are alike in all that is shown of them."""
    record, network = delayed(0), sb.Single(sb.GRU(3), SHORT)
    trained = [network.clone().fit(record, seed=seed) for seed in (0, 1)]
    goes_on = [
        network.continued(Earlier(0, {seed: model.state()})) for seed, model in enumerate(trained)
    ]
    goes_on[0].by_seed = {1: goes_on[1]}
    members = [each.clone().fit(record, seed=seed) for seed, each in enumerate(goes_on)]
    expected = [member.predict(9, u=np.ones(9)).y for member in members]
    ensemble = over_seeds(goes_on[0], [0, 1])
    assert isinstance(ensemble, sb.Ensemble)
    for again in (ensemble, sb.Ensemble.of(ensemble.fit(record).members)):
        y = again.clone().fit(record).predict(9, u=np.ones(9)).y
        np.testing.assert_allclose(y, np.mean(expected, axis=0), rtol=1e-6)
    alike = over_seeds(network, [0, 1])
    assert isinstance(alike, sb.Ensemble)
    assert alike.member is not network
    assert isinstance(alike.member, sb.Forecaster)


@pytest.mark.xfail(strict=True, reason="One clock")
def test_a_training_that_goes_on_keeps_its_delays() -> None:
    """Its weights and its scaling are those of the delayed inputs."""
    network = sb.Single(sb.GRU(3), SHORT)
    first = network.clone().fit(delayed(6))
    assert first.delays[0] > 2
    again = network.continued(Earlier(0, {0: first.state()})).fit(delayed(0))
    assert again.delays == first.delays

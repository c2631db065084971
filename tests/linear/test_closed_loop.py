"""Plants that are unstable, and held by a controller: found, judged as far as forecasts reach."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy

import splitband as sb
from benchmarks.closed_loop import POLE, pendulum, plant
from splitband.checks.responses import respond_over_range
from splitband.comparison.plan import plan
from splitband.comparison.request import PlanRequest
from splitband.linear.identification import identified, unstable
from splitband.runtime.arrays import Array


@pytest.fixture(scope="module")
def held() -> sb.Linear:
    return sb.Linear().fit(pendulum(0))


@pytest.mark.parametrize("outputs", [1, 2])
@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_pole_of_a_pendulum_that_is_held_upright(seed: int, outputs: int) -> None:
    record = pendulum(seed)
    y = record.y[:, :outputs]
    found = sb.Linear().fit(sb.Record(y, record.sampling_time, u=record.u))
    assert abs(found.poles()).max() == pytest.approx(POLE, abs=0.02)
    assert f"unstable: largest pole {abs(found.poles()).max():.4g}" in found.describe()


def test_the_pole_is_found_beside_gaps_and_from_several_runs() -> None:
    record, rng = pendulum(4), np.random.default_rng(0)
    measured = rng.random(record.y.shape) > 0.05
    gaps = replace(record, measured=measured)
    several = [pendulum(seed)[:300] for seed in (5, 6, 7)]
    for records in ([gaps], several):
        found = identified([(each.y_with_gaps, each.u) for each in records if each.u is not None])
        assert abs(found.poles()).max() == pytest.approx(POLE, abs=0.02)


def test_coloured_noise_does_not_bias_the_pole() -> None:
    """A pole at 1.05, noise with a pole at 0.9, and a dead time of four samples."""
    poles = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        v = 0.02 * scipy.signal.lfilter([0.44], [1, -0.9], rng.standard_normal(2000))
        r = rng.uniform(-1, 1, 50).repeat(40)
        x, y, u = 0.0, np.zeros(2000), np.zeros(2000)
        for n in range(2000):
            y[n] = x + v[n]
            u[n] = 0.1 * r[n] - 1.1 * y[n]
            x = 1.05 * x + 0.1 * u[n - 4]  # 0 before the first sample
        poles.append(abs(identified([(y[:, None], u[:, None])]).poles()).max())
    assert np.mean(poles) == pytest.approx(1.05, abs=0.01)


def integrator(rng: np.random.Generator) -> tuple[Array, Array]:
    u = rng.uniform(-1, 1, 50).repeat(20)
    y = np.cumsum(u) + np.cumsum(rng.standard_normal(1000))
    return y, u


def drifting(rng: np.random.Generator) -> tuple[Array, Array]:
    """A disturbance that grows 3,000-fold, beside a stable plant behind a controller."""
    x, y, u = 0.0, np.zeros(1000), np.zeros(1000)
    r = rng.uniform(-1, 1, 25).repeat(40)
    for n in range(1000):
        y[n] = x + 0.01 * rng.standard_normal()
        u[n] = 2 * (r[n] - y[n])
        x = 0.9 * x + 0.1 * (u[n] + 5 * np.exp(8 * (n / 1000 - 1)))
    return y, u


def self_excited(rng: np.random.Generator) -> tuple[Array, Array]:
    """A Van der Pol oscillator in an open loop: its rest is unstable, and no controller acts."""
    x, y, u = np.array([0.1, 0.0]), np.zeros(1000), rng.uniform(-1, 1, 100).repeat(10)
    for n in range(1000):
        y[n] = x[0]
        for _ in range(5):
            x = x + 0.02 * np.array([x[1], (1 - x[0] ** 2) * x[1] - x[0] + u[n]])
    return y, u


def saturated(rng: np.random.Generator) -> tuple[Array, Array]:
    """A controller with limits, and a sensor that rounds."""
    x, y, u, r = 0.0, np.zeros(1000), np.zeros(1000), rng.uniform(-1, 1, 25).repeat(40)
    for n in range(1000):
        y[n] = round(x / 0.05) * 0.05
        u[n] = np.clip(10 * (r[n] - y[n]), -1, 1)
        x = 0.98 * x + 0.03 * u[n] + 0.01 * rng.standard_normal()
    return y, u


def logged_late(rng: np.random.Generator) -> tuple[Array, Array]:
    u = rng.uniform(-1, 1, 100).repeat(10)
    y = scipy.signal.lfilter([0, 0.1, 0.05], [1, -1.5, 0.6], u) + 0.01 * rng.standard_normal(1000)
    return y[4:], u[:-4]


@pytest.mark.parametrize("make", [integrator, drifting, self_excited, saturated, logged_late])
def test_what_is_stable_or_not_held_by_its_inputs_is_not_called_unstable(
    make: Callable[[np.random.Generator], tuple[Array, Array]],
) -> None:
    for seed in range(6):
        y, u = make(np.random.default_rng(seed))
        assert unstable([(y[:, None], u[:, None])]) is None
    for seed in range(6):
        assert unstable([plant(seed, 0, True, "20 % drifting", 0.4)]) is None


def test_an_unstable_model_is_judged_as_far_as_its_forecasts_reach(held: sb.Linear) -> None:
    found = sb.check(held, pendulum(8))
    assert found.outcome != "rejected"
    assert [*found.fits] == ["1 sample ahead", "5 samples ahead", "50 samples ahead"]
    assert min(found.fits["1 sample ahead"]) > 95
    assert min(found.fits["50 samples ahead"]) > 70
    assert "forecasts up to 50 samples ahead" in str(found)


def test_the_step_response_of_an_unstable_model_is_that_of_its_state_space(held: sb.Linear) -> None:
    responses = respond_over_range(held)[0]
    system, steps = held.state_space(), len(responses.y)
    matrices: Any = (system.A, system.B, system.C, system.D, 1.0)
    _, (y,) = scipy.signal.dstep(matrices, n=steps)
    assert responses.y[:, :, 0] == pytest.approx(y, rel=1e-6, abs=1e-9)
    assert "no static gain" in " ".join(responses.remarks)


def test_a_stream_of_an_unstable_model_overflows_as_its_prediction(held: sb.Linear) -> None:
    u = np.resize(np.sin(np.arange(50)), (14_000, 1))
    with pytest.warns(sb.ExtrapolationWarning, match="leaves 3 times the range"):
        stream, said = held.stream(), held.predict(len(u), u=u).y
    streamed = np.array([stream.step(row) for row in u])
    small = abs(said) < 1e90
    assert np.isfinite(said).all()
    assert streamed[small] == pytest.approx(said[small], rel=1e-6)
    assert (streamed[-100:] == said[-100:]).all()
    assert (said[-1] == 1e100).all()


def test_a_network_with_fewer_states_than_the_plant_has_poles_begins_with_as_many() -> None:
    record = pendulum(0)
    late = sb.Record(record.y[:-5], record.sampling_time, u=record.u[5:])  # a dead time
    assert len(sb.Linear().fit(late).poles()) > 2
    settings = sb.TrainingSettings(100, 50, epochs=1)
    assert sb.Single(sb.StateSpace(2), settings=settings).fit(late).fitted is not None


def test_it_is_no_slow_part_of_a_hybrid() -> None:
    settings = sb.TrainingSettings(60, 20, epochs=1)
    hybrid = sb.Residual(sb.Linear(), sb.GRU(4), settings=settings)
    with pytest.raises(ValueError, match="slow part of a hybrid must be stable"):
        hybrid.fit(pendulum(0))


def test_methods_are_judged_as_far_ahead_as_forecasts_reach() -> None:
    """By free runs, which leave the record, the last value held would be the best one."""
    record, methods = pendulum(0), ["linear", "mean", "persistence"]
    found = sb.compare(record, 750, methods)
    assert "50 samples ahead" in found.warnings[0]
    assert found.recommended == "linear"
    asked = sb.compare(record, 750, methods, ahead=50)
    assert found.require_trial().scores == asked.require_trial().scores
    free = sb.compare(record, 750, methods, horizon=250)
    assert "--ahead 50" in free.warnings[0]
    assert free.recommended != "linear"


def test_windows_of_trainings_end_where_forecasts_do() -> None:
    record = pendulum(0)
    planned = plan(PlanRequest(record, 750, ["linear", "gru"], rounds=1))
    assert planned.settings.window - planned.settings.warmup == planned.reach == 50
    assert planned.ahead == 50
    given: Any = {"window": 200}
    assert plan(PlanRequest(record, 750, ["gru"], settings=given)).settings.window == 200

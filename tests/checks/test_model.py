"""The check of a model: residual tests with known answers, stability, ranges."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy

import splitband as sb
from benchmarks import residuals
from splitband.checks.residuals import LAGS, ResidualTests, residual_tests
from splitband.forecasters.prediction import ForecastContext
from splitband.runtime.arrays import Array
from tests.support import known_after


def left_with(e: Array, u: Array) -> ResidualTests:
    """The tests of what a model leaves that says 0."""
    inputs = u.reshape(len(e), -1)
    names = "uv"[: inputs.shape[1]]
    (test,) = residual_tests(e[:, None], inputs, "y", names)
    return test


@pytest.mark.parametrize("kind", ["one step", "20 steps", "5 sinusoids", "slow noise"])
@pytest.mark.parametrize("model", residuals.MODELS)
def test_wrong_models_are_rejected_and_right_ones_are_not(model: str, kind: str) -> None:
    """Whatever the input is: the test is conditional on it."""
    right = model == "right"
    for seed in range(1000, 1004):
        for noise in ("white", "AR(0.8)") if right else ("white",):
            test = residuals.tested(kind, noise, model, seed)
            assert test.accepted == right, (model, noise, seed)


def test_a_residual_that_is_the_whole_response_to_a_few_steps_is_rejected() -> None:
    """An autoregressive model of the input would explain such steps, and hide them."""
    for seed in range(40):
        rng = np.random.default_rng(seed)
        u = np.repeat(rng.uniform(-1, 1, 10), 20)
        e = scipy.signal.lfilter([0.0, 0.147], [1.0, -0.951], u) + 0.01 * rng.standard_normal(200)
        assert left_with(e, u).dependent == ["u"]


def test_of_two_inputs_the_one_whose_effect_is_missed_is_named() -> None:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1, 1, (50, 2)), 20, axis=0)
    response = scipy.signal.lfilter([0.1], [1.0, -0.9], u, axis=0)
    noise = 0.05 * rng.standard_normal((2, 1000))
    one, both = response[:, 1] + noise[0], response.sum(axis=1) + noise[1]
    assert left_with(one, u).dependent == ["v"]
    assert left_with(both, u).dependent == ["u", "v"]
    # Two inputs that are the same: neither is missed beside the other, and one of them is missed.
    assert left_with(one, np.stack([u[:, 1], u[:, 1]], axis=1)).dependent == ["u", "v"]


def test_an_input_that_never_changes_is_not_tested() -> None:
    test = left_with(np.random.default_rng(0).standard_normal(300), np.ones(300))
    assert not test.inputs
    assert test.accepted


def test_an_output_that_is_measured_too_seldom_is_not_tested() -> None:
    g = np.random.default_rng(0)
    e, u = g.standard_normal((200, 2)), g.standard_normal((200, 1))
    e[np.arange(200) % 10 > 0, 0] = np.nan  # 20 samples at its own rate
    (test,) = residual_tests(e, u, ("slow", "fast"), ("u",), np.cumsum(e, axis=0))
    assert test.output == "fast"


def test_a_model_that_is_exact_is_accepted_for_its_rounding_errors() -> None:
    u = np.random.default_rng(0).standard_normal(300)
    y = scipy.signal.lfilter([0.5], [1.0, -0.8], u)
    e = y.astype(np.float32) - y
    (test,) = residual_tests(e[:, None], u[:, None], ("y",), ("u",), y[:, None])
    assert test.accepted


def test_what_the_inputs_do_not_explain_may_be_a_disturbance_or_a_lack_of_dynamics() -> None:
    test = residuals.tested("slow noise", "AR(0.97)", "right", 1000)
    assert (test.outcome, test.accepted) == ("not rejected", True)
    assert "Either a disturbance acts or the model lacks dynamics" in test.finding()
    alone = residual_tests(np.sin(np.arange(300.0))[:, None], None, ("y",), ())[0]
    assert alone.outcome == "not rejected"


def test_a_rejection_says_how_large_the_residuals_are() -> None:
    rng = np.random.default_rng(0)
    u = rng.standard_normal(500)
    e, y = 0.02 * u + 0.001 * rng.standard_normal(500), u
    (test,) = residual_tests(e[:, None], u[:, None], ("y",), ("u",), y[:, None])
    assert test.size == pytest.approx(0.02 / 1.02, rel=0.01)
    assert "still contain an effect of u, which" in test.finding()
    assert "have an RMS of 2 % of its standard deviation" in test.finding()


@pytest.mark.parametrize("kind", ["5 sinusoids", "1 sinusoid", "20 steps"])
def test_a_response_without_noise_is_rejected_though_its_own_past_predicts_it(kind: str) -> None:
    u = residuals.INPUTS[kind](np.random.default_rng(0))
    assert left_with(residuals.resonant(u), u).dependent == ["u"]


def test_lags_reach_to_twice_the_slowest_period_on_both_sides() -> None:
    """An effect of the input five samples later stands at 5, a feedback to it at the other side."""
    rng = np.random.default_rng(0)
    u, e = rng.standard_normal(2000), rng.standard_normal(2000)
    for later, at in ((np.append(np.zeros(5), u[:-5]) + e, 5), (e, -3)):
        inputs = u if at > 0 else np.append(np.zeros(3), e[:-3]) + 0.5 * u
        period = np.sin(2 * np.pi * np.arange(2000.0) / 80)
        (test,) = residual_tests(later[:, None], inputs[:, None], "y", "u", 5 * period[:, None])
        (around,) = (each.around for each in test.inputs)
        middle = (len(around) - 1) // 2
        assert middle == pytest.approx(160, abs=10)
        assert int(np.argmax(np.abs(around))) - middle == at
        assert around[middle : middle + LAGS + 1].tolist() == [*test.inputs[0].values]


def test_gaps_leave_the_verdict() -> None:
    """Also gaps in every tenth sample, which leave no long past."""
    for model, accepted in (("right", True), ("half the gain", False)):
        e, simulated, u = residuals.drawn("20 steps", "AR(0.8)", model, 1000)
        e[::10] = np.nan
        (test,) = residual_tests(e[:, None], u[:, None], ("y",), ("u",), simulated[:, None])
        assert test.accepted == accepted


def test_the_p_values_of_what_is_adequate_are_uniform() -> None:
    """A test of the test, by Kolmogorov and Smirnov."""
    rng = np.random.default_rng(0)
    tests = [left_with(rng.standard_normal(400), u) for u in rng.standard_normal((300, 400))]
    for p in ([t.whiteness.p for t in tests], [t.p for t in tests]):
        assert scipy.stats.kstest(p, "uniform").pvalue > 0.01


def test_colored_signals_that_have_nothing_in_common_are_not_taken_to_depend() -> None:
    """Two slow signals look alike."""
    rng = np.random.default_rng(1)
    slow = scipy.signal.lfilter([1.0], [1.0, -0.97], rng.standard_normal((100, 2, 1000)))
    tests = [left_with(e, u) for e, u in slow]
    assert sum(bool(test.dependent) for test in tests) <= 3
    assert not any(test.white for test in tests)


def walk_and_inputs(kind: str, seed: int, samples: int = 400) -> tuple[Array, Array]:
    """A random walk, and two inputs that are drawn independently of it."""
    rng = np.random.default_rng(seed)
    u = np.stack([residuals.INPUTS[kind](rng)[:samples] for _ in range(2)], axis=1)
    return np.cumsum(rng.standard_normal(samples)), u


@pytest.mark.parametrize("kind", ["white noise", "smooth noise"])
def test_a_spurious_regression_of_a_random_walk_says_that_the_inputs_may_be_unrelated(
    kind: str,
) -> None:
    """Levels that wander seem to depend on each other (Granger and Newbold, 1974)."""
    rejected = of_levels = 0
    for seed in range(100):
        y, u = walk_and_inputs(kind, seed)
        wandering = np.column_stack([np.cumsum(u, axis=0), np.ones(len(y))])
        model = wandering @ np.linalg.lstsq(wandering, y, rcond=None)[0]
        (test,) = residual_tests((y - model)[:, None], u, "y", "uv", model[:, None])
        of_levels += test.p < 0.005
        rejected += not test.accepted
        assert test.unrelated == ("may be unrelated to y" in test.finding())
    assert rejected <= 2
    assert of_levels > 15


def test_a_linear_model_of_a_random_walk_is_not_said_to_miss_an_effect() -> None:
    y, u = walk_and_inputs("white noise", 0, 800)
    record = sb.Record(y, 0.1, u=u, inputs=("a", "b"))
    found = sb.check(sb.Linear().fit(record[:500]), record[300:])
    assert found.tests[0].p < 0.005  # levels would reject it
    assert found.outcome == "not rejected"
    assert "The inputs may be unrelated to y, which wanders like a random walk" in str(found)


@pytest.mark.parametrize("kind", ["white noise", "smooth noise", "20 steps"])
def test_inputs_that_act_are_judged_beside_integrated_noise(kind: str) -> None:
    """The right model is not rejected, half its gain is; and so for an integrator."""
    for seed in range(10):
        walk, u = walk_and_inputs(kind, seed, 1000)
        for pole in (0.95, 1.0):
            x = scipy.signal.lfilter([0.0, 1.0], [1.0, -pole], u[:, 0])
            y = x + 0.3 * np.diff(x).std() * walk
            tests = [
                residual_tests((y - m)[:, None], u[:, :1], "y", "u", m[:, None])[0]
                for m in (x, 0.5 * x)
            ]
            assert [test.accepted for test in tests] == [True, False], (seed, pole)
            assert not any(test.unrelated for test in tests)


def test_the_ljung_box_statistic_is_that_of_its_definition() -> None:
    e = np.random.default_rng(2).standard_normal(300)
    x = e - e.mean()
    r = np.array([np.sum(x[k:] * x[:-k]) for k in range(1, LAGS + 1)]) / np.sum(x**2)
    q = 300 * 302 * sum(r[k - 1] ** 2 / (300 - k) for k in range(1, LAGS + 1))
    (test,) = residual_tests(e[:, None], None, ("y",), ())
    np.testing.assert_allclose(test.whiteness.values, r)
    assert test.whiteness.p == pytest.approx(1 - scipy.stats.chi2.cdf(q, LAGS))
    assert test.whiteness.band == pytest.approx(2.5758 / np.sqrt(300), rel=1e-4)


def driven(samples: int, seed: int = 0) -> sb.Record:
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(samples)
    y = scipy.signal.lfilter([0.5], [1.0, -0.8], u) + 0.01 * rng.standard_normal(samples)
    return sb.Record(y, 0.1, u=u, inputs=("force",))


def test_a_good_model_is_accepted_with_its_fits_on_a_record_with_gaps() -> None:
    model = sb.Linear().fit(driven(600))
    other = driven(400, 1)
    y = other.y.copy()
    y[200:210] = np.nan
    gaps = sb.Record.with_gaps(y, 0.1, other.u, inputs=("force",))
    found = sb.check(model, gaps)
    assert found.accepted
    assert [*found.fits] == ["simulation", "1 sample ahead", "10 samples ahead"]
    (fit,) = found.fits["simulation"]
    simulated = model.predict(350, other[:50], **known_after(other, 50), other_record=True).y
    assert fit == pytest.approx(sb.fit_percent(gaps.y_with_gaps[50:], simulated)[0])
    assert "stays in range" in str(found)


class Growing(sb.Forecaster):
    """Doubles in 100 samples."""

    name = "growing"

    def extrapolate(self, known: ForecastContext) -> Array:
        return np.asarray(known.y[-1] * 2.0 ** (np.arange(1, known.steps + 1)[:, None] / 100))


def test_a_free_run_that_leaves_the_range_and_an_input_beyond_it_are_named() -> None:
    record = sb.Record(np.sin(0.3 * np.arange(300)), 0.1)
    found = sb.check(Growing().fit(record), record)
    assert not found.accepted
    assert f"leaves the range of the training record by far after {found.leaves:,}" in str(found)
    model = sb.Linear().fit(driven(600))
    far: Any = driven(400, 1)
    found = sb.check(model, sb.Record(5 * far.y, 0.1, u=5 * far.u, inputs=("force",)))
    assert any("force" in line and "range in training" in line for line in found.in_words())


class Bounded(Growing):
    """A network whose linear part has a pole outside the unit circle; its simulation is bounded."""

    name = "bounded"

    def learn(self, records: Any, **_: Any) -> None:
        self.fitted = self.require_fitted().reporting(growth=1.02)

    def extrapolate(self, known: ForecastContext) -> Array:
        return np.zeros((known.steps, known.y.shape[1]))


class Leaving(Bounded):
    """Another one, whose simulation leaves the range."""

    name = "leaving"
    extrapolate = Growing.extrapolate


def test_a_network_is_judged_by_its_simulation_whatever_the_pole_of_its_linear_part() -> None:
    record = sb.Record(np.sin(0.3 * np.arange(300)), 0.1)
    found = sb.check(Bounded().fit(record), record)
    assert "simulation" in found.fits
    assert "stays in range" in str(found)
    found = sb.check(Leaving().fit(record), record)
    assert "simulation" not in found.fits
    assert "perhaps unstable: its linear part has the pole 1.02" in str(found)


def test_no_long_free_run_is_asked_of_a_model_with_an_exported_trajectory() -> None:
    time = 0.1 * np.arange(400)
    truth = sb.Recorded.of(sb.Record(np.sin(time), 0.1))
    record = sb.Record(1.1 * np.sin(time), 0.1)
    found = sb.check(sb.Calibrated(truth, ("gain",)).fit(record[:300]), record)
    assert found.fits["simulation"] == pytest.approx([100.0])
    assert "it needs the simulator's output beyond the record" in str(found)


def test_a_record_that_is_too_short_is_named() -> None:
    model = sb.Mean().fit(sb.Record(np.sin(np.arange(99.0)), 0.1))
    with pytest.raises(ValueError, match="record must have 50 samples after the warm-up of mean"):
        sb.check(model, sb.Record(np.sin(np.arange(40.0)), 0.1))
    holed = np.where(np.arange(400) % 20, np.sin(np.arange(400.0)), np.nan)
    with pytest.raises(ValueError, match="takes 50 samples in a row without gaps, got 400"):
        sb.check(model, sb.Record.with_gaps(holed, 0.1))

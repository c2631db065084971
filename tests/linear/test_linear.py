"""The linear model, against linear systems of SciPy."""

import itertools
import tracemalloc
from collections.abc import Callable, Iterator
from typing import Any, cast
from unittest.mock import patch

import numpy as np
import numpy.typing as npt
import pytest
import scipy.signal
from hypothesis import given, settings
from hypothesis import strategies as st

import splitband as sb
from benchmarks.driven import drawn
from benchmarks.linear import PLANTS
from splitband.linear.identification import identified
from splitband.linear.kalman import states
from splitband.linear.model import LinearModel
from splitband.linear.refinement import (
    Blocks,
    Signals,
    blocks_of,
    by_segment,
    equations,
    linear_solution,
    segments,
    total,
)
from splitband.linear.subspace import subspace
from splitband.metrics import fit_percent
from splitband.records.named import overhead_crane
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import Deadline, current, within
from tests.support import known_after

TRAIN, LENGTH = 400, 600


def polynomial(roots: npt.ArrayLike) -> Array:
    return np.real(np.poly(np.asarray(roots))).astype(np.float64)


def inputs(samples: int = LENGTH, nu: int = 1, seed: int = 0) -> Array:
    """Steps of random height and length."""
    rng = np.random.default_rng(seed)
    u: Array = rng.standard_normal((samples, nu))
    held = np.maximum.accumulate(np.where(rng.random(samples) < 0.2, np.arange(samples), 0))
    return u[held]


def oscillators(u: Array, begin: float = 0.0) -> Array:
    """Two masses driven by all inputs, their two positions; SciPy's simulation."""
    a = np.array([[0, 0, 1, 0], [0, 0, 0, 1], [-9, 4, -0.4, 0.1], [4, -6, 0.1, -0.3]])
    b = np.zeros((4, u.shape[1]))
    b[2:] = np.arange(1, 2 * u.shape[1] + 1).reshape(2, -1)
    c = np.eye(2, 4)
    system = scipy.signal.cont2discrete((a, b, c, np.zeros((2, u.shape[1]))), 0.2)
    _, y, _ = scipy.signal.dlsim((*system[:4], 0.2), u, x0=begin * np.arange(1, 5))
    return np.asarray(y)


def fit_on(model: LinearModel, u: Array, y: Array, known: int = 50) -> Array:
    """Return the fit of a simulation after `known` samples of another record."""
    found, *_ = model.continued(u, y[:known])
    return np.asarray(fit_percent(y[known:], found[known:]))


@pytest.mark.parametrize(("nu", "begin"), [(1, 0.0), (2, 1.0)], ids=["at rest", "in motion"])
def test_a_linear_system_is_found_and_goes_on_as_it_does(nu: int, begin: float) -> None:
    u = inputs(nu=nu)
    y = oscillators(u, begin)
    found = identified([(y[:TRAIN], u[:TRAIN])])
    np.testing.assert_allclose(found.simulate(u), y, atol=1e-5)
    assert found.order == 4


def test_units_and_offsets_do_not_matter() -> None:
    u, noise = inputs(), np.random.default_rng(1).standard_normal((LENGTH, 2))
    y = oscillators(u) + 0.01 * noise
    plain = identified([(y[:TRAIN], u[:TRAIN])]).simulate(u)
    moved_u = 300 - 50 * u
    moved = identified([(1e6 + 1e-3 * y[:TRAIN], moved_u[:TRAIN])]).simulate(moved_u)
    np.testing.assert_allclose(moved, 1e6 + 1e-3 * plain, atol=1e-6)


def test_what_was_not_measured_is_gone_around() -> None:
    u, noise = inputs(), np.random.default_rng(1).standard_normal((LENGTH, 2))
    y = oscillators(u, 1.0)
    seen = y + 0.1 * noise
    seen[:20] = seen[100:150] = seen[200:240, 1] = seen[390:400] = np.nan
    found = identified([(seen[:TRAIN], u[:TRAIN])]).simulate(u)[TRAIN:]
    assert np.sqrt(np.mean((found - y[TRAIN:]) ** 2)) < 0.05


def test_a_gap_at_the_beginning_is_as_a_record_that_begins_after_it() -> None:
    """A slow pole, a fast one and a friction that no linear model has: orders differ easily."""
    g, lead, n = np.random.default_rng(2), 100, 1000
    u = np.repeat(g.normal(size=50), 30)
    x = np.zeros((1500, 2))
    x[0] = 3, 0
    for k in range(1, len(x)):
        x[k] = 0.997 * x[k - 1, 0] + 0.01 * u[k] + 0.003 * abs(u[k]), 0.9 * x[k - 1, 1] + 0.1 * u[k]
    y = x.sum(axis=1) + 0.1 * np.tanh(x[:, 1]) + 0.02 * g.normal(size=len(x))
    seen = np.where(np.arange(len(y)) < lead, np.nan, y)
    gap, cut = sb.Record.with_gaps(seen, 0.1, u=u), sb.Record(y[lead:], 0.1, u=u[lead:])
    models = sb.Linear().fit(gap[:n]), sb.Linear().fit(cut[: n - lead])
    found, wanted = (model.predict(500, u=u[n:, None]).y for model in models)
    np.testing.assert_allclose(found, wanted, atol=1e-6)
    whole, after = (m.model.simulate(r.u[:n]) for m, r in zip(models, (gap, cut), strict=True))
    apart = np.abs(whole[lead:] - after[: n - lead])
    assert np.median(apart) < 0.1 * np.std(y)


def test_gaps_that_leave_no_window_whole_cost_no_accuracy() -> None:
    u = inputs(2000)
    y = oscillators(u)
    seen = y + 0.01 * y.std(axis=0) * np.random.default_rng(1).standard_normal(y.shape)
    seen[::7] = np.nan
    assert fit_on(identified([(seen, u)]), u[::-1], oscillators(u[::-1])).min() > 99


def test_the_order_of_a_short_record_is_chosen() -> None:
    u = np.random.default_rng(0).standard_normal((62, 1))
    y = scipy.signal.lfilter(
        [0.5, -0.2], polynomial([0.9 * np.exp(0.5j), 0.9 * np.exp(-0.5j)]), u, 0
    )
    found = identified([(np.asarray(y), u)])
    np.testing.assert_allclose(found.simulate(u), y, atol=1e-5)


def test_lightly_damped_modes_are_found_all_at_once() -> None:
    """Six modes, two inputs and outputs, noise of 1 %: a subspace method has more than 99.5 %."""
    rng = np.random.default_rng(4)
    w = 2 * np.pi * np.sort(rng.uniform(0.02, 0.4, 6))
    a = scipy.linalg.block_diag(*(np.array([[0, x], [-x, -0.02 * x]]) for x in w))
    b, c = np.zeros((12, 2)), np.zeros((2, 12))
    b[1::2], c[:, ::2] = rng.standard_normal((6, 2)), rng.standard_normal((2, 6))
    system = scipy.signal.cont2discrete((a, b, c, np.zeros((2, 2))), 1.0)
    u = rng.standard_normal((8000, 2))
    y = np.asarray(scipy.signal.dlsim((*system[:4], 1.0), u)[1])
    seen = y + 0.01 * y.std(axis=0) * rng.standard_normal(y.shape)
    found = identified([(seen[:4000], u[:4000])])
    assert found.order == 12
    assert fit_on(found, u[4000:], y[4000:], 500).min() > 99.5


@pytest.mark.parametrize("chain", [1, 2], ids=["one", "two in a row"])
def test_an_integrator_has_its_pole_at_1(chain: int) -> None:
    rng = np.random.default_rng(5)
    u = rng.choice([-1.0, 1.0], 100).repeat(30)
    level = scipy.signal.lfilter([0, 0.02], polynomial([1.0] * chain), u)[:, None]
    seen = level + 0.01 * level.std() * rng.standard_normal(level.shape)
    found = identified([(seen[:2000], u[:2000, None])])
    assert found.integrators == found.order == chain
    ahead, *_ = found.continued(u[:, None], seen[:2000], u[:0, None])
    assert fit_percent(level[2000:], ahead[2000:]).min() > 99


def test_an_integrator_does_not_hide_a_lag_in_a_long_record() -> None:
    """The output wanders: noise of 2 % of its deviation hides the lag from a fit without it."""
    rng = np.random.default_rng(0)
    u = rng.choice([-1.0, 1.0], 1200).repeat(50)
    y = scipy.signal.lfilter([0, 0, 0.001], polynomial([1.0, 0.95]), u)[:, None]
    found = identified([(y + 0.02 * y.std() * rng.standard_normal(y.shape), u[:, None])])
    assert (found.order, found.integrators, found.delays) == (2, 1, (0,))
    np.testing.assert_allclose(np.sort(found.poles().real), [0.95, 1.0], atol=2e-3)


def test_two_integrators_are_found_in_a_long_record_where_a_free_fit_misses_both() -> None:
    rng = np.random.default_rng(1)
    u = rng.choice([-1.0, 1.0], (1201, 2)).repeat(50, axis=0)[:60_000]
    y = scipy.signal.lfilter([0, 0.02], [1, -1], u, axis=0)
    found = identified([(y + 0.02 * y.std(axis=0) * rng.standard_normal(y.shape), u)])
    assert (found.order, found.integrators) == (2, 2)
    other = rng.choice([-1.0, 1.0], (40, 2)).repeat(50, axis=0)
    truth = scipy.signal.lfilter([0, 0.02], [1, -1], other, axis=0)
    assert fit_on(found, other, np.asarray(truth)).min() > 99


def test_a_swinging_load_on_a_trolley_is_an_integrator_and_a_pair_of_poles() -> None:
    """Its inputs wander: a subspace of this order has another pole near 1 in place of the pair."""
    record = overhead_crane()
    model = sb.Linear().fit(record[:2000])
    assert (model.model.order, model.model.integrators) == (3, 1)
    ahead = model.predict(2000, u=record.u[2000:]).y
    assert np.sqrt(np.mean((ahead - record.y[2000:]) ** 2)) < 0.4


def test_an_unknown_constant_flow_into_a_tank_is_estimated() -> None:
    u = inputs()
    level = np.cumsum(0.1 * u[:, 0] - 0.05)[:, None]
    found = identified([(level[:TRAIN], u[:TRAIN])])
    np.testing.assert_allclose(found.simulate(u), level, atol=1e-5)


def test_more_samples_help_although_the_input_rests_in_them() -> None:
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-1, 1, 31), 400)[:12000, None]
    u[6000:] = 0.5
    y = scipy.signal.lfilter([0, 0.01], [1, -0.99], u, axis=0)
    found = identified([(y + 0.02 * rng.standard_normal(y.shape), u)])
    other = np.repeat(rng.uniform(-1, 1, 10), 400)[:, None]
    truth = scipy.signal.lfilter([0, 0.01], [1, -0.99], other, axis=0)
    assert fit_on(found, other, np.asarray(truth)).min() > 99


def test_a_delay_of_any_length_is_found() -> None:
    rng, delay = np.random.default_rng(0), 1000
    u = rng.choice([-1.0, 1.0], 200).repeat(20)
    y = np.append(np.zeros(delay), scipy.signal.lfilter([0.1], [1, -0.9], u)[:-delay])[:, None]
    found = identified([(y + 0.01 * rng.standard_normal(y.shape), u[:, None])])
    assert found.delays == (delay,)
    assert found.order == 1
    assert fit_percent(y[delay:], found.simulate(u[:, None])[delay:]).min() > 99


def test_a_delay_of_more_than_half_the_record_is_simulated_as_it_was_fitted() -> None:
    u = np.random.default_rng(0).standard_normal(100)
    late = np.append(np.full(60, u[0]), u[:-60])
    y = (
        scipy.signal.lfilter([0.5], [1, -0.95], late)[:, None]
        + 5 * 0.95 ** np.arange(100.0)[:, None]
    )
    found = sb.Linear(order=1, delay=60, integrators=0).fit(sb.Record(y, 0.1, u=u)).model
    assert fit_percent(y, found.simulate(u[:, None])).min() > 99


def test_each_output_has_delays_of_its_own() -> None:
    rng = np.random.default_rng(0)
    u = rng.standard_normal((2000, 1))
    x = scipy.signal.lfilter([0.1], [1, -0.9], u[:, 0])
    y = np.stack([x, np.append(np.zeros(250), x[:-250])], axis=1)
    found = identified([(y + 0.01 * rng.standard_normal(y.shape), u)])
    assert found.taps == ((0, 0), (0, 250))
    assert fit_percent(y[250:], found.simulate(u)[250:]).min() > 98


def test_what_has_died_out_before_the_record_is_not_made_up() -> None:
    rng = np.random.default_rng(3)
    u = rng.standard_normal((9000, 1))
    y = scipy.signal.lfilter([0.001], [1, -0.999], u[:, 0])[:, None]
    noisy = y + 0.1 * y.std() * rng.standard_normal(y.shape)
    found = identified([(noisy[:8500], u[:8500])]).simulate(u)
    assert np.sqrt(np.mean((found - y) ** 2)) < 0.2 * y.std()


def test_the_filter_predicts_one_step_as_well_as_the_true_one() -> None:
    """An innovations form of order 2: of the true filter's error at most 1.02 times."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        a = np.array([[1.5, -0.7], [1.0, 0.0]])
        b, c, k = np.array([1.0, 0.0]), np.array([0.5, 0.2]), np.array([0.9, 0.4])
        u, e = rng.standard_normal((2, 6000))
        x, y = np.zeros(2), np.zeros(6000)
        for n in range(6000):
            y[n] = c @ x + e[n]
            x = a @ x + b * u[n] + k * e[n]
        found = identified([(y[:3000, None], u[:3000, None])])
        ahead, *_ = found.continued(u[:, None], y[:, None])
        left = y[3000:] - ahead[3000:, 0]
        assert np.sqrt(np.mean(left**2)) < 1.02 * np.sqrt(np.mean(e[3000:] ** 2))


def test_behind_a_controller_noise_does_not_bias_the_pole() -> None:
    """A proportional controller acts on the noisy output one sample later."""
    poles = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        setpoint, e = rng.choice([-1.0, 1.0], 150).repeat(20), rng.standard_normal(3000)
        y, u, x = np.zeros(3000), np.zeros(3000), 0.0
        for n in range(3000):
            y[n] = x + 0.5 * e[n]
            u[n] = 2.0 * (setpoint[n] - y[n - 1])
            x = 0.9 * x + 0.1 * u[n] + 0.45 * e[n]
        found = identified([(y[:, None], u[:, None])], order=1, integrators=0)
        assert found.by == "prediction error"
        poles.append(found.poles()[0].real)
    assert np.mean(poles) == pytest.approx(0.9, abs=0.015)


def test_errors_of_a_nonlinear_system_are_not_taken_for_a_controller() -> None:
    """A filter, a diode, a filter: a smooth input can be predicted from its own effect."""
    record, _ = drawn("Wiener-Hammerstein", 126, 1000)
    assert identified([(record.y, record.u)]).by == "output error"


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_sensors_of_the_output_are_not_taken_for_a_controller(seed: int) -> None:
    rng, time, angle = np.random.default_rng(seed), 0.02 * np.arange(3000), np.zeros(3000)
    for k in range(25):
        size = rng.normal(0, 6) / (1 + 0.3 * k)
        turns = 0.03 * (k + 1) * rng.uniform(0.6, 1.4) * time + rng.uniform(0, 1)
        angle += size * np.sin(2 * np.pi * turns)
    u = angle[:, None] + 3 * rng.standard_normal((3000, 1))
    y = angle[:, None] + 0.05 * rng.standard_normal((3000, 1))
    found = identified([(y[:2250], u[:2250])])
    assert fit_percent(y[2250:], found.simulate(u)[2250:]) > 75


def closed_loop(seed: int) -> tuple[sb.Record, sb.Record]:
    """One run, with the controller's output and with the set-point as the input."""
    rng = np.random.default_rng(seed)
    setpoint, e = rng.choice([-1.0, 1.0], 150).repeat(20), rng.standard_normal(3000)
    y, u, x = np.zeros(3000), np.zeros(3000), 0.0
    for n in range(3000):
        y[n] = x + 0.1 * e[n]
        u[n] = 3.0 * (setpoint[n] - y[n])
        x = 1.05 * x + 0.1 * u[n] + 0.05 * e[n]
    return sb.Record(y, 0.1, u=u), sb.Record(y, 0.1, u=setpoint)


def test_an_unstable_plant_behind_a_controller_is_unstable_and_its_loop_is_not() -> None:
    plant, loop = closed_loop(0)
    direct, whole = sb.Linear(order=1).fit(plant), sb.Linear().fit(loop)
    assert direct.poles()[0].real == pytest.approx(1.05, abs=0.02)
    assert not direct.require_fitted().report.stable
    assert whole.poles().real == pytest.approx([0.75], abs=0.02)
    plant, loop = closed_loop(1)
    for model, record in ((direct, plant), (whole, loop)):
        assert sb.check(model, record[:400]).fits["1 sample ahead"][0] > 85
    assert sb.check(whole, loop[:400]).fits["simulation"][0] > 85


def test_order_delay_and_integrators_can_be_given() -> None:
    u = inputs(nu=2)
    record = sb.Record(oscillators(u), 0.2, u=u)
    found = sb.Linear(order=2, delay=[0, 3], integrators=1).fit(record)
    assert found.poles().shape == (2,)
    assert found.poles().real.max() == pytest.approx(1, abs=1e-12)
    assert found.delays == (0, 3)
    u = inputs()
    each = sb.Linear(delay=[[4], [5]]).fit(sb.Record(oscillators(u), 0.2, u=u))
    assert each.model.taps == ((0, 4), (0, 5))


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (lambda r: sb.Linear(order=0), "order must be between 1 and 200, got 0"),
        (lambda r: sb.Linear(integrators=-1), "integrators must be between 0 and 200, got -1"),
        (lambda r: sb.Linear(delay=[1, 2, 3]).fit(r), "delay must be whole numbers of samples"),
        (lambda r: sb.Linear(delay=cast(Any, 1.5)).fit(r), "delay must be whole numbers of samp"),
        (lambda r: sb.Linear(order=50).fit(r[:40]), "order must suit the record, got 50"),
    ],
)
def test_what_cannot_be_is_refused(make: Any, said: str) -> None:
    u = inputs(nu=2)
    with pytest.raises(ValueError, match=said):
        make(sb.Record(oscillators(u), 0.2, u=u))


def test_an_input_that_never_moves_is_named() -> None:
    u = inputs(nu=2)
    u[:, 1] = 7.0
    found = sb.Linear().fit(sb.Record(oscillators(u), 0.2, u=u, inputs=("force", "valve")))
    assert "constant in training, effect unknown: valve" in found.describe()


@settings(max_examples=settings().max_examples // 6)
@given(
    samples=st.integers(1, 30), nu=st.integers(1, 3), seed=st.integers(0, 99), same=st.booleans()
)
def test_short_and_constant_records_give_finite_numbers(
    samples: int, nu: int, seed: int, same: bool
) -> None:
    rng = np.random.default_rng(seed)
    u = np.ones((samples + 20, nu)) if same else rng.standard_normal((samples + 20, nu))
    for y in (np.full((samples, 1), 7.0), rng.standard_normal((samples, 1))):
        assert np.isfinite(identified([(y, u[:samples])]).simulate(u)).all()
    constant = identified([(np.full((samples, 1), 7.0), u[:samples])])
    np.testing.assert_allclose(constant.simulate(u)[samples:], 7, atol=1e-6)


def test_a_further_record_may_be_shorter_than_the_model_is_long() -> None:
    u = inputs()
    whole = sb.Record(oscillators(u), 0.2, u=u)
    fitted = sb.Linear().fit(whole[:TRAIN], whole[TRAIN : TRAIN + 3])
    np.testing.assert_allclose(
        fitted.predict(50, whole[:TRAIN], u=u[TRAIN : TRAIN + 50]).y,
        whole.y[TRAIN : TRAIN + 50],
        atol=0.1,
    )


def test_long_records_are_fitted_whole_and_their_order_by_windows() -> None:
    """A slow pole, of which windows see little, beside a fast one; the input mostly rests."""
    rng = np.random.default_rng(0)
    u = np.repeat(rng.choice([-1.0, 1.0], 1500), 40)
    u[15_000:40_000] = 1.0
    slow, fast = (
        scipy.signal.lfilter([0, 1e-4], [1, -0.9999], u),
        scipy.signal.lfilter([0, 0.1], [1, -0.9], u),
    )
    y = slow + fast
    found = identified([((y + 0.01 * rng.standard_normal(len(y)))[:, None], u[:, None])])
    poles = np.sort(np.log(found.poles().real))
    np.testing.assert_allclose(poles, np.log([0.9, 0.9999]), rtol=0.02)


def test_the_equations_of_a_long_record_are_the_sum_of_those_of_its_parts() -> None:
    """Those of every nth sample led to 85 % of fit where a million samples have 98."""
    rng = np.random.default_rng(0)
    u = rng.normal(size=(1, 60_000))
    run = Signals(u, scipy.signal.lfilter([0.1], [1, -0.9], u), np.ones_like(u))
    blocks = blocks_of(np.array([[0.8]]), np.ones((1, 1)), [False])
    at = linear_solution(blocks, [run])
    whole = equations(at, [run], blocks.free)
    parts = total(by_segment(at, [run], blocks.free, segments([run], 7)))
    np.testing.assert_allclose(whole.n, parts.n, rtol=1e-9)
    np.testing.assert_allclose(whole.g, parts.g, rtol=1e-6, atol=1e-9 * abs(whole.n).max())


def test_a_fit_that_its_deadline_ends_is_nearly_as_good() -> None:
    """The deadline passes at the twelfth look at the clock; the best model so far is kept."""
    u, y, seen = PLANTS["12 modes, 3 x 3"].record(0, 6000)
    clock = itertools.count()
    looked = patch("splitband.runtime.deadlines.now", lambda: float(next(clock)))
    with looked, within(Deadline(12.0)):
        found = identified([(seen, u)], delay=np.zeros((3, 3), int))
    assert found.uncertainty is None
    assert np.min(fit_percent(y, found.simulate(u))) > 90


def test_after_the_deadline_no_work_grows_with_the_record_but_a_simulation() -> None:
    """What a pass of derivatives over all samples takes is not known; two outputs and inputs."""
    u = inputs(200_000, 2)
    seen = oscillators(u) + 0.01 * np.random.default_rng(1).standard_normal((200_000, 2))
    record, samples = sb.Record(seen, 0.2, u=u), 0
    chunks = Blocks.chunks

    def counted(*of: Any) -> Iterator[Any]:
        nonlocal samples
        for chunk in chunks(*of):
            samples += chunk[1].shape[2] * current().over
            yield chunk

    with patch.object(Blocks, "chunks", counted), within(Deadline.after(0.2)):
        late = sb.Linear().fit(record)
    assert late.require_fitted().report.cut
    assert samples < 20 * 20_000
    assert fit_on(late.model, u[:2000], oscillators(u[:2000])).min() > 99


def test_the_response_of_outputs_with_different_delays_is_that_at_its_angles() -> None:
    u = inputs(400)
    late = np.append(np.repeat(u[:1, 0], 150), u[:-150, 0])
    y = scipy.signal.lfilter([0, 0.1], [1, -0.9], np.stack([late, u[:, 0]], axis=1), axis=0)
    y += 0.01 * np.random.default_rng(1).standard_normal(y.shape)
    model = sb.Linear(order=1, delay=[[151], [1]]).fit(sb.Record(y, 0.2, u=u))
    found = model.uncertainty()
    for k in range(2):
        _, expected = scipy.signal.dfreqresp(cast(Any, model.transfer_function(k)), found.angles)
        np.testing.assert_allclose(found.response[:, k, 0], abs(expected), rtol=1e-6)


@pytest.mark.parametrize("sign", [1, -1])
def test_the_infinite_gain_of_an_integrator_has_its_sign(sign: int) -> None:
    u = inputs()
    y = scipy.signal.lfilter([0, 0.02 * sign], [1, -1], u[:, 0])
    model = sb.Linear(order=1, delay=1, integrators=1).fit(sb.Record(y, 0.2, u=u))
    assert model.uncertainty().gains == [[sign * np.inf]]


@pytest.mark.parametrize("seldom", [0, 1])
def test_two_sensors_of_one_signal_may_be_sampled_at_different_rates(seldom: int) -> None:
    """The covariance of their errors is one: symmetric, and without negative variances."""
    rng = np.random.default_rng(0)
    u = np.repeat(np.sign(rng.standard_normal(30)), 10)
    y = scipy.signal.lfilter([0, 0.1], [1, -0.9], u)
    y += scipy.signal.lfilter([1], [1, -0.6], 0.1 * rng.standard_normal(300))
    seen = np.stack([y, y], axis=1) + 1e-3 * rng.standard_normal((300, 2))
    seen[np.arange(300) % 10 > 0, seldom] = np.nan
    model = sb.Linear(order=1, delay=1).fit(sb.Record.with_gaps(seen, 0.1, u=u)).model
    np.testing.assert_allclose(model.noise, model.noise.T, rtol=1e-12)
    variances = np.linalg.eigvalsh(model.noise)
    assert variances[0] > -1e-12 * variances[1]


def test_a_slow_pole_that_the_record_does_not_determine_is_no_integrator() -> None:
    """Two filters with a diode between them: a simulation of more samples would drift away."""
    record, test = drawn("Wiener-Hammerstein", 104, 400)
    model = sb.Linear().fit(record)
    assert (abs(model.poles()) < 1).all()
    with pytest.warns(sb.ExtrapolationWarning):  # the test's input goes a little beyond
        y = model.predict(len(test) - 50, test[:50], **known_after(test, 50), other_record=True).y
    assert fit_percent(test.y[50:], y)[0] > 60


def peak(work: Callable[[], object]) -> int:
    """Most bytes that arrays take in addition to those of before."""
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def test_a_long_record_takes_the_memory_of_its_states_or_windows_once() -> None:
    u, rows = inputs(40_000, 4), 10
    assert peak(lambda: states(0.9 * np.eye(4), u, np.zeros(4))) < 1.5 * u.nbytes
    of_windows = 2 * rows * u.nbytes
    assert peak(lambda: subspace([(u[:, :2], u[:, 2:])], rows)) < 1.5 * of_windows

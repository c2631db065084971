"""A simulator with fitted parameters as a forecaster: from any origin, on any record."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy

import splitband as sb
from splitband.checks.model import tests_on as residuals_on
from splitband.runtime.arrays import Array
from splitband.simulators.open_simulator import simulated

DT, STEPS = 0.1, 80


def lagging(t: float, x: Any, u: Any, p: Any) -> list[float]:
    return [x[1], p.k * (u[0] - x[0]) - p.c * x[1]]


def rig(**parameters: Any) -> sb.Ode:
    given: dict[str, Any] = {"k": (0.5, 20.0), "c": (0.05, 2.0)} | parameters
    return sb.Ode(lagging, [0.0, 0.0], parameters=given)


def driven(seed: int, state: tuple[float, float] = (0.0, 0.0), noise: float = 0.01) -> sb.Record:
    """By SciPy's linear simulation: k = 4, c = 0.5."""
    random = np.random.default_rng(seed)
    u = np.repeat(random.normal(size=40), 10)
    system = [[0.0, 1.0], [-4.0, -0.5]], [[0.0], [4.0]], [[1.0, 0.0]], [[0.0]]
    _, y, _ = scipy.signal.lsim(system, u, DT * np.arange(400), X0=state)
    return sb.Record(y + random.normal(0, noise, 400), DT, u=u, y_true=y)


def inputs(record: sb.Record) -> Array:
    return record.u


@pytest.fixture(scope="module")
def model() -> sb.GreyBox:
    return sb.GreyBox(rig(), starts=2).fit(driven(0)[:300])


def test_it_forecasts_from_the_end_of_its_training_record(model: sb.GreyBox) -> None:
    record = driven(0)
    found = model.predict(100, u=inputs(record)[300:])
    np.testing.assert_allclose(found.y, record.truth[300:], atol=0.01)
    later = model.predict(STEPS, record[:320], inputs(record)[320:])
    np.testing.assert_allclose(later.y, record.truth[320:], atol=0.01)
    assert model.describe().startswith("k = ")


@pytest.mark.parametrize("warmup", [5, 100])
def test_another_record_begins_in_a_state_of_its_own(model: sb.GreyBox, warmup: int) -> None:
    record = driven(1, state=(2.0, -1.0))
    coming = inputs(record)[warmup:]
    found = model.predict(STEPS, record[:warmup], coming, other_record=True)
    expected = record.truth[warmup : warmup + STEPS]
    assert sb.nrmse(expected, found.y) < (0.1 if warmup < 10 else 0.02)
    # Its time stamps are those of the training record, its inputs are not.
    np.testing.assert_allclose(model.predict(STEPS, record[:warmup], coming).y, found.y, atol=0.05)


def test_a_wrong_model_goes_on_from_what_was_measured_last() -> None:
    """Its friction is missing: a free run of the whole record is late and too large."""

    def without_friction(t: float, x: Any, u: Any, p: Any) -> list[float]:
        return [x[1], -p.k * x[0]]

    time = DT * np.arange(400)
    y = 3 * np.exp(-0.05 * time) * np.cos(2 * time)
    record = sb.Record(y + np.random.default_rng(0).normal(0, 0.005, 400), DT)
    how: Any = {"parameters": {"k": (1.0, 10.0)}, "tolerances": (1e-5, 1e-5)}
    model = sb.GreyBox(sb.Ode(without_friction, [3.0, 0.0], **how), starts=2).fit(record[:300])
    assert 0 < model.memory < 100
    assert sb.nrmse(y[300:310, None], model.predict(10).y) < 0.1


def test_a_saved_model_needs_its_simulator_and_keeps_its_values(
    model: sb.GreyBox, tmp_path: Path
) -> None:
    record = driven(0)
    model.save(tmp_path)
    # With other ranges: the values are those that were fitted.
    loaded = sb.load(tmp_path, simulator=rig(k=(1.0, 2.0)))
    expected = model.predict(100, u=inputs(record)[300:]).y
    np.testing.assert_allclose(loaded.predict(100, u=inputs(record)[300:]).y, expected, atol=1e-6)
    assert loaded.describe() == model.describe()


def test_a_hybrid_fits_the_parameters_first(model: sb.GreyBox) -> None:
    record = driven(0)
    settings = sb.TrainingSettings.paper(window=40, warmup=10, epochs=2)
    hybrid = sb.Residual(rig(), sb.GRU(4), settings=settings).fit(record[:300], seed=0)
    assert hybrid.name == "residual-grey-box-gru"
    assert f"grey-box: {model.describe()}" in hybrid.describe()
    found = hybrid.predict(100, u=inputs(record)[300:]).components["grey-box"]
    np.testing.assert_allclose(found, record.truth[300:], atol=0.01)


def test_a_black_box_function_is_fitted_too() -> None:
    def decays(t: Array, u: Any, p: Any) -> Array:
        return np.asarray(p.x0_1 * np.exp(-p.rate * (t - t[0])))

    y = 3 * np.exp(-0.5 * DT * np.arange(100))
    simulator = sb.Function(decays, parameters={"rate": (0.01, 10.0), "x0_1": (0.0, 5.0)})
    model = sb.GreyBox(simulator, starts=4).fit(sb.Record(y[:60], DT))
    assert model.estimate.values == pytest.approx({"rate": 0.5, "x0_1": 3.0}, rel=1e-4)
    np.testing.assert_allclose(model.predict(40).y[:, 0], y[60:], atol=1e-5)
    other = sb.Record(2.0 * y[:30] / 3.0, DT)
    found = model.predict(20, other, other_record=True)
    np.testing.assert_allclose(found.y[:, 0], 2 / 3 * y[30:50], atol=1e-4)


def test_a_black_box_is_fitted_to_the_whole_record() -> None:
    """No window begins later than the record: the first 30 samples, which fit, are not enough."""
    time = DT * np.arange(400)
    y = np.where(np.arange(400) < 30, 2.0 * time, 20 * np.sign(np.sin(0.9 * time)))
    ramp = sb.Function(lambda t, u, p: p.k * (t - t[0]), parameters={"k": (-5.0, 5.0)})
    model = sb.GreyBox(ramp, starts=4).fit(sb.Record(y, DT))
    assert model.estimate.values == pytest.approx({"k": time @ y / (time @ time)}, rel=1e-3)


def test_a_detrended_record_is_refused_beside_a_simulator_of_its_own(tmp_path: Path) -> None:
    record = sb.Record(3 + np.sin(DT * np.arange(400)), DT, start=0.0)
    alone = sb.Function(lambda t: 3 + np.sin(t))
    fitted = sb.Function(lambda t, u, p: p.a + np.sin(t), parameters={"a": (0.0, 5.0)})
    for model in (sb.Simulation(alone), sb.GreyBox(fitted)):
        with pytest.raises(ValueError, match="record must not be detrended for"):
            model.fit(record.detrend())
        with pytest.raises(ValueError, match="record must not be detrended for"):
            simulated(record.detrend(), alone)
    given = replace(record, y_sim=record.y).detrend()
    model = sb.Simulation().fit(given[:300])
    np.testing.assert_allclose(model.predict(3, y_sim=given.y[300:]).y, given.y[300:303])
    model.save(tmp_path / "model")
    with pytest.raises(ValueError, match="record must not be detrended for simulator"):
        sb.load(tmp_path / "model", alone)


@pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")
def test_the_state_of_another_run_is_found_far_from_that_in_training() -> None:
    """A model without an error has a small noise, beside which a wrong state is far away."""
    time = DT * np.arange(400)

    def cooled(begin: float) -> sb.Record:
        return sb.Record(20 + (begin - 20) * np.exp(-0.1 * time), DT)

    rig = sb.Ode(lambda t, x, u, p: [-p.k * (x[0] - 20)], [60.0], parameters={"k": (0.01, 1.0)})
    model = sb.GreyBox(rig, starts=2).fit(cooled(60.0))
    other = cooled(80.0)
    found = model.predict(50, other[:50], other_record=True)
    np.testing.assert_allclose(found.y, other.y[50:100], atol=1e-3)


def test_a_loaded_one_asks_for_its_equation_whatever_it_is_asked(
    model: sb.GreyBox, tmp_path: Path
) -> None:
    model.save(tmp_path)
    loaded, record = sb.load(tmp_path), driven(3)
    for ask in (
        lambda: loaded.predict(STEPS, record[:100], inputs(record)[100:], other_record=True),
        lambda: loaded.predict(STEPS, record[:100], inputs(record)[100:]),
        lambda: loaded.stream(record[:100], other_record=True).step([0.0]),
        lambda: sb.check(loaded, record),
        lambda: loaded.fit(record),
    ):
        with pytest.raises(ValueError, match="simulator must be given"):
            ask()


def test_an_error_of_a_loaded_models_equation_says_where_it_is(
    model: sb.GreyBox, tmp_path: Path
) -> None:
    def other_shape(t: float, x: Any, u: Any, p: Any) -> Any:
        return np.ones(2) + np.ones(3)

    ranges: Any = {"k": (0.5, 20.0), "c": (0.05, 2.0)}
    model.save(tmp_path)
    loaded = sb.load(tmp_path, sb.Ode(other_shape, [0.0, 0.0], parameters=ranges))
    with pytest.raises(ValueError, match=r"could not be broadcast.*\(test_grey_box.py, line"):
        loaded.predict(5, driven(0)[:320], u=inputs(driven(0))[320:325])


@pytest.mark.filterwarnings("ignore:the equation lag is solved in Python")
@pytest.mark.parametrize(
    "gain", [lambda p: 1.0 / p.a, lambda p: math.sqrt(p.a - 0.5), lambda p: (p.a - 0.5) ** 0.5]
)
def test_an_equation_may_fail_in_the_middle_of_the_ranges(gain: Any) -> None:
    def lag(t: float, x: Any, u: Any, p: Any) -> list[float]:
        return [gain(p) * (u[0] - x[0])]

    u = np.sin(0.3 * np.arange(100))
    y = scipy.signal.lfilter([0.0, 0.1], [1.0, -0.9], u)
    simulator = sb.Ode(lag, [0.0], parameters={"a": (-2.0, 2.0)})
    assert sb.GreyBox(simulator, starts=4).fit(sb.Record(y, DT, u=u)).describe().startswith("a = ")


def test_residuals_of_an_unstable_hybrid_take_one_run_of_its_equation(
    monkeypatch: pytest.MonkeyPatch, model: sb.GreyBox
) -> None:
    """Not a search for the equation's state, over the whole history, before each sample."""
    runs, respond = list[int](), sb.Ode.respond

    def counted(self: Any, time: Array, *rest: Any) -> Any:
        runs.append(len(time))
        return respond(self, time, *rest)

    short = sb.TrainingSettings(window=40, warmup=20, epochs=1)
    bands = sb.Bands(0.2, 1, 1)
    hybrid = sb.Filtered(rig(k=4.0, c=0.5), sb.StateSpace(2), bands, True, short)
    hybrid.fit(driven(0)[:300], seed=0)
    hybrid.fitted = hybrid.require_fitted().reporting(growth=1.001, reach=50)
    fitted = sb.Ensemble.of([hybrid])
    monkeypatch.setattr(sb.Ode, "respond", counted)
    for samples in (200, 400):
        record = driven(1, state=(2.0, -1.0))[:samples]
        (tested,) = residuals_on(fitted, record)
        assert runs.count(samples) == 1
        assert sum(each > 20 for each in runs) == 1
        # By streams that observe every sample, which estimate the state of the equation once.
        stream = hybrid.stream(record[:20], other_record=True)
        left = []
        for n in range(20, samples):
            y = stream.copy().step(inputs(record)[n])
            left.append(record.y[n] - y)
            stream.observe(record.y[n], inputs(record)[n])
        size = np.sqrt(np.mean(np.square(left))) / record.y[20:].std()
        assert tested.size == pytest.approx(size, rel=1e-3)
        runs.clear()

"""Responses to steps, and the linear model as a system, against SciPy."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy

import splitband as sb
from splitband.checks.responses import respond_over_range
from splitband.forecasters.prediction import ForecastContext

DT, LATE = 0.1, 4
A1, A2 = [1.0, -1.2, 0.5], [1.0, -0.9]
GAINS = np.array([[0.7 / 0.3, 3.0], [0.0, 10.0]])


@pytest.fixture(scope="module")
def linear() -> sb.Linear:
    """Two inputs, one of them late, to two outputs around an operating point."""
    rng = np.random.default_rng(0)
    u = np.cumsum(rng.standard_normal((600, 2)), axis=0) * 0.1 + [5.0, -2.0]
    late = np.vstack([np.repeat(u[:1], LATE, axis=0), u[:-LATE]])[:, 0]
    first = scipy.signal.lfilter([0.5, 0.2], A1, late) + 3 * u[:, 1]
    y = np.stack([first, scipy.signal.lfilter([1.0], A2, u[:, 1])], axis=1)
    y += 0.001 * rng.standard_normal(y.shape)
    record = sb.Record(y, DT, u=u, inputs=("flow", "heat"), columns=("t", "p"))
    return sb.Linear().fit(record)


def test_the_step_response_ends_at_the_static_gain(linear: sb.Linear) -> None:
    found = sb.step_responses(linear, 400)
    np.testing.assert_allclose(found.y[-1], GAINS, atol=0.02)
    assert found.time[1] == DT
    assert (found.inputs, found.columns) == (("flow", "heat"), ("t", "p"))


def test_a_saved_model_responds_at_the_mean_of_its_training_inputs(
    linear: sb.Linear, tmp_path: Path
) -> None:
    record = linear.require_fitted().record
    linear.save(tmp_path)
    loaded = sb.load(tmp_path)
    assert len(loaded.require_fitted().record) < len(record)
    np.testing.assert_allclose(sb.step_responses(loaded, 3).at, record.u.mean(axis=0))


def test_the_frequency_response_is_that_of_the_transfer_function(linear: sb.Linear) -> None:
    frequencies, gains = sb.step_responses(linear, 600).frequency_response()
    for i in range(2):
        for j in range(2):
            system: Any = linear.transfer_function(i, j)
            _, expected = scipy.signal.dfreqresp(system, 2 * np.pi * frequencies * DT)
            np.testing.assert_allclose(gains[:, i, j], expected, atol=1e-9)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(("of_u", "of_y"), [(1.0, 1.0), (1e5, 1e-9), (1e5, 1e-12), (1e-9, 1e9)])
def test_the_transfer_function_does_not_depend_on_units(of_u: float, of_y: float) -> None:
    u = np.repeat(np.sign(np.random.default_rng(0).standard_normal(150)), 4)
    a = np.poly([0.9, 0.7])
    y = scipy.signal.lfilter([0, 0.1, -0.08], a, u)
    model = sb.Linear(order=2, delay=1).fit(sb.Record(of_y * y, DT, u=of_u * u))
    system: Any = model.transfer_function()
    found = scipy.signal.dfreqresp(system, [0.5])[1] * of_u / of_y
    _, expected = scipy.signal.freqz([0, 0.1, -0.08], a, [0.5])
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    assert abs(model.zeros() - 0.8).min() < 1e-4


def test_the_frequency_response_of_an_integrator_rises_towards_low_frequencies() -> None:
    u = np.sign(np.sin(0.05 * np.arange(400)))
    y = scipy.signal.lfilter([0, 0.1], np.poly([1.0, 0.5]), u)
    model = sb.Linear(2, integrators=1).fit(sb.Record(y, DT, u=u))
    frequencies, gains = sb.step_responses(model, 200).frequency_response()
    z = np.exp(2j * np.pi * frequencies * DT)
    np.testing.assert_allclose(gains[:, 0, 0], 0.1 * z / ((z - 1) * (z - 0.5)), rtol=1e-3)


def driven(linear: sb.Linear, seed: int) -> tuple[Any, Any]:
    """Inputs beside the operating point, and what the model says from rest there."""
    u0, y0 = linear.operating_point()
    u = 0.1 * np.random.default_rng(seed).standard_normal((300, 2))
    said = linear.predict(1100, u=np.vstack([np.tile(u0, (800, 1)), u + u0])).y[800:]
    return u, said - y0


def test_the_state_space_simulates_as_the_model_does(linear: sb.Linear) -> None:
    assert linear.delays == (LATE, 0)
    system: Any = linear.state_space()
    u, expected = driven(linear, 1)
    np.testing.assert_allclose(scipy.signal.dlsim(system, u)[1], expected, atol=1e-9)
    assert system.dt == DT
    poles = linear.poles()
    for pole in (*np.roots(A1), 0.9):
        assert abs(poles - pole).min() < 0.01


def test_python_control_simulates_as_the_model_does(linear: sb.Linear) -> None:
    control: Any = pytest.importorskip("control", reason="pip install 'splitband[control]'")
    system: Any = linear.to_control()
    u, expected = driven(linear, 2)
    found = control.forced_response(system, inputs=u.T)
    np.testing.assert_allclose(found.outputs.T, expected, atol=1e-9)
    np.testing.assert_allclose(system.dcgain(), GAINS, atol=0.02)
    assert system.dt == DT
    assert (system.input_labels, system.output_labels) == (["flow", "heat"], ["t", "p"])


class Swinging(sb.Forecaster):
    """A lightly damped mode, which a response of 200 samples does not show to its end."""

    name = "swinging"
    needs = frozenset({"inputs"})
    A = np.poly([0.99 * np.exp(0.3j), 0.99 * np.exp(-0.3j)]).real

    def extrapolate(self, known: ForecastContext) -> Any:
        return scipy.signal.lfilter([0.0, 0.1], self.A, known.u[:, :1], axis=0)[len(known.y) :]


def test_a_mode_that_swings_on_is_simulated_until_it_has_settled() -> None:
    u = np.random.default_rng(0).standard_normal(100)
    model = Swinging().fit(sb.Record(u, DT, u=u))
    found = sb.step_responses(model, 200)
    frequencies, gains = found.frequency_response()
    _, expected = scipy.signal.dfreqresp(([0.1, 0.0], model.A, DT), 2 * np.pi * frequencies * DT)
    assert len(found.y) == 200
    np.testing.assert_allclose(abs(gains[:, 0, 0]), abs(expected), rtol=0.01)


class RunningAway(sb.Forecaster):
    """A network that is unstable, as the pole of its linear part says: 1.1."""

    name = "running away"
    needs = frozenset({"inputs"})

    def learn(self, records: Any, **_: Any) -> None:
        self.fitted = self.require_fitted().reporting(growth=1.1)

    def extrapolate(self, known: ForecastContext) -> Any:
        with np.errstate(over="ignore"):
            return scipy.signal.lfilter([0.0, 1.0], [1.0, -1.1], known.u, axis=0)[len(known.y) :]


def test_the_response_of_a_network_that_runs_away_ends_before_it_is_not_finite() -> None:
    u = np.random.default_rng(0).standard_normal(100)
    model = RunningAway().fit(sb.Record(u, DT, u=u))
    found = sb.step_responses(model, 8000)
    n = np.arange(len(found.y))
    assert 40 < len(n) < 60
    np.testing.assert_allclose(found.y[:, 0, 0], (1.1**n - 1) / 0.1)
    assert len(sb.step_responses(model, 200).y) == 200


def test_an_input_that_never_moved_and_a_point_that_fails_are_left_out_and_said() -> None:
    u = np.stack([np.full(200, 3.0), np.linspace(0, 4, 200)], axis=1)
    model = Rooted().fit(sb.Record(u[:, 1], DT, u=u))
    found = respond_over_range(model)
    assert [each.share for each in found] == [None, 0.9]
    assert (found[0].inputs, found[0].y.shape) == (("u1",), (500, 1, 1))
    assert ["u0 never moved" in found[0].remarks[0], "10 %" in found[0].remarks[1]] == [True, True]


class Rooted(sb.Forecaster):
    """The output is not a number for small inputs."""

    name = "rooted"
    needs = frozenset({"inputs"})

    def extrapolate(self, known: ForecastContext) -> Any:
        u = known.u[len(known.y) :, 1:]
        return np.where(u < 1, np.nan, u)


class Squared(sb.Forecaster):
    """The output is the input's square: its small-signal gain is twice the operating point."""

    name = "squared"
    needs = frozenset({"inputs"})

    def extrapolate(self, known: ForecastContext) -> Any:
        return known.u[len(known.y) :] ** 2


def test_a_nonlinear_model_is_linearised_at_its_operating_point() -> None:
    u = np.linspace(0, 4, 200)
    model = Squared().fit(sb.Record(u**2, DT, u=u))
    np.testing.assert_allclose(sb.step_responses(model, 5, at=3.0).y[:, 0, 0], 6.0)
    np.testing.assert_allclose(sb.step_responses(model, 5).y[:, 0, 0], 4.0)
    over_range = [each.y[-1, 0, 0] for each in respond_over_range(model)]
    np.testing.assert_allclose(over_range, [4.0, 0.8, 7.2])
    with pytest.warns(sb.ExtrapolationWarning, match="beyond its range in training"):
        sb.step_responses(model, 5, at=9.0)


@pytest.mark.parametrize("kind", [sb.Simulation, sb.GreyBox])
def test_a_driven_simulator_responds_differently_over_the_range(kind: Any) -> None:
    """Its static gain for small steps is the derivative of u cubed."""
    u = np.linspace(0, 4, 200)
    ode = sb.Ode(lambda t, x, u: [9 * (u[0] ** 3 - x[0])], [0.0])
    y: Any = sb.Simulation(ode).fit(sb.Record(u, DT, u=u)).on(sb.Record(u, DT, u=u)).y_sim
    model = kind(ode).fit(sb.Record(y, DT, u=u))
    found = [each.y[-1, 0, 0] for each in respond_over_range(model)]
    np.testing.assert_allclose(found, 3 * np.array([2.0, 0.4, 3.6]) ** 2, atol=0.05)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"at": [1.0, 2.0]}, "at must be a finite number for each of 1 inputs"),
        ({"size": 0.0}, "size must not be 0"),
        ({"steps": 0}, "steps must be"),
    ],
)
def test_what_cannot_be_is_named(options: dict[str, Any], said: str) -> None:
    u = np.linspace(0, 4, 200)
    model = Squared().fit(sb.Record(u**2, DT, u=u))
    with pytest.raises(ValueError, match=said):
        sb.step_responses(model, **options)


def test_what_has_no_inputs_does_not_respond() -> None:
    model = sb.Mean().fit(sb.Record(np.sin(np.arange(50.0)), DT))
    with pytest.raises(ValueError, match="mean must have inputs to respond to"):
        sb.step_responses(model)

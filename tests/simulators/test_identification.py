"""Parameters of simulators, fitted to records: closed forms, other solvers, and what is said."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy

import splitband as sb
from splitband.metrics import ExtrapolationWarning
from splitband.simulators import Effort, identify
from splitband.simulators.parameters import Parameters

Array = npt.NDArray[np.float64]


DT = 0.1
FEW = Effort(starts=4)


def swing(t: float, x: Any, u: Any, p: Any) -> list[float]:
    """One equation for most tests, as compiling takes longest."""
    return [x[1], -p.k * p.b * p.w**2 * x[0] - p.c * x[1]]


def oscillation(samples: int, k: float = 4.0, c: float = 0.1, x0: float = 1.0) -> Array:
    """The closed form, for a swing that begins at rest."""
    decay, omega = c / 2, np.sqrt(k - c**2 / 4)
    t = DT * np.arange(samples)
    return np.asarray(
        x0 * np.exp(-decay * t) * (np.cos(omega * t) + decay / omega * np.sin(omega * t))
    )


def measured(samples: int = 120, noise: float = 0.0, seed: int = 0, **others: float) -> sb.Record:
    random = np.random.default_rng(seed)
    return sb.Record(oscillation(samples, **others) + random.normal(0, noise, samples), DT)


def oscillator(**parameters: Any) -> sb.Ode:
    given: dict[str, Any] = {
        "k": (0.5, 50.0),
        "c": (0.0, 1.0),
        "b": 1.0,
        "w": 1.0,
        "idle": 1.0,
    } | parameters
    return sb.Ode(swing, [1.0, 0.0], parameters=given)


@cache
def of_noisy() -> Any:
    """What a record with noise tells, for two tests."""
    return identify(oscillator(), measured(noise=0.05), effort=FEW)


def test_parameters_are_found_whose_phase_a_long_simulation_has_lost() -> None:
    """The middle of the range is another frequency: windows that grow lead to the right one."""
    found = identify(oscillator(), measured(300), effort=FEW)
    assert found.values == pytest.approx({"k": 4.0, "c": 0.1}, rel=1e-4)
    assert found.remarks == ()
    assert found.starts[0] >= 1


def test_standard_errors_and_correlations_are_those_of_scipy() -> None:
    """Of `curve_fit` with the closed form."""
    record, found = measured(noise=0.05), of_noisy()
    values, covariance = scipy.optimize.curve_fit(
        lambda _, k, c: oscillation(120, k, c), record.time, record.y[:, 0], [4.0, 0.1]
    )
    assert [*found.values.values()] == pytest.approx(values, rel=1e-4)
    deviations = np.sqrt(np.diag(covariance))
    assert [*found.errors.values()] == pytest.approx(deviations, rel=0.01)
    expected = covariance / np.outer(deviations, deviations)
    np.testing.assert_allclose(found.correlations, expected, atol=0.02)


def test_a_solver_of_loose_tolerance_gives_the_same_standard_errors() -> None:
    record = measured(noise=0.02)
    exact, loose = (
        identify(
            replace(oscillator(k=(1.0, 20.0), c=(0.0, 1.0)), tolerances=each), record, effort=FEW
        )
        for each in ((1e-8, 1e-10), (1e-2, 1e-2))
    )
    for name, error in exact.errors.items():
        assert loose.errors[name] == pytest.approx(error, rel=0.05)
        assert abs(loose.values[name] - exact.values[name]) < 0.1 * error


def test_numbers_are_kept_and_each_record_has_its_own_initial_state() -> None:
    simulator = oscillator(k=4.0, x0_1=(-3.0, 3.0))
    found = identify(simulator, measured(x0=1.5), measured(80, x0=-2.0), effort=FEW)
    assert found.values == pytest.approx({"c": 0.1, "x0_1": 1.5, "x0_1, record 2": -2.0}, abs=1e-4)


def test_gaps_do_not_count() -> None:
    y = measured().y[:, 0].copy()
    y[20:60] = np.nan
    record = sb.Record.with_gaps(y, DT)
    found = identify(oscillator(), record, effort=FEW)
    assert found.values == pytest.approx({"k": 4.0, "c": 0.1}, rel=1e-4)


def driven(t: float, x: Any, u: Any, p: Any) -> list[float]:
    return [(p.gain * u[0] - x[0]) / p.lag]


@pytest.mark.parametrize(("hold", "other"), [("zoh", "linear"), ("linear", "zoh")])
def test_inputs_are_held_or_interpolated(hold: Any, other: Any) -> None:
    """As SciPy's linear systems have it: zero-order and first-order hold; the wrong one is told."""
    u = np.random.default_rng(0).normal(size=100)
    time = DT * np.arange(100)
    _, y, _ = scipy.signal.lsim(
        ([[-2.0]], [[6.0]], [[1.0]], [[0.0]]), u, time, interp=hold == "linear"
    )
    simulator = sb.Ode(driven, [0.0], hold=hold, parameters={"gain": (0, 10.0), "lag": (0.1, 2.0)})
    found = identify(simulator, sb.Record(y, DT, u=u), effort=FEW)
    assert found.values == pytest.approx({"gain": 3.0, "lag": 0.5}, rel=1e-4)
    assert not found.doubt
    noisy = sb.Record(y + np.random.default_rng(1).normal(0, 0.1, 100), DT, u=u)
    model = sb.GreyBox(replace(simulator, hold=other), starts=1).fit(noisy)
    assert f"the record favours inputs that are {'held' if hold == 'zoh' else 'inter'}" in str(
        model.estimate
    )
    known = replace(model.simulator, parameters=dict(found.values))
    assert f"hold={hold!r}" in identify(known, noisy).doubt
    with pytest.warns(ExtrapolationWarning, match="the record favours"):
        model.predict(1, u=[[0.0]])


def test_a_parameter_that_does_not_matter_is_said() -> None:
    simulator = oscillator(idle=(0.0, 5.0))
    found = identify(simulator, measured(noise=0.01), effort=FEW)
    assert found.remarks == ("the record does not tell idle: its value does not matter",)
    assert np.isnan(found.errors["idle"])
    assert np.isfinite(found.errors["k"])


def test_parameters_that_appear_as_a_product_are_said() -> None:
    simulator = oscillator(k=(0.5, 20.0), b=(0.5, 20.0), c=0.1)
    found = identify(simulator, measured(noise=0.01), effort=FEW)
    assert found.values["k"] * found.values["b"] == pytest.approx(4.0, rel=1e-2)
    assert found.remarks == ("the record does not tell k and b apart: only their product matters",)


def test_a_parameter_at_the_end_of_its_range_is_said() -> None:
    found = identify(oscillator(c=(0.2, 1.0)), measured(noise=0.01), effort=FEW)
    assert found.remarks == ("c is at its lower bound, 0.2",)
    assert np.isnan(found.errors["c"])


def test_minima_that_are_as_good_are_said() -> None:
    simulator = oscillator(k=1.0, c=0.1, w=(-5.0, 5.0))
    found = identify(simulator, measured(), effort=Effort(starts=8))
    assert abs(found.values["w"]) == pytest.approx(2.0, rel=1e-4)
    assert found.remarks == (f"fits as well with w = {-2 * np.sign(found.values['w']):g}",)


def lorenz(t: float, x: Any, u: Any, p: Any) -> list[float]:
    return [10 * (x[1] - x[0]), x[0] * (p.rho - x[2]) - x[1], x[0] * x[1] - p.beta * x[2]]


def test_a_chaotic_system_is_fitted_in_windows() -> None:
    time = 0.02 * np.arange(400)
    begin, how = [1.0, 1.0, 20.0], dict[str, Any](rtol=1e-10, atol=1e-10)

    def exactly(t: float, x: Array) -> list[float]:
        return lorenz(t, x, None, SimpleNamespace(rho=28.0, beta=8 / 3))

    exact = scipy.integrate.solve_ivp(exactly, (0, time[-1]), begin, "DOP853", time, **how).y
    noise = np.random.default_rng(0).normal(0, 0.1, (400, 2))
    record = sb.Record(exact[:2].T + noise, 0.02)
    ranges: Any = {"rho": (10.0, 50.0), "beta": (0.5, 10.0)}
    simulator = sb.Ode(lorenz, begin, lambda x: x[:, :2], ranges, tolerances=(1e-6, 1e-6))
    found = identify(simulator, record, effort=Effort(starts=2))
    assert found.values == pytest.approx({"rho": 28.0, "beta": 8 / 3}, rel=0.01)


@pytest.mark.filterwarnings("ignore:the equation fails is solved in Python")
def test_runs_that_fail_are_bad_values_and_no_run_at_all_is_an_error() -> None:
    """Of an equation that Numba cannot compile."""

    def fails(t: float, x: Array, u: Array, p: Any) -> Sequence[float]:
        if p.k > 6:
            raise RuntimeError("too stiff")
        return [float(part) for part in map(str, (x[1], -p.k * x[0]))]

    def simulator(low: float, high: float) -> sb.Ode:
        given: dict[str, Any] = {"k": (low, high)}
        return sb.Ode(fails, [1.0, 0.0], parameters=given, tolerances=(1e-4, 1e-4))

    record = measured(40, c=0.0)
    found = identify(simulator(2.0, 8.0), record, effort=Effort(2))
    assert found.values == pytest.approx({"k": 4.0}, rel=1e-3)
    with pytest.raises(ValueError, match=r"simulator must run .* RuntimeError: too stiff"):
        identify(simulator(7.0, 8.0), record, effort=Effort(2))


def test_dry_friction_is_found_with_tolerances_that_its_solver_can_keep() -> None:
    """At rest the force jumps to and fro; with the default tolerances, that is said."""

    def rubbing(t: float, x: Any, u: Any, p: Any) -> list[float]:
        return [x[1], 4 * (u[0] - x[0]) - p.f * np.sign(x[1])]

    def smooth(t: float, x: Array) -> list[float]:
        drive = np.interp(t, time, np.sin(0.7 * time))
        return [x[1], 4 * (drive - x[0]) - 0.8 * np.tanh(1e4 * x[1])]

    time: Array = DT * np.arange(100.0)
    exact = scipy.integrate.solve_ivp(
        smooth, (0, time[-1]), [1.0, 0.0], "Radau", time, rtol=1e-8, atol=1e-10, max_step=0.01
    ).y[0]
    record = sb.Record(exact, DT, u=np.sin(0.7 * time))
    ode = sb.Ode(rubbing, [1.0, 0.0], parameters={"f": (0.1, 2.0)}, tolerances=(1e-4, 1e-4))
    found = identify(ode, record, effort=FEW)
    assert found.values["f"] == pytest.approx(0.8, rel=0.01)
    assert "standard errors are rough" in str(found)
    lost = str(identify(replace(ode, tolerances=(1e-8, 1e-10)), record, effort=FEW))
    assert "of 4 starting points could not be simulated" in lost
    assert "larger tolerances" in lost


def test_a_limit_of_time_ends_it_with_what_has_been_found() -> None:
    with pytest.raises(ValueError, match="the time was over before the first one was done"):
        identify(oscillator(), measured(), effort=Effort(4, seconds=0.0))


def test_parameters_are_read_as_the_command_line_has_them() -> None:
    read = Parameters.read("k=0.1:10, c=0.05,x0_2=-1:1")
    assert read == Parameters({"k": (0.1, 10.0), "c": 0.05, "x0_2": (-1.0, 1.0)})
    assert Parameters.read(str(read)) == read
    assert read.logarithmic("k")
    assert not read.logarithmic("x0_2")
    assert read.value_at("k", 0.5) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "text", ["k", "k=a", "k=1:2:3", "k=2:1", "k=1,k=2", "=1", "k=nan", "k=1:1"]
)
def test_other_texts_are_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"parameters must|range must"):
        Parameters.read(text)


def test_initial_values_are_those_of_states() -> None:
    wrong: list[Any] = [[(-2, 2), 0.0], [[1.0, 2.0]], [], [np.nan]]
    for x0 in wrong:
        with pytest.raises(ValueError, match=r'x0 must be .* parameters=\{"x0_1": \(low, high\)'):
            sb.Ode(lambda t, x: -x, x0)
    with pytest.raises(ValueError, match=r"initial values must be out of x0_1, x0_2, .* got x0_3"):
        oscillator(x0_3=(0.0, 1.0))

"""Simulators against closed forms and solvers; what `run` checks, gives up on and keeps."""

from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy.integrate

import splitband as sb
from splitband import Record
from splitband.metrics import rmse
from splitband.records.named import van_der_pol
from splitband.simulators import Function, Ode, Recorded, run
from splitband.simulators.named import SIMULATORS

Array = npt.NDArray[np.float64]
SAMPLES, DT = 200, 0.05
GRID: Array = DT * np.arange(SAMPLES, dtype=np.float64)


def oscillator(mu: float, start: tuple[float, float], grid: Array = GRID) -> Array:
    """The Van der Pol oscillator `(time, 2)` by another solver than the package's."""

    def slope(_: float, s: Array) -> list[float]:
        return [s[1], mu * (1 - s[0] ** 2) * s[1] - s[0]]

    return by_scipy(slope, start, grid)


def by_scipy(slope: Any, start: tuple[float, float], grid: Array) -> Array:
    span = 0, grid[-1]
    found = scipy.integrate.solve_ivp(slope, span, start, "DOP853", grid, rtol=1e-12, atol=1e-13)
    return np.asarray(found.y.T)


# ---------------------------------------------------------------- Recorded and Function


def test_a_recorded_trajectory_is_cut_to_the_record() -> None:
    y = np.random.default_rng(0).standard_normal((30, 2))
    np.testing.assert_array_equal(run(Recorded(y, DT), 20, DT, ny=2), y[:20])
    np.testing.assert_array_equal(run(Recorded(y[:, 0], DT), 30, DT), y[:, :1])


def test_a_recorded_trajectory_has_the_channels_of_a_record_by_their_names() -> None:
    y = np.random.default_rng(0).standard_normal((40, 2))
    record = Record(y, DT, columns=("a", "b"))
    swapped = Recorded.of(Record(y[:, ::-1], DT, columns=("b", "a")))
    for model in (sb.Simulation(swapped), sb.Calibrated(swapped)):
        np.testing.assert_allclose(model.fit(record[:30]).predict(10).y, y[30:], atol=1e-9)
    broken = Recorded(np.where(np.arange(40) == 35, np.nan, y[:, 0]), DT)
    with pytest.raises(ValueError, match="y must be finite, the exported trajectory holds NaN"):
        sb.Simulation(broken).fit(Record(y[:, 0], DT)[:30]).predict(10)


@pytest.mark.parametrize(("other", "got"), [(DT, "got 30$"), (DT / 2, r"got 30 every 0\.025 s")])
def test_a_recorded_trajectory_that_is_too_short_is_refused(other: float, got: str) -> None:
    with pytest.raises(ValueError, match=rf"cover 31 samples every 0\.05 s, {got}"):
        run(Recorded(np.zeros(30), other), 31, DT)


@pytest.mark.parametrize("other", [2 * DT, 1.02 * DT, 0.97 * DT, 1.002 * DT])
def test_a_recorded_trajectory_of_another_rate_is_interpolated(other: float) -> None:
    y = np.sin(other * np.arange(300))
    np.testing.assert_allclose(run(Recorded(y, other), 200, DT)[:, 0], np.sin(GRID), atol=1e-5)


def test_a_function_gets_the_time_grid_and_answers_with_one_or_more_channels() -> None:
    np.testing.assert_array_equal(run(Function(lambda t: t), SAMPLES, DT)[:, 0], GRID)
    both = run(Function(lambda t: [[s, -s] for s in t]), SAMPLES, DT, ny=2)
    np.testing.assert_array_equal(both, np.stack([GRID, -GRID], axis=1))


# ---------------------------------------------------------------- Ode


def test_an_ode_follows_the_closed_form_of_a_damped_oscillator() -> None:
    damping, omega = 0.2, 3.0

    def damped(_: float, x: Array) -> list[float]:
        return [x[1], -(omega**2 + damping**2) * x[0] - 2 * damping * x[1]]

    simulator = Ode(damped, [1.0, -damping], tolerances=(1e-10, 1e-12))
    expected = np.exp(-damping * GRID) * np.cos(omega * GRID)
    np.testing.assert_allclose(run(simulator, SAMPLES, DT)[:, 0], expected, atol=1e-8)


def test_an_ode_is_observed_as_asked() -> None:
    simulator = Ode(lambda _, x: [x[1], -x[0]], [0.0, 1.0], observe=lambda x: x[:, ::-1] * [2, 1])
    expected = np.stack([2 * np.cos(GRID), np.sin(GRID)], axis=1)
    np.testing.assert_allclose(run(simulator, SAMPLES, DT, ny=2), expected, atol=1e-6)


def test_the_tolerances_and_the_method_of_an_ode_reach_the_solver() -> None:
    def error(**options: Any) -> float:
        simulator = Ode(lambda _, x: [x[1], -x[0]], [1.0, 0.0], **options)
        return float(np.abs(run(simulator, 50, 1.0)[:, 0] - np.cos(np.arange(50))).max())

    tight, by_atol = error(), error(tolerances=(1e-4, 1e-4))
    assert tight < 1e-6 < error(tolerances=(1e-3, 1e-10)) / 10
    assert tight < by_atol
    assert error(method="DOP853") != tight


def test_an_ode_that_blows_up_says_when() -> None:
    with pytest.raises(ValueError, match=r"Ode failed.*RK45, stopped before t = 1.05 s") as caught:
        run(Ode(lambda _, x: x**2, [1.0]), SAMPLES, DT)
    assert "\n" not in str(caught.value)


def test_a_single_sample_is_the_initial_state() -> None:
    assert run(Ode(lambda _, x: -x, [1.5]), 1, DT) == [[1.5]]


# ---------------------------------------------------------------- what run refuses


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (np.zeros(SAMPLES - 1), r"must return \(200, 1\) values, got \(199, 1\)"),
        (np.zeros((1, SAMPLES)), r"must return \(200, 1\) values, got \(1, 200\)"),
        (None, r"must return \(200, 1\) values, got \(\)"),
        (np.where(GRID < 2, 0, np.nan), "must .* finite values: 160 .* first at 2 s"),
        ("fast", "failed.*could not convert"),
        (1j * GRID, "failed.*its values must be real"),
    ],
)
def test_an_answer_that_is_no_trajectory_is_refused(answer: Any, words: str) -> None:
    with pytest.raises(ValueError, match=f"simulator Function {words}"):
        run(Function(lambda _: answer), SAMPLES, DT)


def test_what_a_simulator_raises_is_passed_on_with_the_call() -> None:
    def fail(grid: Array) -> Array:
        raise KeyError("stiffness")

    with pytest.raises(
        ValueError, match=r"Function failed on 200 samples every 0.05 s: KeyError: 'stiffness'"
    ) as caught:
        run(Function(fail), SAMPLES, DT)
    assert isinstance(caught.value.__cause__, KeyError)


# ---------------------------------------------------------------- the driven Van der Pol system


@pytest.fixture(scope="module")
def system_v() -> Record:
    return van_der_pol()


def test_the_driven_oscillator_agrees_with_another_solver(system_v: Record) -> None:
    def slope(t: float, s: Array) -> list[float]:
        return [s[1], -s[0] + 5 * (1 - s[0] ** 2) * s[1] + 80 * 0.31 * np.cos(7 * t)]

    found = by_scipy(slope, (-2.0, 1.0), system_v.time)
    np.testing.assert_allclose(system_v.y[:, 0], found[:, 0], atol=1e-6)


def test_the_simulator_of_the_driven_oscillator_is_0405_off(system_v: Record) -> None:
    assert system_v.y_sim is not None
    assert (len(system_v), system_v.sampling_time) == (2000, 0.05)
    assert rmse(system_v.y, system_v.y_sim) == pytest.approx(0.405, abs=1e-4)
    found = run(SIMULATORS["van-der-pol"](), 2000, system_v.sampling_time)
    np.testing.assert_allclose(found, system_v.y_sim, atol=1e-6)
    expected = oscillator(3.81, (-2.0, 1.0), system_v.time[:400])
    np.testing.assert_allclose(found[:400, 0], expected[:, 0], atol=1e-6)


def test_a_loose_tolerance_moves_the_simulators_error_to_the_papers(system_v: Record) -> None:
    loose = van_der_pol(simulator_rtol=1e-3)
    np.testing.assert_array_equal(loose.y, system_v.y)
    assert loose.y_sim is not None
    assert rmse(loose.y, loose.y_sim) == pytest.approx(0.4185, abs=2e-4)

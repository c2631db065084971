"""Ordinary differential equations: the compiled solver, the plain one, and SciPy's."""

from typing import Any

import numpy as np
import pytest
import scipy

from splitband.kernels.ode import solver
from splitband.simulators.parameters import parameters_class

TIME = 0.05 * np.arange(200)
P = parameters_class(("k", "c"))(9.0, 0.3)
INPUT = np.sin(3 * TIME)[:, None]


def pendulum(t: float, x: Any, u: Any, p: Any) -> list[float]:
    return [x[1], -p.k * np.sin(x[0]) - p.c * x[1] + u[0] + 0.1 * np.cos(t)]


def solved(compiled: bool, held: bool = False, tolerance: float = 1e-10) -> Any:
    steps = np.zeros(len(TIME) - 1, dtype=np.int64)
    solve = solver(pendulum, 4, compiled)
    return solve(P, np.array([1.0, 0.0]), TIME, (INPUT, held), (steps, tolerance, tolerance)), steps


@pytest.mark.parametrize("held", [False, True])
def test_it_agrees_with_scipy(held: bool) -> None:
    """Which is begun anew at each sample, where the input has a kink or jumps."""
    x, expected = np.array([1.0, 0.0]), []
    for n in range(len(TIME) - 1):
        expected.append(x)
        after = INPUT[n] if held else INPUT[n + 1]

        def rhs(t: float, x: Any, n: int = n, after: Any = after) -> list[float]:
            return pendulum(t, x, INPUT[n] + (t - TIME[n]) / 0.05 * (after - INPUT[n]), P)

        span = TIME[n], TIME[n + 1]
        x = scipy.integrate.solve_ivp(rhs, span, x, "DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    found, _ = solved(compiled=False, held=held)
    np.testing.assert_allclose(found[:-1], expected, atol=1e-7)


def test_the_compiled_solver_is_the_plain_one() -> None:
    (plain, steps), (compiled, fast_steps) = solved(False), solved(True)
    np.testing.assert_allclose(compiled, plain, atol=1e-12)
    np.testing.assert_array_equal(fast_steps, steps)


def test_looser_tolerances_take_fewer_steps() -> None:
    assert solved(False, tolerance=1e-4)[1].sum() < solved(False)[1].sum() / 2


def test_a_state_that_is_not_finite_ends_the_simulation() -> None:
    steps = np.zeros(len(TIME) - 1, dtype=np.int64)
    grows = solver(lambda _, x: [x[0] ** 2], 2, False)
    with np.errstate(all="ignore"):
        found = grows((), np.array([1.0]), TIME, (np.empty((200, 0)), False), (steps, 1e-6, 1e-6))
    exact = 1 / (1 - TIME[:19])  # up to 1 s
    np.testing.assert_allclose(found[:19, 0], exact, rtol=1e-4)
    assert np.isnan(found[-1])

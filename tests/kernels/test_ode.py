"""Ordinary differential equations: the compiled solver, the plain one, and SciPy's."""

from functools import partial
from types import ModuleType
from typing import Any

import numpy as np
import pytest
import scipy

from splitband.kernels.ode import Solver, solver
from splitband.runtime.arrays import Array
from splitband.simulators.parameters import parameters_class

TIME: Array = 0.05 * np.arange(200.0)
P = parameters_class(("k", "c"))(9.0, 0.3)
INPUT = np.sin(3 * TIME)[:, None]
SIDE = np.array([1.0, 0.0])
NONE, ALONE = np.empty(0), np.empty((200, 0))
TIGHT = 1e-10, 1e-10


def pendulum(t: float, x: Any, u: Any, p: Any) -> list[float]:
    return [x[1], -p.k * np.sin(x[0]) - p.c * x[1] + u[0] + 0.1 * np.cos(t)]


def solved(held: bool = False, tolerance: float = 1e-10) -> Any:
    solve, x0 = Solver(pendulum, 4), np.array([1.0, 0.0])
    return solve(P, x0, TIME, (INPUT, held), (NONE, 0.0), (tolerance, tolerance))


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
    found, *_ = solved(held=held)
    np.testing.assert_allclose(found[:-1], expected, atol=1e-7)


def test_a_result_does_not_depend_on_what_its_process_solved_before() -> None:
    """A network that is trained on the difference would be another one."""

    def hardening(t: float, x: Any, u: Any, p: Any) -> list[float]:  # powers round otherwise
        return [x[1], -p.k * x[0] ** 3 - p.c * x[1] + u[0]]

    solve, x0 = Solver(hardening, 4), np.array([1.0, 0.0])
    runs = [solve(P, x0, TIME, (INPUT, False), (NONE, 0.0), TIGHT)[0] for _ in range(200)]
    np.testing.assert_array_equal(runs[0], runs[-1])


def test_an_index_outside_a_table_is_an_error_in_compiled_code_too() -> None:
    """It is reached only once the state has grown."""
    table = np.array([1.0, 2.0, 3.0])
    solve = Solver(lambda t, x, u, p: [p.k * table[int(x[0])]], 4)
    p, u = parameters_class(("k",))(1.0), np.zeros((len(TIME), 1))
    with pytest.raises(IndexError, match="out of bounds"):
        solve(p, np.array([0.5]), TIME, (u, False), (NONE, 0.0), TIGHT)
    assert solve.compiled


def test_what_cannot_be_compiled_or_would_be_wrong_stays_as_it_is(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is solved in Python, and after many steps it says so."""
    monkeypatch.setattr("splitband.kernels.ode.WORTH_SAYING", 2 * len(TIME))
    table: list[Any] = [1.0, "text"]
    solve = Solver(partial(lambda of, t, x: [-float(str(x[0])) * of[0]], table), 2)
    found, *_ = solve((), np.array([1.0]), TIME, (ALONE, False), (NONE, 0.0), TIGHT)
    with pytest.warns(UserWarning, match="equation partial is solved in Python, .*slower than"):
        again, *_ = solve((), np.array([1.0]), TIME, (ALONE, False), (NONE, 0.0), TIGHT)
    for each in (found, again):
        np.testing.assert_allclose(each[:, 0], np.exp(-TIME), atol=1e-8)


def test_compiled_code_follows_the_values_that_it_refers_to() -> None:
    """In the notebook, in a module, and in a table, which changes in place."""
    rig, table = ModuleType("rig"), np.array([1.0])
    cell: dict[str, Any] = {"__name__": "cell", "rig": rig, "G": 1.0, "table": table}
    rig.H = 1.0  # type: ignore[attr-defined]
    exec("def rhs(t, x): return [-G * rig.H * table[0] * x[0]]", cell)
    solve = solver(cell["rhs"], 2)

    def rates() -> list[float]:
        ran = [
            solve((), np.array([1.0]), TIME, (ALONE, False), (NONE, 0.0), TIGHT) for _ in range(2)
        ]
        assert solve.compiled
        return [-np.log(x[-1, 0]) / TIME[-1] for x, *_ in ran]

    assert rates() == pytest.approx([1.0, 1.0])
    cell["G"] = 0.5
    assert rates() == pytest.approx([0.5, 0.5])
    table[0] = 3.0
    assert rates() == pytest.approx([1.5, 1.5])
    rig.H = 0.1  # type: ignore[attr-defined]
    assert rates() == pytest.approx([0.15, 0.15])
    compiled = solve.compiled
    cell["H"] = 5.0  # a global that is called as an attribute is none of its values
    assert rates() == pytest.approx([0.15, 0.15])
    assert solve.compiled is compiled


def test_a_hard_saturation_of_a_number_is_compiled() -> None:
    """Numba's own np.clip takes arrays alone; in Python such an equation takes 100 times longer."""
    solve = Solver(lambda t, x, u, p: [float(np.clip(p.k * (u[0] - x[0]), -1, 1.0))], 4)
    p, x0, u = parameters_class(("k",))(2.0), np.array([3.0]), np.zeros((len(TIME), 1))
    for _ in range(2):  # at the limit until x = 1/2
        found, *_ = solve(p, x0, TIME, (u, True), (NONE, 0.0), TIGHT)
        after = 0.5 * np.exp(-2 * np.maximum(TIME - 2.5, 0.0))
        np.testing.assert_allclose(found[:, 0], np.maximum(3 - TIME, after), atol=1e-8)
    assert solve.compiled


@pytest.mark.parametrize("tolerance", [1e-4, 1e-7, 1e-10])
def test_its_error_is_of_the_order_of_its_tolerance(tolerance: float) -> None:
    solve = Solver(lambda t, x: [x[1], -x[0]], 2)
    x0, inputs = np.array([1.0, 0.0]), (ALONE, False)
    found, steps, *_ = solve((), x0, 20 * TIME, inputs, (NONE, 0.0), (tolerance, tolerance))
    assert 1e-3 * tolerance < np.abs(found[:, 0] - np.cos(20 * TIME)).max() < 1e3 * tolerance
    assert (steps == 1).sum() == len(TIME) - 1  # one ends at each sample


def test_neighbours_take_the_same_steps() -> None:
    found, steps, *_ = solved(tolerance=1e-4)
    solve, x0 = Solver(pendulum, 4), np.array([1.0, 0.0])
    again, same, *_ = solve(P, x0, TIME, (INPUT, False), (steps, 0.0), (1e-4, 1e-4))
    np.testing.assert_array_equal(again, found)
    np.testing.assert_array_equal(same, steps)
    beside, *_ = solve(P, x0 + 1e-7 * SIDE, TIME, (INPUT, False), (steps, 0.0), (1e-4, 1e-4))
    two, *_ = solve(P, x0 + 2e-7 * SIDE, TIME, (INPUT, False), (steps, 0.0), (1e-4, 1e-4))
    np.testing.assert_allclose(two - found, 2 * (beside - found), atol=1e-11)


def test_one_sample_at_a_time_is_the_same_solution() -> None:
    whole, *_ = solved()
    solve, x, size = Solver(pendulum, 4), np.array([1.0, 0.0]), 0.0
    for n in range(len(TIME) - 1):
        inputs = INPUT[n : n + 2], False
        found, _, size, _ = solve(P, x, TIME[n : n + 2], inputs, (NONE, size), TIGHT)
        x = found[1]
        np.testing.assert_array_equal(x, whole[n + 1])


@pytest.mark.parametrize(
    ("rhs", "ends"),
    [
        (lambda t, x: [x[0] ** 2], 20),  # infinite at 1 s
        (lambda t, x: [np.sin(t) - 2 * np.sign(x[0])], 0),  # slides: it jumps to and fro
        (lambda t, x: [-1e7 * (x[0] - np.cos(t))], 0),  # stiff
        (lambda t, x: [np.nan * x[0]], 0),
    ],
    ids=["infinite", "sliding", "stiff", "nan"],
)
def test_what_its_tolerances_cannot_reach_is_nan(rhs: Any, ends: int) -> None:
    solve = Solver(rhs, 2)
    found, *_ = solve((), np.array([1.0]), TIME, (ALONE, False), (NONE, 0.0), (1e-8, 1e-8))
    good = int(np.isfinite(found[:, 0]).sum())
    assert ends <= good < len(TIME)
    assert np.isnan(found[good:]).all()
    if ends:
        np.testing.assert_allclose(found[:19, 0], 1 / (1 - TIME[:19]), rtol=1e-4)


def test_a_jump_of_the_equation_is_passed_with_small_steps() -> None:
    solve = Solver(lambda t, x: [1.0 if x[0] < 0.512345 else 0.25], 2)
    found, *_ = solve((), np.array([0.0]), TIME, (ALONE, False), (NONE, 0.0), (1e-9, 1e-9))
    exact = np.where(TIME < 0.512345, TIME, 0.512345 + 0.25 * (TIME - 0.512345))
    np.testing.assert_allclose(found[:, 0], exact, atol=1e-8)

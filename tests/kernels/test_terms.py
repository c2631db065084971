"""Unknown terms: compiled values and derivatives, beside NumPy's definition and torch."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy
import torch

import splitband as sb
from splitband.kernels.ode import Solver
from splitband.kernels.terms import evaluate
from splitband.runtime.arrays import Array
from splitband.simulators.parameters import parameters_class
from splitband.simulators.unknown import Chosen, packed

KINDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "odd": {"odd": True},
    "increasing": {"increasing": True},
    "within bounds": {"bounded": (-0.5, 2.0)},
    "positive": {"bounded": (0.0, 2.0), "outputs": 2, "increasing": True},
    "all": {"odd": True, "increasing": True, "bounded": (-1.5, 1.5), "outputs": 2},
}
Z: Array = np.random.default_rng(1).normal(size=(40, 2)) * [1.0, 30.0] + [0.5, 100.0]


def term(seed: int = 0, hold: bool = False, **options: Any) -> sb.Unknown:
    """A term of two quantities with random weights."""
    made = sb.Unknown(**{"hidden": 5, **options})
    state = made.begun(Z, np.linspace(0.7, 2.0, made.outputs), seed)
    weights = np.random.default_rng(seed).normal(size=state.weights.shape)
    made = replace(made, trained=replace(state, weights=weights))
    return made.holding(0.7 * Z) if hold else made


def derivatives(terms: list[sb.Unknown], z: Array) -> tuple[Array, Array, Array]:
    theta, scaling, layout = packed(terms)
    w = np.empty(layout[:, 2].sum())
    by_z, by_theta = np.empty((len(w), len(z))), np.empty((len(w), len(theta)))
    evaluate(theta, scaling, layout, z, w, by_z, by_theta)
    return w, by_z, by_theta


def in_torch(term: sb.Unknown, weights: torch.Tensor, z: torch.Tensor) -> torch.Tensor:
    """The formula of the module, once more."""
    trained: Any = term.trained
    low, high, centre, width, scale = (
        torch.tensor(getattr(trained, name)) for name in ("low", "high", "centre", "width", "scale")
    )
    sizes = [10, 5, 5 * term.outputs, 0 if term.odd else term.outputs]
    first, bias, second, last = weights.split(sizes)
    first, second = first.reshape(5, 2), second.reshape(term.outputs, 5)
    if term.increasing:
        first, second = first**2, second**2

    def g(s: torch.Tensor) -> torch.Tensor:
        return second @ torch.tanh(first @ s + bias) + (0 if term.odd else last)

    end = z.clamp(low, high)
    value, slope = torch.autograd.functional.jvp(
        lambda s: g(s) - g(-s) if term.odd else g(s),
        (end - centre) / width,
        (z - end) / width,
        create_graph=True,
    )
    w = scale * (value + slope)
    if term.bounded is None:
        return w
    low, high = (torch.tensor(end, dtype=torch.float64) for end in term.bounded)
    share = -low / (high - low) if low < 0 < high else torch.tensor(0.5, dtype=torch.float64)
    return low + (high - low) * torch.sigmoid(
        torch.logit(share) + w / ((high - low) * share * (1 - share))
    )


@pytest.mark.parametrize("hold", [False, True])
@pytest.mark.parametrize("kind", KINDS)
def test_values_and_derivatives_are_those_of_torch(kind: str, hold: bool) -> None:
    terms = [term(0, hold, **KINDS[kind]), term(1, hold)]
    for z in np.concatenate([Z[:3], 3 * Z[3:6]]):
        w, by_z, by_theta = derivatives(terms, np.concatenate([z, 0.9 * z]))
        each: Any
        for i, (each, at) in enumerate(zip(terms, (z, 0.9 * z), strict=True)):
            weights = torch.tensor(each.trained.weights, requires_grad=True)
            quantities = torch.tensor(at, requires_grad=True)
            rows, columns = (slice(0, -1), slice(-1, None))[i], slice(2 * i, 2 * i + 2)
            places = (slice(0, len(by_theta.T) - 21), slice(-21, None))[i]
            expected = in_torch(each, weights, quantities)
            np.testing.assert_allclose(w[rows], expected.detach(), rtol=1e-12, atol=1e-14)
            np.testing.assert_allclose(w[rows], each.value(at), rtol=1e-12, atol=1e-14)
            for row, output in enumerate(expected):
                of_weights, of_z = torch.autograd.grad(
                    output, (weights, quantities), retain_graph=True
                )
                found = by_theta[rows][row]
                np.testing.assert_allclose(found[places], of_weights, rtol=1e-10, atol=1e-13)
                assert np.count_nonzero(found) <= len(of_weights)
                found = by_z[rows][row]
                np.testing.assert_allclose(found[columns], of_z, rtol=1e-10, atol=1e-13)


def test_options_hold_for_any_weights() -> None:
    grid = np.linspace(-3, 3, 101)[:, None] * [1.0, 30.0]
    for seed in range(5):
        odd = term(seed, odd=True, increasing=True, bounded=(-1, 1)).value(grid)
        np.testing.assert_allclose(odd, -odd[::-1], atol=1e-13)
        assert (np.diff(odd, axis=0) >= 0).all()
        assert np.abs(odd).max() <= 1
        positive = term(seed, bounded=(0.0, 2.0)).value(grid)
        assert positive.min() >= 0
        assert positive.max() <= 2


def test_a_term_begins_at_zero_or_within_its_bounds() -> None:
    for bounded, w in ((None, 0.0), ((-1, 3), 0.0), ((1, 3), 2.0)):
        before = sb.Unknown(bounded=bounded)
        begun = replace(before, trained=before.begun(Z))
        assert before.value(None) == pytest.approx(w, abs=1e-15)
        assert begun.value(Z) == pytest.approx(w, abs=1e-15)
        assert derivatives([before], np.empty(0))[0] == pytest.approx(w, abs=1e-15)
    steady = replace(before := sb.Unknown(increasing=True), trained=before.begun(Z))
    assert np.abs(steady.value(Z)).max() < 0.5


def _nothing(*_: Any) -> None:
    """Compile nothing."""


def rhs(t: float, x: Any, u: Any, p: Any, w: Any) -> list[float]:
    return [x[1], u[0] - p.k * x[0] - w[1] - 0.1 * w[0]]


def test_the_equation_is_compiled_with_its_terms(monkeypatch: pytest.MonkeyPatch) -> None:
    of = (None, lambda x, u: [x[1]])
    friction = sb.Unknown(of[1], odd=True)
    state = friction.begun(np.linspace(-1, 1, 50)[:, None])
    weights = np.random.default_rng(0).normal(size=state.weights.shape)
    terms = [sb.Unknown(), replace(friction, trained=replace(state, weights=weights))]
    solve, p = Solver(rhs, 5, of), (parameters_class(("k",))(4.0), packed(terms))
    time = 0.05 * np.arange(200.0)
    rest = np.array([1.0, 0.0]), time, (np.sin(3 * time)[:, None], False)
    fast = solve(p, *rest, (np.empty(0), 0.0), (1e-9, 1e-9))
    assert solve.compiled
    monkeypatch.setattr(Solver, "_compile", _nothing)
    plain = Solver(rhs, 5, of)(p, *rest, (np.empty(0), 0.0), (1e-9, 1e-9))
    np.testing.assert_allclose(fast[0], plain[0], atol=1e-11)

    def slope(t: float, x: Array) -> list[float]:
        sine = np.interp(t, time, np.sin(3 * time))
        return [x[1], sine - 4.0 * x[0] - terms[1].value(x[1:]).item()]

    how: Any = {"rtol": 1e-9, "atol": 1e-9, "max_step": 0.05}
    expected = scipy.integrate.solve_ivp(slope, (0, 2), [1.0, 0.0], "RK45", time[:41], **how).y.T
    np.testing.assert_allclose(fast[0][:41], expected, atol=1e-6)


def test_another_number_of_quantities_is_refused() -> None:
    two = term()
    short = replace(two, of=lambda x, u: [x[1]])
    u = np.empty(0)
    with pytest.raises(sb.InputError, match="of must return 2 quantities, as in training, got 1"):
        short.at(np.zeros(2), u)
    of: Any = (short.of,)
    solve, time = Solver(lambda t, x, u, p, w: [w[0], w[0]], 5, of), np.arange(3.0)
    inputs = np.empty((3, 0)), False
    with pytest.raises(ValueError, match="as many quantities"):
        solve(((), packed([short])), np.zeros(2), time, inputs, (np.empty(0), 0.0), (1e-6, 1e-6))


def test_derivatives_go_through_the_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """By the parameters, the initial state and the weights, beside differences of solutions."""
    of = Chosen((0, 2)), Chosen((1, 0))
    terms = [term(hidden=3), term(1, odd=True, hidden=2)]
    time = 0.05 * np.arange(40.0)
    inputs, tight = (np.sin(3 * time)[:, None], False), (1e-11, 1e-11)
    kind, begin, packed_terms = parameters_class(("k",)), np.array([1.0, 0.0]), packed(terms)

    def states(change: Array) -> Array:
        theta = packed_terms[0] + change[3:]
        p = kind(4.0 + change[0]), (theta, *packed_terms[1:])
        return solve(p, begin + change[1:3], time, inputs, (np.empty(0), 0.0), tight)[0]

    given = (kind(4.0), packed_terms), begin, time, inputs, (np.array([1.0]), np.array([0])), tight
    for compile_it in (Solver._compile, _nothing):
        monkeypatch.setattr(Solver, "_compile", compile_it)
        solve = Solver(rhs, 5, of)
        x, dx, steps, apart = solve.derivatives(*given)
        np.testing.assert_allclose(x, states(np.zeros(dx.shape[2])), atol=1e-10)
        for d, unit in enumerate(np.eye(dx.shape[2])):
            expected = (states(1e-4 * unit) - states(-1e-4 * unit)) / 2e-4
            np.testing.assert_allclose(dx[..., d], expected, atol=2e-6 * np.abs(dx).max())
        np.testing.assert_allclose(dx @ steps, apart, atol=1e-3 * np.abs(apart).max())
        assert bool(solve.compiled) == (compile_it is not _nothing)

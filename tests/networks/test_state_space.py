"""The state-space network: the linear model that it holds, its observer, and its sizes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import scipy
import torch
from torch import Tensor

import splitband as sb
from splitband.models import Recurrent
from splitband.models.base import with_next_input
from splitband.networks import Backend, StateSpace, rollout
from splitband.runtime.arrays import Array

A = np.array([[0.9, 0.2, 0.0], [-0.2, 0.9, 0.1], [0.0, 0.0, 0.7]])
B = np.array([[0.1, 0.0], [0.3, -0.2], [0.5, 1.0]])
C = np.array([[1.0, 0.0, 0.5], [0.0, 1.0, 0.0]])
D = np.array([[0.4, 0.0], [0.1, -0.3]])
K = np.array([[0.5, 0.1], [0.0, 0.4], [0.2, 0.0]])
WARMUP, STEPS = 7, 40


def linear(k: Array | None = None, hidden: int = 6) -> StateSpace:
    """The model above; its rows of inputs are those of a sample and of the next one."""
    torch.manual_seed(0)
    cell = StateSpace(3, hidden, ny=2, nu=4).double()
    none = np.zeros((2, 2))
    cell.set_linear(A, np.hstack([B, np.zeros((3, 2))]), C, np.hstack([none, D]), k)
    return cell


def inputs() -> Array:
    """Two inputs, constant at first, when the record begins."""
    u = np.random.default_rng(0).standard_normal((WARMUP + STEPS, 2))
    u[:2] = u[0]
    return u


def simulate(cell: StateSpace, y_warmup: Array, u: Array, backend: Backend) -> Array:
    rows = with_next_input(torch.from_numpy(u)[None])
    with torch.no_grad():
        y = rollout(cell, torch.from_numpy(y_warmup)[None], STEPS, rows, backend)
    return np.asarray(y[0])


@pytest.mark.parametrize("backend", ["plain", "fused"])
@pytest.mark.parametrize("hidden", [0, 6])
def test_as_a_linear_model_it_simulates_as_scipy_does(backend: Backend, hidden: int) -> None:
    u = inputs()
    _, y, _ = scipy.signal.dlsim((A, B, C, D, 1.0), u)
    found = simulate(linear(hidden=hidden), np.zeros((WARMUP, 2)), u, backend)
    np.testing.assert_allclose(found, y[WARMUP:], atol=1e-12, rtol=0)


@pytest.mark.parametrize("backend", ["plain", "fused"])
def test_the_warm_up_is_an_observer_written_out(backend: Backend) -> None:
    u, measured = inputs(), np.random.default_rng(1).standard_normal((WARMUP, 2))
    x, expected = np.zeros(3), []
    for n in range(WARMUP + STEPS):
        y = C @ x + D @ u[n]
        e = measured[n] - y if n < WARMUP else 0
        x = A @ x + B @ u[n] + (K @ e if n < WARMUP else 0)
        expected.append(y)
    found = simulate(linear(K), measured, u, backend)
    np.testing.assert_allclose(found, expected[WARMUP:], atol=1e-12, rtol=0)


def test_a_free_run_does_not_depend_on_the_gain() -> None:
    torch.manual_seed(1)
    cell, u = StateSpace(3, 6, 2, 2), torch.randn(5, STEPS, 2)
    h, other = torch.randn(5, 3 + 2), StateSpace(3, 6, 2, 2)
    other.load_state_dict(cell.state_dict() | {"gain": 100 * torch.randn(3, 2)})
    for n in range(STEPS):
        following = cell.step(h, cell.observe(h), u[:, n])
        assert torch.equal(following, other.step(h, other.observe(h), u[:, n]))
        h = following


def test_several_layers_are_what_is_written_out() -> None:
    torch.manual_seed(2)
    cell, h, u = StateSpace(3, 6, 2, 1, layers=2), torch.randn(4, 5), torch.randn(4, 1)

    def equation(layers: Any, out: Any, x: Tensor) -> Tensor:
        seen = torch.cat([x, u], dim=1)
        units = torch.tanh(layers[2](torch.tanh(layers[0](seen))))
        return seen @ out.weight[:, :4].T + units @ out.weight[:, 4:].T + out.bias

    y = torch.randn(4, 2)
    x = equation(cell.f, cell.transition, h[:, :3]) + (y - h[:, 3:]) @ cell.gain.T
    expected = torch.cat([x, equation(cell.g, cell.observation, x)], dim=1)
    torch.testing.assert_close(cell.step(h, y, u), expected)
    assert not cell.fusable()
    measured, rows = torch.randn(4, 3, 2), torch.randn(4, 8, 1)
    assert torch.equal(rollout(cell, measured, 5, rows), rollout(cell, measured, 5, rows, "plain"))


def test_what_it_begins_with_is_stable_and_follows_the_measured_samples() -> None:
    for seed in range(20):
        torch.manual_seed(seed)
        cell = StateSpace(4, 8, 2, 1)
        a = cell.transition.weight[:, :4]
        observer = a - cell.gain @ cell.observation.weight[:, :4]
        for matrix in (a, observer):
            assert torch.linalg.eigvals(matrix).abs().max() < 1


def test_a_matrix_of_a_wrong_shape_is_named() -> None:
    with pytest.raises(ValueError, match=r"b must be \(3, 4\), got \(3, 2\)"):
        linear().set_linear(A, B, C, np.hstack([D, D]))


def test_templates_of_other_sizes_begin_with_its_own() -> None:
    found = [cell.sized(2, 4, 10) for cell in StateSpace(3, 8, layers=2).variants()]
    assert (found[0].states, found[0].hidden) == (3, 8)
    assert len({(cell.states, cell.hidden) for cell in found}) == len(found)
    assert {(cell.ny, cell.nu, cell.layers, cell.encoded) for cell in found} == {(2, 4, 2, 10)}


def test_a_forecaster_learns_with_it_a_nonlinear_system() -> None:
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1, 1, 60), 10)
    x = np.zeros((600, 2))
    for n in range(599):
        rate = x[n, 1] + 0.3 * (u[n] - 0.6 * x[n, 1] - x[n, 0] - x[n, 0] ** 3)
        x[n + 1] = x[n, 0] + 0.3 * rate, rate
    record = sb.Record(x[:, :1], 1.0, u=u[:, None])
    settings = sb.TrainingSettings.paper(100, 20, 3, 25, 1e-2, lbfgs_iterations=60, max_batches=20)
    model = sb.Single(sb.StateSpace(2, 6), settings).fit(record[:500], seed=0)
    assert isinstance(model.model, Recurrent)
    error = model.predict(100, u=u[500:, None]).y - x[500:, :1]
    assert np.sqrt(np.mean(error**2)) < 0.05 * x.std()

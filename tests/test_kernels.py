"""The fused rollouts against the plain loop, `nn.GRU` and float64: samples and every gradient."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from torch import Tensor, nn

from splitband.cells import GRU, EulerMLP
from splitband.kernels import euler_rollout, gru_rollout
from splitband.rollout import free_run

RTOL = {torch.float32: 1e-5, torch.float64: 1e-10}
DTYPES = list(RTOL)
# batch, warm-up, steps, ny, hidden size, nu
SIZES = [(50, 30, 60, 1, 64, 0), (5, 4, 7, 3, 10, 2), (1, 1, 1, 1, 1, 0), (3, 1, 2, 2, 17, 1)]
SIZES += [(13, 2, 9, 2, 48, 0), (1, 70, 3, 3, 33, 2), (2, 3, 70, 17, 20, 18)]

Run = Callable[..., Tensor]


@pytest.fixture(autouse=True)
def _seeded_on_two_threads():
    threads = torch.get_num_threads()
    torch.manual_seed(0)
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(threads)


def plain(cell, y, steps, u=None):
    past, future = (None, None) if u is None else (u[:, : y.shape[1]], u[:, y.shape[1] :])
    return free_run(cell, cell.initial_state(y, past), steps, future)[0]


def fused(cell, y, steps, u=None):
    recurrent, out = cell.transition, cell.observation
    weights = recurrent.weight_ih, recurrent.weight_hh, recurrent.bias_ih, recurrent.bias_hh
    return gru_rollout(y, steps, u, *weights, out.weight, out.bias)


def plain_euler(cell, h0, steps, u=None):
    return free_run(cell, h0, steps, u)[0]


def fused_euler(cell, h0, steps, u=None):
    f = cell.dynamics
    weights = [p for i in (0, 2, 4) for p in (f[i].weight, f[i].bias)]
    return euler_rollout(h0, steps, cell.ny, cell.step_size, u, *weights)


def gru_case(sizes, dtype):
    batch, warmup, steps, ny, hidden, nu = sizes
    cell = GRU(ny, hidden, nu).to(dtype)
    y = torch.randn(batch, warmup, ny, dtype=dtype, requires_grad=True)
    u = torch.randn(batch, warmup + steps + 1, nu, dtype=dtype, requires_grad=True)
    return cell, y, steps, u if nu else None


def euler_case(sizes, dtype):
    batch, warmup, steps, ny, hidden, nu = sizes
    cell = EulerMLP(ny, warmup, ny + 1, hidden, 5, 0.3, nu).to(dtype)
    h0 = torch.randn(batch, ny + 1, dtype=dtype, requires_grad=True)
    u = torch.randn(batch, steps + 1, nu, dtype=dtype, requires_grad=True)
    return cell, h0, steps, u if nu else None


CASES = pytest.mark.parametrize(
    ("case", "kernel", "loop"),
    [(gru_case, fused, plain), (euler_case, fused_euler, plain_euler)],
    ids=["GRU", "EulerMLP"],
)


def samples_and_gradients(run: Run, cell: nn.Module, start: Tensor, steps: int, u: Tensor | None):
    """The samples, and the gradients of their RMSE against noise with respect to everything."""
    y = run(cell, start, steps, u)
    target = torch.randn(y.shape, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    inputs = {**dict(cell.named_parameters()), "start": start} | ({} if u is None else {"u": u})
    rmse = (y - target.to(y)).square().mean().sqrt()
    grads = torch.autograd.grad(rmse, list(inputs.values()), allow_unused=True)
    return {"y": y} | {
        name: torch.zeros_like(x) if grad is None else grad
        for (name, x), grad in zip(inputs.items(), grads, strict=True)
    }


def agree(found, expected, rtol):
    for name, value in expected.items():
        assert found[name].dtype == value.dtype, name
        atol = rtol * max(value.abs().max().item(), 1e-3)
        torch.testing.assert_close(found[name], value, rtol=0, atol=atol, msg=lambda m: name + m)


@CASES
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_samples_and_every_gradient_are_those_of_the_plain_loop(case, kernel, loop, sizes, dtype):
    args = case(sizes, dtype)
    agree(
        samples_and_gradients(kernel, *args), samples_and_gradients(loop, *args), RTOL[dtype]
    )

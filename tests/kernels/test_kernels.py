"""The fused rollouts against the plain loop, `nn.GRU` and float64: samples and every gradient."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor, nn
from torch.utils._python_dispatch import TorchDispatchMode

from splitband.kernels.euler_mlp import euler_rollout
from splitband.kernels.gru import gru_rollout
from splitband.kernels.state_space import state_space_rollout
from splitband.networks import GRU, EulerMLP, StateSpace, free_run

Sizes = tuple[int, int, int, int, int, int]
Run = Callable[..., Tensor]
Case = Callable[[Sizes, torch.dtype], tuple[Any, Tensor, int, Any]]

RTOL = {torch.float32: 1e-5, torch.float64: 1e-10}
DTYPES = list(RTOL)
# batch, warm-up, steps, ny, hidden size, nu
SIZES: list[Sizes] = [
    (50, 30, 60, 1, 64, 0),
    (1, 1, 1, 1, 1, 0),
    (13, 2, 9, 2, 48, 0),
    (1, 70, 3, 3, 33, 2),
    (2, 3, 70, 17, 20, 18),
    (3, 2, 4, 1, 512, 1),
]
"""Many rows and one; sizes that are blocks of the processor's registers, and that are not; rows a
power of two apart."""


def plain(cell: GRU, y: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
    past, future = (None, None) if u is None else (u[:, : y.shape[1]], u[:, y.shape[1] :])
    return free_run(cell, cell.initial_state(y, past), steps, future)[0]


def fused(cell: GRU, y: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
    recurrent, out = cell.transition, cell.observation
    weights = recurrent.weight_ih, recurrent.weight_hh, recurrent.bias_ih, recurrent.bias_hh
    return gru_rollout(y, steps, u, *weights, out.weight, out.bias)


def plain_euler(cell: Any, h0: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
    return free_run(cell, h0, steps, u)[0]


def fused_euler(cell: Any, h0: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
    f = cell.dynamics
    weights = [p for i in (0, 2, 4) for p in (f[i].weight, f[i].bias)]
    return euler_rollout(h0, steps, cell.ny, cell.step_size, u, *weights)


def plain_state_space(cell: Any, y: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
    h = cell._with_output(cell.x0.expand(len(y), -1), None if u is None else u[:, 0])
    for n in range(y.shape[1]):
        h = cell.step(h, y[:, n], None if u is None else u[:, n])
    return free_run(cell, h, steps, None if u is None else u[:, y.shape[1] :])[0]


def fused_state_space(cell: Any, y: Tensor, steps: int, u: Tensor | None = None) -> Tensor:
    units = [cell.f[0].weight, cell.f[0].bias, cell.g[0].weight, cell.g[0].bias]
    out = [p for layer in (cell.transition, cell.observation) for p in layer.parameters()]
    weights = [*units, *out, cell.gain]
    return state_space_rollout(cell.x0.expand(len(y), -1), y, steps, u, *weights)


def gru_case(sizes: Sizes, dtype: torch.dtype) -> tuple[Any, Tensor, int, Any]:
    batch, warmup, steps, ny, hidden, nu = sizes
    cell = GRU(hidden, ny, nu).to(dtype)
    y = torch.randn(batch, warmup, ny, dtype=dtype, requires_grad=True)
    u = torch.randn(batch, warmup + steps + 1, nu, dtype=dtype, requires_grad=True)
    return cell, y, steps, u if nu else None


def euler_case(sizes: Sizes, dtype: torch.dtype) -> tuple[Any, Tensor, int, Any]:
    batch, warmup, steps, ny, hidden, nu = sizes
    cell = EulerMLP(ny, warmup, ny + 1, hidden, 5, 0.3, nu).to(dtype)
    h0 = torch.randn(batch, ny + 1, dtype=dtype, requires_grad=True)
    u = torch.randn(batch, steps + 1, nu, dtype=dtype, requires_grad=True)
    return cell, h0, steps, u if nu else None


def state_space_case(sizes: Sizes, dtype: torch.dtype) -> tuple[Any, Tensor, int, Any]:
    batch, warmup, steps, ny, hidden, nu = sizes
    cell = StateSpace(3, hidden, ny, nu)
    with torch.no_grad():
        for layer in (cell.transition, cell.observation):
            layer.weight[:, 3 + nu :] *= 3
    cell.x0 = nn.Parameter(torch.randn(3))
    y = torch.randn(batch, warmup, ny, dtype=dtype, requires_grad=True)
    u = torch.randn(batch, warmup + steps + 1, nu, dtype=dtype, requires_grad=True)
    return cell.to(dtype), y, steps, u if nu else None


CASES = pytest.mark.parametrize(
    ("case", "kernel", "loop"),
    [
        (gru_case, fused, plain),
        (euler_case, fused_euler, plain_euler),
        (state_space_case, fused_state_space, plain_state_space),
    ],
    ids=["GRU", "EulerMLP", "StateSpace"],
)


def samples_and_gradients(
    run: Run, cell: nn.Module, start: Tensor, steps: int, u: Tensor | None = None
) -> dict[str, Tensor]:
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


def agree(found: dict[str, Tensor], expected: dict[str, Tensor], rtol: float) -> None:
    """Largest error within `rtol` of the largest value, array by array."""
    assert found.keys() == expected.keys()
    for name, value in expected.items():
        assert found[name].dtype == value.dtype
        assert found[name].shape == value.shape
        if value.numel():
            error = (found[name] - value).abs().max().item()
            assert error <= rtol * max(value.abs().max().item(), 1e-3), name


@CASES
@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("sizes", SIZES, ids=str)
def test_samples_and_every_gradient_are_those_of_the_plain_loop(
    case: Case, kernel: Run, loop: Run, sizes: Sizes, dtype: torch.dtype
) -> None:
    args = case(sizes, dtype)
    agree(samples_and_gradients(kernel, *args), samples_and_gradients(loop, *args), RTOL[dtype])


@CASES
@settings(max_examples=settings().max_examples // 4)
@given(
    sizes=st.tuples(
        st.integers(1, 9),
        st.integers(1, 4),
        st.integers(0, 5),
        st.integers(1, 4),
        st.integers(1, 40),
        st.integers(0, 3),
    )
)
def test_any_sizes(case: Case, kernel: Run, loop: Run, sizes: Sizes) -> None:
    torch.manual_seed(0)  # for each example, so that it can be found again
    args = case(sizes, torch.float64)
    if args[2]:
        found, expected = (samples_and_gradients(run, *args) for run in (kernel, loop))
        agree(found, expected, 1e-10)
    else:
        assert kernel(*args).shape == (sizes[0], 0, sizes[3])


@pytest.mark.parametrize("sizes", [(2, 2, 3, 2, 3, 1), (1, 1, 2, 1, 2, 0)], ids=str)
@CASES
def test_gradcheck(case: Case, kernel: Run, loop: Run, sizes: Sizes) -> None:
    cell, start, steps, u = case(sizes, torch.float64)
    weights = list(cell.parameters())
    inputs = [start, *weights] if u is None else [start, *weights, u]
    # The kernels read the weights from the cell, where gradcheck moves them in place.
    assert torch.autograd.gradcheck(lambda *_: kernel(cell, start, steps, u), inputs)


@pytest.mark.parametrize("dtype", DTYPES)
def test_the_warm_up_is_a_teacher_forced_gru(dtype: torch.dtype) -> None:
    cell, y, *_ = gru_case((5, 20, 1, 2, 24, 0), dtype)
    layer = nn.GRU(2, 24, batch_first=True).to(dtype)
    mine = cell.transition
    with torch.no_grad():
        for name, value in mine.named_parameters():
            getattr(layer, f"{name}_l0").copy_(value)
    expected = cell.observation(layer(y)[1][0])[:, None]
    found = fused(cell, y, 1)
    error = torch.randn_like(expected)
    pairs = [(y, y), *((p, getattr(layer, f"{n}_l0")) for n, p in mine.named_parameters())]
    ours, theirs = zip(*pairs, strict=True)
    torch.testing.assert_close(found, expected, rtol=RTOL[dtype], atol=RTOL[dtype])
    for a, b in zip(
        torch.autograd.grad(found, ours, error),
        torch.autograd.grad(expected, theirs, error),
        strict=True,
    ):
        torch.testing.assert_close(a, b, rtol=RTOL[dtype], atol=RTOL[dtype] * b.abs().max().item())


@CASES
def test_inputs_and_weights_need_not_be_contiguous(case: Case, kernel: Run, loop: Run) -> None:
    cell, start, steps, u = case((4, 3, 5, 2, 20, 2), torch.float64)
    strided = torch.stack([start.detach(), start.detach()], dim=-1)[..., 0].requires_grad_()
    long = torch.randn(2, 9, 4, dtype=torch.float64).requires_grad_()
    u = long.transpose(0, 2)[..., ::1]
    assert not strided.is_contiguous()
    assert not u.is_contiguous()
    for layer in cell.modules():
        for name, weight in list(layer.named_parameters(recurse=False)):
            spread = torch.stack([weight.detach(), weight.detach()], dim=-1)[..., 0]
            setattr(layer, name, nn.Parameter(spread))
    agree(
        samples_and_gradients(kernel, cell, strided, steps, u),
        samples_and_gradients(loop, cell, strided, steps, u),
        1e-10,
    )


@CASES
@pytest.mark.parametrize("dtype", DTYPES)
def test_a_nan_stays_in_its_row_and_shows(
    case: Case, kernel: Run, loop: Run, dtype: torch.dtype
) -> None:
    cell, start, steps, u = case((6, 3, 5, 2, 20, 2), dtype)
    with torch.no_grad():
        clean = kernel(cell, start, steps, u)
        start[2].flatten()[0] = torch.nan
        u[4, -4 if case is euler_case else -5] = torch.nan
        found = kernel(cell, start, steps, u)
        assert torch.equal(found.isnan(), loop(cell, start, steps, u).isnan())
    assert found[2, 1:].isnan().all()
    assert found[4, -1].isnan().all()
    assert torch.equal(found[[0, 1, 3, 5]], clean[[0, 1, 3, 5]])


def test_infinite_inputs_saturate_the_gates() -> None:
    cell, y, steps, _ = gru_case((2, 3, 4, 1, 5, 0), torch.float32)
    with torch.no_grad():
        y[0, 1] = torch.inf
        torch.testing.assert_close(fused(cell, y, steps), plain(cell, y, steps))


class Allocations(TorchDispatchMode):
    """Sizes of what torch makes."""

    def __init__(self) -> None:
        super().__init__()  # type: ignore[no-untyped-call]
        self.sizes: list[int] = []

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        out = func(*args, **(kwargs or {}))
        if "empty" in str(func):
            self.sizes.append(out.numel())
        return out


@CASES
def test_without_gradients_the_memory_does_not_grow_with_the_steps(
    case: Case, kernel: Run, loop: Run
) -> None:
    steps = 200_000
    cell, start, *_ = case((1, 3, 1, 1, 16, 0), torch.float32)
    with torch.no_grad(), Allocations() as made:
        y = kernel(cell, start, steps)
    assert y.isfinite().all()
    assert sorted(made.sizes)[-1] == steps
    assert sum(made.sizes) < steps + 10_000
    with Allocations() as made:
        kernel(cell, start, 1000)
    assert max(made.sizes) > 10_000


@CASES
def test_backward_can_be_repeated_but_not_differentiated(
    case: Case, kernel: Run, loop: Run
) -> None:
    cell, start, steps, u = case((3, 2, 5, 1, 7, 1), torch.float64)
    y = kernel(cell, start, steps, u).square().sum()
    (first,) = torch.autograd.grad(y, start, retain_graph=True)
    (again,) = torch.autograd.grad(y, start, create_graph=True)
    assert torch.equal(again, first)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        again.sum().backward()


@CASES
def test_rows_do_not_see_each_other_nor_the_number_of_threads(
    monkeypatch: pytest.MonkeyPatch, case: Case, kernel: Run, loop: Run
) -> None:
    cell, start, steps, u = case((11, 3, 20, 2, 20, 1), torch.float32)
    whole = kernel(cell, start, steps, u)
    for rows in (slice(0, 1), slice(3, 8)):
        torch.testing.assert_close(kernel(cell, start[rows], steps, u[rows]), whole[rows])
    two = samples_and_gradients(kernel, cell, start, steps, u)
    monkeypatch.setattr(torch, "get_num_threads", lambda: 1)
    agree(samples_and_gradients(kernel, cell, start, steps, u), two, 1e-5)


@CASES
def test_several_threads_at_once(case: Case, kernel: Run, loop: Run) -> None:
    args = case((8, 3, 50, 1, 32, 0), torch.float64)
    alone = samples_and_gradients(kernel, *args)
    with ThreadPoolExecutor(8) as pool:
        runs = [pool.submit(samples_and_gradients, kernel, *args) for _ in range(40)]
        for run in runs:
            agree(run.result(), alone, 1e-12)


@pytest.mark.soak
def test_the_process_that_compiles_a_kernel_gives_the_bits_of_later_ones(tmp_path: Path) -> None:
    code = """
import torch
from splitband.networks import GRU, rollout
torch.manual_seed(0)
cell, y = GRU(48), torch.randn(25, 50, 1)
rollout(cell, y, 250).square().sum().backward()
print([p.grad.numpy().tobytes().hex() for p in cell.parameters()])
"""
    cached = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    compiled, loaded = (
        subprocess.run([sys.executable, "-c", code], env=cached, stdout=-1, check=True).stdout
        for _ in range(2)
    )
    assert any(tmp_path.rglob("*.nbi"))
    assert compiled == loaded

"""Training steps through a rollout: the kernels against loops over steps, JAX and their products.

    python -m benchmarks.rollout [--out FILE.json]

A training step is rollout, RMSE, backward and an Adam step. Times are medians of interleaved
repeats in one run; read the ratios. "Products" are the matrix products that a step cannot do
without, by `torch.mm` into ready buffers and nothing else: for a GRU, per step (B, H) by (H, 3 H)
forward and (B, 3 H) by (3 H, H) backward, and once (3 H, n B) by (n B, H) for the weights; for an
EulerMLP likewise with M by M. Those with inputs and outputs are left out.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn

from benchmarks.peers import installed, jax_gru, tsfast_gru, tsfast_state_space
from benchmarks.timing import circumstances, medians, threads, write
from splitband.networks import GRU, EulerMLP, rollout
from splitband.runtime.threads import one_torch_thread

WARMUP, WINDOW, BATCH, HIDDEN = 30, 150, 50, 64
EULER_WARMUP, EULER_WINDOW, EULER_HIDDEN = 20, 200, 500

Call = Callable[[], object]


def training_step(
    predict: Callable[[], Tensor],
    target: Tensor,
    parameters: Iterable[nn.Parameter],
) -> Call:
    """One step, with Adam on one thread as `splitband.fit` has it."""
    optimizer = torch.optim.Adam(parameters)

    def step() -> None:
        optimizer.zero_grad()
        (predict() - target).square().mean().sqrt().backward()
        with one_torch_thread():
            optimizer.step()

    return step


class Loop(nn.Module):
    """A free run by one call of `nn.GRU` per step, as it is commonly written."""

    def __init__(self, hidden: int) -> None:
        super().__init__()
        self.gru = nn.GRU(1, hidden, batch_first=True)
        self.out = nn.Linear(hidden, 1)

    def forward(self, warmup: Tensor, steps: int) -> Tensor:
        """Warm up, then feed each sample back."""
        _, h = self.gru(warmup)
        samples = [self.out(h[0])[:, None]]
        for _ in range(steps - 1):
            seen, h = self.gru(samples[-1], h)
            samples.append(self.out(seen))
        return torch.cat(samples, dim=1)


def products(batch: int, steps: int, rows: int, columns: int) -> Call:
    """The products with one matrix `(rows, columns)`: forward, backward, and for its gradient."""
    w, x = torch.randn(rows, columns), torch.randn(batch, columns)
    dy = torch.randn(batch, rows)
    xs, dys = torch.randn(batch * steps, columns), torch.randn(batch * steps, rows)
    y, dx, dw = torch.empty_like(dy), torch.empty_like(x), torch.empty_like(w)

    def call() -> None:
        for _ in range(steps):
            torch.mm(x, w.t(), out=y)
        for _ in range(steps):
            torch.mm(dy, w, out=dx)
        torch.mm(dys.t(), xs, out=dw)

    return call


def gru_calls(hidden: int, batch: int, window: int) -> dict[str, Call]:
    """The same training step by our loop and our kernel, and its products."""
    y = torch.randn(batch, WARMUP + window, 1)
    warmup, target = y[:, :WARMUP], y[:, WARMUP:]

    def step(backend: Any) -> Call:
        cell = GRU(hidden, 1)
        return training_step(
            lambda: rollout(cell, warmup, window, backend=backend), target, cell.parameters()
        )

    return {
        "plain loop": step("plain"),
        "kernel": step("fused"),
        "products": products(batch, WARMUP + window - 1, 3 * hidden, hidden),
    }


def gru_peers() -> dict[str, Call]:
    """The training step as others have it."""
    y = torch.randn(BATCH, WARMUP + WINDOW, 1)
    warmup, target = y[:, :WARMUP], y[:, WARMUP:]
    loop = Loop(HIDDEN)
    calls = {
        "nn.GRU, step by step": training_step(
            lambda: loop(warmup, WINDOW), target, loop.parameters()
        )
    }
    if installed("tsfast"):
        model, predict = tsfast_gru(1, HIDDEN)
        calls["tsfast AR_Model"] = training_step(
            lambda: predict(warmup, WINDOW), target, model.parameters()
        )
    if installed("jax"):
        calls["JAX scan"] = jax_gru(y, WARMUP, HIDDEN)
    return calls


def euler_calls() -> dict[str, Call]:
    """The training step of an EulerMLP 4-500-500-4, and its products."""
    y = torch.randn(BATCH, EULER_WARMUP + EULER_WINDOW, 4)
    warmup, target = y[:, :EULER_WARMUP], y[:, EULER_WARMUP:]

    def step(backend: Any) -> Call:
        cell = EulerMLP(4, EULER_WARMUP, 4, EULER_HIDDEN, step_size=0.1)
        return training_step(
            lambda: rollout(cell, warmup, EULER_WINDOW, backend=backend), target, cell.parameters()
        )

    def peer(backend: str) -> Call:
        model, predict = tsfast_state_space(4, EULER_HIDDEN, backend)
        return training_step(
            lambda: predict(warmup[:, 0], EULER_WINDOW), target, model.parameters()
        )

    calls = {
        "plain loop": step("plain"),
        "kernel": step("fused"),
        "products": products(BATCH, EULER_WINDOW - 1, EULER_HIDDEN, EULER_HIDDEN),
    }
    if installed("tsfast"):
        calls["tsfast NeuralStateSpace, eager"] = peer("eager")
        calls["tsfast NeuralStateSpace, C"] = peer("c")
    return calls


def compare(title: str, calls: dict[str, Call], repeats: int) -> dict[str, float]:
    """Print and return the milliseconds of each call, and its ratio to the kernel's."""
    seconds = medians(calls, repeats)
    figures = {}
    print(f"{title}, {torch.get_num_threads()} thread(s)")
    for name, value in seconds.items():
        figures[f"{name}, ms"] = 1e3 * value
        figures[f"{name} / kernel"] = value / seconds["kernel"]
        print(f"  {name:32s} {1e3 * value:9.2f} ms {figures[f'{name} / kernel']:7.2f} kernels")
    return figures


def growth(repeats: int) -> dict[str, dict[str, float]]:
    """One of hidden size, batch and window at a time away from the usual."""
    cases = [(hidden, BATCH, WINDOW) for hidden in (16, 32, 64, 128, 256)]
    cases += [(HIDDEN, batch, WINDOW) for batch in (1, 8, 128, 512)]
    cases += [(HIDDEN, BATCH, window) for window in (50, 500, 1500, 5000)]
    return {
        f"hidden {hidden}, batch {batch}, window {window}": compare(
            f"GRU, hidden {hidden}, batch {batch}, window {window}",
            gru_calls(hidden, batch, window),
            max(3, repeats * WINDOW * BATCH // (max(window, WINDOW) * max(batch, BATCH))),
        )
        for hidden, batch, window in cases
    }


def main() -> None:
    """Print and, if asked to, write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, help="JSON file for the figures")
    parser.add_argument("--repeats", type=int, default=20, help="turns of the quickest cases")
    arguments = parser.parse_args()
    figures = circumstances("torch", "numba", "numpy", "jax", "tsfast")
    print(figures)
    for count in (1, 2):
        with threads(count):
            gru = gru_calls(HIDDEN, BATCH, WINDOW) | gru_peers()
            figures[f"GRU, {count} threads"] = compare("GRU", gru, arguments.repeats)
            figures[f"EulerMLP, {count} threads"] = compare(
                "EulerMLP", euler_calls(), max(3, arguments.repeats // 5)
            )
            figures[f"growth, {count} threads"] = growth(arguments.repeats // 3)
    write(figures, arguments.out)


if __name__ == "__main__":
    main()

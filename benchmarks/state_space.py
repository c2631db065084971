"""Gradients of a state-space network: the kernel against the loop, JAX, products and a GRU.

    python -m benchmarks.state_space [--out docs/benchmarks/state_space.json]

A gradient is rollout, RMSE and backward, on one thread. The calls take turns, so that other work of
the machine meets all of them; figures are medians of CPU time. "Products" are the matrix products
of the same step by `torch.mm` into ready buffers and nothing else: those of the state equation one
after the other, forward and backward, those of the output equation and of the weights at once.
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks.peers import installed, jax_state_space
from benchmarks.timing import circumstances, medians, write
from splitband.networks import GRU, StateSpace, rollout
from splitband.runtime.threads import use_one_thread

CASES = ((25, 50, 350), (50, 30, 150), (128, 50, 200), (650, 33, 67), (1, 50, 1000), (1, 50, 65000))
"""Batch, warm-up and steps."""
SIZES = ((4, 8), (4, 24), (16, 32))
"""States and units."""
NU = 2
LONGEST_LOOP = 2000

Call = Callable[[], object]


def gradient(cell: GRU | StateSpace, y: Tensor, u: Tensor, warmup: int, backend: Any) -> Call:
    """Of the RMSE of a free run with respect to every weight."""

    def call() -> None:
        cell.zero_grad(set_to_none=True)
        predicted = rollout(cell, y[:, :warmup], y.shape[1] - warmup, u, backend)
        (predicted - y[:, warmup:]).square().mean().sqrt().backward()

    return call


def products(batch: int, steps: int, states: int, hidden: int) -> Call:
    """The products of a gradient, by `torch.mm`."""
    seen, out = states + NU, states + NU + hidden
    of_units, of_states, of_outputs = (
        torch.randn(*s) for s in ((hidden, seen), (states, out), (1, out))
    )
    z, a, x, d = (torch.randn(batch, n) for n in (seen, hidden, states, out))
    rows = batch * steps
    zs, fs, xs, full, ys = (torch.randn(rows, n) for n in (seen, hidden, states, out, 1))
    d_units, d_states, d_outputs = (torch.empty_like(w) for w in (of_units, of_states, of_outputs))

    def call() -> None:
        for _ in range(steps):
            torch.mm(z, of_units.t(), out=a)
            torch.mm(d, of_states.t(), out=x)
        torch.mm(zs, of_units.t(), out=fs)
        torch.mm(full, of_outputs.t(), out=ys)
        torch.mm(ys, of_outputs, out=full)
        torch.mm(fs, of_units, out=zs)
        for _ in range(steps):
            torch.mm(x, of_states, out=d)
            torch.mm(a, of_units, out=z)
        for _ in range(2):
            torch.mm(fs.t(), zs, out=d_units)
        torch.mm(xs.t(), full, out=d_states)
        torch.mm(ys.t(), full, out=d_outputs)

    return call


def calls(batch: int, warmup: int, steps: int, states: int, hidden: int) -> dict[str, Call]:
    """The same gradient in several ways, and that of a GRU with as many units."""
    y, u = torch.randn(batch, warmup + steps, 1), torch.randn(batch, warmup + steps, NU)
    torch.manual_seed(0)
    cell, gru = StateSpace(states, hidden, 1, NU), GRU(hidden, 1, NU)
    found = {
        "kernel": gradient(cell, y, u, warmup, "fused"),
        "GRU of as many units": gradient(gru, y, u, warmup, "fused"),
        "products": products(batch, warmup + steps - 1, states, hidden),
    }
    if steps <= LONGEST_LOOP:
        found["plain loop"] = gradient(cell, y, u, warmup, "plain")
    if installed("jax"):
        found["JAX scan"] = jax_state_space(y, u, warmup, dict(cell.named_parameters()))
    return found


def main() -> None:
    """Print and, if asked to, write the figures."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path)
    parser.add_argument("--repeats", type=int, default=20, help="turns of the quickest cases")
    arguments = parser.parse_args()
    one = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
    os.environ["XLA_FLAGS"] = one  # read when JAX is loaded
    use_one_thread()
    figures = circumstances("torch", "numba", "jax")
    for batch, warmup, steps in CASES:
        for states, hidden in SIZES:
            title = f"{states} states, {hidden} units, batch {batch}, window {warmup + steps}"
            repeats = max(2, min(arguments.repeats, arguments.repeats * 20_000 // (batch * steps)))
            seconds = medians(
                calls(batch, warmup, steps, states, hidden), repeats, time.process_time
            )
            print(title)
            figures[title] = of_case = {}
            for name, value in seconds.items():
                of_case[f"{name}, ms"] = 1e3 * value
                of_case[f"{name} / kernel"] = value / seconds["kernel"]
                print(
                    f"  {name:24s} {1e3 * value:9.3f} ms {value / seconds['kernel']:7.2f} kernels"
                )
            write(figures, arguments.out)


if __name__ == "__main__":
    main()

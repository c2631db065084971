"""Run compiled rollouts and their gradients, with the rows of a batch split over threads."""

from __future__ import annotations

import math
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from splitband.kernels.common import PAD, Array, Arrays

Shapes = Sequence[tuple[int, ...]]

CROWDED = 512
"""`pad` avoids rows at multiples of this distance, in numbers. With 512 columns, products then take
0.4 to 0.6 of the time (501 rows, 8 to 50 rows of data, 512 KiB of second-level cache)."""
_WORTH_A_THREAD = 1e7
"""Multiplications in the time of waking a thread."""
_GRADIENT_ROWS = 64
"""Least rows of gradients in a product."""

# Numba's own threads may not be entered from several threads at once on every platform.
_POOL = ThreadPoolExecutor(os.cpu_count(), "splitband")


@dataclass(frozen=True)
class Kernel(ABC):
    """The compiled rollout of a kind of cell, for `run`.

    Attributes
    ----------
    batch, steps, ny, nu : Sizes of the samples and of the known inputs.
    last : Steps of the state, the warm-up included.
    forward, backward : Compiled functions of a job, some rows of the batch.
        `forward(inputs, weights, buffers, y)` writes the samples, and intermediate values.
        `backward(wanted, dy, weights, buffers, sums, gradients)` adds gradients of weights to
        `sums` and writes gradients of `inputs`; of samples and known inputs only if `wanted`.
    """

    batch: int
    steps: int
    ny: int
    nu: int
    last: int
    forward: Callable[..., None]
    backward: Callable[..., None]

    @abstractmethod
    def pack(self, *weights: Array) -> Arrays:
        """Return the weights in the layout of `forward`."""

    def pack_back(self, *weights: Array) -> Arrays:
        """Return the weights in the layout of `backward`."""
        return self.pack(*weights)

    @abstractmethod
    def split(self, packed: Arrays) -> list[slice]:
        """Return the rows by job."""

    @abstractmethod
    def kept(self, packed: Arrays, rows: int, keep: bool) -> Shapes:
        """Return the shapes of `forward`'s intermediate values: of all steps, or of one."""

    def scratch(self, packed: Arrays, rows: int) -> Shapes:
        """Return the shapes of `backward`'s work space, appended to `buffers`."""
        return ()

    @abstractmethod
    def sums(self, packed: Arrays) -> Shapes:
        """Return the shapes of the gradients of the weights."""

    @abstractmethod
    def unpack(self, *sums: Array) -> Iterable[Array]:
        """Return the gradients by weight; entries beyond the weight's shape are ignored."""


def run(kernel: Kernel, inputs: tuple[Tensor, ...], weights: tuple[Tensor, ...]) -> Tensor:
    """Return the samples `(batch, steps, ny)`, differentiable once.

    Without gradients the memory does not grow with the steps, apart from the result.

    Parameters
    ----------
    inputs : Tensors by row; the last two are measured samples or a state, and known inputs.
    weights : Tensors common to all rows.
    """
    if not kernel.steps:
        return inputs[0].new_empty(kernel.batch, 0, kernel.ny)
    if torch.is_grad_enabled() and any(t.requires_grad for t in (*inputs, *weights)):
        y: Tensor = _Rollout.apply(kernel, len(inputs), *inputs, *weights)  # type: ignore[no-untyped-call]
        return y
    return _simulate(kernel, inputs, weights, keep=False)[0]


class _Rollout(torch.autograd.Function):
    @staticmethod
    def forward(ctx: Any, kernel: Kernel, count: int, *tensors: Tensor) -> Tensor:
        inputs, weights = tensors[:count], tensors[count:]
        y, whole, ctx.kept, ctx.rows = _simulate(kernel, inputs, weights, keep=True)
        ctx.save_for_backward(*weights, whole)
        ctx.kernel, ctx.shapes = kernel, [x.shape for x in inputs]
        return y

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, dy: Tensor) -> tuple[Tensor | None, ...]:
        kernel, split = ctx.kernel, ctx.rows
        *weights, whole = ctx.saved_tensors
        packed = kernel.pack_back(*(w.detach().numpy() for w in weights))
        gradients = [zeros(dy, *shape) for shape in ctx.shapes]
        scratch = [kernel.scratch(packed, rows.stop - rows.start) for rows in split]
        shapes = [kernel.sums(packed) for _ in split]
        buffers, working = _cut(whole, ctx.kept), _cut(dy.new_empty(_length(scratch)), scratch)
        sums = _cut(zeros(dy, _length(shapes)), shapes)
        # All inputs but the state at the first sample.
        wanted = any(ctx.needs_input_grad[len(ctx.shapes) : 2 + len(ctx.shapes)])
        dy_rows, written = dy.contiguous().numpy(), [g.numpy() for g in gradients]
        jobs = []
        for i, rows in enumerate(split):
            arrays = packed, buffers[i] + working[i], sums[i], tuple(g[rows] for g in written)
            jobs.append((wanted, dy_rows[rows], *arrays))
        run_jobs(kernel.backward, jobs)
        of_weights = kernel.unpack(*(sum(parts) for parts in zip(*sums, strict=True)))
        cut = (g[tuple(map(slice, w.shape))] for g, w in zip(of_weights, weights, strict=True))
        return None, None, *gradients, *(torch.from_numpy(np.ascontiguousarray(g)) for g in cut)


def _simulate(
    kernel: Kernel, inputs: Sequence[Tensor], weights: Sequence[Tensor], keep: bool
) -> tuple[Tensor, Tensor, list[Shapes], list[slice]]:
    """Return the samples, the intermediate values, their shapes and the rows by job."""
    packed = kernel.pack(*(w.detach().numpy() for w in weights))
    split = kernel.split(packed)
    shapes = [kernel.kept(packed, rows.stop - rows.start, keep) for rows in split]
    y = inputs[0].new_empty(kernel.batch, kernel.steps, kernel.ny)
    whole = y.new_empty(_length(shapes))
    samples, arrays = y.numpy(), [x.detach().contiguous().numpy() for x in inputs]
    jobs = [
        (tuple(x[rows] for x in arrays), packed, buffers, samples[rows])
        for rows, buffers in zip(split, _cut(whole, shapes), strict=True)
    ]
    run_jobs(kernel.forward, jobs)
    return y, whole, shapes, split


def pad(x: Array) -> Array:
    """Return a copy with the last axis padded with zeros to a multiple of `PAD`.

    Rows a multiple of `CROWDED` apart would share few places of the cache: they get `PAD` more.
    """
    width = padded(x.shape[-1])
    width += PAD * (width % CROWDED == 0)
    out: Array = zeros(torch.from_numpy(x[..., :0]), *x.shape[:-1], width).numpy()
    out[..., : x.shape[-1]] = x
    return out


def padded(n: int) -> int:
    """Return the next multiple of `PAD`."""
    return -(-n // PAD) * PAD


def zeros(like: Tensor, *shape: int) -> Tensor:
    """Return zeros in the dtype of `like`.

    Buffers come from torch, which aligns them to 64 bytes. NumPy fills them: torch's own threads
    would go on spinning for milliseconds on the cores of `run_jobs`.
    """
    out = like.new_empty(shape)
    out.numpy().fill(0)
    return out


def _length(jobs: Iterable[Shapes]) -> int:
    """Return the length of a buffer for `_cut`."""
    return sum(padded(math.prod(shape)) for shapes in jobs for shape in shapes)


def _cut(buffer: Tensor, jobs: Iterable[Shapes]) -> list[Arrays]:
    """Return arrays of the given shapes by job, as views of one buffer.

    The C library returns several large allocations to the system, and taking them again page by
    page costs as much as the products.
    """
    values, at = buffer.numpy(), 0
    by_job: list[Arrays] = []
    for shapes in jobs:
        arrays = []
        for shape in shapes:
            arrays.append(values[at : at + math.prod(shape)].reshape(shape))
            at += padded(math.prod(shape))
        by_job.append(tuple(arrays))
    return by_job


def gradient_steps(rows: int) -> int:
    """Return the number of steps with gradients in one product."""
    return -(-_GRADIENT_ROWS // max(rows, 1))


def split_rows(batch: int, work: float, least: int = 1) -> list[slice]:
    """Split batch rows over torch's threads by `work` (multiplications), into at least `least`."""
    n = max(1, min(torch.get_num_threads(), batch, int(work / _WORTH_A_THREAD)), least)
    return [slice(batch * i // n, batch * (i + 1) // n) for i in range(n)]


def run_jobs(function: Callable[..., None], jobs: Sequence[Sequence[Any]]) -> None:
    """Call `function` with all `jobs`, on as many threads as torch has.

    This thread takes jobs too: no job waits for a busy thread, or one lost by a fork.
    """
    waiting = [*jobs]

    def work() -> None:
        while True:
            try:
                job = waiting.pop()
            except IndexError:
                return
            function(*job)

    threads = min(len(jobs), torch.get_num_threads())
    helpers = [_POOL.submit(work) for _ in range(threads - 1)]
    work()
    for helper in helpers:
        if not helper.cancel():
            helper.result()

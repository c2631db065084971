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
from splitband.runtime.errors import InputError

Shapes = Sequence[tuple[int, ...]]

CROWDED = 512
"""Rows that `pad` makes are not a multiple of this many numbers apart. Of 512 columns, products
take 0.4 to 0.6 of the time (501 rows, 8 to 50 rows of data, 512 KiB of second-level cache)."""
_WORTH_A_THREAD = 1e7
"""Multiplications that take as long as waking a thread."""
_GRADIENT_ROWS = 64
"""Rows of gradients worth a product with them."""

# Numba's own threads may not be entered from several threads at once on every platform.
_POOL = ThreadPoolExecutor(os.cpu_count(), "splitband")


@dataclass(frozen=True)
class Kernel(ABC):
    """Describe the compiled rollout of a kind of cell, which `run` calls.

    Attributes
    ----------
    batch, steps, ny, nu : Sizes of the samples and of the known inputs.
    last : Steps of the state, those of the warm-up included.
    forward, backward : Compiled functions of a job, which has some rows of the batch.
        `forward(inputs, weights, kept, y)` writes the samples, and what `backward` needs.
        `backward(wanted, dy, weights, kept, sums, gradients)` adds gradients of weights to `sums`
        and writes those of `inputs`; those of samples and known inputs only where `wanted`.
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
        """Return the weights as `forward` takes them."""

    def pack_back(self, *weights: Array) -> Arrays:
        """Return the weights as `backward` takes them."""
        return self.pack(*weights)

    @abstractmethod
    def split(self, packed: Arrays) -> list[slice]:
        """Return the rows of each job."""

    @abstractmethod
    def kept(self, packed: Arrays, rows: int, keep: bool) -> Shapes:
        """Return the shapes of what `forward` writes of each step, or overwrites unless `keep`."""

    def scratch(self, packed: Arrays, rows: int) -> Shapes:
        """Return the shapes of what `backward` has in `kept` beside it, to work with."""
        return ()

    @abstractmethod
    def sums(self, packed: Arrays) -> Shapes:
        """Return the shapes of the gradients that `backward` adds up."""

    @abstractmethod
    def unpack(self, *sums: Array) -> Iterable[Array]:
        """Return a gradient for each weight; entries beyond its shape are ignored."""


def run(kernel: Kernel, inputs: tuple[Tensor, ...], weights: tuple[Tensor, ...]) -> Tensor:
    """Return the samples `(batch, steps, ny)`, differentiable once.

    Without gradients the memory does not grow with the steps, apart from the result.

    Parameters
    ----------
    inputs : What differs from row to row, the last two of it measured samples or a state, and
        known inputs.
    weights : What all rows share.
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
        kept, working = _cut(whole, ctx.kept), _cut(dy.new_empty(_length(scratch)), scratch)
        sums = _cut(zeros(dy, _length(shapes)), shapes)
        # Of the inputs, all but the state at the first sample.
        wanted = any(ctx.needs_input_grad[len(ctx.shapes) : 2 + len(ctx.shapes)])
        given, written = dy.contiguous().numpy(), [g.numpy() for g in gradients]
        jobs = []
        for i, rows in enumerate(split):
            arrays = packed, kept[i] + working[i], sums[i], tuple(g[rows] for g in written)
            jobs.append((wanted, given[rows], *arrays))
        run_jobs(kernel.backward, jobs)
        of_weights = kernel.unpack(*(sum(parts) for parts in zip(*sums, strict=True)))
        cut = (g[tuple(map(slice, w.shape))] for g, w in zip(of_weights, weights, strict=True))
        return None, None, *gradients, *(torch.from_numpy(np.ascontiguousarray(g)) for g in cut)


def _simulate(
    kernel: Kernel, inputs: Sequence[Tensor], weights: Sequence[Tensor], keep: bool
) -> tuple[Tensor, Tensor, list[Shapes], list[slice]]:
    """Return the samples, what is kept and its shapes by job, and the rows of each job."""
    packed = kernel.pack(*(w.detach().numpy() for w in weights))
    split = kernel.split(packed)
    shapes = [kernel.kept(packed, rows.stop - rows.start, keep) for rows in split]
    y = inputs[0].new_empty(kernel.batch, kernel.steps, kernel.ny)
    whole = y.new_empty(_length(shapes))
    samples, given = y.numpy(), [x.detach().contiguous().numpy() for x in inputs]
    jobs = [
        (tuple(x[rows] for x in given), packed, kept, samples[rows])
        for rows, kept in zip(split, _cut(whole, shapes), strict=True)
    ]
    run_jobs(kernel.forward, jobs)
    return y, whole, shapes, split


def check(like: Tensor, **tensors: tuple[Tensor, tuple[int, ...]]) -> None:
    """Raise ValueError unless each tensor has its shape, and the dtype of `like`, on the CPU."""
    if like.dtype not in (torch.float32, torch.float64):
        raise InputError(f"the kernels take float32 or float64, got {like.dtype}")
    for name, (tensor, shape) in tensors.items():
        if tensor.shape != shape or tensor.dtype != like.dtype or tensor.device.type != "cpu":
            raise InputError(
                f"{name} must be {shape}, {like.dtype} on the CPU, "
                f"got {tuple(tensor.shape)}, {tensor.dtype} on {tensor.device}"
            )


def pad(x: Array) -> Array:
    """Return a copy whose last axis is padded with zeros to a multiple of `PAD`.

    Rows a multiple of `CROWDED` apart get `PAD` more, as they would share few places of the cache.
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

    Buffers come from torch, which aligns them to 64 bytes. NumPy fills them: torch might use its
    own threads, which go on spinning for milliseconds on the cores that `run_jobs` needs.
    """
    out = like.new_empty(shape)
    out.numpy().fill(0)
    return out


def _length(jobs: Iterable[Shapes]) -> int:
    """Return the length of a buffer that `_cut` can take apart."""
    return sum(padded(math.prod(shape)) for shapes in jobs for shape in shapes)


def _cut(buffer: Tensor, jobs: Iterable[Shapes]) -> list[Arrays]:
    """Return for each job an array of each shape.

    All are cut from one allocation: the C library gives several large ones back to the system,
    and taking them again page by page costs as much as the products.
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
    """Return of how many steps gradients are kept until they are multiplied."""
    return -(-_GRADIENT_ROWS // max(rows, 1))


def split_rows(batch: int, work: float, least: int = 1) -> list[slice]:
    """Split batch rows over torch's threads, if `work` (multiplications) is worth them.

    There are at least `least` parts.
    """
    n = max(1, min(torch.get_num_threads(), batch, int(work / _WORTH_A_THREAD)), least)
    return [slice(batch * i // n, batch * (i + 1) // n) for i in range(n)]


def run_jobs(function: Callable[..., None], jobs: Sequence[Sequence[Any]]) -> None:
    """Call `function` with each of the `jobs`, on at most torch's many threads.

    This thread takes jobs too, so that none waits for a thread that is busy, or that a fork of
    the process has lost.
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

"""Provide what kernels share: compilation, tanh, padded buffers, rows split over threads."""

from __future__ import annotations

import hashlib
import logging
import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import torch
from numba import njit, types
from numba.core import event
from numba.extending import overload
from numpy.typing import NDArray
from torch import Tensor

Array = NDArray[Any]
_LOG = logging.getLogger("splitband")
F = TypeVar("F", bound=Callable[..., Any])

PAD = 16
"""The last axis of a buffer is padded to a multiple of this: vector loops need no remainder."""
CROWDED = 512
"""Rows that `pad` makes are not a multiple of this many numbers apart. Of 512 columns, products
take 0.4 to 0.6 of the time (501 rows, 8 to 50 rows of data, 512 KiB of second-level cache)."""
_WORTH_A_THREAD = 1e7
"""Multiplications that take as long as waking a thread."""

# Numba's own threads may not be entered from several threads at once on every platform.
_POOL = ThreadPoolExecutor(os.cpu_count(), "splitband")

# Without "nnan" and "ninf", by which LLVM assumes that there is no NaN and no infinity.
# With the error model of NumPy, division by zero gives infinity and does not raise.
_OPTIONS: Any = {
    "fastmath": {"contract", "reassoc", "nsz"},
    "error_model": "numpy",
    "nogil": True,
}


def part(function: F) -> F:
    """Compile a part of a kernel into the kernel.

    A part that is left as a function of its own is linked otherwise where the kernel is compiled
    than where it comes from the disk: the last bits then differ between the two processes.
    """
    compiled: F = njit(forceinline=True, **_OPTIONS)(function)
    return compiled


_SOURCES = hashlib.sha256(
    b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
).hexdigest()


def kernel(function: F) -> F:
    """Compile on the first call and keep the result on disk, until a file of this folder changes.

    Numba itself compares the kernel's own file, and would not see that a part of it has changed.
    """
    compiled: Any = njit(cache=True, **_OPTIONS)(function)
    kept = compiled._cache._cache_file
    kept._source_stamp = kept._source_stamp, _SOURCES
    return cast("F", compiled)


class _Announcement(event.Listener):
    """Say once in a process that kernels are compiled; where they are on disk, say nothing."""

    said = False

    def on_start(self, event: Any) -> None:
        module = event.data["dispatcher"].py_func.__module__
        # What is compiled for a user's own equation is not kept, and not announced.
        ours = module.startswith("splitband.") and not module.endswith(".ode")
        if ours and not self.said:
            _Announcement.said = True
            # A warning, as Python prints these even where no logging has been set up.
            _LOG.warning("splitband: compiling kernels, once after installation (some seconds)")

    def on_end(self, event: Any) -> None:
        pass


event.register("numba:compile", _Announcement())  # type: ignore[no-untyped-call]


def tanh(x: float) -> float:
    """Return tanh by rational approximations that vectorise, to 4 ulp."""
    return math.tanh(x)


@overload(tanh, jit_options=_OPTIONS)
def _tanh(x: Any) -> Callable[[Any], Any]:
    return _in_float32 if x == types.float32 else _in_float64


def _in_float64(x: Any) -> Any:
    # Eight levels of Lambert's continued fraction for x / 8, then three times
    # tanh(2 x) = 2 p d / (p^2 + d^2), where tanh(x) = p / d.
    x = max(min(x, 19.1), -19.1) / 8  # in this order NaN stays NaN
    q = x * x
    p = (((36.0 * q + 6930.0) * q + 270270.0) * q + 2027025.0) * x
    d = (((q + 630.0) * q + 51975.0) * q + 945945.0) * q + 2027025.0
    p, d = 2 * p * d, p * p + d * d
    p, d = 2 * p * d, p * p + d * d
    p, d = 2 * p * d, p * p + d * d
    return p / d


def _in_float32(x: Any) -> Any:
    f = np.float32
    x = max(min(x, f(9)), f(-9))  # in this order NaN stays NaN
    q = x * x
    p = q * f(5.0856173e-08) + f(3.1615688e-05)
    p = p * q + f(0.0040097303)
    p = p * q + f(0.13786322)
    p = p * q + f(1)
    d = q * f(7.393396e-10) + f(1.6195536e-06)
    d = d * q + f(0.00042096181)
    d = d * q + f(0.027741925)
    d = d * q + f(0.47119654)
    d = d * q + f(1)
    return x * p / d


@part
def copy(out: Array, values: Array) -> None:
    """Write `values` to the first columns of `out`; compiles ten times faster than a slice."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            out[i, j] = values[i, j]


def check(like: Tensor, **tensors: tuple[Tensor, tuple[int, ...]]) -> None:
    """Raise ValueError unless each tensor has its shape, and the dtype of `like`, on the CPU."""
    if like.dtype not in (torch.float32, torch.float64):
        raise ValueError(f"the kernels take float32 or float64, got {like.dtype}")
    for name, (tensor, shape) in tensors.items():
        if tensor.shape != shape or tensor.dtype != like.dtype or tensor.device.type != "cpu":
            raise ValueError(
                f"{name} must be {shape}, {like.dtype} on the CPU, "
                f"got {tuple(tensor.shape)}, {tensor.dtype} on {tensor.device}"
            )


# Buffers come from torch, which aligns them to 64 bytes. NumPy fills them: torch might use its
# own threads, which go on spinning for milliseconds on the cores that `run_rows` needs.


def zeros(like: Tensor, *shape: int) -> Tensor:
    """Return zeros in the dtype of `like`."""
    out = like.new_empty(shape)
    out.numpy().fill(0)
    return out


def pad(x: Tensor | Array) -> Tensor:
    """Return a copy whose last axis is padded with zeros to a multiple of `PAD`.

    Rows a multiple of `CROWDED` apart get `PAD` more, as they would share few places of the cache.
    """
    values = array(x)
    width = padded(values.shape[-1])
    width += PAD * (width % CROWDED == 0)
    out = zeros(torch.from_numpy(values[..., :0]), *values.shape[:-1], width)
    out.numpy()[..., : values.shape[-1]] = values
    return out


def padded(n: int) -> int:
    """Return the next multiple of `PAD`."""
    return -(-n // PAD) * PAD


def array(x: Any) -> Any:
    """Return the values of a tensor, and anything else unchanged."""
    return x.detach().numpy() if isinstance(x, Tensor) else x


def add(sums: Sequence[Sequence[Tensor]]) -> list[Array]:
    """Sum over jobs what each has summed over its rows."""
    return [sum(array(s) for s in parts) for parts in zip(*sums, strict=True)]


def split_rows(batch: int, work: float) -> list[slice]:
    """Split batch rows over torch's threads, if `work` (multiplications) is worth them."""
    n = max(1, min(torch.get_num_threads(), batch, int(work / _WORTH_A_THREAD)))
    return [slice(batch * i // n, batch * (i + 1) // n) for i in range(n)]


def buffers(like: Tensor, split: list[slice], *shapes: tuple[int, ...]) -> list[list[Tensor]]:
    """Return for each job a tensor of each shape, with its rows as the last axis but one.

    All are cut from one allocation: the C library gives several large ones back to the system,
    and taking them again page by page costs as much as the products.
    """
    sizes = [math.prod(shape) for shape in shapes]
    whole = like.new_empty(split[-1].stop * sum(sizes) + PAD * len(split) * len(sizes))
    by_job: list[list[Tensor]] = []
    at = 0
    for rows in split:
        by_job.append([])
        for shape, size in zip(shapes, sizes, strict=True):
            n = rows.stop - rows.start
            values = whole[at : at + n * size]
            by_job[-1].append(values.view(*shape[:-1], n, shape[-1]))
            at = padded(at + n * size)
    return by_job


def run_rows(kernel: Callable[..., None], jobs: Sequence[Sequence[Any]]) -> None:
    """Call `kernel` with each of the `jobs`, tensors as arrays, on at most torch's many threads.

    This thread takes jobs too, so that none waits for a thread that is busy, or that a fork of
    the process has lost.
    """
    waiting = [[array(a) for a in job] for job in jobs]

    def work() -> None:
        while True:
            try:
                job = waiting.pop()
            except IndexError:
                return
            kernel(*job)

    threads = min(len(jobs), torch.get_num_threads())
    helpers = [_POOL.submit(work) for _ in range(threads - 1)]
    work()
    for helper in helpers:
        if not helper.cancel():
            helper.result()

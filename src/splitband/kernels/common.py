"""What the kernels share besides products: tanh, padded buffers, batch rows over threads.

Numba keys its disk cache on the file a kernel stands in: after a change here or in `matmul`,
touch the kernels too.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import numpy as np
import torch
from numba import types
from numba.extending import overload
from torch import Tensor

from splitband.kernels.matmul import PAD

# No "nnan" or "ninf", by which a NaN could be taken for a number; division does not raise.
JIT: dict[str, Any] = {"fastmath": {"contract", "reassoc", "nsz"}, "error_model": "numpy"}
_WORTH_A_THREAD = 1e7  # multiplications that take as long as starting a thread


def tanh(x: float) -> float:
    """tanh: exact in float64, a quotient of polynomials (to 4e-7) that vectorises in float32."""
    return math.tanh(x)


@overload(tanh, jit_options=JIT)
def _tanh(x):  # type: ignore[no-untyped-def]
    return _quotient if x == types.float32 else lambda x: math.tanh(x)


def _quotient(x):  # type: ignore[no-untyped-def]
    f = np.float32
    x = max(min(x, f(9)), f(-9))  # in this order a NaN goes through
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


# Numba's own threads may not be entered from several threads at once on every platform.
_POOL = ThreadPoolExecutor(os.cpu_count(), "splitband")
# Buffers come from torch, which aligns them to 64 bytes. NumPy fills them: torch would use its
# own threads, which go on spinning for milliseconds on the cores that `run_rows` needs.


def zeros(like: Tensor, *shape: int) -> Tensor:
    """A tensor of zeros."""
    out = like.new_empty(shape)
    out.numpy().fill(0)
    return out


def pad(x: Tensor) -> Tensor:
    """A copy whose last axis is padded with zeros to a multiple of `PAD`."""
    out = zeros(x, *x.shape[:-1], -(-x.shape[-1] // PAD) * PAD)
    out.numpy()[..., : x.shape[-1]] = x.detach().numpy()
    return out


def split_rows(batch: int, work: float) -> list[slice]:
    """Batch rows for each of torch's threads, as far as `work` (multiplications) is worth them."""
    n = max(1, min(torch.get_num_threads(), batch, int(work / _WORTH_A_THREAD)))
    return [slice(batch * i // n, batch * (i + 1) // n) for i in range(n)]


def run_rows(kernel: Callable[..., None], jobs: Sequence[Sequence[Any]]) -> None:
    """Call `kernel` with each of the `jobs` at once, tensors as arrays.

    A job that no thread has begun (they may be busy, or lost in a forked process) is done here.
    """
    args = [[a.detach().numpy() if isinstance(a, Tensor) else a for a in job] for job in jobs]
    begun = [(_POOL.submit(kernel, *arg), arg) for arg in args[1:]]
    kernel(*args[0])
    for future, arg in begun:
        if future.cancel():
            kernel(*arg)
        else:
            future.result()

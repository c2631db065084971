"""Compile kernels and their parts, and provide their common parts."""

from __future__ import annotations

import hashlib
import logging
import math
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
from filelock import FileLock
from numba import njit, types
from numba.core import event
from numba.extending import overload
from numpy.typing import NDArray

Array = NDArray[Any]
Arrays = tuple[Array, ...]
_LOG = logging.getLogger("splitband")
F = TypeVar("F", bound=Callable[..., Any])

PAD = 16
"""The last axis of a buffer is a multiple of `PAD`: vector loops need no remainder."""
# "nnan" and "ninf" are absent: with them LLVM assumes the absence of NaN and infinity.
# In the error model of NumPy, division by zero gives infinity and does not raise.
_OPTIONS: Any = {
    "fastmath": {"contract", "reassoc", "nsz"},
    "error_model": "numpy",
    "nogil": True,
}


def part(function: F) -> F:
    """Compile a part of a kernel into the kernel.

    Without inlining, linking differs between a process that compiles the kernel and one that loads
    the kernel from the disk, and so do the last bits of results.
    """
    compiled: F = njit(forceinline=True, **_OPTIONS)(function)
    return compiled


_SOURCES = hashlib.sha256(
    b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
).hexdigest()


def kernel(function: F, fastmath: Any = _OPTIONS["fastmath"]) -> F:
    """Compile on the first call and keep the result on disk, until a file of this folder changes.

    Numba itself compares the kernel's own file only, not those of the parts.
    """
    compiled: Any = njit(cache=True, **_OPTIONS | {"fastmath": fastmath})(function)
    cache = compiled._cache._cache_file
    cache._source_stamp = cache._source_stamp, _SOURCES
    compile_or_load = compiled.compile

    def alone(signature: Any) -> Any:
        """Wait while another process compiles the kernel, then load it."""
        lock = FileLock(f"{cache._index_path}.lock")
        with suppress(OSError, NotImplementedError):  # a read-only folder
            compiled._cache._impl.locator.ensure_cache_path()
            lock.acquire()
        try:
            with event.install_listener("numba:compile", _Announcement()):
                return compile_or_load(signature)
        finally:
            lock.release()

    compiled.compile = alone
    return cast("F", compiled)


class _Announcement(event.Listener):
    """Announce compilation; kernels loaded from disk cause no such event."""

    def on_start(self, event: Any) -> None:
        announce()

    def on_end(self, event: Any) -> None:
        pass


@cache
def announce() -> None:
    """Log once in a process that kernels are compiled."""
    # A warning: without logging handlers, Python prints warnings but no infos.
    _LOG.warning("splitband: compiling kernels, once after installation (some seconds)")


def tanh(x: float) -> float:
    """Return tanh by vectorisable rational approximations, to 4 ulp."""
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


@part
def add(out: Array, values: Array) -> None:
    """Add `values` to the first columns of `out`."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            out[i, j] += values[i, j]


@part
def tanh_of(x: Array) -> None:
    """Write tanh(x) to x."""
    for i in range(x.size):
        x[i] = tanh(x[i])


@part
def tanh_back(a: Array, da: Array) -> None:
    """Propagate the gradient of a = tanh(x) to x, in place."""
    one = a.dtype.type(1)
    for i in range(a.size):
        da[i] *= one - a[i] * a[i]

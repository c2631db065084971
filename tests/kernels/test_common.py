"""What kernels share: products, tanh, rows split over threads, and what is said of compiling."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from typing import Any

import numpy as np
import pytest
from numba import from_dtype, types
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

import splitband
from splitband import kernels
from splitband.comparison.jobs import every_kernel
from splitband.filters import tensors
from splitband.kernels import common, ode, rollouts
from splitband.kernels import matmul as products
from splitband.kernels.recurrence import recurrence
from splitband.kernels.state_space_jacobian import jacobian
from splitband.kernels.terms import evaluate


@pytest.mark.parametrize(("blocks", "dtype"), [("_WIDE", np.float32), ("_NARROW", np.float64)])
def test_products_of_any_shape_on_any_processor(
    monkeypatch: pytest.MonkeyPatch, blocks: str, dtype: type[np.floating[Any]]
) -> None:
    monkeypatch.setattr(products, "_BLOCKS", getattr(products, blocks))

    @common.part
    def product(out: common.Array, a: common.Array, w: common.Array, accumulate: bool) -> None:
        products._matmul(out, a, w, accumulate)

    # Compiled once, for arrays of any strides, and not for each layout that they happen to have.
    array = types.Array(from_dtype(np.dtype(dtype)), 2, "A")
    dispatcher: Any = product
    dispatcher.compile((array, array, array, types.boolean))
    dispatcher.disable_compile()
    rng = np.random.default_rng(0)
    for rows, inner, columns in [(1, 1, 16), (7, 3, 48), (25, 0, 64), (11, 9, 112), (16, 40, 80)]:
        a = rng.standard_normal((inner, rows + 1)).astype(dtype)[:, 1:].T
        w = rng.standard_normal((inner, columns + 3)).astype(dtype)[:, 3:]
        out = rng.standard_normal((rows, columns)).astype(dtype)
        before, beside = out.copy(), np.full((rows + 2, columns + 2), 7, dtype)
        product(out, a, w, True)
        product(beside[1:-1, 1:-1], a, w, False)
        tolerance = 1e-5 if dtype == np.float32 else 1e-12
        np.testing.assert_allclose(out, before + a @ w, atol=tolerance)
        np.testing.assert_allclose(beside[1:-1, 1:-1], a @ w, atol=tolerance)
        beside[1:-1, 1:-1] = 7
        assert (beside == 7).all()


@pytest.mark.parametrize(("dtype", "rtol"), [(np.float32, 5e-7), (np.float64, 1e-15)])
def test_tanh_is_exact_to_four_ulp_and_bounded(dtype: type[np.floating], rtol: float) -> None:
    @common.part
    def compiled(x: common.Array) -> None:
        for i in range(x.size):
            x[i] = common.tanh(x[i])

    x = np.concatenate([np.linspace(-12, 12, 100_001), np.logspace(-30, 0, 1000)])
    x = np.concatenate([x, [np.inf, -np.inf, np.nan, 0.0]]).astype(dtype)
    y = x.copy()
    compiled(y)
    np.testing.assert_allclose(y, np.tanh(x.astype(np.float64)), rtol=rtol)
    assert np.isnan(y[-2])
    assert np.nanmax(np.abs(y)) <= 1 + rtol


def test_jobs_that_no_thread_takes_are_done_all_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    class Lost:
        def submit(self, work: Callable[[], None]) -> Future[None]:
            return Future()

    done: list[int] = []
    monkeypatch.setattr(rollouts, "_POOL", Lost())
    rollouts.run_jobs(done.append, [(i,) for i in range(5)])
    assert sorted(done) == list(range(5))


def test_an_error_in_a_job_is_raised() -> None:
    def fail(i: int) -> None:
        if i == 1:
            raise MemoryError

    with pytest.raises(MemoryError):
        rollouts.run_jobs(fail, [(0,), (1,), (2,)])


def test_compiling_is_announced_once_and_only_then(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    # A kernel of a compiled part, as those of the package, that takes no time to compile.
    (tmp_path / "tiny.py").write_text(
        """
from splitband.kernels.common import kernel, part

@part
def half(x):
    return x / 2

@kernel
def quarter(x):
    return half(half(x))
"""
    )
    monkeypatch.setattr(splitband, "__path__", [*splitband.__path__, str(tmp_path)])

    def announced() -> int:
        """As in a process that has not compiled anything yet."""
        caplog.clear()
        common.announce.cache_clear()
        monkeypatch.delitem(sys.modules, "splitband.tiny", raising=False)
        quarter = import_module("splitband.tiny").quarter
        assert not quarter.signatures  # importing compiles nothing
        assert (quarter(4.0), quarter(4)) == (1.0, 1.0)
        return caplog.text.count("compiling kernels")

    assert announced() == 1
    assert announced() == 0
    sys.modules.pop("splitband.tiny")


def test_doctor_compiles_every_kernel_in_every_precision(monkeypatch: pytest.MonkeyPatch) -> None:
    called: set[tuple[Any, str]] = set()

    def note(function: Any, jobs: Sequence[Sequence[Any]]) -> None:
        first, second = jobs[0][:2]
        called.add((function, (first[0] if isinstance(first, tuple) else second).dtype.name))

    ode.compiled.cache_clear()
    monkeypatch.setattr(rollouts, "run_jobs", note)
    monkeypatch.setattr(tensors, "recurrence", lambda *given: note(recurrence, [given]))
    for each in every_kernel():
        each()
    modules = [import_module(f"splitband.kernels.{m.name}") for m in iter_modules(kernels.__path__)]
    values = [value for module in modules for value in vars(module).values()]
    compiled: list[Any] = [value for value in values if isinstance(value, Dispatcher)]
    kept = [value for value in compiled if isinstance(value._cache, FunctionCache)]
    # Filters and derivatives know no other, and terms are compiled with the solver of equations.
    precisions = {recurrence: ["float64"], jacobian: ["float64"], evaluate: []}
    expected = {
        (each, name) for each in kept for name in precisions.get(each, ["float32", "float64"])
    }
    assert called == expected
    assert ode.compiled.cache_info().currsize == 1

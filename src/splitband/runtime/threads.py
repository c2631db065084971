"""Set thread counts, and guard the shared state of threads."""

from __future__ import annotations

import sys
import threading
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext

import threadpoolctl

from splitband.runtime.optional import has_torch

_DRAWING, _WARNING = threading.RLock(), threading.RLock()


def use_one_thread() -> None:
    """Limit this process to one thread from now on: parallel runs are processes.

    The limit holds for torch, whose count the fused kernels take, and for the BLAS of NumPy and
    SciPy. Without torch in memory there is nothing to limit: a job with a network loads torch on
    arrival, and then enters `one_thread`.
    """
    if _torch_is_loaded():
        import torch  # noqa: PLC0415  torch is in memory

        torch.set_num_threads(1)
    threadpoolctl.threadpool_limits(1, user_api="blas")


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread in this context, as with `use_one_thread`, then on as many as before.

    Several threads may be in the context at the same time. Torch is limited if in memory: networks
    load torch when they are created.
    """
    with one_torch_thread() if _torch_is_loaded() else nullcontext(), _ONE_BLAS_THREAD.entered():
        yield


def _torch_is_loaded() -> bool:
    return "torch" in sys.modules


class _OneBlasThread:
    """A limit of one thread for BLAS; the count is process-wide: the last to leave restores it."""

    def __init__(self) -> None:
        self._lock, self._inside = threading.Lock(), 0
        self._limits: threadpoolctl.threadpool_limits | None = None

    @contextmanager
    def entered(self) -> Iterator[None]:
        with self._lock:
            if self._inside == 0:
                _let_this_thread_set_blas()
                self._limits = threadpoolctl.threadpool_limits(1, user_api="blas")
            self._inside += 1
        try:
            yield
        finally:
            with self._lock:
                self._inside -= 1
                if self._inside == 0:
                    assert self._limits is not None
                    _let_this_thread_set_blas()
                    self._limits.restore_original_limits()
                    _let_this_thread_set_blas()


def _let_this_thread_set_blas() -> None:
    """Let this thread set BLAS's count: newer threadpoolctl accepts only the first thread."""
    clear = getattr(threadpoolctl.OpenBLASController, "clear_controlling_thread", None)
    if clear is not None:
        clear(force=True)


_ONE_BLAS_THREAD = _OneBlasThread()


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Limit torch to one thread, as others would spin on the cores of the fused kernels."""
    import torch  # noqa: PLC0415  for networks only

    count = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(count)


@contextmanager
def seeded(seed: int) -> Iterator[None]:
    """Seed torch, if there, in this context, safe from other threads; then restore its state."""
    if not has_torch():
        yield
        return
    import torch  # noqa: PLC0415  for networks only

    with _DRAWING, torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        yield


@contextmanager
def without_warnings(category: type[Warning]) -> Iterator[None]:
    """Silence warnings of a category, one thread at a time, as filters are process-wide."""
    with _WARNING, warnings.catch_warnings():
        warnings.simplefilter("ignore", category)
        yield

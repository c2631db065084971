"""The one place where thread counts are set."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import threadpoolctl
import torch


def use_one_thread() -> None:
    """Let this process compute on one thread from now on; parallel runs are processes of one each.

    That goes for torch, whose count the fused kernels take, and for the BLAS of NumPy and SciPy.
    """
    torch.set_num_threads(1)
    threadpoolctl.threadpool_limits(1, user_api="blas")


@contextmanager
def one_thread() -> Iterator[None]:
    """Compute on one thread, as with `use_one_thread`, and then on as many as before."""
    with one_torch_thread(), threadpoolctl.threadpool_limits(1, user_api="blas"):
        yield


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Keep torch to one thread, for small work between calls of the fused kernels.

    Its other threads would go on spinning for milliseconds on the cores that the kernels need.
    """
    count = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(count)


def available_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

"""The one place where thread counts are set."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import threadpoolctl
import torch


def use_threads(count: int) -> None:
    """Let this process compute on `count` threads; parallel runs are processes of one each.

    That goes for torch, whose count the fused kernels take, and for the BLAS of NumPy and SciPy.
    """
    torch.set_num_threads(count)
    threadpoolctl.threadpool_limits(count, user_api="blas")


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

"""The one place where thread counts are set."""

from __future__ import annotations

import os

import threadpoolctl
import torch


def use_threads(count: int) -> None:
    """Let this process compute on `count` threads; parallel runs are processes of one each.

    That goes for torch, whose count the fused kernels take, and for the BLAS of NumPy and SciPy.
    """
    torch.set_num_threads(count)
    threadpoolctl.threadpool_limits(count, user_api="blas")


def available_cores() -> int:
    """Cores this process may run on."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

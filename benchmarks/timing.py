"""What the benchmarks share: interleaved medians, and the facts that go with the figures."""

from __future__ import annotations

import json
import os
import platform
import statistics
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

import torch


def medians(
    calls: dict[str, Callable[[], object]],
    repeats: int,
    clock: Callable[[], float] = time.perf_counter,
) -> dict[str, float]:
    """Median seconds of each call, the calls taking turns.

    A turn is a pause, as threads of the call before may go on spinning for milliseconds, one call
    that is not timed, by which caches and memory are again as in a run of the same call, and three
    that are.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            time.sleep(0.05)
            call()
            for _ in range(3):
                began = clock()
                call()
                times[name].append(clock() - began)
    return {name: statistics.median(values) for name, values in times.items()}


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Compute on `count` of torch's threads."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    yield
    torch.set_num_threads(before)


def circumstances(*packages: str) -> dict[str, Any]:
    """Versions and the machine: figures mean nothing without them."""
    versions = {}
    for package in packages:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:
            versions[package] = "not installed"
    return {
        "versions": {"python": platform.python_version()} | versions,
        "machine": platform.machine(),
        "cores": os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
    }


def write(figures: dict[str, Any], out: Path | None) -> None:
    """Write the figures as JSON, if asked to."""
    if out:
        out.write_text(json.dumps(figures, indent=2) + "\n", encoding="utf-8")

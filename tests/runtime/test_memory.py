"""Memory that a training frees is used again without a page fault for every page."""

import platform
import resource
from collections.abc import Callable

import numpy as np
import pytest

from splitband import GRU, Record, TrainingSettings
from splitband.models import Recurrent
from splitband.runtime.memory import freed_memory_kept
from splitband.training import fit

SIZE = 100_000_000  # more than glibc would ever take from its heap by itself
PAGES = SIZE // resource.getpagesize()


def faults(work: Callable[[], object]) -> int:
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    work()
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


def resident() -> int:
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * resource.getpagesize()


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs glibc")
def test_freed_memory_is_used_again_and_given_back_at_the_end() -> None:
    begun = resident()
    with freed_memory_kept():
        b"x" * SIZE
        assert faults(lambda: b"x" * SIZE) < 20
        assert resident() > begun + SIZE // 2
    assert resident() < begun + SIZE // 2


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="needs glibc")
def test_a_training_keeps_what_it_frees() -> None:
    wave = np.sin(0.3 * np.arange(60))
    during: list[int] = []

    def progress(_: object) -> None:
        during.append(faults(lambda: b"x" * SIZE))

    settings = TrainingSettings.paper(window=20, warmup=5, epochs=3)
    fit(Recurrent(GRU(2)), Record(wave, 1.0), settings, progress=progress)
    assert max(during[1:]) < PAGES // 10

"""Let the C library keep or return freed memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from splitband.runtime import system

_TRIM_THRESHOLD, _MMAP_THRESHOLD = -1, -3
"""Numbers of M_TRIM_THRESHOLD and M_MMAP_THRESHOLD in malloc.h."""
_KEPT = 2**30
"""Both thresholds in a training, in bytes. By `python -m benchmarks.allocation`."""
_USUAL = 2**22
"""M_MMAP_THRESHOLD in bytes after a training, so that arrays of long records are returned at once;
glibc's own adjustment may raise it to 2**25. M_TRIM_THRESHOLD is twice as much, as in glibc."""


@contextmanager
def freed_memory_kept() -> Iterator[None]:
    """Let the C library reuse freed memory, and return free memory to the system at the end.

    By default glibc maps arrays of more than some megabytes one by one and unmaps freed ones. A
    training allocates the same arrays for all gradients, and the operating system would clear their
    pages every time. The thresholds are process-wide: if several threads train, the first to end
    lowers the thresholds for all. Other C libraries have no thresholds.
    """
    libc = system.glibc()
    if libc is None:
        yield
        return
    libc.mallopt(_MMAP_THRESHOLD, _KEPT)
    libc.mallopt(_TRIM_THRESHOLD, _KEPT)
    try:
        yield
    finally:
        return_freed()


def return_freed() -> None:
    """Return the memory of freed arrays to the system; from now on that of large ones at once."""
    libc = system.glibc()
    if libc is not None:
        libc.mallopt(_MMAP_THRESHOLD, _USUAL)
        libc.mallopt(_TRIM_THRESHOLD, 2 * _USUAL)
        libc.malloc_trim(0)

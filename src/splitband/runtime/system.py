"""Handle all differences between operating systems.

Branches ask `sys.platform`, which type checkers know: `make check` reads this file as on Windows
and on macOS, too.
"""

from __future__ import annotations

import ctypes
import os
import platform
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from glob import glob
from pathlib import Path

_BUSY = 5, 32
"""Numbers of Windows' errors for a file in use by another program, "access denied" and "sharing
violation". A convention."""
STANDARD = {"/dev/stdout": 1, "/dev/stderr": 2}
"""Output of this process, possibly redirected to a file: writing continues at its position."""
TRIES, _AGAIN = 20, 0.05
"""Attempts to replace a file in use, and seconds between two of them. Bounds the time."""


def available_cores() -> int:
    """Return the number of cores available to this process."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C in threads started in this context, and in the threads' processes.

    Ctrl-C in a loading process would print a traceback. Windows cannot block it.
    """
    if sys.platform == "win32":
        yield
    else:
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            yield
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


def start_resource_tracker() -> None:
    """Start multiprocessing's resource tracker early, as its start unblocks signals."""
    if sys.platform != "win32":
        from multiprocessing import resource_tracker  # noqa: PLC0415  it cannot start on Windows

        resource_tracker.ensure_running()


def lead_group() -> int:
    """Make this process the head of a group (not needed on Windows); return its number."""
    if sys.platform != "win32":
        os.setsid()
    return os.getpid()


def end_group(head: int) -> None:
    """End the process with this number from `lead_group`, if it still runs, and its children."""
    if sys.platform == "win32":
        with suppress(OSError):
            command = ["taskkill", "/T", "/F", "/PID", str(head)]
            subprocess.run(command, capture_output=True, check=False)
    else:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(head, signal.SIGKILL)


def glibc() -> ctypes.CDLL | None:
    """Return the GNU C library of this process; None for another C library."""
    # On other systems `libc_ver` searches the interpreter's file, possibly without permission.
    if sys.platform == "linux" and platform.libc_ver()[0] == "glibc":
        return ctypes.CDLL(None)
    return None


def move(source: Path, target: Path) -> None:
    """Rename a file, in place of an earlier one; raises OSError for a failure.

    Windows refuses to rename or replace a file in use. Scanners open every new file for a moment:
    renaming is tried again for a second.
    """
    _patiently(source.replace, target)


def in_use(paths: Iterable[Path]) -> Path | None:
    """Return the first of these files in use by another program, so not replaceable, or None.

    Windows refuses to rename it even to its own name, which has no effect on other systems.
    """
    for path in paths:
        if path.is_file():
            try:
                _patiently(path.rename, path)
            except PermissionError as error:
                if _is_busy(error):
                    return path
                raise
    return None


def _patiently(rename: Callable[[Path], Path], target: Path) -> None:
    for left in reversed(range(TRIES)):
        try:
            rename(target)
            return
        except PermissionError as error:
            if not left or not _is_busy(error):
                raise
            time.sleep(_AGAIN)


def _is_busy(error: PermissionError) -> bool:
    return getattr(error, "winerror", None) in _BUSY


def quoted(word: str) -> str:
    """Return a word quoted for the shells of this system: bash, or cmd and PowerShell."""
    if sys.platform != "win32":
        return shlex.quote(word)
    if re.fullmatch(r"[\w.:\\/=+-]+", word):  # a comma makes two words in PowerShell
        return word
    # Backslashes before a quotation mark would escape it: double them.
    escaped = re.sub(r'(\\*)("|\Z)', lambda found: 2 * found[1] + (found[2] and '\\"'), word)
    return f'"{escaped}"'


def over_lines(lines: Sequence[str]) -> str:
    """Return a command over several lines; for Windows, whose shells differ, on one line."""
    if sys.platform == "win32":
        return " ".join(line.strip() for line in lines)
    return " \\\n".join(lines)


def split_command(text: str) -> list[str]:
    """Return the words of a command such as "ccache gcc -m64"; Windows keeps backslashes."""
    return shlex.split(text, posix=sys.platform != "win32")


def expanded(words: Sequence[str]) -> list[str]:
    """Return the words of a command line; on Windows with the files of patterns (runs/*)."""
    if sys.platform != "win32":
        return [*words]
    matches = [(word, sorted(glob(word)) if {"*", "?"} & {*word} else []) for word in words]
    return [path for word, files in matches for path in files or [word]]

"""Do what differs between operating systems; no other module asks on which one it runs.

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
"""Numbers of Windows' errors for a file that another program has open: "access denied" and "sharing
violation". A convention."""
STANDARD = {"/dev/stdout": 1, "/dev/stderr": 2}
"""Files that are the output of this process, which may lead to a file and is gone on with there."""
TRIES, _AGAIN = 20, 0.05
"""Tries to replace a file that is open elsewhere, and seconds between two of them. Bounds the
time."""


# ---------------------------------------------------------------- processes


def available_cores() -> int:
    """Return how many cores this process may run on."""
    if sys.platform == "linux":
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


@contextmanager
def interrupts_blocked() -> Iterator[None]:
    """Block Ctrl-C in threads that start in this context, and so in the processes they start.

    A process that Ctrl-C reaches while it loads complains. Windows has no means against it.
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
    """Start the process that removes what multiprocessing shares, as starting it unblocks signals.

    On Windows there is none: what processes share ends with them.
    """
    if sys.platform != "win32":
        from multiprocessing import resource_tracker  # noqa: PLC0415  it cannot start on Windows

        resource_tracker.ensure_running()


def lead_group() -> int:
    """Make this process the head of a group, and return its number, for `end_group`.

    On Windows each process knows which one has started it, and there is nothing to do.
    """
    if sys.platform != "win32":
        os.setsid()
    return os.getpid()


def end_group(head: int) -> None:
    """End the process that called `lead_group`, if it still runs, and all that it has started."""
    if sys.platform == "win32":
        with suppress(OSError):
            command = ["taskkill", "/T", "/F", "/PID", str(head)]
            subprocess.run(command, capture_output=True, check=False)
    else:
        with suppress(ProcessLookupError, PermissionError):
            os.killpg(head, signal.SIGKILL)


def glibc() -> ctypes.CDLL | None:
    """Return the GNU C library of this process; None where it has another one."""
    # Elsewhere `libc_ver` searches the interpreter's file, which not every system lets one read.
    if sys.platform == "linux" and platform.libc_ver()[0] == "glibc":
        return ctypes.CDLL(None)
    return None


# ---------------------------------------------------------------- files


def move(source: Path, target: Path) -> None:
    """Rename a file, in place of an earlier one; raises OSError where that fails.

    Windows refuses it while another program has one of them open. Scanners open every new file for
    a moment: it is tried again for a second.
    """
    _patiently(source.replace, target)


def in_use(paths: Iterable[Path]) -> Path | None:
    """Return the first of these files that another program keeps from being replaced, or None.

    Windows refuses to rename it, even to its own name, which elsewhere does nothing.
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


# ---------------------------------------------------------------- commands


def quoted(word: str) -> str:
    """Return a word as the shells of this system take it: bash, or cmd and PowerShell."""
    if sys.platform != "win32":
        return shlex.quote(word)
    if re.fullmatch(r"[\w.:\\/=+-]+", word):  # a comma makes two words in PowerShell
        return word
    # Backslashes are doubled where a quotation mark follows, which they would escape.
    escaped = re.sub(r'(\\*)("|\Z)', lambda found: 2 * found[1] + (found[2] and '\\"'), word)
    return f'"{escaped}"'


def over_lines(lines: Sequence[str]) -> str:
    """Return a command over several lines; on Windows, whose shells differ in how, on one."""
    if sys.platform == "win32":
        return " ".join(line.strip() for line in lines)
    return " \\\n".join(lines)


def split_command(text: str) -> list[str]:
    """Return the words of a command such as "ccache gcc -m64".

    On Windows a backslash in it separates folders.
    """
    return shlex.split(text, posix=sys.platform != "win32")


def expanded(words: Sequence[str]) -> list[str]:
    """Return the words of a command line, with the files that a pattern such as runs/* matches.

    On other systems the shell has done so.
    """
    if sys.platform != "win32":
        return [*words]
    found = [(word, sorted(glob(word)) if {"*", "?"} & {*word} else []) for word in words]
    return [each for word, files in found for each in files or [word]]

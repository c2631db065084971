"""Let splitband see Windows in a process of Linux; everything else sees what is there.

`pretend` is called when an interpreter starts, by a `sitecustomize` of the test, so that it holds
in worker processes, too. What a module of splitband imports is then a stand-in without what POSIX
alone has.
"""

from __future__ import annotations

import builtins
import ctypes
import errno
import fcntl
import os
import signal
import sys
import warnings
from collections.abc import Collection
from contextlib import suppress
from pathlib import Path
from types import ModuleType
from typing import Any

POSIX = "fcntl grp posix pty pwd readline resource syslog termios tty"
"""Modules that Windows lacks; those of processes can be imported there, and do not start."""
PROCESSES = "popen_fork", "popen_forkserver", "resource_tracker"
ABSENT = {*POSIX.split(), *(f"multiprocessing.{name}" for name in PROCESSES)}
EXTRAS = "pyarrow", "matplotlib", "fmpy", "onnx", "control", "distributed"
OF_OS = """
    chown chroot confstr ctermid fchmod fchown fork forkpty getegid geteuid getgid getgroups
    getloadavg getpgid getpgrp getpriority getsid getuid initgroups killpg lchown lockf mkfifo
    mknod nice openpty pathconf pidfd_open posix_fadvise posix_fallocate posix_spawn pread pwrite
    register_at_fork sched_getaffinity sched_setaffinity sched_yield sendfile setegid seteuid
    setgid setpgid setpriority setregid setreuid setsid setuid statvfs sync sysconf tcgetpgrp
    uname wait wait3 wait4 waitid"""
OF_SIGNAL = """
    alarm getitimer pause pthread_kill pthread_sigmask setitimer SIG_BLOCK SIG_SETMASK SIG_UNBLOCK
    SIGALRM SIGCHLD SIGCONT SIGHUP SIGKILL sigpending SIGPIPE SIGQUIT SIGSTOP sigtimedwait SIGTSTP
    SIGUSR1 SIGUSR2 sigwait"""


class Seen(ModuleType):
    """A module as it is on Windows: without some names, and with others in place of its own."""

    def __init__(self, real: ModuleType, absent: Collection[str] = (), **instead: Any) -> None:
        super().__init__(real.__name__)
        vars(self).update(instead, _real=real, _absent=absent)

    def __getattr__(self, name: str) -> Any:
        if name in self._absent:
            raise AttributeError(f"{self._real.__name__} has no {name} on Windows")
        return getattr(self._real, name)


def fsync(descriptor: int) -> None:
    """Windows flushes only what is open for writing."""
    if fcntl.fcntl(descriptor, fcntl.F_GETFL) & 3 == os.O_RDONLY:
        raise OSError(errno.EBADF, os.strerror(errno.EBADF))
    os.fsync(descriptor)


def library(name: str | None, *rest: Any, **more: Any) -> ctypes.CDLL:
    """A library without a name is none."""
    if name is None:
        raise TypeError("expected str, bytes or os.PathLike object, not NoneType")
    return ctypes.CDLL(name, *rest, **more)


def held(path: str | Path) -> bool:
    """Whether this process has a file open or mapped."""
    real, open_files = os.path.realpath(path), set()
    for each in os.listdir("/proc/self/fd"):
        with suppress(OSError):
            open_files.add(os.readlink(f"/proc/self/fd/{each}"))
    with open("/proc/self/maps", encoding="utf-8") as mapped:
        return real in open_files or real in mapped.read()


def pretend() -> None:
    """Begin to pretend, for as long as the process runs."""
    seen = {
        "os": Seen(os, OF_OS.split(), name="nt", fsync=fsync),
        "signal": Seen(signal, OF_SIGNAL.split()),
        "sys": Seen(sys, platform="win32"),
        "ctypes": Seen(ctypes, CDLL=library),
    }
    real_import = builtins.__import__

    def imported(
        name: str, globals: Any = None, locals: Any = None, fromlist: Any = (), level: int = 0
    ) -> Any:
        found = real_import
        asks = str((globals or {}).get("__name__", ""))
        if level or not asks.startswith("splitband"):
            return found(name, globals, locals, fromlist, level)
        for each in (name, *(f"{name}.{part}" for part in fromlist or ())):
            if each in ABSENT:
                raise ModuleNotFoundError(f"no module {each!r} on Windows, asked for by {asks}")
        module = found(name, globals, locals, fromlist, level)
        return seen.get(name if fromlist else name.partition(".")[0], module)

    builtins.__import__ = imported
    for method in ("replace", "rename", "unlink"):
        setattr(Path, method, _refusing(getattr(Path, method)))
    sys.modules.update(dict.fromkeys(EXTRAS))  # None: not installed
    warnings.filterwarnings("error", category=EncodingWarning, module=r"splitband\.")


def _refusing(method: Any) -> Any:
    """Refuse to rename, replace or remove what is open or mapped, if splitband asks for it."""

    def called(path: Path, *rest: Any, **more: Any) -> Any:
        asks = str(sys._getframe(1).f_globals.get("__name__", ""))
        if asks.startswith("splitband"):
            for each in (path, *rest):
                if isinstance(each, str | Path) and os.path.isfile(each) and held(each):
                    error = PermissionError(errno.EACCES, "in use by another process", str(each))
                    error.winerror = 32  # type: ignore[attr-defined]
                    raise error
        return method(path, *rest, **more)

    return called

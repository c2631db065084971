"""Compile the C code of an FMU for the platforms on which it is to run.

The package ziglang (the extra `everywhere`) is a C compiler that brings the C libraries of all
platforms. Without it, the compiler of this machine compiles for this platform alone.
"""

from __future__ import annotations

import logging
import os
import platform
import shutil
import struct
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version
from importlib.util import find_spec
from pathlib import Path

from splitband.runtime.errors import InputError
from splitband.runtime.system import split_command

_LOG = logging.getLogger("splitband")


@dataclass(frozen=True)
class Platform:
    """Hold a platform of FMI 2.0."""

    folder: str  # its name in FMI
    name: str  # its name in messages
    ending: str  # of a shared library
    targets: tuple[str, ...]  # of ziglang; the results of several become one universal file


PLATFORMS = (
    Platform("win64", "Windows", ".dll", ("x86_64-windows-gnu",)),
    # A library that is linked with an old GNU C library runs with every newer one.
    Platform("linux64", "Linux", ".so", ("x86_64-linux-gnu.2.17",)),
    # The first version for Apple's own processors; the one that ziglang takes itself is of 2024.
    Platform("darwin64", "macOS", ".dylib", ("x86_64-macos.11.0", "aarch64-macos.11.0")),
)
COMPILERS = "cc", "gcc", "clang"
"""Compilers to look for if the environment variable CC names none."""
OPTIONS = "-std=c99", "-O2", "-ffp-contract=off", "-shared"
"""Options of all compilers. A product and the sum that it goes into are rounded one after the
other, as NumPy does: fused into one operation, which ARM has, they would give other results."""
OTHERS = 'pip install "splitband[everywhere]"'
_FAT = 0xCAFEBABE
"""First word of a universal file. A convention."""
_ALIGNMENT = 14
"""Its parts begin at multiples of 2 to this power, a page of ARM. A convention."""


def libraries(folder: Path, files: Sequence[str], name: str) -> dict[str, bytes]:
    """Return the shared library `name` of C files, by its path below `binaries` of an FMU.

    There is one for each of `PLATFORMS` with ziglang, one for this platform without it; a line of
    the log says which.

    folder : Where the files are; what is compiled stays there, too.
    files : Names of the C files; headers stand beside them.
    name : Name of the library, without an ending.

    Raises
    ------
    ValueError
        If there is no compiler, or if it fails.
    """
    if find_spec("ziglang") is not None:
        return _for_all(folder, files, name)
    return _for_this(folder, files, name)


def zig_cache() -> Path:
    """Return the folder in which ziglang keeps the C libraries that it has built."""
    import pooch  # noqa: PLC0415  not needed without ziglang

    given = os.environ.get("ZIG_GLOBAL_CACHE_DIR")
    return Path(given or pooch.os_cache("splitband") / "zig").absolute()


def universal(parts: Sequence[bytes]) -> bytes:
    """Return one Mach-O file that holds 64-bit libraries for several processors, as lipo does.

    All numbers of its head are big-endian words: the magic number and how many parts there are; for
    each part type and subtype of its processor, offset, size, and binary logarithm of the alignment
    (`mach-o/fat.h`). The parts stay as they are, and so do their signatures.
    """
    content, table = bytearray(1 << _ALIGNMENT), b""
    for part in parts:
        content += bytes(-len(content) % (1 << _ALIGNMENT))
        processor = struct.unpack_from("<2I", part, 4)  # type and subtype, after a magic number
        table += struct.pack(">5I", *processor, len(content), len(part), _ALIGNMENT)
        content += part
    head = struct.pack(">2I", _FAT, len(parts)) + table
    content[: len(head)] = head
    return bytes(content)


def _for_all(folder: Path, files: Sequence[str], name: str) -> dict[str, bytes]:
    cache = zig_cache()
    cache.mkdir(parents=True, exist_ok=True)
    ready = cache / f"ziglang-{version('ziglang')}-is-ready"
    if not ready.exists():
        # A warning, as Python prints these even where no logging has been set up.
        _LOG.warning(
            "splitband: ziglang builds its C libraries, once after installation (about two minutes)"
        )
    # What zig keeps of this FMU goes with the folder, what it keeps of its C libraries stays.
    caches = {"ZIG_GLOBAL_CACHE_DIR": str(cache), "ZIG_LOCAL_CACHE_DIR": str(folder / "zig")}
    found = {}
    for each in PLATFORMS:
        library = f"{name}{each.ending}"
        parts = [_by_zig(target, folder, files, library, caches) for target in each.targets]
        found[f"{each.folder}/{library}"] = parts[0] if len(parts) == 1 else universal(parts)
    ready.touch()
    _LOG.info("the FMU runs on %s", ", ".join(each.name for each in PLATFORMS))
    return found


def _by_zig(
    target: str, folder: Path, files: Sequence[str], library: str, caches: Mapping[str, str]
) -> bytes:
    """Return a library for a target; a folder of that name is made for it."""
    (folder / target).mkdir()
    # Without its symbols for debuggers, as they name this folder: equal models are equal files.
    command = [sys.executable, "-m", "ziglang", "cc", "-target", target, *OPTIONS, "-s"]
    command += ["-o", f"{target}/{library}", *files, *_mathematics("windows" in target)]
    _run(command, folder, f"ziglang for {target}", caches)
    return (folder / target / library).read_bytes()


def _for_this(folder: Path, files: Sequence[str], name: str) -> dict[str, bytes]:
    import fmpy  # noqa: PLC0415  the optional extra

    here, library = fmpy.platform, f"{name}{fmpy.sharedLibraryExtension}"
    windows = here.startswith("win")
    command = _compiler()
    # On Windows all code is position-independent, and a compiler's own DLL would be missing
    # elsewhere.
    own = ["-static-libgcc"] if windows else ["-fPIC"]
    _run(
        [*command, *OPTIONS, *own, "-o", library, *files, *_mathematics(windows)],
        folder,
        command[0],
        {},
    )
    # A warning, as Python prints these even where no logging has been set up.
    _LOG.warning(
        "the FMU runs only on %s (%s), or where its sources are compiled; for Windows, Linux and "
        "macOS: %s, and export again",
        {each.folder: each.name for each in PLATFORMS}.get(here, here),
        platform.machine(),
        OTHERS,
    )
    return {f"{here}/{library}": (folder / library).read_bytes()}


def _mathematics(windows: bool) -> list[str]:
    """Return the option that links math.h, which belongs to the C library of Windows."""
    return [] if windows else ["-lm"]


def _compiler() -> list[str]:
    """Return the C compiler with its options: those of the environment variable CC, if set."""
    given = os.environ.get("CC", "").strip()
    whole = shutil.which(given) if given else None
    parts = split_command(given)  # such as "ccache gcc -m64"
    commands = [[whole]] if whole else [parts] if parts else [[word] for word in COMPILERS]
    for compiler, *options in commands:
        if Path(compiler).stem.lower() in ("cl", "clang-cl"):
            raise InputError(
                f"CC must take the options of gcc, as MinGW and clang do, got {given}; "
                f"{OTHERS} brings a compiler that needs no setting"
            )
        if found := shutil.which(compiler):
            return [found, *options]
    raise InputError(
        f"an FMU needs a C compiler: none of {given or ', '.join(COMPILERS)}; {OTHERS} brings one"
    )


def _run(command: Sequence[str], folder: Path, name: str, variables: Mapping[str, str]) -> None:
    """Run a compiler in a folder, with variables of the environment; ValueError if it fails."""
    done = subprocess.run(
        command,
        cwd=folder,
        env={**os.environ, **variables},
        capture_output=True,
        encoding="utf-8",
        errors="replace",
        check=False,
    )
    if done.returncode:
        raise InputError(f"the FMU could not be compiled by {name}: {done.stderr[-300:]}")

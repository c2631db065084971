"""Describe the environment of a result: versions, machine, commit."""

from __future__ import annotations

import platform
import subprocess
from importlib.metadata import version
from pathlib import Path
from typing import Any

from splitband.runtime.optional import has_torch


def environment() -> dict[str, Any]:
    """Return versions, machine and, in a checkout, the commit."""
    packages = ["splitband", "numpy", "scipy", "numba"]
    if has_torch():
        packages.insert(1, "torch")
    return {
        "versions": {"python": platform.python_version()} | {p: version(p) for p in packages},
        "machine": f"{platform.system()} {platform.machine()}",
        "commit": _commit(),
    }


def _commit() -> str | None:
    """Return the commit of the package's checkout; None without a checkout.

    It ends with "-dirty" after changes of the code; other files do not count.
    """
    root = Path(__file__).resolve().parents[3]
    if not (root / ".git").exists():
        return None
    command = ["git", "status", "--porcelain=v2", "--branch", "--", "src", "reproduction"]
    kept: dict[str, Any] = {"capture_output": True, "encoding": "utf-8", "errors": "replace"}
    try:
        said = subprocess.run(command, cwd=root, timeout=10, check=True, **kept).stdout.splitlines()
    except (OSError, subprocess.SubprocessError):
        return None
    commit = said[0].removeprefix("# branch.oid ")[:12]
    return commit if all(line.startswith("#") for line in said) else f"{commit}-dirty"

"""`splitband doctor`: whether this machine has what the package needs."""

from __future__ import annotations

import time
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from rich.table import Table

from splitband.cli import showing
from splitband.data import PUBLIC, fetch
from splitband.data.public import data_folder
from splitband.networks import GRU, rollout
from splitband.report.results import environment
from splitband.runtime.threads import available_cores


def doctor() -> None:
    """Show versions, cores, accelerators, the public records, compiled kernels and extras.

    The first call after an installation compiles the kernels, which takes some seconds. Records
    are looked for where `splitband data fetch` puts them; nothing is downloaded.
    """
    facts = examined()
    table = Table(show_header=False)
    for name, value in facts.items():
        pairs = value.items() if isinstance(value, dict) else [("", value)]
        table.add_row(name, "\n".join(f"{key} {said}".strip() for key, said in pairs))
    showing.console.print(table)
    showing.as_json(facts)


def examined() -> dict[str, Any]:
    """What the command shows, by heading."""
    found = environment()
    return {
        "versions": found["versions"],
        "machine": found["machine"],
        "cores": available_cores(),
        "threads": torch.get_num_threads(),
        "accelerators": _accelerators(),
        "public records": _records(),
        "kernels": _kernels(),
        "extras": _extras(),
    }


def _accelerators() -> str:
    names = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
    named = [f"cuda:{i} {name}" for i, name in enumerate(names)]
    return ", ".join(named) or "none; --device cpu"


def _records() -> dict[str, str]:
    """Where each public record lies, without downloading any."""
    folder = data_folder()
    return {name: _state(name, folder) for name in PUBLIC} | {"folder": str(folder)}


def _state(name: str, folder: Path) -> str:
    if not (folder / PUBLIC[name].path).is_file():
        return "not there: splitband data fetch"
    try:
        fetch(name, folder)
    except (ValueError, OSError) as error:
        return str(error)
    return "there"


def _kernels() -> dict[str, str]:
    """Seconds of a small free run at the first call, which may compile, and at the second."""
    cell = GRU(8)
    y = torch.zeros(4, 10, 1)
    seconds = []
    for _ in range(2):
        begin = time.perf_counter()
        with torch.no_grad():
            rollout(cell, y, 100)
        seconds.append(time.perf_counter() - begin)
    return {"first call": f"{seconds[0]:.2g} s", "second call": f"{seconds[1]:.2g} s"}


EXTRAS = {"fmu": "fmpy", "cluster": "distributed"}
"""A module of each optional part of the package that is for users."""


def _extras() -> dict[str, str]:
    """Whether each optional part is installed, and how to."""
    return {
        extra: "installed" if find_spec(module) else f"missing: pip install 'splitband[{extra}]'"
        for extra, module in EXTRAS.items()
    }

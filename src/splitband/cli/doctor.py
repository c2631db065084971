"""Define `splitband doctor`: whether this machine has what the package needs."""

from __future__ import annotations

import time
from importlib.util import find_spec
from typing import Any

from rich.table import Table

from splitband.cli import printing
from splitband.comparison.jobs import every_kernel
from splitband.report.environment import environment
from splitband.runtime.optional import HOW, has_torch
from splitband.runtime.system import available_cores
from splitband.runtime.workers import Workers, result_of

EXTRAS = {
    "networks": "torch",
    "fmu": "fmpy",
    "everywhere": "ziglang",
    "onnx": "onnx",
    "casadi": "casadi",
    "parquet": "pyarrow",
    "plot": "matplotlib",
    "control": "control",
    "cluster": "distributed",
}
"""The extras for users, and a module that each installs."""


def doctor() -> None:
    """Show versions, cores, accelerators, compiled kernels and extras.

    The first call after an installation compiles all kernels, which takes about a minute;
    comparisons then start at once.
    """
    found = environment()
    facts = {
        "versions": found["versions"],
        "machine": found["machine"],
        "cores": available_cores(),
        **(_of_torch() if has_torch() else {"networks": f"none without torch: {HOW}"}),
        "kernels": _kernels(),
        "extras": {
            extra: "installed"
            if find_spec(module)
            else f'missing: pip install "splitband[{extra}]"'
            for extra, module in EXTRAS.items()
        },
    }
    table = Table(show_header=False)
    for name, value in facts.items():
        pairs = value.items() if isinstance(value, dict) else [("", value)]
        table.add_row(name, "\n".join(f"{key} {said}".strip() for key, said in pairs))
    printing.console.print(table)
    printing.as_json(facts)


def _of_torch() -> dict[str, Any]:
    """Return the threads of torch, and the accelerators that it finds."""
    import torch  # noqa: PLC0415  where it is installed

    names = [torch.cuda.get_device_name(i) for i in range(torch.cuda.device_count())]
    named = [f"cuda:{i} {name}" for i, name in enumerate(names)]
    found = ", ".join(named) or "none; --device cpu"
    return {"threads": torch.get_num_threads(), "accelerators": found}


def _kernels() -> str:
    """Compile every kernel, or load it, on all cores, and return how long it took."""
    begin = time.perf_counter()
    with Workers(available_cores()) as workers:
        for future in [workers.submit(each) for each in every_kernel()]:
            result_of(future)
    return f"ready, after {time.perf_counter() - begin:.0f} s"

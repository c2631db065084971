"""What --out may be: nothing that a command reads, and no folder that another command uses."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from splitband.forecasters import saving
from splitband.runtime.files import CHECKPOINTS
from splitband.runtime.outputs import TEST_PREDICTIONS, files_of_result, locked

COMPARED = (
    "results.json", "predictions.csv", TEST_PREDICTIONS.format("*"), "rollouts.png", "error.png",
    "spectrum.png", "components.png", "report.html", "recommended.json", "model/**/*",
)  # fmt: skip
WRITES = {
    "demo": COMPARED,
    "compare": COMPARED,
    "benchmark": ("results.json", "table.csv", "cases.png", "report.html"),
    "forecast": (
        "results.json",
        "forecast.csv",
        "forecast.png",
        "report.html",
        "recommended.json",
        "model/**/*",
    ),
    "fit": ("results.json", saving.FILE, saving.WEIGHTS.format("*")),
    "check": ("results.json", "report.html"),
    "spectrum": ("results.json", "spectrum.png", "report.html"),
}
"""The files that each command writes into its folder --out."""


@contextmanager
def claimed(context: Any) -> Iterator[None]:
    """Check --out against the inputs of a command, and keep other commands out of its folder.

    Parameters
    ----------
    context : Of typer, with the command and its parameters.

    Raises
    ------
    ValueError
        Where --out would replace an input, or is in use.
    """
    command, out = context.command.name, context.params.get("out")
    if out is None:
        yield
    elif command not in WRITES:  # --out is a file, which is replaced at once
        refuse_inputs(out, [out], _inputs(context))
        yield
    else:
        refuse_inputs(out, replaced(command, out), _inputs(context))
        with locked(out, "--out"):
            yield


def replaced(command: str, out: Path) -> list[Path]:
    """Return the files below `out` that a command would replace or remove."""
    if not os.path.isdir(out):
        return []
    names = [path for pattern in WRITES[command] for path in out.glob(pattern)]
    earlier = [out / name for name in files_of_result(out)]
    return [*names, *earlier, *(out / CHECKPOINTS).rglob("*")]


def refuse_inputs(out: Path, targets: Iterable[Path], inputs: Mapping[Path, str]) -> None:
    """Raise ValueError where a target is an input, whatever links lead to either."""
    for target in targets:
        for path, option in inputs.items():
            if os.path.isfile(target) and os.path.samefile(target, path):
                raise ValueError(
                    f"--out must not replace a file that the command reads, got {out}: {target} "
                    f"is read by {option}"
                )


def _inputs(context: Any) -> dict[Path, str]:
    """Return the files that options name, those of saved models too, and the option of each."""
    found: dict[Path, str] = {}
    for parameter in context.command.params:
        value = context.params.get(parameter.name)
        if parameter.name == "out":
            continue
        is_option = parameter.param_type_name == "option"
        said = parameter.opts[0] if is_option else parameter.metavar
        for each in value if isinstance(value, list | tuple) else [value]:
            if isinstance(each, str | Path):
                found |= dict.fromkeys(_files(str(each)), said)
    return found


def _files(named: str) -> list[Path]:
    """Return the files of a value; none where it is no file."""
    file, function, _ = named.partition(".py:")  # FILE.py:FUNCTION
    path = Path(file + ".py" if function else named)
    if os.path.isfile(path):  # False, too, for what can be no path
        return [path]
    return saving.files(path) if os.path.isdir(path) else []

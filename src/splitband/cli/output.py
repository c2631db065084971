"""Check that --out replaces no input and no other model, and is not in use."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from splitband.cli.options import names
from splitband.forecasters import saving
from splitband.runtime.errors import InputError
from splitband.runtime.outputs import DESCRIPTION, FACTS, MODEL_FOLDER, belongs_to_result, locked

TO_A_FILE = ("simulate", "export", "summary")
"""Commands that write a file; all others with --out write a folder."""
MODELS = {"fit": "", "compare": MODEL_FOLDER, "demo": MODEL_FOLDER, "forecast": MODEL_FOLDER}
"""Where in --out commands write a model; others write none."""


@contextmanager
def claimed(context: Any) -> Iterator[None]:
    """Check --out against the inputs of a command, and keep other commands out of its folder.

    Raises ValueError if --out would replace an input, has another model, or is in use.
    """
    out = context.params.get("out")
    if out is None:
        yield
    elif context.command.name in TO_A_FILE:
        refuse_inputs(out, [out], _inputs(context))
        yield
    else:
        refuse_inputs(out, replaced(out), _inputs(context))
        refuse_other_model(out, MODELS.get(context.command.name))
        with locked(out, "--out"):
            yield


def replaced(out: Path) -> list[Path]:
    """Return the files below `out` that a result may replace or remove."""
    if not os.path.isdir(out):
        return []
    found = [path for path in out.iterdir() if belongs_to_result(path.name)]
    return [*found, *(out / MODEL_FOLDER).rglob("*"), *saving.files(out)]


def refuse_inputs(out: Path, targets: Iterable[Path], inputs: Mapping[Path, str]) -> None:
    """Raise ValueError if a target is an input file, also through links."""
    for target in targets:
        for path, option in inputs.items():
            if os.path.isfile(target) and os.path.samefile(target, path):
                raise InputError(
                    f"--out must not replace a file that the command reads, got {out}: {target} "
                    f"is read by {option}"
                )


def refuse_other_model(out: Path, own: str | None) -> None:
    """Raise ValueError for a model elsewhere than in `own`: it would stay beside other results."""
    for place in {"", MODEL_FOLDER} - {own}:
        if os.path.isfile(out / place / DESCRIPTION):
            raise InputError(
                "--out must not hold a model that the command does not replace, got "
                f"{out / place}: choose another folder"
            )


def _inputs(context: Any) -> dict[Path, str]:
    """Return the input files, those of saved models included, and the option that names each."""
    found: dict[Path, str] = {}
    for parameter in context.command.params:
        value = context.params.get(parameter.name)
        if parameter.name == "out":
            continue
        is_option = parameter.param_type_name == "option"
        said = parameter.opts[0] if is_option else parameter.metavar
        for each in value if isinstance(value, list | tuple) else [value]:
            text = str(each) if isinstance(each, str | Path) else ""
            for file in filter(None, {text, *names(text)}):
                found |= dict.fromkeys(_files(file), said)
    return found


def _files(named: str) -> list[Path]:
    """Return the files that a value names: a file, or those of a model, also that of a result."""
    file, _, function = named.partition(".py:")
    path = Path(f"{file}.py" if function else file)
    if os.path.isfile(path):  # also False for text that cannot be a path
        return [path]
    folders = [each for each in (path, path / MODEL_FOLDER) if os.path.isdir(each)]
    found = [file for folder in folders for file in saving.files(folder)]
    return [*found, path / FACTS] if (path / FACTS).is_file() else found

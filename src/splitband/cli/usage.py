"""How the page of a result says it can be used: commands, and the line that reads the record."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from splitband.cli.naming import FITTED
from splitband.cli.options.simulators import PATIENCE
from splitband.data.named import RECORDS
from splitband.forecasters.names import named as named_forecaster
from splitband.report.page.usage import Usage

_FIT = (
    "columns", "inputs", "time_column", "sampling_time", "gaps", "simulator", "simulator_columns",
    "simulator_timeout", "simulator_cache", "simulator_reads", "more", "more_simulator",
    "cutoff", "order", "downsampling", "warmup", "window", "epochs", "recipe", "learning_rate",
    "lr_milestones", "hidden", "budget", "effort", "settings", "device",
)  # fmt: skip
_FORECAST = (*_FIT[:12], "epochs", "budget", "effort", "settings", "device")
_SIMULATE = (
    "simulator", "simulator_columns", "simulator_timeout", "simulator_cache", "simulator_reads",
    "time_column",
)  # fmt: skip
_FOUND = (
    "cutoff", "order", "downsampling", "warmup", "window", "epochs", "recipe", "learning_rate",
    "lr_milestones", "hidden", "budget", "effort",
)  # fmt: skip
"""What a file of settings says."""
_USUAL = {"gaps": "refuse", "recipe": "default", "device": "cpu",
          "simulator_timeout": PATIENCE}  # fmt: skip
_IMPORT = "from splitband.data.named import RECORDS"
WIDTH = 80
"""Characters in a line of a command."""
STEPS = 100
"""Samples ahead in the examples."""


def usage(
    command: str,
    given: Mapping[str, Any],
    method: str = "",
    driven: bool = False,
    named: str = "",
    found: Path | None = None,
) -> Usage:
    """How to use a method, from the options (as in results.json) of the command that recommends it.

    `driven` is a record with known inputs; `named` is what the record is called, where a command
    without one has made it; `found` is the file that says how the method is to be trained.
    """
    record = str(given.get("record", ""))
    of_case = command == "benchmark" and record  # one of its cases is a comparison of its own
    asked = _line(f"splitband {'compare' if of_case else command}", given, [*given])
    record = record or (named if named in RECORDS else "")
    if not method or not record:
        return Usage(asked=asked)
    given = {**given, "record": record}
    if found is not None:
        given = {k: v for k, v in given.items() if k not in _FOUND} | {"settings": str(found)}
    ahead = ["--steps " + str(STEPS), *(["--future-inputs FILE"] if driven else [])]
    commands = []
    if method in FITTED:
        options = ["record", *_FIT]
        end = [f"--method {method}", "--out model"]
        fit = _line("splitband fit", given, options, end)
        commands.append(("Fit it to the whole record", fit))
        simulated = "simulator" in named_forecaster(method).needs
        options = [*_SIMULATE] if simulated else ["time_column"]
        end = ["--history FILE", *ahead, "--out ahead.csv"]
        simulate = _line("splitband simulate model", given, options, end)
        commands.append(("Simulate it beyond measured samples", simulate))
    else:
        options = ["record", *_FORECAST]
        forecast = _line("splitband forecast", given, options, [f"--method {method}", *ahead])
        commands.append(("Fit it to the whole record, and forecast what comes next", forecast))
    more = [_read(each, given) for each in given.get("more") or ()]
    named_record = "" if record not in RECORDS else f"{_IMPORT}\n\n"
    return Usage(commands, f"{named_record}record = {_read(record, given)}", asked, more)


def _line(begin: str, given: Mapping[str, Any], names: Any, end: Sequence[str] = ()) -> str:
    """Return a command with those of its options that were given, in lines that a shell joins."""
    words = [begin]
    for name in names:
        value = given.get(name)
        if value in (None, False, "", [], ()) or _USUAL.get(name) == value:
            continue
        if name in ("record", "listed"):
            words.append(shlex.quote(str(value)))
            continue
        option = f"--{name.replace('_', '-')}"
        for each in value if isinstance(value, list | tuple) else [value]:
            words.append(option if each is True else f"{option} {shlex.quote(str(each))}")
    lines = [""]
    for word in [*words, *end]:
        if lines[-1] and len(lines[-1]) + len(word) > WIDTH:
            lines.append("   ")
        lines[-1] += f" {word}" if lines[-1] else word
    return " \\\n".join(lines)


def _read(record: str, given: Mapping[str, Any]) -> str:
    """Return the Python expression that reads a record."""
    if record in RECORDS:
        return f'RECORDS["{record}"].make()'
    words = [repr(str(Path(record)))]
    for name in ("columns", "inputs"):
        if given.get(name):
            words.append(f"{name}={[part.strip() for part in given[name].split(',')]!r}")
    for name in ("time_column", "sampling_time", "gaps"):
        value = given.get(name)
        if value is not None and _USUAL.get(name) != value:
            words.append(f"{name}={value!r}")
    return f"sb.read({', '.join(words)})"

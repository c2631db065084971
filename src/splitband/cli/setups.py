"""Convert the options of a command to the setup of models and their training."""

from __future__ import annotations

import csv
from dataclasses import fields, replace
from pathlib import Path

import torch

from splitband.cli.options.models import AUTO, ModelOptions
from splitband.evaluation.saved_settings import SavedSettings
from splitband.evaluation.search import Search
from splitband.evaluation.setup import Options
from splitband.forecasters.bands import Bands
from splitband.forecasters.names import Sizes
from splitband.training import Settings

_DECIDES = "window", "epochs", "learning_rate", "lr_milestones", "recipe"
"""Options that fix how to train, so that no search is needed."""


def names(text: str, blank: bool = False) -> list[str]:
    """Return the parts of a comma-separated option; one in double quotes may have commas.

    Empty parts are left out unless they may be `blank`.
    """
    line = " ".join(text.splitlines())
    parts = next(csv.reader([line], skipinitialspace=True))
    return [part.strip() for part in parts if blank or part.strip()]


def options_of(given: ModelOptions, cores: int, saved: SavedSettings | None = None) -> Options:
    """Return the setup that the options give; the rest is as `saved`, or else left open.

    A budget is spent on `cores`.
    """
    search = _search(given, cores)
    check_device(given.device)
    cutoff = None if given.cutoff == AUTO else given.cutoff
    bands = Bands(cutoff, given.order, given.downsampling)
    changes = {
        field.name: getattr(given, field.name)
        for field in fields(Settings)
        if getattr(given, field.name, None) is not None
    }
    if given.lr_milestones is not None:
        changes["milestones"] = _milestones(given.lr_milestones)
    sizes = None if saved is None else saved.sizes
    if given.hidden is not None:
        high, low = _hidden(given.hidden)
        sizes = replace(sizes or Sizes(), hidden_high=high, hidden_low=low)
    if saved is None:
        return Options(given.recipe, None, changes, bands, sizes, search)
    said = {name: value for name, value in vars(bands).items() if value is not None}
    # The saved order and down-sampling hold for the saved cut-off only.
    bands = bands if given.cutoff is not None else replace(saved.bands, **said)
    return Options("default", saved.settings, changes, bands, sizes)


def load_settings(path: Path | None, options: ModelOptions) -> SavedSettings | None:
    """Read the file of --settings; raises ValueError for options that conflict with it."""
    if path is None:
        return None
    if not path.is_file():
        raise FileNotFoundError(
            f"--settings must be a recommended.json that `compare` wrote, got {path}"
        )
    _check_search(options, "--settings")
    if options.recipe != "default":
        raise ValueError(f"--recipe and --settings exclude each other, got {options.recipe}")
    return SavedSettings.read(path)


def check_device(name: str) -> None:
    """Raise ValueError, naming the option, for a device that is not available."""
    try:
        torch.zeros(1, device=name).item()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(f"--device must be one that is there, got {name}: {reason}") from None


def seconds(duration: str, option: str = "--budget") -> float:
    """Return the length of a duration such as 90s, 10m or 1h; raises ValueError for other text."""
    number, unit = duration.strip()[:-1], duration.strip()[-1:].lower()
    try:
        length = float(number) * {"s": 1, "m": 60, "h": 3600}[unit]
    except (KeyError, ValueError):
        length = 0.0
    if not 0 < length < float("inf"):
        raise ValueError(f"{option} must be a time such as 90s, 10m or 1h, got {duration}")
    return length


def _search(options: ModelOptions, cores: int) -> Search | None:
    """Return the limits of the search for how to train; None without --budget and --effort."""
    if options.budget is not None and options.effort is not None:
        raise ValueError(
            "--budget and --effort exclude each other (the one limits the time, the other the "
            f"work), got {options.budget} and {options.effort}"
        )
    decides = [name for name in _DECIDES if getattr(options, name) not in (None, "default")]
    if decides:
        _check_search(options, f"--{decides[0].replace('_', '-')}")
    if options.effort is not None:
        return Search(seconds(options.effort, "--effort"))
    return None if options.budget is None else Search.within(seconds(options.budget), cores)


def _check_search(options: ModelOptions, decides: str) -> None:
    """Raise ValueError if --budget or --effort is given although `decides` replaces the search."""
    for option, value in (("--budget", options.budget), ("--effort", options.effort)):
        if value is not None:
            raise ValueError(
                f"{option} is for finding out how to train, which {decides} decides, got {value}"
            )


def _milestones(text: str) -> tuple[tuple[int, float], ...]:
    try:
        pairs = [part.split(":") for part in names(text)]
        return tuple((int(epoch), float(rate)) for epoch, rate in pairs)
    except ValueError:
        raise ValueError(f"--lr-milestones must be EPOCH:RATE,EPOCH:RATE,..., got {text}") from None


def _hidden(text: str) -> tuple[int, int]:
    try:
        high, low = (int(part) for part in names(text))
    except ValueError:
        raise ValueError(f"--hidden must be HIGH,LOW, two whole numbers, got {text}") from None
    return high, low

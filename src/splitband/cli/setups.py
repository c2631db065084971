"""What the options of a command say of models and their training."""

from __future__ import annotations

from dataclasses import fields, replace
from pathlib import Path

from splitband.cli.devices import check_device
from splitband.cli.naming import names
from splitband.cli.options.models import AUTO, ModelOptions
from splitband.evaluation.saved_settings import SavedSettings
from splitband.evaluation.search import Search
from splitband.evaluation.setup import Options
from splitband.forecasters.bands import Bands
from splitband.forecasters.names import Sizes
from splitband.training import Settings


def options_of(given: ModelOptions, cores: int, saved: SavedSettings | None = None) -> Options:
    """What the options say, the rest as `saved`, or else left open.

    `cores` are what a budget is spent on.
    """
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
        return Options(given.recipe, None, changes, bands, sizes, _search(given, cores))
    said = {name: value for name, value in vars(bands).items() if value is not None}
    # What was found for one cut-off is not for another one.
    bands = bands if given.cutoff is not None else replace(saved.bands, **said)
    return Options("default", saved.settings, changes, bands, sizes)


def load_settings(path: Path | None, options: ModelOptions) -> SavedSettings | None:
    """What --settings names; raises ValueError for options that it leaves nothing to."""
    if path is None:
        return None
    if not path.is_file():
        raise FileNotFoundError(
            f"--settings must be a recommended.json that `compare` wrote, got {path}"
        )
    for option, limit in (("--budget", options.budget), ("--effort", options.effort)):
        if limit is not None:
            raise ValueError(
                f"{option} is for finding out how to train, which --settings decides, got {limit}"
            )
    if options.recipe != "default":
        raise ValueError(f"--recipe and --settings exclude each other, got {options.recipe}")
    return SavedSettings.read(path)


def check_model_options(options: ModelOptions) -> None:
    """Raise ValueError for what would be wrong with any record."""
    _search(options, 1)
    if options.hidden is not None:
        _hidden(options.hidden)
    if options.lr_milestones is not None:
        _milestones(options.lr_milestones)
    if options.device != "cpu":
        check_device(options.device)


def seconds(duration: str, option: str = "--budget") -> float:
    """Of a duration such as 90s, 10m or 1h; raises ValueError for another text."""
    number, unit = duration.strip()[:-1], duration.strip()[-1:].lower()
    try:
        length = float(number) * {"s": 1, "m": 60, "h": 3600}[unit]
    except (KeyError, ValueError):
        length = 0.0
    if not 0 < length < float("inf"):
        raise ValueError(f"{option} must be a time such as 90s, 10m or 1h, got {duration}")
    return length


def _search(options: ModelOptions, cores: int) -> Search | None:
    """How much goes into finding out how to train; None where no option says so."""
    said = {
        "--window": options.window,
        "--epochs": options.epochs,
        "--learning-rate": options.learning_rate,
        "--lr-milestones": options.lr_milestones,
        "--recipe": None if options.recipe == "default" else options.recipe,
    }
    decided = [option for option, value in said.items() if value is not None]
    limits = {"--budget": options.budget, "--effort": options.effort}
    limit = next((name for name, value in limits.items() if value is not None), None)
    if None not in limits.values():
        raise ValueError(
            "--budget and --effort exclude each other (the one limits the time, the other the "
            f"work), got {options.budget} and {options.effort}"
        )
    if decided and limit is not None:
        raise ValueError(
            f"{limit} is for finding out how to train, which {decided[0]} decides, got "
            f"{limits[limit]}"
        )
    if options.effort is not None:
        return Search(seconds(options.effort, "--effort"))
    if options.budget is not None:
        return Search.within(seconds(options.budget), cores)
    return None


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

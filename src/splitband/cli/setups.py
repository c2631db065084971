"""Setups of comparisons: what options say of models and their training, the rest by a recipe."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

from splitband.cli.devices import check_device
from splitband.cli.naming import names
from splitband.cli.options.models import AUTO, ModelOptions
from splitband.data import Record
from splitband.data.named import RECORDS
from splitband.evaluation.protocols import check_train
from splitband.evaluation.saved_settings import SavedSettings
from splitband.evaluation.search import Search
from splitband.evaluation.setup import Setup, default_setup
from splitband.forecasters.bands import Bands
from splitband.forecasters.names import Sizes
from splitband.training import Settings, default_warmup
from splitband.training.recipes import recipe_settings


def setup(
    record: str,
    trajectory: Record,
    train: int | None,
    options: ModelOptions,
    methods: Sequence[str] | None = None,
    ahead: int = 1,
    tested: bool = False,
    cores: int = 1,
    saved: SavedSettings | None = None,
) -> Setup:
    """What the options say (`None`: nothing), the rest as `saved`, or else by the recipe.

    `record` is the argument that `trajectory` comes from, `methods` what the setup is for; `ahead`
    samples at least must be left to predict. What is `tested` on other records is trained on all of
    this one by default.
    `cores` are what a budget is spent on.
    """
    if train is None:
        usual = RECORDS[record].train if record in RECORDS else None
        train = usual or int(0.75 * len(trajectory))
        train = len(trajectory) if tested else train
    check_train(trajectory, train, ahead)
    bands = Bands(
        None if options.cutoff == AUTO else options.cutoff, options.order, options.downsampling
    )
    if saved is not None:
        return _as_saved(saved, trajectory, train, options, bands, methods)
    settings = _trained(recipe_settings(options.recipe, trajectory[:train]), options)
    by_recipe = default_setup(trajectory, train, options.recipe, settings, bands, methods)
    sizes = _with_hidden(by_recipe.sizes, options)
    return replace(by_recipe, sizes=sizes, search=_search(options, cores))


def setup_ahead(
    known: Record,
    methods: Sequence[str],
    options: ModelOptions,
    cores: int,
    saved: SavedSettings | None = None,
) -> Setup:
    """For a forecast beyond the end of a record."""
    if saved is not None:
        return _as_saved(saved, known, len(known), options, Bands(), methods)
    settings = _trained(recipe_settings("default", known), options)
    chosen = default_setup(known, len(known), "default", settings, None, methods)
    return replace(chosen, search=_search(options, cores))


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
    _with_hidden(Sizes(), options)
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


def _as_saved(
    saved: SavedSettings,
    trajectory: Record,
    train: int,
    options: ModelOptions,
    bands: Bands,
    methods: Sequence[str] | None,
) -> Setup:
    """What the options say, the rest as it has been found before."""
    said = {name: value for name, value in vars(bands).items() if value is not None}
    # What was found for one cut-off is not for another one.
    bands = bands if options.cutoff is not None else replace(saved.bands, **said)
    settings = _trained(saved.settings, options)
    chosen = default_setup(trajectory, train, "default", settings, bands, methods)
    return replace(chosen, sizes=_with_hidden(saved.sizes, options))


def _search(options: ModelOptions, cores: int) -> Search | None:
    """How much goes into finding out how to train; None where the options say how."""
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
    if decided:
        if limit is not None:
            raise ValueError(
                f"{limit} is for finding out how to train, which {decided[0]} decides, got "
                f"{limits[limit]}"
            )
        return None
    sizes = options.hidden is None
    if options.effort is not None:
        work = seconds(options.effort, "--effort")
        return Search(work, sizes=sizes)
    if options.budget is None:
        return replace(Search.usual(), sizes=sizes)
    return replace(Search.within(seconds(options.budget), cores), sizes=sizes)


def _trained(settings: Settings, options: ModelOptions) -> Settings:
    """Settings with what the options say about training."""
    said: dict[str, Any] = {
        field.name: getattr(options, field.name)
        for field in fields(Settings)
        if getattr(options, field.name, None) is not None
    }
    if "window" in said:
        said.setdefault("warmup", default_warmup(said["window"], settings.warmup))
    if options.lr_milestones is not None:
        said |= {"milestones": _milestones(options.lr_milestones), "one_cycle": False}
    return replace(settings, **said)


def _with_hidden(sizes: Sizes, options: ModelOptions) -> Sizes:
    if options.hidden is None:
        return sizes
    high, low = _hidden(options.hidden)
    return replace(sizes, hidden_high=high, hidden_low=low)


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

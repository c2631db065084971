"""The high-passed split GRU on the double-torsion record, trained so that its high band learns."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks import study
from benchmarks.high_band import ONE_CYCLE, WarmedOnAllFromZero
from reproduction.jobs import SYSTEMS
from reproduction.settings import LearningBased
from splitband.data import Record
from splitband.metrics import rmse
from splitband.models import Model, Split
from splitband.models.base import Signals, Task
from splitband.networks import GRU
from splitband.training import Checkpoint, Settings, fit

SYSTEM_ROWS = ("ii", "iii", "iv")
LOW, HIGH = "low band", "high band"


@dataclass(frozen=True)
class Recipe:
    """How a split model is trained on a row of the double-torsion record.

    Attributes
    ----------
    kind : Of model.
    filtered : Whether the prediction of the high band is high-passed.
    low, high : Changes of the paper's settings for each band.
    """

    kind: type[Split] = WarmedOnAllFromZero
    filtered: bool = True
    low: Mapping[str, Any] = field(default_factory=dict)
    high: Mapping[str, Any] = field(default_factory=dict)


RECIPES = {
    "+HP, our recipe": Recipe(low=ONE_CYCLE, high=ONE_CYCLE),
    "split GRU, one cycle of the rate": Recipe(Split, False, ONE_CYCLE, ONE_CYCLE),
}
"""The second one, without a filter, says what the filter is worth under the same training."""


class OneBand(Model):
    """A split model of which one network alone is trained."""

    def __init__(self, of: Split, band: int) -> None:
        super().__init__(of.ny, of.nu)
        self.of, self.band = of, band

    def components(self, known: Signals, steps: int) -> dict[str, torch.Tensor]:
        """Return those of the whole."""
        return self.of.components(known, steps)

    def tasks(self, record: Signals) -> list[Task]:
        """Return that of the band."""
        return [self.of.tasks(record)[self.band]]


def trained(row: str, name: str, seed: int, path: Path) -> study.Facts:
    """Train a recipe for all of the paper's epochs; return its errors and training losses.

    `low_as_in_the_paper` has the same high band beside a low band that is trained as the paper
    says. A training that was stopped goes on from its checkpoint beside `path`.
    """
    system, recipe = SYSTEMS[row], RECIPES[name]
    assert isinstance(system.column, LearningBased)
    record = system.record(0)
    setup = system.column.setup(record.sampling_rate, "split-gru-hp")
    began, begin = time.process_time(), setup.settings.warmup
    resumed, facts = False, {}
    losses: dict[str, list[float]] = {}
    model = _model(record, setup.sizes.hidden_low, setup.sizes.hidden_high, recipe, seed, row)

    def fitted(band: int, label: str, changes: Mapping[str, Any]) -> None:
        nonlocal resumed
        file = path.with_name(f".{path.stem}-{label}.safetensors")
        resumed = resumed or file.exists()
        settings = replace(setup.settings, **changes)
        of_band = fit(OneBand(model, band), record[: setup.train], settings, seed,
                      checkpoint=Checkpoint(file)).losses  # fmt: skip
        losses[label] = next(iter(of_band.values()))

    fitted(1, HIGH, recipe.high)
    untrained = {k: v.clone() for k, v in model.networks[0].state_dict().items()}
    fitted(0, "low band as in the paper", {})
    paper = _errors(model, record, begin, setup.train)
    model.networks[0].load_state_dict(untrained)
    fitted(0, LOW, recipe.low)
    facts = _errors(model, record, begin, setup.train)
    return {
        "system": row,
        **facts,
        "low_as_in_the_paper": paper,
        "losses": {label: study.final(values) for label, values in losses.items()},
        "first_losses": {label: values[0] for label, values in losses.items()},
        "curves": {label: study.few(values, 50) for label, values in losses.items()},
        "resumed": resumed,
        **study.facts(seed, _settings(setup.settings, recipe), began),
    }


def epochs(row: str) -> int:
    """Return the paper's epochs of a row."""
    return SYSTEMS[row].column.epochs_of("split-gru-hp")


def clean(path: Path) -> None:
    """Remove the checkpoints of a finished run."""
    for file in path.parent.glob(f".{path.stem}-*.safetensors"):
        file.unlink()


def _settings(settings: Settings, recipe: Recipe) -> Settings:
    return replace(settings, **recipe.high)


def _model(record: Record, low: int, high: int, recipe: Recipe, seed: int, row: str) -> Split:
    setup = SYSTEMS[row].column.setup(record.sampling_rate, "split-gru-hp")
    torch.manual_seed(seed)
    networks = [GRU(size, record.ny) for size in (low, high)]
    k = setup.bands.downsampling
    assert k is not None
    pair = setup.bands.pair(record.sampling_rate)
    return recipe.kind(networks, pair, k, filter_output=recipe.filtered)


def _errors(model: Split, record: Record, begin: int, train: int) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for key, at in (("total_rmse", begin), ("forecast_rmse", train)):
        parts = model.simulate_components(record.y[at - begin : at], len(record) - at)
        found[key] = rmse(record.truth[at:], np.sum([*parts.values()], axis=0))
    return found

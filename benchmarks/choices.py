"""Readings of what the paper leaves open on (i), and why "+HP" does not converge under (ii).

    python -m benchmarks.choices [--out docs/results/choices] [--seeds 3]

Each run is a JSON file that is made once; the page beside the folder, choices.md, is made of all
that are there. Errors are those of the free run from the start on the paper's first noise draw here
(draw 0): this is a study of what the paper may have done, no setting of the package was chosen by
it.
"""

from __future__ import annotations

import argparse
import time
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks import study
from splitband.data import Trajectory, double_torsion
from splitband.evaluation.setup import Setup
from splitband.filters.resampling import downsample
from splitband.metrics import rmse
from splitband.models import Model, Recurrent, Split
from splitband.models.base import Signals, Task
from splitband.networks import GRU, rollout
from splitband.paper.settings import LEARNING_BASED
from splitband.paper.systems import double_mass_spring
from splitband.training import Progress, fit

METHODS = ("split-gru", "split-gru-hp")
HP_EPOCHS = 300
"""Of the paper's 1,000 under (ii): by then the network without the filter has converged."""


class FilteredAsAWhole(Split):
    """Its warm-ups are slices of the filtered record, which comes in place of a simulator."""

    def _simulate(self, band: int, known: Signals, steps: int, slower: Tensor | None) -> Tensor:
        assert known.y_sim is not None
        k, warmup = self._factor(band), known.y.shape[1]
        low = known.y_sim[:, :warmup]
        history = known.y - low if band else low
        y = rollout(self._network(band), downsample(history, k, warmup % k), steps)
        if not self.filter_output or not band:
            return y
        return self.pairs[-1].highpass(torch.cat([history, y], dim=1))[:, warmup:]


class WarmedOnAll(Split):
    """ "+HP" whose fast network warms up on the whole signal, which it can then continue."""

    def _simulate(self, band: int, known: Signals, steps: int, slower: Tensor | None) -> Tensor:
        if not band:
            return super()._simulate(band, known, steps, slower)
        warmup = known.y.shape[1]
        y = rollout(self._network(band), known.y, steps)
        return self.pairs[-1].highpass(torch.cat([known.y, y], dim=1))[:, warmup:]


class TargetFilteredTwice(Split):
    """ "+HP" that is compared with the high band filtered once more, as its output is."""

    def tasks(self, record: Signals) -> list[Task]:
        """See `Split`."""
        low, high = super().tasks(record)
        return [low, replace(high, target=self.pairs[-1].highpass(high.target, dim=0))]


@dataclass(frozen=True)
class Reading:
    """One way to read what the paper says.

    Attributes
    ----------
    variance : Of the noise.
    large_low : GRU 1, the larger network, has the low band.
    kind : Of model.
    """

    variance: float = 0.1
    large_low: bool = False
    kind: type[Split] = Split


READINGS = {
    "as taken here": Reading(),
    "record filtered as a whole": Reading(kind=FilteredAsAWhole),
    "GRU 1 in the low band": Reading(large_low=True),
    "noise of deviation 0.1": Reading(variance=0.01),
    "deviation 0.1, filtered as a whole": Reading(0.01, kind=FilteredAsAWhole),
    "deviation 0.1, GRU 1 low": Reading(0.01, large_low=True),
    "all three": Reading(0.01, large_low=True, kind=FilteredAsAWhole),
}

HP = {
    "+HP": (Split, True),
    "no filter": (Split, False),
    "+HP, warmed up on the whole signal": (WarmedOnAll, True),
    "+HP, target filtered twice": (TargetFilteredTwice, True),
}
"""Models of (ii), and whether the prediction of their high band is filtered."""


class Best:
    """Keeps the weights of each network's epoch with the lowest training loss."""

    def __init__(self, networks: dict[str, torch.nn.Module]) -> None:
        self.networks = networks
        self.losses: dict[str, float] = {}
        self.epochs: dict[str, int] = {}
        self.weights: dict[str, dict[str, Tensor]] = {}

    def __call__(self, at: Progress) -> None:
        """See an epoch."""
        if at.loss < self.losses.get(at.task, np.inf):
            self.losses[at.task], self.epochs[at.task] = at.loss, at.epoch
            self.weights[at.task] = deepcopy(self.networks[at.task].state_dict())

    def restore(self) -> None:
        """Put them back."""
        for name, network in self.networks.items():
            network.load_state_dict(self.weights[name])


def built(record: Trajectory, setup: Setup, method: str, reading: Reading, seed: int) -> Model:
    """The untrained model, with the weights that the package's own would begin with."""
    torch.manual_seed(seed)
    high, low = setup.sizes.hidden_high, setup.sizes.hidden_low
    if method == "gru":
        return Recurrent(GRU(high + low, record.ny))
    networks = [GRU(high if reading.large_low else low, record.ny)]
    networks.append(GRU(low if reading.large_low else high, record.ny))
    pair, k = setup.bands.pair(record.sampling_rate), setup.bands.downsampling
    assert k is not None
    return reading.kind(networks, pair, k, filter_output=method.endswith("-hp"))


def tried(method: str, name: str, seed: int, _: Path) -> study.Facts:
    """Train one reading on (i); its errors at the last epoch, and at the best by training loss."""
    reading = READINGS[name]
    record = double_mass_spring(noise_variance=reading.variance)
    setup = LEARNING_BASED["i"].setup(record.sampling_rate).only_for(method)
    model = built(record, setup, method, reading, seed)
    filtered = setup.bands.pair(record.sampling_rate).lowpass(record.y)
    told = replace(record, y_sim=filtered) if reading.kind is FilteredAsAWhole else record
    networks: dict[str, torch.nn.Module] = (
        dict(zip(("low band", "high band"), model.networks, strict=True))
        if isinstance(model, Split) else {"network": model.cell}  # type: ignore[dict-item]
    )  # fmt: skip
    best, began = Best(networks), time.process_time()
    history = fit(model, told[: setup.train], setup.settings, seed, progress=best)
    warmup = setup.settings.warmup

    def error() -> float:
        steps = len(record) - warmup
        parts = model.simulate_components(record.y[:warmup], steps, None, told.y_sim)
        return rmse(record.truth[warmup:], sum(parts.values()))

    last = error()
    best.restore()
    counted = 1 - warmup / len(record)
    return {
        "last": last,
        "from 0": last * counted**0.5,
        "best": error(),
        "best epochs": best.epochs,
        "losses": {n: study.final(losses) for n, losses in history.losses.items()},
        **study.facts(seed, setup.settings, began),
    }


class OnlyFast(Model):
    """A split model of which the fast network alone is trained."""

    def __init__(self, of: Split) -> None:
        super().__init__(of.ny, of.nu)
        self.of = of

    def components(self, known: Signals, steps: int) -> dict[str, Tensor]:
        """Those of the whole."""
        return self.of.components(known, steps)

    def tasks(self, record: Signals) -> list[Task]:
        """The last one."""
        return self.of.tasks(record)[-1:]


def high_band(name: str, seed: int, _: Path) -> study.Facts:
    """Train the high-band network under (ii); how far its loss comes down."""
    kind, filtered = HP[name]
    record = double_torsion()
    setup = LEARNING_BASED["ii"].setup(record.sampling_rate)
    settings = replace(setup.settings, epochs=HP_EPOCHS)
    reading = Reading(kind=kind)
    model = built(record, setup, "split-gru" + "-hp" * filtered, reading, seed)
    assert isinstance(model, Split)
    began = time.process_time()
    history = fit(OnlyFast(model), record[: setup.train], settings, seed)
    losses = history.losses["high band"]
    return {"loss": study.final(losses), "losses": study.few(losses),
            **study.facts(seed, settings, began)}  # fmt: skip


def main() -> None:
    """Train what is missing, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/results/choices"))
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    out = arguments.out
    for method in METHODS:
        study.complete(out / method, READINGS, arguments.seeds, partial(tried, method))
    study.complete(out / "ii", HP, arguments.seeds, high_band)


if __name__ == "__main__":
    main()

"""Which part of (v) a hybrid model is trained on, and what training needs to leave its plateau.

    python -m benchmarks.segments [--out docs/results/segments] [--seeds 3] [ROW ...]

The paper trains on "a fixed subtrajectory" and does not say which. Each run is a JSON file that is
made once, and goes on from a checkpoint where it was cut off; the page beside the folder,
segments.md, is made of all that are there. Errors are those of the free run from the start of the
whole record, after the warm-up: this is a study of why the paper's rows come out as they do, no
setting of the package was chosen by it.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks import study
from benchmarks.beyond import SYSTEMS
from splitband.filters.spectrum import oracle
from splitband.forecasters.simulation import Simulation
from splitband.metrics import rmse
from splitband.models import Filtered, Model, Residual
from splitband.models.base import Signals
from splitband.networks import GRU
from splitband.paper.settings import HYBRID
from splitband.training import Checkpoint, Settings, fit

SAMPLES = HYBRID["v"].train
FIRST = (0, 400, 600, 1000)
"""Samples that a training segment begins with."""
STUDIED = 1000
"""Where the plateau is looked at: an exactly right network has by far the lowest loss there."""
EPOCHS = 250
"""Of what is tried there, an eighth of the paper's, so that all of it can be tried."""
FEW = 60
"""Epochs of what has no kernel: a step of it takes some twenty times as long."""


class FedBack(Filtered):
    """The network continues the sum of both bands, in place of its own prediction.

    What the simulator says of the low band then reaches the network's state at every step.
    """

    def _high(self, filtered: Signals, steps: int) -> Tensor:
        if self.pair.order != 1:
            raise ValueError(f"the filters must be of order 1, got {self.pair.order}")
        assert filtered.y_sim is not None
        (b_0, b_1), a_1 = self.pair.b_high, self.pair.a[1]
        warmup, low = filtered.y.shape[1], filtered.y_sim
        h = self.cell.initial_state(filtered.y)
        before = filtered.y[:, -1]
        high = before - low[:, warmup - 1]
        samples = []
        for n in range(warmup, warmup + steps):
            network = self.cell.observe(h)
            high = b_0 * network + b_1 * before - a_1 * high
            h, before = self.cell.step(h, high + low[:, n]), network
            samples.append(high)
        return torch.stack(samples, dim=1)


@dataclass(frozen=True)
class Row:
    """A model on a training segment, and what is changed of the paper's settings.

    Attributes
    ----------
    method : As the tables name it.
    first : The segment's first sample.
    changes : Of the settings.
    model : What the method is made of.
    conditioned : The network is told what the simulator says.
    """

    method: str
    first: int
    changes: dict[str, Any] = field(default_factory=dict)
    model: type[Filtered | Residual] = Filtered
    conditioned: bool = False

    @property
    def settings(self) -> Settings:
        """How it is trained."""
        column = HYBRID["v"].setup(20.0).settings
        return replace(column, **self.changes)


def _studied(**changes: Any) -> Row:
    return Row("filtered-gru", STUDIED, {"epochs": EPOCHS} | changes)


PLATEAU = {
    "the paper's, 250 epochs": _studied(),
    "warm-up of 50 samples": _studied(warmup=50),
    "windows of 400 samples": _studied(window=400),
    "gradients clipped at 1": _studied(clip=1.0),
    "free run that grows": _studied(growth=0.6),
    "rate of 3e-3": _studied(learning_rate=3e-3),
    "one cycle of the rate to 1e-2, clipped": _studied(
        learning_rate=1e-2, one_cycle=True, clip=1.0
    ),
    "that, growing, warm-up of 50": _studied(
        warmup=50, clip=1.0, growth=0.6, learning_rate=1e-2, one_cycle=True
    ),
    "told the simulator": replace(_studied(), conditioned=True),
    "the sum of the bands fed back, 60 epochs": replace(_studied(epochs=FEW), model=FedBack),
}
"""What is tried against the plateau, beside the paper's settings with as few epochs."""

ROWS = {
    **{
        f"{method} from {first}": Row(method, first, model=model)
        for first in FIRST[1:]
        for method, model in (("filtered-gru", Filtered), ("residual-gru", Residual))
    },
    **PLATEAU,
}
"""By name; those trained from the first sample on are runs of the paper's tables."""


def run(row: Row, seed: int, checkpoint: Checkpoint | None = None) -> study.Facts:
    """Train a row on its segment, and simulate the whole record."""
    record = SYSTEMS["v"].record()
    training = record[row.first : row.first + SAMPLES]
    bands = HYBRID["v"].setup(record.sampling_rate).bands
    torch.manual_seed(seed)
    cell = GRU(HYBRID["v"].gru_hidden, record.ny, 2 * record.ny if row.conditioned else 0)
    model: Model
    if issubclass(row.model, Filtered):
        pair = bands.one_way_pair(record.sampling_rate)
        model = row.model(cell, pair, conditioned=row.conditioned)
    else:
        model = row.model(cell, conditioned=row.conditioned)
    began = time.process_time()
    history = fit(model, training, row.settings, seed, checkpoint=checkpoint)
    warmup = row.settings.warmup
    steps = len(record) - warmup
    parts = model.simulate_components(record.y[:warmup], steps, None, record.y_sim)
    losses = history.losses["network"]
    return {
        "total_rmse": rmse(record.y[warmup:], sum(parts.values())),
        "loss": study.final(losses),
        "losses": study.few(losses),
        "first": row.first,
        **study.facts(seed, row.settings, began),
    }


def segment(first: int, samples: int = SAMPLES) -> dict[str, float]:
    """What there is to be learned of a segment; no network is trained.

    RMSE after the warm-up of the simulator, of L(simulator) alone and of H(record) + L(simulator),
    which an exactly right network has; and the latter two once the simulator is calibrated to the
    segment.
    """
    record = SYSTEMS["v"].record()[first : first + samples]
    setup = HYBRID["v"].setup(record.sampling_rate)
    assert setup.bands.cutoff is not None
    counted = record.y.copy()
    counted[: setup.settings.warmup] = np.nan
    simulation = Simulation(calibrated=True)
    simulation.fit(record, horizon=0)
    found = {}
    for name, of in (("", record), ("calibrated ", simulation.on(record))):
        assert of.y_sim is not None
        check = oracle(of.y, of.y_sim, of.sampling_rate, setup.bands.cutoff, seen=counted)
        found[f"{name}simulator"] = rmse(counted, of.y_sim)
        found[f"{name}nothing learned"] = check.no_network
        found[f"{name}exactly right"] = check.perfect_network
    return found


def main() -> None:
    """Train what is missing, one seed of all rows after the other, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help="; ".join(ROWS))
    parser.add_argument("--out", type=Path, default=Path("docs/results/segments"))
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    study.complete(arguments.out, arguments.rows or ROWS, arguments.seeds, _resumed)


def _resumed(name: str, seed: int, path: Path) -> study.Facts:
    """A run that goes on from its checkpoint, which is deleted once there is a result."""
    checkpoint = Checkpoint(path.with_suffix(".safetensors"))
    found = run(ROWS[name], seed, checkpoint)
    checkpoint.path.unlink()
    return found


if __name__ == "__main__":
    main()

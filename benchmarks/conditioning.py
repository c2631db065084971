"""What a conditioned network is best told in training: the measured low band, or the predicted one.

    python -m benchmarks.conditioning [--out docs/benchmarks] [--seeds 3] [SYSTEM ...]

Split GRUs are trained on three quarters of a training part and forecast the rest of it; no later
sample is looked at. What they are told in the forecast is the same, the low network's free run.
"""

from __future__ import annotations

import argparse
import statistics
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from benchmarks.beyond import SYSTEMS
from benchmarks.comparing import held_out
from splitband.data import Record
from splitband.evaluation.setup import Options, Setup
from splitband.metrics import rmse, spread
from splitband.models import Split
from splitband.models.base import Signals
from splitband.networks import GRU
from splitband.runtime.files import write_json
from splitband.training import fit

STUDIED = ("double-torsion record", "pendulum ii", "pendulum iii", "i, draw 0", "i, draw 1")


class ToldTheMeasurement(Split):
    """Its fast network is trained beside the measured low band, which stands in for `y_sim`."""

    def high_in_training(self, known: Signals, steps: int) -> Tensor:
        """See `Split`."""
        assert known.y_sim is not None
        warmup = known.y.shape[1]
        return self.high(known, steps, known.y_sim[:, warmup : warmup + steps])


def error(part: Record, setup: Setup, kind: type[Split], seed: int) -> dict[str, float]:
    """RMSE on the held-out part, and the last training loss, in standard deviations."""
    pair, sizes = setup.bands.pair(part.sampling_rate), setup.sizes
    assert setup.bands.downsampling is not None
    torch.manual_seed(seed)
    networks = [GRU(sizes.hidden_low, part.ny), GRU(sizes.hidden_high, part.ny, 2 * part.ny)]
    model = kind(networks, pair, setup.bands.downsampling, conditioned=True)
    training = part[: setup.train]
    told = replace(training, y_sim=pair.lowpass(training.y), beyond=None)
    history = fit(model, told, setup.settings, seed)
    warm = part.y[setup.train - setup.settings.warmup : setup.train]
    parts = model.simulate_components(warm, len(part) - setup.train)
    left = (part.y[setup.train :] - sum(parts.values())) / spread(part.y)
    return {
        "held_out": rmse(left, 0 * left),
        "high_band_loss": history.losses["high band"][-1],
    }


def main() -> None:
    """Train both kinds and say how they do."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("systems", nargs="*", metavar="SYSTEM", help=", ".join(STUDIED))
    parser.add_argument("--out", type=Path, default=Path("docs/benchmarks"))
    parser.add_argument("--seeds", type=int, default=3)
    arguments = parser.parse_args()
    found: dict[str, dict[str, list[dict[str, float]]]] = {}
    for name in arguments.systems or STUDIED:
        record = replace(SYSTEMS[name].record(), y_sim=None, beyond=None)
        part, setup = held_out(record, Options().decided(record, SYSTEMS[name].train))
        found[name] = {
            label: [error(part, setup, kind, seed) for seed in range(arguments.seeds)]
            for label, kind in (("prediction", Split), ("measurement", ToldTheMeasurement))
        }
        for label, runs in found[name].items():
            means = {key: statistics.mean(run[key] for run in runs) for key in runs[0]}
            print(f"{name}, told the {label}: {means}", flush=True)
    write_json(arguments.out / "conditioning.json", found)


if __name__ == "__main__":
    main()

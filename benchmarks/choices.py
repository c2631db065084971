"""Readings of what the paper leaves open on (i), and why "+HP" does not converge under (ii).

    python -m benchmarks.choices [--out docs/results/choices] [--seeds 3]

Each run is a JSON file that is made once; the page beside the folder, choices.md, is made of all
that are there. Errors are those of the free run from the start on the paper's first noise draw here
(draw 0): this is a study of what the paper may have done, no setting of the package was chosen by
it.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from benchmarks import study
from benchmarks.high_band import HP, double_filtering, high_band, high_band_section
from reproduction import published
from reproduction.settings import LEARNING_BASED
from splitband.data import Record
from splitband.data.named import double_mass_spring
from splitband.evaluation.setup import Setup
from splitband.filters.resampling import downsample
from splitband.metrics import rmse
from splitband.models import Model, Recurrent, Split
from splitband.models.base import Signals
from splitband.networks import GRU, rollout
from splitband.runtime.files import write_json
from splitband.training import Progress, fit

Array = npt.NDArray[np.float64]
APART = 2.0
"""Standard errors by which two readings are called different."""
BASE = "as taken here"


class FilteredAsAWhole(Split):
    """Its warm-ups are slices of the filtered record, which comes in place of a simulator."""

    def slow_run(self, known: Signals, steps: int) -> Tensor:
        """See `Split`."""
        assert known.y_sim is not None
        k, warmup = self.downsampling, known.y.shape[1]
        return rollout(self.slow, downsample(known.y_sim[:, :warmup], k, warmup % k), steps)

    def high(self, known: Signals, steps: int, low: Tensor) -> Tensor:
        """See `Split`."""
        assert known.y_sim is not None
        warmup = known.y.shape[1]
        history = known.y - known.y_sim[:, :warmup]
        y = rollout(self.fast, history, steps)
        if not self.filter_output:
            return y
        return self.pair.highpass(torch.cat([history, y], dim=1))[:, warmup:]


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
    BASE: Reading(),
    "record filtered as a whole": Reading(kind=FilteredAsAWhole),
    "GRU 1 in the low band": Reading(large_low=True),
    "noise of deviation 0.1": Reading(variance=0.01),
    "deviation 0.1, filtered as a whole": Reading(0.01, kind=FilteredAsAWhole),
    "deviation 0.1, GRU 1 low": Reading(0.01, large_low=True),
    "all three": Reading(0.01, large_low=True, kind=FilteredAsAWhole),
}

METHODS = ("split-gru",)


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


def built(record: Record, setup: Setup, method: str, reading: Reading, seed: int) -> Model:
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
    setup = LEARNING_BASED["i"].setup(record.sampling_rate, method)
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


def page(
    readings: dict[str, dict[str, list[study.Facts]]],
    networks: dict[str, list[study.Facts]],
    filtering: dict[str, float],
) -> str:
    """All that was tried, in Markdown."""
    assert __doc__ is not None
    return "\n".join(
        [
            f"# {__doc__.splitlines()[0]}\n",
            "Made by `python -m benchmarks.choices` of the files in [choices](choices). Total RMSE "
            "of the free run from the start on (i), draw 0, mean (standard deviation) over seeds: "
            "after the warm-up as in the tables; counted *from 0*, with no error on the measured "
            "warm-up; and after the warm-up with the weights of each network's *best epoch* by "
            "training loss. *Nearer* is by how many standard errors of the difference over seeds a "
            "reading comes nearer to the paper's mean than the first row, minus where it is "
            f"farther; it is called one where that is more than {APART:g}.\n",
            *study.table(
                ("method", "reading", "after the warm-up", "from 0", "best epoch", "paper",
                 "nearer", "seeds"),
                [
                    (method, name, study.spread(runs, "last"), study.spread(runs, "from 0"),
                     study.spread(runs, "best"), str(published.LEARNING_BASED["i"][method]),
                     _nearer(of, name, method), str(len(runs)))
                    for method, of in readings.items() for name, runs in of.items() if runs
                ],
            ),
            "",
            *[f"- {_verdict(method, of)}" for method, of in readings.items()],
            f"- {_counting(readings)}",
            "",
            *high_band_section(networks, filtering),
        ]
    )  # fmt: skip


def _distances(runs: Sequence[study.Facts], key: str, method: str) -> list[float]:
    return [abs(run[key] - published.LEARNING_BASED["i"][method].mean) for run in runs]


def _gain(base: Sequence[float], other: Sequence[float]) -> float:
    """By how many standard errors of the difference (Welch's) the other distances are smaller."""
    error = sum(np.var(v, ddof=1) / len(v) for v in (base, other) if len(v) > 1) ** 0.5
    return float((np.mean(base) - np.mean(other)) / error) if error else 0.0


def _nearer(of: dict[str, list[study.Facts]], name: str, method: str) -> str:
    base = _distances(of[BASE], "last", method)
    return "" if name == BASE else f"{_gain(base, _distances(of[name], 'last', method)):.1f}"


def _verdict(method: str, of: dict[str, list[study.Facts]]) -> str:
    """Which readings come nearer to the paper's value, and what is left of the distance."""
    base = _distances(of[BASE], "last", method)
    gains = {name: _gain(base, _distances(runs, "last", method))
             for name, runs in of.items() if name != BASE and runs}  # fmt: skip
    nearer = [name for name, gain in gains.items() if gain > APART]
    farther = [name for name, gain in gains.items() if gain < -APART]
    best = min(of, key=lambda name: float(np.mean([run["last"] for run in of[name]] or [np.inf])))
    value = published.LEARNING_BASED["i"][method]
    return (
        f"{method}: nearer to the paper by more than {APART:g} standard errors: "
        f"{'; '.join(nearer) or 'none'}; farther: {'; '.join(farther) or 'none'}. The lowest, "
        f"{best}, has {study.spread(of[best], 'last')} where the paper has {value}."
    )


def _counting(readings: dict[str, dict[str, list[study.Facts]]]) -> str:
    """What is counted, and which epoch: readings of the same trainings."""
    base = [run for of in readings.values() for run in of[BASE]]
    best = [run["best"] - run["last"] for of in readings.values() for runs in of.values()
            for run in runs]  # fmt: skip
    error = np.std(best, ddof=1) / len(best) ** 0.5
    change = "no" if abs(np.mean(best)) <= APART * error else "a"
    return (
        f"Counting from 0 takes {1 - base[0]['from 0'] / base[0]['last']:.1%} off, and explains "
        f"nothing of it; neither does the epoch: the best one by training loss makes {change} "
        f"difference ({np.mean(best):+.3f}, standard error {error:.3f}, over all trainings)."
    )


def main() -> None:
    """Train what is missing, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--out", type=Path, default=Path("docs/results/choices"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--no-run", action="store_true", help="just write the page again")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    out = arguments.out
    if not arguments.no_run:
        for method in METHODS:
            study.complete(out / method, READINGS, arguments.seeds, partial(tried, method))
        study.complete(out / "ii", HP, arguments.seeds, high_band)
    write_json(out / "filtering.json", double_filtering())
    out.with_suffix(".md").write_text(made(out), encoding="utf-8")


def made(out: Path) -> str:
    """The page of the files in a folder."""
    readings = {method: study.found(out / method, READINGS) for method in METHODS}
    filtering = json.loads((out / "filtering.json").read_text(encoding="utf-8"))
    return page(readings, study.found(out / "ii", HP), filtering)


if __name__ == "__main__":
    main()

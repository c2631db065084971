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
import json
import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks import study
from benchmarks.beyond import SYSTEMS
from reproduction import published
from reproduction.settings import HYBRID
from splitband.filters.spectrum import oracle
from splitband.forecasters.simulation import Calibrated
from splitband.metrics import rmse
from splitband.models import Filtered, Model, Residual
from splitband.models.base import Signals
from splitband.networks import GRU
from splitband.runtime.files import write_json
from splitband.training import Checkpoint, Settings, fit

SAMPLES = HYBRID["v"].train
FIRST = (0, 400, 600, 1000)
"""Samples that a training segment begins with."""
STUDIED = 1000
"""Where the plateau is looked at: an exactly right network has by far the lowest loss there."""
EPOCHS = 200
"""Of what is tried there, a tenth of the paper's, so that all of it can be tried."""
FEW = 30
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
        column = HYBRID["v"].setup(20.0, "filtered-gru").settings
        return replace(column, **self.changes)


def _studied(**changes: Any) -> Row:
    return Row("filtered-gru", STUDIED, {"epochs": EPOCHS} | changes)


LIFTED: dict[str, Any] = {
    "warmup": 50, "clip": 1.0, "growth": 0.6, "learning_rate": 1e-2, "one_cycle": True,
}  # fmt: skip
"""What the default recipe of the package has, in the paper's windows."""
PLATEAU = {
    f"nothing, {EPOCHS} epochs": _studied(),
    "warm-up of 50 samples": _studied(warmup=50),
    "gradients clipped at 1": _studied(clip=1.0),
    "free run that grows": _studied(growth=0.6),
    "one cycle of the rate to 1e-2, clipped": _studied(
        learning_rate=1e-2, one_cycle=True, clip=1.0
    ),
    "that, growing, warm-up of 50": _studied(**LIFTED),
    "told the simulator": replace(_studied(), conditioned=True),
    f"the sum of the bands fed back, {FEW} epochs": replace(_studied(epochs=FEW), model=FedBack),
}
"""What is tried against the plateau, beside the paper's settings with as few epochs."""

MODELS: dict[str, type[Filtered | Residual]] = {
    "filtered-gru": Filtered,
    "residual-gru": Residual,
}
SHORT = {
    f"{method} from {first}, {EPOCHS} epochs": Row(method, first, {"epochs": EPOCHS}, model)
    for first in FIRST[1:]
    for method, model in MODELS.items()
    if (method, first) != ("filtered-gru", STUDIED)
}
BEST = "that, growing, warm-up of 50"
"""Of what is tried against the plateau, and on the other segments, too."""
ELSEWHERE = {
    f"{BEST}, from {first}": Row("filtered-gru", first, {"epochs": EPOCHS} | LIFTED)
    for first in FIRST
    if first != STUDIED
}
FULL = {
    f"{method} from {first}": Row(method, first, model=model)
    for first in FIRST[1:]
    for method, model in MODELS.items()
}
ROWS = PLATEAU | SHORT | ELSEWHERE | FULL
"""By name; those trained from the first sample on are runs of the paper's tables."""


def run(row: Row, seed: int, checkpoint: Checkpoint | None = None) -> study.Facts:
    """Train a row on its segment, and simulate the whole record."""
    record = SYSTEMS["v"].record()
    training = record[row.first : row.first + SAMPLES]
    bands = HYBRID["v"].setup(record.sampling_rate, "filtered-gru").bands
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
    setup = HYBRID["v"].setup(record.sampling_rate, "filtered-gru")
    assert setup.bands.cutoff is not None
    counted = record.y.copy()
    counted[: setup.settings.warmup] = np.nan
    simulation = Calibrated()
    simulation.fit(record)
    found = {}
    for name, of in (("", record), ("calibrated ", simulation.on(record))):
        assert of.y_sim is not None
        check = oracle(of.y, of.y_sim, of.sampling_rate, setup.bands.cutoff, seen=counted)
        found[f"{name}simulator"] = rmse(counted, of.y_sim)
        found[f"{name}nothing learned"] = check.no_network
        found[f"{name}exactly right"] = check.perfect_network
    return found


def page(found: dict[str, list[study.Facts]], segments: study.Facts, runs: Path) -> str:
    """Segments and runs in Markdown; `runs` is the folder of the paper's own runs of (v)."""
    assert __doc__ is not None
    return "\n".join(
        [
            f"# {__doc__.splitlines()[0]}\n",
            "Made by `python -m benchmarks.segments` of the files in [segments](segments) and of "
            "the paper's runs. RMSE, mean (standard deviation) over seeds; without one, a single "
            "seed.\n",
            f"What a segment of {SAMPLES} samples rewards, without any training: the low-passed "
            "simulator alone, which is what a network that adds nothing leaves, beside the low-"
            "passed simulator with the high band of the record, which is what a network that is "
            "exactly right would reach; and both with the simulator calibrated to the segment. "
            "Where the first is the lower one, training does not lead to the second. That one is "
            "no floor: a network can also make up for what the simulator gets wrong on its "
            "segment, which then need not hold elsewhere.\n",
            *study.table(
                ("samples", *(f"{made}{what}" for made in ("", "calibrated: ")
                              for what in ("simulator", "nothing learned", "exactly right"))),
                [(name, *(f"{value:.3f}" for value in of.values()))
                 for name, of in segments.items()],
            ),
            "",
            "The paper's settings on other segments, each run simulated over the whole record from "
            "its start; *training loss* is that of the segment, at the end of the training.\n",
            *study.table(
                ("trained on", "method", "total RMSE", "paper", "training loss", "seeds", "epochs"),
                _trained(found, runs),
            ),
            "",
            "The same with the package's own way of training in the paper's windows: one cycle of "
            "the rate up to 1e-2, clipped gradients, free runs that grow, a warm-up of 50 "
            "samples.\n",
            *study.table(
                ("trained on", "total RMSE", "training loss", "nothing learned", "exactly right",
                 "seeds", "epochs"),
                [
                    (_name(first), study.spread(of, "total_rmse"), study.spread(of, "loss"),
                     *(f"{segments[_name(first)][key]:.3f}"
                       for key in ("nothing learned", "exactly right")),
                     str(len(of)), str(EPOCHS))
                    for first in FIRST
                    if (of := found[BEST if first == STUDIED else f"{BEST}, from {first}"])
                ],
            ),
            "",
            f"What leaves the plateau on samples {_name(STUDIED)}, where nothing learned has a "
            f"loss of {segments[_name(STUDIED)]['nothing learned']:.3f} and exactly right one of "
            f"{segments[_name(STUDIED)]['exactly right']:.3f}; filtered-gru, one thing changed.\n",
            *study.table(
                ("changed", "training loss", "total RMSE", "seeds", "epochs"),
                [
                    (name, study.spread(found[name], "loss"),
                     study.spread(found[name], "total_rmse"), str(len(found[name])),
                     str(row.settings.epochs))
                    for name, row in PLATEAU.items() if found[name]
                ],
            ),
            "",
        ]
    )  # fmt: skip


def _trained(found: dict[str, list[study.Facts]], runs: Path) -> list[tuple[str, ...]]:
    """The rows of the paper's settings, by segment, with its epochs and with fewer."""
    rows: list[tuple[str, ...]] = []
    for first in FIRST:
        for method in MODELS:
            plain = f"{method} from {first}"
            of_all = [found.get(f"{plain}, {EPOCHS} epochs"), found.get(plain)]
            if not first:
                of_all = [_papers(runs / method)]
            elif (method, first) == ("filtered-gru", STUDIED):
                of_all[0] = found[next(iter(PLATEAU))]
            for of in of_all:
                if of:
                    rows.append(
                        (_name(first), method, study.spread(of, "total_rmse"),
                         str(published.HYBRID_GRU["v"][method]), study.spread(of, "loss"),
                         str(len(of)), str(of[0]["settings"]["epochs"]))
                    )  # fmt: skip
    return rows


def _papers(folder: Path) -> list[study.Facts]:
    """The runs of the paper's tables, as those here are."""
    read = [json.loads(path.read_text(encoding="utf-8")) for path in folder.glob("seed*.json")]
    return [
        {"total_rmse": run["total_rmse"], "loss": study.final(run["losses"]["network"]),
         "settings": run["settings"]["settings"]}
        for run in sorted(read, key=lambda run: int(run["job"]["seed"]))
    ]  # fmt: skip


def _name(first: int, samples: int = SAMPLES) -> str:
    return f"{first} to {first + samples}"


def main() -> None:
    """Train what is missing, one seed of all rows after the other, and write the page."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rows", nargs="*", metavar="ROW", help="; ".join(ROWS))
    parser.add_argument("--out", type=Path, default=Path("docs/results/segments"))
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--no-run", action="store_true", help="just write the page again")
    arguments = parser.parse_args()
    out = arguments.out
    torch.set_num_threads(1)
    if not arguments.no_run:
        study.complete(out, arguments.rows or ROWS, arguments.seeds, _resumed)
    write_json(out / "segments.json", segments())
    out.with_suffix(".md").write_text(made(out), encoding="utf-8")


def segments() -> dict[str, dict[str, float]]:
    """What there is to be learned of each segment, and of the whole record."""
    whole = len(SYSTEMS["v"].record())
    return {_name(first): segment(first) for first in FIRST} | {_name(0, whole): segment(0, whole)}


def made(out: Path) -> str:
    """The page of the files in a folder."""
    of = json.loads((out / "segments.json").read_text(encoding="utf-8"))
    return page(study.found(out, ROWS), of, out.parent / "runs" / "v")


def _resumed(name: str, seed: int, path: Path) -> study.Facts:
    """A run that goes on from its checkpoint, which is deleted once there is a result."""
    checkpoint = Checkpoint(path.with_suffix(".safetensors"))
    found = run(ROWS[name], seed, checkpoint)
    checkpoint.path.unlink()
    return found


if __name__ == "__main__":
    main()

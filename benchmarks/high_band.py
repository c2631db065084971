"""What keeps the high-band network of "+HP" from learning under (ii), for `benchmarks.choices`."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from benchmarks import study
from reproduction.settings import LEARNING_BASED
from splitband.data import double_torsion
from splitband.metrics import rmse
from splitband.models import Model, Split
from splitband.models.base import Signals, Task
from splitband.networks import GRU, rollout
from splitband.training import fit

Array = npt.NDArray[np.float64]
LEARNED = 0.7
"""Share of the first epoch's loss below which a network is said to have learned something."""
HP_EPOCHS = 150
"""Of the paper's 1,000 under (ii): enough to see which of the networks gets stuck."""


class WarmedOnAll(Split):
    """A "+HP" whose fast network warms up on the whole signal, which it can then continue."""

    def high(self, known: Signals, steps: int, low: Tensor) -> Tensor:
        """See `Split`."""
        y = rollout(self.fast, known.y, steps)
        return self.pair.highpass(torch.cat([known.y, y], dim=1))[:, known.y.shape[1] :]


class WarmedOnAllFromZero(Split):
    """Both of `WarmedOnAll` and `StartedFromZero`."""

    def high(self, known: Signals, steps: int, low: Tensor) -> Tensor:
        """See `Split`."""
        y = torch.cat([known.y, rollout(self.fast, known.y, steps)], dim=1)
        return replace(self.pair, start="zeros").highpass(y)[:, known.y.shape[1] :]


class StartedFromZero(Split):
    """A "+HP" whose filter starts from zero at both ends, as torchaudio's does.

    Ours continues a signal by its odd reflection, which multiplies what its last sample does.
    """

    def high(self, known: Signals, steps: int, low: Tensor) -> Tensor:
        """See `Split`."""
        history = known.y - self.pair.lowpass(known.y)
        y = torch.cat([history, rollout(self.fast, history, steps)], dim=1)
        return replace(self.pair, start="zeros").highpass(y)[:, known.y.shape[1] :]


class TargetFilteredTwice(Split):
    """A "+HP" that is compared with the high band filtered once more, as its output is."""

    def tasks(self, record: Signals) -> list[Task]:
        """See `Split`."""
        low, high = super().tasks(record)
        return [low, replace(high, target=self.pair.highpass(high.target, dim=0))]


ONE_CYCLE: dict[str, Any] = {"learning_rate": 1e-2, "one_cycle": True, "clip": 1.0}
"""How the package trains by default, but for free runs that grow."""


@dataclass(frozen=True)
class HighBand:
    """A network of the high band of (ii).

    Attributes
    ----------
    kind : Of model.
    filtered : Whether its prediction is high-passed.
    changes : Of the paper's settings.
    """

    kind: type[Split] = Split
    filtered: bool = True
    changes: dict[str, Any] = field(default_factory=dict)


HP = {
    "+HP": HighBand(),
    "no filter": HighBand(filtered=False),
    "+HP, target filtered twice": HighBand(TargetFilteredTwice),
    "+HP, warmed up on the whole signal": HighBand(WarmedOnAll),
    "+HP, filter started from zero": HighBand(StartedFromZero),
    "+HP, one cycle of the rate to 1e-2, clipped": HighBand(changes=ONE_CYCLE),
    "+HP, these three together": HighBand(WarmedOnAllFromZero, changes=ONE_CYCLE),
    "no filter, one cycle of the rate to 1e-2, clipped": HighBand(Split, False, ONE_CYCLE),
}
"""What is tried under (ii)."""


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
    row = HP[name]
    record = double_torsion()
    setup = LEARNING_BASED["ii"].setup(record.sampling_rate, "split-gru-hp")
    settings = replace(setup.settings, epochs=HP_EPOCHS, **row.changes)
    torch.manual_seed(seed)
    networks = [GRU(size, record.ny) for size in (setup.sizes.hidden_low, setup.sizes.hidden_high)]
    pair, k = setup.bands.pair(record.sampling_rate), setup.bands.downsampling
    assert k is not None
    model = row.kind(networks, pair, k, filter_output=row.filtered)
    began = time.process_time()
    history = fit(OnlyFast(model), record[: setup.train], settings, seed)
    losses = history.losses["high band"]
    return {"loss": study.final(losses), "losses": study.few(losses),
            **study.facts(seed, settings, began)}  # fmt: skip


def double_filtering() -> dict[str, float]:
    """What the high-pass filter of "+HP" does under (ii); no network is trained.

    Mean RMSE over the training windows, as the training loss has it: of the high band that is
    filtered once more, which is what a network has that goes on with what it warmed up on; of the
    whole signal, filtered; and of nothing.
    """
    record, column = double_torsion(), LEARNING_BASED["ii"]
    setup = column.setup(record.sampling_rate, "split-gru-hp")
    pair, y, warmup = (
        setup.bands.pair(record.sampling_rate),
        record.y[: column.train],
        column.warmup,
    )
    high = y - pair.lowpass(y, dim=0)

    def loss(goes_on: Array) -> float:
        errors = []
        for begin in range(len(y) - column.window + 1):
            at = slice(begin, begin + column.window)
            warm = y[at][:warmup] - pair.lowpass(y[at][:warmup], dim=0)
            filtered = pair.highpass(np.concatenate([warm, goes_on[at][warmup:]]), dim=0)
            errors.append(rmse(high[at][warmup:], filtered[warmup:]))
        return float(np.mean(errors))

    last = np.zeros((column.window, 1))
    last[-1] = 1.0
    gains = [np.linalg.norm(replace(pair, start=start).highpass(last, dim=0))
             for start in ("odd", "zeros")]  # fmt: skip
    return {
        "high band": loss(high),
        "whole signal": loss(y),
        "nothing": loss(0 * y),
        "gain of the last sample": float(gains[0]),
        "the same from zero": float(gains[1]),
    }


def high_band_section(
    networks: dict[str, list[study.Facts]], filtering: dict[str, float]
) -> list[str]:
    """What was tried, in lines of Markdown."""
    return [
            '## "+HP" under (ii)\n',
            f"Training losses of the high band after {HP_EPOCHS} epochs; *left* is the share of "
            "the first epoch's loss.\n",
            *study.table(
                ("network of the high band", "training loss", "left", "seeds"),
                [(name, study.spread(runs, "loss"), f"{_left(runs):.0%}", str(len(runs)))
                 for name, runs in networks.items() if runs],
            ),
            "",
            _ruled_out(networks),
            "",
            "What the filter does, without any training: a network that goes on with the high band "
            "that it warmed up on is filtered a second time, which leaves a loss of "
            f"{filtering['high band']:.3f}, where predicting nothing has "
            f"{filtering['nothing']:.3f}: the fundamental of the record lies near the cut-off and "
            "is in both bands. One that goes on with the whole signal is right up to "
            f"{filtering['whole signal']:.3f}. Where the filter continues a window by its odd "
            "reflection, as here, the last sample has "
            f"{filtering['gain of the last sample']:.1f} times its weight in the filtered one; "
            f"started from zero, as torchaudio's, {filtering['the same from zero']:.1f} times.",
            "",
    ]  # fmt: skip


def _left(runs: Sequence[study.Facts]) -> float:
    """The share of the first epoch's loss that there is at the end."""
    return float(np.mean([run["loss"] / run["losses"][0] for run in runs]))


def _ruled_out(networks: dict[str, list[study.Facts]]) -> str:
    """Which networks learn, and what is not the cause, as the others do not learn without it."""
    tried = {name: _left(runs) for name, runs in networks.items() if runs}
    learned = [name for name, left in tried.items() if left <= LEARNED]
    stuck = [name.removeprefix("+HP, ") for name, left in tried.items()
             if left > LEARNED and name != "+HP"]  # fmt: skip
    return (
        f"At least {1 - LEARNED:.0%} of the loss was learned by: {'; '.join(learned) or 'none'}. "
        "It is the filter around the prediction that keeps the network from learning, and no one "
        f"of these changes mends it: {'; '.join(stuck) or 'none'}."
    )

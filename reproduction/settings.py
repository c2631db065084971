"""Settings of the paper's experiments, from the tables of its supplement."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from splitband.comparison.methods import Sizes, named
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.network import with_defaults
from splitband.training import TrainingSettings

SAMPLE_FREQUENCY = 10.0
"""The "sample frequency f" of every filter table, whatever the record's real rate."""


OURS = {f"{kind}rnn": f"{kind}euler-mlp" for kind in ("", "residual-", "filtered-")}
"""Our names of methods that the paper calls RNN."""


@dataclass(frozen=True)
class Setup:
    """What the methods of one run share.

    Attributes
    ----------
    train : Length of the training part, in samples.
    settings : Of the training.
    bands : Cut-off, order and down-sampling.
    sizes : Of the networks.
    """

    train: int
    settings: TrainingSettings
    bands: Bands
    sizes: Sizes

    def forecaster(self, name: str) -> Forecaster:
        """The method with this name of the paper."""
        ours = OURS.get(name, name)
        return with_defaults(named(ours, self.sizes), self.settings, self.bands)

    def as_json(self) -> dict[str, Any]:
        """What a file of a run says of it."""
        bands = asdict(self.bands)
        said = {name: bands[name] for name in ("cutoff", "order", "downsampling")}
        return {"train": self.train, "settings": asdict(self.settings), **said} | asdict(self.sizes)


@dataclass(frozen=True)
class LearningBased:
    """A column of the table "Hyperparameters for learning-based method".

    Attributes
    ----------
    train : Samples trained on (Sec. 5).
    hidden_high, hidden_low : Its GRU 1 and GRU 2.
    cutoff : w, in the table's unit, where the sampling rate is 10.
    order : Of the Butterworth filters.
    window, warmup : Subtrajectory length and warm-up phase, in samples.
    epochs : Its training steps.
    gru_epochs : Training steps of the single GRU, where the text names others (Sec. 5, Results).
    downsampling : Its sampling rate k.
    """

    train: int
    hidden_high: int
    hidden_low: int
    cutoff: float
    order: int
    window: int
    warmup: int
    epochs: int
    gru_epochs: int | None = None
    downsampling: int = 2

    def epochs_of(self, method: str) -> int:
        """The paper's epochs for a method."""
        return self.gru_epochs if method == "gru" and self.gru_epochs else self.epochs

    def setup(self, sampling_rate: float, method: str) -> Setup:
        """Return the setup of a method on a record of `sampling_rate` Hz."""
        return Setup(
            train=self.train,
            settings=TrainingSettings.paper(
                self.window, self.warmup, self.epochs_of(method), normalize=False
            ),
            bands=Bands(in_hz(self.cutoff, sampling_rate), self.order, self.downsampling),
            sizes=Sizes(hidden_low=self.hidden_low, hidden_high=self.hidden_high),
        )


@dataclass(frozen=True)
class Hybrid:
    """A column of the tables "Hyperparameters for hybrid model" with MLP and with GRU.

    Attributes
    ----------
    train : Samples trained on; not in the paper (reproduction/REPORT.md).
    cutoff : w, in the table's unit; the filters have order 1.
    warmup : Recognition steps of the MLP and warm-up phase of the GRU.
    gru_window, gru_epochs, gru_hidden : Of the GRU.
    rnn_window, rnn_epochs, rnn_state : Of the MLP; its state's size is the table's input_dim.
    rnn_milestones : Learning rates of `rnn_reduced`, by epoch.
    rnn_reduced : The RNN methods whose learning rate is reduced; the text names them.
    downsampling : The tables have none.
    """

    train: int
    cutoff: float
    warmup: int
    gru_window: int
    gru_epochs: int
    rnn_window: int
    rnn_epochs: int
    rnn_state: int
    rnn_milestones: tuple[tuple[int, float], ...]
    rnn_reduced: tuple[str, ...]
    gru_hidden: int = 64
    downsampling: None = None

    def epochs_of(self, method: str) -> int:
        """The paper's epochs for a method."""
        return self.rnn_epochs if method.endswith("rnn") else self.gru_epochs

    def setup(self, sampling_rate: float, method: str) -> Setup:
        """Return the setup of a method on a record of `sampling_rate` Hz."""
        rnn = method.endswith("rnn")
        return Setup(
            train=self.train,
            settings=TrainingSettings.paper(
                self.rnn_window if rnn else self.gru_window,
                self.warmup,
                self.epochs_of(method),
                milestones=self.rnn_milestones if method in self.rnn_reduced else (),
                normalize=False,
            ),
            bands=Bands(in_hz(self.cutoff, sampling_rate), order=1, downsampling=2),
            sizes=Sizes(
                hidden_low=self.gru_hidden // 4,
                hidden_high=self.gru_hidden - self.gru_hidden // 4,
                state_size=self.rnn_state,
                step_size=1 / sampling_rate,
            ),
        )


def in_hz(cutoff: float, sampling_rate: float) -> float:
    """A cut-off of the paper's tables in real Hz, for a record of `sampling_rate` Hz."""
    return cutoff * sampling_rate / SAMPLE_FREQUENCY


LEARNING_BASED = {
    "i": LearningBased(250, 48, 16, 0.4, 3, 150, 30, 300, gru_epochs=2000),
    "ii": LearningBased(600, 64, 32, 0.07, 1, 250, 100, 1000),
    "iii": LearningBased(600, 64, 32, 0.1, 1, 250, 50, 501),
    "iv": LearningBased(600, 64, 32, 0.2, 1, 250, 50, 1000),
}
_V = ((20, 1e-4), (500, 1e-5)), ("rnn", "filtered-rnn")
_VI = ((10, 1e-4),), ("filtered-rnn", "residual-rnn")
HYBRID = {
    "v": Hybrid(600, 0.25, 10, 200, 2000, 200, 2000, 4, *_V),
    "vi": Hybrid(2000, 0.1, 50, 500, 500, 1500, 300, 15, *_VI),
}

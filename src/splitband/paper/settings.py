"""Settings of the paper's experiments, from the tables of its supplement."""

from __future__ import annotations

from dataclasses import dataclass

from splitband.comparison import Setup
from splitband.training import Settings

SAMPLE_FREQUENCY = 10.0
"""The "sample frequency f" of every filter table, whatever the record's real rate."""


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
    downsampling: int = 2

    def cutoff_hz(self, sampling_rate: float) -> float:
        """The cut-off in real Hz for a record of `sampling_rate` Hz."""
        return self.cutoff * sampling_rate / SAMPLE_FREQUENCY

    def setup(self, sampling_rate: float) -> Setup:
        """The setup of a comparison on a record of `sampling_rate` Hz."""
        return Setup(
            train=self.train,
            settings=Settings(self.window, self.warmup, self.epochs, normalize=False),
            cutoff=self.cutoff_hz(sampling_rate),
            order=self.order,
            downsampling=self.downsampling,
            hidden_high=self.hidden_high,
            hidden_low=self.hidden_low,
        )


LEARNING_BASED = {
    "i": LearningBased(250, 48, 16, 0.4, 3, 150, 30, 300),
    "ii": LearningBased(600, 64, 32, 0.07, 1, 250, 100, 1000),
    "iii": LearningBased(600, 64, 32, 0.1, 1, 250, 50, 501),
    "iv": LearningBased(600, 64, 32, 0.2, 1, 250, 50, 1000),
}

RECORD_SETTINGS = {"double-mass-spring": "i", "double-torsion": "ii"}
"""Which column is the default for a named record."""

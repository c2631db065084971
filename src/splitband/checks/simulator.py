"""Check what a record's simulator is worth, and whether a network can learn what it lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from splitband.filters.spectrum import Oracle, coherence, oracle, oracle_cutoffs
from splitband.forecasters.bands import Bands
from splitband.forecasters.held_out import beginning
from splitband.forecasters.simulation import Calibrated
from splitband.metrics import rmse
from splitband.records import Record


@dataclass(frozen=True)
class SimulatorCheck:
    """How a simulator compares with a record.

    Attributes
    ----------
    total_rmse : RMSE of the simulator.
    cutoff : Cut-off in Hz of the hybrids that are checked on training samples.
    mean_coherence_below_cutoff : Mean coherence of simulator and record up to the cut-off.
    oracle : Least errors of a hybrid at several cut-offs, over the whole record.
    training : These on the training samples, at the cut-off.
    calibrated : These with the simulator calibrated, where there is nothing to learn without.
    """

    total_rmse: float
    cutoff: float
    mean_coherence_below_cutoff: float
    oracle: Sequence[Oracle]
    training: Oracle
    calibrated: Oracle | None = None

    def in_words(self) -> list[str]:
        """Return the coherence with the record in a sentence."""
        return [
            "a lower cut-off leaves more to the network; mean coherence of simulator and record up "
            f"to {self.cutoff:.4g} Hz: {self.mean_coherence_below_cutoff:.2f}"
        ]

    def warnings(self) -> list[str]:
        """Return that there is nothing to learn, if so, and whether calibration helps."""
        if self.calibrated is None:
            return []
        by = self.calibrated
        then = "the same" if by.nothing_to_learn else "there is something to learn"
        return [
            f"{self.training.describe()}; with the simulator calibrated (-calibrated) "
            f"{by.no_network:.3g} and {by.perfect_network:.3g}: {then}"
        ]


def simulator_check(record: Record, train: int, bands: Bands) -> SimulatorCheck | None:
    """Compare a record with its simulator, and a network's task at the cut-off of these bands.

    Returns None for a record without a simulator, or without a cut-off.
    """
    if record.y_sim is None or bands.cutoff is None:
        return None
    rate, order, shown = record.sampling_rate, bands.order or 1, record[:]
    assert shown.y_sim is not None
    cutoffs = sorted({*oracle_cutoffs(len(record), rate), bands.cutoff})
    frequencies, agreement = coherence(shown.y, shown.y_sim, rate)
    below = frequencies <= bands.cutoff
    training = _oracle(record[:train], bands.cutoff, order)
    calibrated = None
    if training.nothing_to_learn:
        calibrated = Calibrated().fit(beginning(record, train)).on(record[:train])
    return SimulatorCheck(
        rmse(record.y_with_gaps, shown.y_sim),
        bands.cutoff,
        float(agreement[below].mean()) if below.any() else 0.0,
        tuple(_oracle(shown, cutoff, order) for cutoff in cutoffs),
        training,
        None if calibrated is None else _oracle(calibrated, bands.cutoff, order),
    )


def _oracle(record: Record, cutoff: float, order: int) -> Oracle:
    """Run the oracle check on a record with a simulator."""
    assert record.y_sim is not None
    return oracle(record.y, record.y_sim, record.sampling_rate, cutoff, order, record.y_with_gaps)

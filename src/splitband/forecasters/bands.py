"""Define the frequency bands of a model: cut-off, order and down-sampling, given or chosen."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

from splitband.filters import Band, ComplementaryPair, butterworth
from splitband.filters.cutoff import Choice, choose, choose_with_simulator
from splitband.runtime.arguments import LARGEST_SIZE, whole
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.options import WithRepr


@dataclass(frozen=True, repr=False)
class Bands(WithRepr):
    """The parameters of a filter pair; those that are None are chosen on training samples.

    Attributes
    ----------
    cutoff : In Hz.
    order : Of each Butterworth filter.
    downsampling : k: the low band keeps every k-th sample.
    choice : Result and reason of the choice, where they were chosen.
    """

    cutoff: float | None = None
    order: int | None = None
    downsampling: int | None = None
    choice: Choice | None = field(default=None, repr=False)

    def __post_init__(self) -> None:
        """Check sizes."""
        for name, value in (("order", self.order), ("downsampling", self.downsampling)):
            if value is not None:
                object.__setattr__(self, name, whole(name, value, 1, LARGEST_SIZE))

    def chosen(
        self,
        y: Array,
        sampling_rate: float,
        warmup: int,
        y_sim: Array | None = None,
        simulator_band: Band = "low",
    ) -> Bands:
        """Return the bands with missing parameters chosen on the training samples `(time, ny)`.

        `y_sim` is the output of the simulator of `simulator_band`; None for networks in both bands.
        If the simulator does not help, the bands are chosen as for networks, and
        `choice.simulator_helps` is False.
        """
        given = self.cutoff, self.order, self.downsampling
        learned = choose(y, sampling_rate, warmup, *given)
        choice = learned
        if y_sim is not None:
            choice = choose_with_simulator(y, y_sim, sampling_rate, warmup, *given, simulator_band)
            if not choice.simulator_helps:
                reason = f"{choice.reason}; chosen for networks alone: {learned.reason}"
                choice = replace(learned, reason=reason, simulator_helps=False)
        return Bands(choice.cutoff, choice.order, choice.downsampling, choice)

    def pair(self, sampling_rate: float) -> ComplementaryPair:
        """Return the zero-phase pair of a split model."""
        cutoff, order = self.filter
        return ComplementaryPair.butterworth(cutoff, sampling_rate, order)

    def one_way_pair(self, sampling_rate: float, simulator_band: Band = "low") -> ComplementaryPair:
        """Return the pair of a hybrid, which filters forwards only.

        The simulator's filter is a Butterworth filter, that of the network the rest: only then
        does a high-pass filter of order n remove a drift up to the power n - 1 of time.
        """
        cutoff, order = self.filter
        b, a = butterworth(cutoff, sampling_rate, order, simulator_band)
        return ComplementaryPair.perfect(b, a, sampling_rate, simulator_band, cutoff=cutoff)

    @property
    def filter(self) -> tuple[float, int]:
        """Return cut-off and order; raises ValueError where they are not known."""
        if self.cutoff is None or self.order is None:
            raise InputError("cutoff and order must be given, or chosen first, see Bands.chosen")
        return self.cutoff, self.order


OPEN = Bands()
"""Bands whose parameters are all chosen on the training samples."""


def require_bands(bands: object) -> Bands:
    """Return bands; raises InputError for anything else, such as a number."""
    if not isinstance(bands, Bands):
        raise InputError(
            "bands must be Bands, such as Bands(0.5) for a cut-off of 0.5 Hz, or left out to be "
            f"chosen on the training samples, got {bands!r}"
        )
    return bands

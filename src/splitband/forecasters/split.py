"""Networks that have but one of two bands: what they share, and one network for each band."""

from __future__ import annotations

from typing import Self, final

import numpy as np
import numpy.typing as npt

from splitband import models
from splitband.data import Record
from splitband.forecasters.bands import OPEN, Bands
from splitband.forecasters.network import Network, Template, as_template, label_of
from splitband.models import Model
from splitband.training import Settings

Array = npt.NDArray[np.float64]


class Banded(Network):
    """A network that has but one of two bands, or is told about the other one."""

    trained_in: Bands | None = None
    """The bands, or what has been chosen where they were left open."""

    def __init__(
        self, bands: Bands, conditioned: bool, settings: Settings | None, name: str | None
    ) -> None:
        super().__init__(settings, name)
        self.bands, self.conditioned = bands, conditioned

    @property
    def shares_bands(self) -> bool:
        """See `Forecaster`."""
        return self.bands == Bands()

    def with_defaults(self, settings: Settings, bands: Bands) -> Self:
        """See `Forecaster`."""
        new = super().with_defaults(settings, bands)
        # What is left open beside a cut-off or an order that is given has to be chosen to suit it.
        if self.shares_bands:
            new = new.clone().set_params(bands=bands)
        return new

    def _decide(self, record: Record, settings: Settings) -> None:
        self.trained_in = self._bands_for(record, settings)

    def _bands_for(self, record: Record, settings: Settings) -> Bands:
        """The bands; what has been left open of them is chosen by the training record."""
        if self.trained_in is not None:
            return self.trained_in
        if self.bands.complete:
            return self.bands
        y_sim = self._low_band(record)
        return self.bands.chosen(record.y, record.sampling_rate, settings.warmup, y_sim)

    def _low_band(self, record: Record) -> Array | None:
        """What is to hold the low band of a record, `(time, ny)`; None where a network is."""
        return None

    def _fast_network_inputs(self, record: Record) -> int:
        """Inputs of the network that sees every sample.

        The record's, of this sample and of the next one, and value and slope of what is slower.
        """
        return 2 * record.nu + (2 * record.ny if self.conditioned else 0)


@final
class Split(Banded):
    """Two networks, each on its band (paper, Sec. 4.2): "split GRU" and "split GRU + HP".

    Parameters
    ----------
    low, high : The cells of the low band and of the high band.
    bands : Where one ends and the other begins; by default chosen by the training samples.
    filter_output : High-pass the fast network's output too, the paper's "+HP".
    conditioned : Tell the fast network what the slow one predicts. Not in the paper.
    settings, name : See `Single`.

    Examples
    --------
    >>> time = 0.1 * np.arange(120)
    >>> record = sb.Record(np.sin(time) + 0.2 * np.sin(9 * time), 0.1)
    >>> short = sb.Settings(window=40, warmup=10, epochs=1)
    >>> model = sb.Split(sb.GRU(4), sb.GRU(4), sb.Bands(0.5, 1, 2), settings=short)
    >>> sorted(model.fit(record, seed=0).predict(20).components)
    ['high band', 'low band']
    """

    cells = ("low", "high")

    def __init__(
        self,
        low: Template,
        high: Template,
        bands: Bands = OPEN,
        filter_output: bool = False,
        conditioned: bool = False,
        settings: Settings | None = None,
        name: str | None = None,
    ) -> None:
        super().__init__(bands, conditioned, settings, name)
        self.low, self.high = as_template(low), as_template(high)
        self.filter_output = filter_output

    def check(self, *records: Record) -> None:
        """See `Forecaster`."""
        super().check(*records)
        check_warmup(self._settings_for(records[0]), 3 * ((self.bands.order or 1) + 1), self.bands)

    def build(self, record: Record, settings: Settings) -> Model:
        """See `Network`."""
        bands = self._bands_for(record, settings)
        assert bands.downsampling is not None
        # With k = 1 the slow network sees every sample as well, and each input twice.
        nu = record.nu * (2 if bands.downsampling == 1 else 1)
        low = self.low.sized(record.ny, nu, settings.warmup)
        high = self.high.sized(record.ny, self._fast_network_inputs(record), settings.warmup)
        return models.Split(
            [low, high],
            bands.pair(record.sampling_rate),
            bands.downsampling,
            self.filter_output,
            self.conditioned,
            record.nu > 0,
        )

    def _derived_name(self) -> str:
        cells = dict.fromkeys([label_of(self.low), label_of(self.high)])
        return (
            f"split-{'-'.join(cells)}{'-hp' if self.filter_output else ''}"
            f"{'-conditioned' if self.conditioned else ''}"
        )


def check_warmup(settings: Settings, shortest: int, bands: Bands) -> None:
    """Raise ValueError for a warm-up of `shortest` samples or fewer: the filters need more."""
    if settings.warmup <= shortest:
        raise ValueError(
            f"warmup must have more than {shortest} samples for filters of order "
            f"{bands.order or 1}, got {settings.warmup}; a record too short for that is one for "
            "methods without filters"
        )

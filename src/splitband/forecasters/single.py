"""Forecast by one network on the whole band."""

from __future__ import annotations

from typing import final

from splitband import models
from splitband.data import Record
from splitband.forecasters.network import Network
from splitband.models import Model
from splitband.networks.cell import Template, as_template, label_of
from splitband.training import Settings


@final
class Single(Network):
    """Train one network on the whole band: the baseline (paper, Sec. 4.1).

    Parameters
    ----------
    cell : Such as `GRU(64)`; of its sizes the hidden ones count, the others are the record's.
    settings : How it is trained; by default the default recipe for the length of the record.
    name : By default what it is made of.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    >>> short = sb.Settings(window=40, warmup=10, epochs=1)
    >>> model = sb.Single(sb.GRU(4), short).fit(record, seed=0)
    >>> prediction = model.predict(20)
    >>> prediction.y.shape, float(round(prediction.time[0], 1))
    ((20, 1), 0.1)
    """

    def __init__(
        self, cell: Template, settings: Settings | None = None, name: str | None = None
    ) -> None:
        super().__init__(settings, name)
        self.cell = as_template(cell)

    def build(self, record: Record, settings: Settings) -> Model:
        """Return one network that sees every sample."""
        cell = self.cell.sized(record.ny, self._fast_network_inputs(record), settings.warmup)
        return models.Recurrent(cell, record.nu > 0)

    def in_words(self) -> str:
        """Return what it is."""
        return f"{type(self.cell).__name__} network"

    def _derived_name(self) -> str:
        return label_of(self.cell)

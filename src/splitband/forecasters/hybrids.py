"""Forecast with hybrids: a network and a simulator, or a forecaster that is fitted first."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, final

from splitband import models
from splitband.data import Record
from splitband.filters.spectrum import oracle
from splitband.forecasters.bands import OPEN, Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.network import CONDITIONED, Network
from splitband.forecasters.simulation import Simulation
from splitband.networks.cell import Template, as_template, label_of, words_of
from splitband.simulators import Simulator
from splitband.training import Settings

if TYPE_CHECKING:
    from splitband.models import Model


def as_slow_part(base: Forecaster | Simulator | None) -> Forecaster:
    """Return the forecaster of the slow component; raises ValueError without a `trajectory`."""
    if not isinstance(base, Forecaster):
        adjustable: Any = base if getattr(base, "adjustable", False) else None
        return Simulation(base) if adjustable is None else GreyBox(adjustable)
    if type(base).trajectory is Forecaster.trajectory:
        raise ValueError(
            f"base must say something about the whole record, as a simulator, Linear, Periodic "
            f"and Harmonic do, got {base.name}"
        )
    return base


@final
class Filtered(Network):
    """Combine a base in the low band with a network in the high band (paper, Sec. 4.3).

    Parameters
    ----------
    base : The model of the low band: a simulator (with parameters to fit, it becomes a `GreyBox`),
        or a forecaster with a `trajectory`, such as `Calibrated()` or `Linear()`, which is fitted
        first; None for the simulator's output in the record.
    cell : The network's, such as `GRU(64)`.
    bands : Cut-off and order; by default chosen by where base and training samples agree.
    conditioned : Use the base's output, value and slope, as an input of the network. Not in the
        paper.
    settings, name : See `Single`.

    Examples
    --------
    >>> time = 0.1 * np.arange(150)
    >>> record = sb.Record(np.sin(time) + 0.2 * np.sin(9 * time), 0.1)
    >>> short = sb.Settings(window=40, warmup=10, epochs=1)
    >>> model = sb.Filtered(sb.Function(np.sin), sb.GRU(4), sb.Bands(0.5, 1, 1), settings=short)
    >>> prediction = model.fit(record[:120], seed=0).predict(30)
    >>> sorted(prediction.components)
    ['network, high band', 'simulator, low band']
    """

    base: Forecaster
    bands: Bands

    def __init__(
        self,
        base: Forecaster | Simulator | None,
        cell: Template,
        bands: Bands = OPEN,
        conditioned: bool = False,
        settings: Settings | None = None,
        name: str | None = None,
    ) -> None:
        super().__init__(settings, name)
        self.base, self.cell = as_slow_part(base), as_template(cell)
        self.bands, self.conditioned = bands, conditioned

    def build(self, record: Record, settings: Settings) -> Model:
        """Return a model with a network and a high-pass filter."""
        bands = self._bands_for(record, settings)
        cell = self.cell.sized(record.ny, self._fast_network_inputs(record), settings.warmup)
        pair = bands.one_way_pair(record.sampling_rate)
        return models.Filtered(cell, pair, self.conditioned, record.nu > 0)

    def in_words(self) -> str:
        """Return a description."""
        slow, network = self.base.as_base, words_of(self.cell)
        words = f"{slow.words or slow.label} in the low band, {network} network in the high band"
        return words + self.conditioned_in_words

    def _shortest_warmup(self) -> int:
        return (self.bands.order or 1) - 1

    def _remarks(self, record: Record) -> list[str]:
        """Return a remark where the training samples favour a network whose output is zero."""
        bands = self._bands_for(record, self._settings_for(record))
        assert bands.cutoff is not None
        assert bands.order is not None
        assert record.y_sim is not None
        reachable = oracle(record.y, record.y_sim, record.sampling_rate, bands.cutoff, bands.order,
                       record.seen)  # fmt: skip
        if not reachable.nothing_to_learn:
            return []
        advice = "" if self.calibrates else "; calibrating it may change that"
        return [reachable.describe() + advice]

    def _derived_name(self) -> str:
        return _name("filtered", self.base, self.cell, self.conditioned)


@final
class Residual(Network):
    """Combine a base with a network that learns its error (paper, Sec. 5.1).

    Parameters
    ----------
    base, cell, conditioned, settings, name : See `Filtered`.

    Examples
    --------
    >>> time = 0.1 * np.arange(150)
    >>> record = sb.Record(np.sin(time) + 0.2 * np.sin(9 * time), 0.1)
    >>> short = sb.Settings(window=40, warmup=10, epochs=1)
    >>> model = sb.Residual(sb.Function(np.sin), sb.GRU(4), settings=short)
    >>> model.fit(record[:120], seed=0).predict(30).y.shape
    (30, 1)
    """

    base: Forecaster

    def __init__(
        self,
        base: Forecaster | Simulator | None,
        cell: Template,
        conditioned: bool = False,
        settings: Settings | None = None,
        name: str | None = None,
    ) -> None:
        super().__init__(settings, name)
        self.base, self.cell = as_slow_part(base), as_template(cell)
        self.conditioned = conditioned

    def build(self, record: Record, settings: Settings) -> Model:
        """Return a model with a network and no filters."""
        cell = self.cell.sized(record.ny, self._fast_network_inputs(record), settings.warmup)
        return models.Residual(cell, self.conditioned, record.nu > 0)

    def in_words(self) -> str:
        """Return a description."""
        slow, network = self.base.as_base, words_of(self.cell)
        words = f"{slow.words or slow.label} plus {network} network that learns its error"
        return words + self.conditioned_in_words

    def _derived_name(self) -> str:
        return _name("residual", self.base, self.cell, self.conditioned)


def _name(kind: str, base: Forecaster, cell: Template, conditioned: bool) -> str:
    slow = base.as_base
    return f"{kind}{slow.before}-{label_of(cell)}{slow.after}{CONDITIONED * conditioned}"

"""Forecast with networks: one for the whole signal, one for each band, or one beside a base."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, final, get_args

from splitband import models
from splitband.filters import Band
from splitband.filters.resampling import Alignment
from splitband.filters.spectrum import oracle
from splitband.forecasters.bands import OPEN, Bands, require_bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.grey_box import GreyBox
from splitband.forecasters.network import CONDITIONED, Network
from splitband.forecasters.simulation import Calibrated, Simulation, SimulatorForecaster
from splitband.networks.cell import Template, as_template, label_of, words_of
from splitband.records import Record
from splitband.runtime.errors import InputError
from splitband.simulators import Simulator
from splitband.simulators.base import as_known
from splitband.training import TrainingSettings

if TYPE_CHECKING:
    from splitband.models import Model


@final
class Single(Network):
    """One network for the whole signal (Ensinger et al. 2023, Sec. 4.1).

    Parameters
    ----------
    cell : Such as `GRU(64)`: only hidden sizes are used, the others are those of the record.
    settings : Of the training; by default the default recipe for the length of the record.
    name : By default derived from the cell.

    Raises
    ------
    ValueError
        For something else than a cell.

    Examples
    --------
    >>> record = sb.Record(np.sin(0.3 * np.arange(120)), 0.1)
    >>> short = sb.TrainingSettings(window=40, warmup=10, epochs=1)
    >>> model = sb.Single(sb.GRU(4), short).fit(record, seed=0)
    >>> prediction = model.predict(20)
    >>> prediction.y.shape, float(round(prediction.time[0], 1))
    ((20, 1), 0.1)
    """

    def __init__(
        self, cell: Template, settings: TrainingSettings | None = None, name: str | None = None
    ) -> None:
        super().__init__(settings, name)
        self.cell = as_template(cell)

    def _build(self, record: Record, settings: TrainingSettings) -> Model:
        return models.Recurrent(self._sized(self.cell, record, settings), record.nu > 0)

    def in_words(self) -> str:
        return words_of(self.cell)

    def _derived_name(self) -> str:
        return label_of(self.cell)


@final
class Split(Network):
    """A network for each band (Ensinger et al. 2023, Sec. 4.2: "split GRU", "split GRU + HP").

    Parameters
    ----------
    low, high : The cells of the low band and of the high band.
    bands : Cut-off, order and down-sampling; by default chosen on the training samples.
    filter_output : High-pass the fast network's output too, the paper's "+HP".
    conditioned : Use the slow network's prediction, value and slope, as an input of the fast one.
        Not in the paper.
    own_warmup : Filter the warm-up of each training window alone, as that of a simulation is.
        Otherwise windows are cut from the filtered training record, as in Eq. 10, training.
    alignment : Of the up-sampled low band: `"time"`, or `"paper"`, which shifts it by (k - 1) / 2
        samples.
    settings, name : See `Single`.

    Examples
    --------
    >>> time = 0.1 * np.arange(120)
    >>> record = sb.Record(np.sin(time) + 0.2 * np.sin(9 * time), 0.1)
    >>> short = sb.TrainingSettings(window=40, warmup=10, epochs=1)
    >>> model = sb.Split(sb.GRU(4), sb.GRU(4), sb.Bands(0.5, 1, 2), settings=short)
    >>> sorted(model.fit(record, seed=0).predict(20).components)
    ['high band', 'low band']
    """

    bands: Bands

    def __init__(  # noqa: PLR0913
        self,
        low: Template,
        high: Template,
        bands: Bands = OPEN,
        filter_output: bool = False,
        conditioned: bool = False,
        settings: TrainingSettings | None = None,
        name: str | None = None,
        own_warmup: bool = True,
        alignment: Alignment = "time",
    ) -> None:
        super().__init__(settings, name)
        self.own_warmup, self.alignment = own_warmup, alignment
        self.low, self.high = as_template(low), as_template(high)
        self.bands, self.conditioned = require_bands(bands), conditioned
        self.filter_output = filter_output

    def _build(self, record: Record, settings: TrainingSettings) -> Model:
        bands = self._bands_for(record, settings)
        assert bands.downsampling is not None
        # With k = 1 the slow network also runs at every sample, with this input and the next.
        nu = record.nu * (2 if bands.downsampling == 1 else 1)
        low = self.low.sized(record.ny, nu, settings.warmup)
        return models.SplitModel(
            [low, self._sized(self.high, record, settings)],
            bands.pair(record.sampling_rate),
            bands.downsampling,
            self.filter_output,
            self.conditioned,
            record.nu > 0,
            self.own_warmup,
            self.alignment,
        )

    def in_words(self) -> str:
        said = self._of_bands(words_of(self.low), words_of(self.high))
        return f"{said}, high-passed" if self.filter_output else said

    def _shortest_warmup(self) -> int:
        return 3 * ((self.bands.order or 1) + 1)

    def _derived_name(self) -> str:
        cells = "-".join(dict.fromkeys([label_of(self.low), label_of(self.high)]))
        return f"split-{cells}{'-hp' * self.filter_output}{CONDITIONED * self.conditioned}"


def as_slow_part(base: Forecaster | Simulator | None) -> Forecaster:
    """Return the forecaster of the slow component; raises ValueError without a `trajectory`."""
    if not isinstance(base, Forecaster):
        known = None if base is None else as_known(base)
        return GreyBox(known) if known is not None and known.adjustable else Simulation(known)
    if type(base).trajectory is Forecaster.trajectory:
        raise InputError(
            "base must say something about the whole record (have a `trajectory`), as a simulator "
            f"or Linear does, got {base.name}"
        )
    return base


@final
class Filtered(Network):
    """A hybrid: a base in one band, a network in the other (Ensinger et al. 2023, Sec. 4.3).

    Parameters
    ----------
    base : The model of its band: a simulator (with parameters to fit, it becomes a `GreyBox`), or a
        forecaster with a `trajectory`, such as `Calibrated()` or `Linear()`, which is fitted first;
        None for the simulator's output in the record.
    cell : That of the network, such as `GRU(64)`.
    bands : Cut-off and order, and the down-sampling of a network in the low band; by default chosen
        by where base and training samples agree.
    conditioned : Use the base's output, value and slope, as an input of the network; with
        `simulator_band="high"` only the high band of it. Not in the paper.
    settings, name : See `Single`.
    simulator_band : The band of the base: `"low"`, as in the paper, or `"high"` for one that is
        right in its details and drifts, such as an integrated rate. The network then simulates the
        low band, down-sampled.

    Raises
    ------
    ValueError
        For a base without a `trajectory`, something else than a cell, and another band.

    Examples
    --------
    >>> time = 0.1 * np.arange(150)
    >>> record = sb.Record(np.sin(time) + 0.2 * np.sin(9 * time), 0.1)
    >>> short = sb.TrainingSettings(window=40, warmup=10, epochs=1)
    >>> model = sb.Filtered(sb.Function(np.sin), sb.GRU(4), sb.Bands(0.5, 1, 1), settings=short)
    >>> prediction = model.fit(record[:120], seed=0).predict(30)
    >>> sorted(prediction.components)
    ['network, high band', 'simulator, low band']

    A sensor that drifts, with a reference over the training samples:

    >>> drifting = sb.Function(lambda t: np.sin(t) + 0.2 * np.sin(9 * t) + 0.3 * t)
    >>> bands = sb.Bands(0.5, 1, downsampling=2)
    >>> model = sb.Filtered(drifting, sb.GRU(4), bands, settings=short, simulator_band="high")
    >>> prediction = model.fit(record[:120], seed=0).predict(30)
    >>> sorted(prediction.components)
    ['network, low band', 'simulator, high band']
    """

    base: Forecaster
    bands: Bands

    def __init__(  # noqa: PLR0913
        self,
        base: Forecaster | Simulator | None,
        cell: Template,
        bands: Bands = OPEN,
        conditioned: bool = False,
        settings: TrainingSettings | None = None,
        name: str | None = None,
        simulator_band: Band = "low",
    ) -> None:
        super().__init__(settings, name)
        if simulator_band not in get_args(Band):
            raise InputError(
                f"simulator_band must be one of {get_args(Band)}, got {simulator_band!r}"
            )
        self.simulator_band = simulator_band
        self.base, self.cell = as_slow_part(base), as_template(cell)
        self.bands, self.conditioned = require_bands(bands), conditioned

    def _build(self, record: Record, settings: TrainingSettings) -> Model:
        bands = self._bands_for(record, settings)
        pair, driven = bands.one_way_pair(record.sampling_rate, self.simulator_band), record.nu > 0
        if not self._above:
            cell = self._sized(self.cell, record, settings)
            return models.FilteredModel(cell, pair, self.conditioned, driven)
        k = bands.downsampling
        assert k is not None
        # With k = 1 the network also runs at every sample, with this input and the next.
        nu = record.nu * (2 if k == 1 else 1) + 2 * record.ny * self.conditioned
        cell = self.cell.sized(record.ny, nu, max(settings.warmup // k, 1))
        return models.FilteredHighModel(cell, pair, k, self.conditioned, driven)

    @property
    def _above(self) -> bool:
        """Return whether the base has the high band."""
        return self.simulator_band == "high"

    def in_bands(self, bands: Bands) -> dict[str, Any]:
        """Return the bands; a simulator is calibrated in its own, the low one."""
        base = self.base
        own = isinstance(base, Calibrated) and base.below is None and not self._above
        if own and bands.cutoff is not None:
            base = base.clone().set_params(below=bands.cutoff)
        return {"bands": bands, "base": base}

    def in_words(self) -> str:
        base, network = self.base.slow_part or self.base.slow_label, words_of(self.cell)
        return self._of_bands(*((network, base) if self._above else (base, network)))

    def _shortest_warmup(self) -> int:
        """Return one sample less than the filter needs, or the down-sampled network."""
        return ((self.bands.downsampling or 2) if self._above else (self.bands.order or 1)) - 1

    def _filters_in_words(self) -> str:
        k = f"a down-sampling by {self.bands.downsampling or 2}"
        return k if self._above else super()._filters_in_words()

    def _remarks(self, record: Record) -> list[str]:
        """Return a remark where the training samples favour a network whose output is zero.

        A high-pass filter does not delay, and there is no such case.
        """
        if self._above:
            return []
        bands = self._bands_for(record, self._settings_for(record))
        assert record.y_sim is not None
        of_filter = record.sampling_rate, *bands.filter
        reachable = oracle(record.y, record.y_sim, *of_filter, record.y_with_gaps)
        if not reachable.nothing_to_learn:
            return []
        advice = "" if self.calibrates else "; calibrating it may change that"
        return [reachable.describe() + advice]

    def _derived_name(self) -> str:
        kind = "filtered-high" if self._above else "filtered"
        return _name(kind, self.base, self.cell, self.conditioned)


@final
class Residual(Network):
    """A hybrid: a base, plus a network that learns its error (Ensinger et al. 2023, Sec. 5.1).

    Parameters
    ----------
    base : A simulator (with parameters to fit, it becomes a `GreyBox`), or a forecaster with a
        `trajectory`, such as `Calibrated()` or `Linear()`, which is fitted first; None for the
        simulator's output in the record.
    cell : That of the network, such as `GRU(64)`: only hidden sizes are used.
    conditioned : Use the base's output, value and slope, as an input of the network. Not in the
        paper.
    settings : Of the training; by default the default recipe for the length of the record.
    name : By default derived from base and cell.

    Raises
    ------
    ValueError
        For a base without a `trajectory`, and something else than a cell.

    Examples
    --------
    >>> time = 0.1 * np.arange(150)
    >>> record = sb.Record(np.sin(time) + 0.2 * np.sin(9 * time), 0.1)
    >>> short = sb.TrainingSettings(window=40, warmup=10, epochs=1)
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
        settings: TrainingSettings | None = None,
        name: str | None = None,
    ) -> None:
        super().__init__(settings, name)
        self.base, self.cell = as_slow_part(base), as_template(cell)
        self.conditioned = conditioned

    def _build(self, record: Record, settings: TrainingSettings) -> Model:
        cell = self._sized(self.cell, record, settings)
        return models.ResidualModel(cell, self.conditioned, record.nu > 0)

    def in_words(self) -> str:
        return f"{self.base.slow_part or self.base.slow_label} + {words_of(self.cell)}"

    def _derived_name(self) -> str:
        return _name("residual", self.base, self.cell, self.conditioned)


def _name(kind: str, base: Forecaster, cell: Template, conditioned: bool) -> str:
    """Return the name of a hybrid; a simulator shows in it by what is calibrated."""
    name = f"{kind}-{base.name}-{label_of(cell)}"
    if isinstance(base, SimulatorForecaster):
        name = f"{kind}-{label_of(cell)}{base.suffix}"
    return name + CONDITIONED * conditioned

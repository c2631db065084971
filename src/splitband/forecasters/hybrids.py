"""Hybrid forecasters: a network beside a simulator, or beside a forecaster that is fitted first."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Self, final

import numpy as np
import numpy.typing as npt

from splitband import models
from splitband.data import Record
from splitband.filters.spectrum import oracle
from splitband.forecasters.bands import OPEN, Bands
from splitband.forecasters.base import Forecaster
from splitband.forecasters.known import Known
from splitband.forecasters.network import Template, as_template, label_of
from splitband.forecasters.simulation import Simulation
from splitband.forecasters.split import Banded, check_warmup
from splitband.forecasters.stepping import Part
from splitband.models import Model
from splitband.models.hybrid import FAST, SLOW
from splitband.simulators import Simulator
from splitband.training import Settings

Array = npt.NDArray[np.float64]


class _Hybrid(Banded):
    """A network beside something that holds the long term."""

    fitted_base: Forecaster | None = None
    """What the base has become by `fit`."""

    def __init__(
        self,
        base: Forecaster | Simulator | None,
        cell: Template,
        bands: Bands,
        calibrated: bool,
        conditioned: bool,
        settings: Settings | None,
        name: str | None,
    ) -> None:
        super().__init__(bands, conditioned, settings, name)
        self.cell = as_template(cell)
        if not isinstance(base, Forecaster):
            base = Simulation(base, calibrated)
        elif calibrated:
            raise ValueError(
                f"calibrated is for a simulator, got {base.name}; Simulation(..., calibrated=True) "
                "is one that is calibrated"
            )
        if not callable(getattr(base, "trajectory", None)):
            raise ValueError(
                f"base must say something about the whole record, as a simulator, Linear, Periodic "
                f"and Harmonic do, got {base.name}"
            )
        self.base = base
        self._calibrated = False  # as an option; from here on the base says it

    @property
    def calibrated(self) -> bool:
        """Whether the base is a simulator that is calibrated."""
        return isinstance(self.base, Simulation) and self.base.calibrated is not False

    @property
    def needs(self) -> frozenset[str]:
        """What the base needs."""
        return self.base.needs

    @property
    def anchored(self) -> bool:
        """Whether the base is."""
        return self.base.anchored

    @property
    def shares_bands(self) -> bool:
        """See `Forecaster`: beside the simulator that a record brings, or where the base does."""
        beside_simulator = "simulator" in self.base.needs
        return (super().shares_bands and beside_simulator) or self.base.shares_bands

    def check(self, *records: Record) -> None:
        """See `Forecaster`."""
        super().check(*records)
        self.base.check(*records)
        if len(records) > 1 and self.base.anchored:
            raise ValueError(
                f"{self.name} cannot be fitted to several records: its base, {self.base.name}, "
                "depends on the time since the first one began"
            )

    def prepare(self, record: Record) -> None:
        """See `Forecaster`."""
        self.base.prepare(record)

    def simulated(self, record: Record, horizon: int, *others: Record) -> Self:
        """See `Forecaster`."""
        return self.clone().set_params(base=self.base.simulated(record, horizon, *others))

    def doubts(self, known: Known) -> list[str]:
        """See `Forecaster`: those of the base."""
        return self._fitted_base().doubts(known)

    def describe(self) -> str:
        """See `Forecaster`."""
        base = self._fitted_base()
        if not isinstance(base, Simulation):
            said = f"{base.name}: {base.describe()}"
        else:
            said = f"simulator: {base.calibration}" if base.calibrated else ""
        return "; ".join(filter(None, [said, super().describe()]))

    def with_defaults(self, settings: Settings, bands: Bands) -> Self:
        """See `Forecaster`."""
        # The usual bands are for the simulator whose output the record brings. Up to which
        # frequency another base is right is only known once it is fitted; they are chosen then.
        usual = bands if "simulator" in self.base.needs else Bands()
        new = super().with_defaults(settings, usual).clone()
        return new.set_params(base=self.base.with_defaults(settings, bands))

    def for_samples(self, samples: int, instead_of: int) -> Self:
        """See `Forecaster`."""
        new = super().for_samples(samples, instead_of).clone()
        return new.set_params(base=self.base.for_samples(samples, instead_of))

    def extrapolate(self, known: Known) -> dict[str, Array]:
        """See `Forecaster`."""
        return self._labelled(super().extrapolate(known))

    def unfiltered(self, steps: int, history: Record) -> dict[str, Array]:
        """See `Network`."""
        return self._labelled(super().unfiltered(steps, history))

    def _labelled(self, parts: dict[str, Array]) -> dict[str, Array]:
        """The model's components; the slow one is labelled by the base, if that is no simulator."""
        if isinstance(self.base, Simulation):
            return parts
        # A base may be named as the fast component is, and two labels must not be the same.
        slow = self.base.name if self.base.name != FAST else "base"
        return {label.replace(SLOW, slow, 1) if label.startswith(SLOW) else label: part
                for label, part in parts.items()}  # fmt: skip

    def _seen(self, records: Sequence[Record], seed: int) -> list[Record]:
        """The records with the slow part as their simulator's output."""
        base = self.fitted_base = self.base.clone().fit(*records, seed=seed)
        if isinstance(base, Simulation):
            return [base.on(record) for record in records]
        seen = []
        for i, record in enumerate(records):
            begin = None if i else 0.0
            known = Known(record.seen, 0, begin, record.u, record.y_sim, record.grid)
            seen.append(replace(record, y_sim=self._slow(known), beyond=None))
        return seen

    def _slow(self, known: Known) -> Array:
        base: Any = self._fitted_base()  # the constructor has checked that it has a `trajectory`
        return base.trajectory(known)

    def _slow_part(self) -> Part:
        return self._fitted_base().part()

    def _fitted_base(self) -> Forecaster:
        self.require_fitted()
        assert self.fitted_base is not None
        return self.fitted_base

    def _parts_of_name(self, kind: str) -> str:
        slow = "" if isinstance(self.base, Simulation) else f"-{self.base.name}"
        suffix = self.base.suffix if isinstance(self.base, Simulation) else ""
        return (
            f"{kind}{slow}-{label_of(self.cell)}{suffix}"
            f"{'-conditioned' if self.conditioned else ''}"
        )


@final
class Filtered(_Hybrid):
    """Something slow in the low band, a network in the high band (paper, Sec. 4.3).

    Parameters
    ----------
    base : What holds the low band: a simulator, or a forecaster that is fitted first, such as
        `Linear()`; by default the simulator's output that a record brings.
    cell : The network's.
    bands : Where they part; by default chosen by where base and training samples agree.
    calibrated : Calibrate the simulator to the training samples first. Not in the paper.
    conditioned : Tell the network what the base says, value and slope. Not in the paper.
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

    def __init__(
        self,
        base: Forecaster | Simulator | None,
        cell: Template,
        bands: Bands = OPEN,
        calibrated: bool = False,
        conditioned: bool = False,
        settings: Settings | None = None,
        name: str | None = None,
    ) -> None:
        super().__init__(base, cell, bands, calibrated, conditioned, settings, name)

    def check(self, *records: Record) -> None:
        """See `Forecaster`."""
        super().check(*records)
        check_warmup(self._settings_for(records[0]), (self.bands.order or 1) - 1, self.bands)

    def build(self, record: Record, settings: Settings) -> Model:
        """See `Network`."""
        bands = self._bands_for(record, settings)
        cell = self.cell.sized(record.ny, self._fast_network_inputs(record), settings.warmup)
        pair = bands.one_way_pair(record.sampling_rate)
        return models.Filtered(cell, pair, self.conditioned, record.nu > 0)

    def _low_band(self, record: Record) -> Array | None:
        return record.y_sim

    def _remarks(self, record: Record) -> list[str]:
        """See `Network`: whether the training samples reward a network that adds nothing."""
        bands = self._bands_for(record, self._settings_for(record))
        assert bands.cutoff is not None
        assert bands.order is not None
        assert record.y_sim is not None
        reachable = oracle(record.y, record.y_sim, record.sampling_rate, bands.cutoff, bands.order,
                       record.seen)  # fmt: skip
        if not reachable.nothing_to_learn:
            return []
        advice = "" if self.calibrated else "; calibrating it may change that"
        return [reachable.describe() + advice]

    def _derived_name(self) -> str:
        return self._parts_of_name("filtered")


@final
class Residual(_Hybrid):
    """A network for what something slower leaves (paper, Sec. 5.1).

    Parameters
    ----------
    base : What is added to: see `Filtered`.
    cell, calibrated, conditioned, settings, name : See `Filtered`.

    Examples
    --------
    >>> time = 0.1 * np.arange(150)
    >>> record = sb.Record(np.sin(time) + 0.2 * np.sin(9 * time), 0.1)
    >>> short = sb.Settings(window=40, warmup=10, epochs=1)
    >>> model = sb.Residual(sb.Function(np.sin), sb.GRU(4), settings=short)
    >>> model.fit(record[:120], seed=0).predict(30).y.shape
    (30, 1)
    """

    def __init__(
        self,
        base: Forecaster | Simulator | None,
        cell: Template,
        calibrated: bool = False,
        conditioned: bool = False,
        settings: Settings | None = None,
        name: str | None = None,
    ) -> None:
        # A residual model has no filter. These bands are not used; they are given so that none are
        # chosen.
        super().__init__(base, cell, Bands(1.0, 1, 1), calibrated, conditioned, settings, name)

    def build(self, record: Record, settings: Settings) -> Model:
        """See `Network`."""
        cell = self.cell.sized(record.ny, self._fast_network_inputs(record), settings.warmup)
        return models.Residual(cell, self.conditioned, record.nu > 0)

    def _derived_name(self) -> str:
        return self._parts_of_name("residual")

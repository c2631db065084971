"""Networks as forecasters: a single one, or one for each band.

What is trained is a model of `splitband.models`; a forecaster adds how it is trained and which
bands it has. A network beside a simulator or another forecaster is in `forecasters.hybrids`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Protocol, Self, final, runtime_checkable

import numpy as np
import numpy.typing as npt
import torch

from splitband import models
from splitband.data import Trajectory
from splitband.data.gaps import first_after, last_before
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster, total
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.known import Known
from splitband.models import Model
from splitband.networks import Cell
from splitband.runtime.threads import drawn_from
from splitband.training import Checkpoint, Progress, Settings, fit
from splitband.training.recipes import recipe_settings
from splitband.training.windows import windows_in

Array = npt.NDArray[np.float64]


@runtime_checkable
class Template(Protocol):
    """A cell, or something else, that cells of the right sizes are made after."""

    def sized(self, ny: int, nu: int, warmup: int) -> Cell:
        """A new cell, its weights drawn by torch's generator.

        `ny` and `nu` are its channels and inputs, `warmup` is the number of measured samples that
        set its initial state.
        """


class Network(Forecaster):
    """A forecaster that is trained by gradients.

    Parameters
    ----------
    settings : How; by default the default recipe for the length of the record.
    name : By default what it is made of.
    """

    cells: ClassVar[tuple[str, ...]] = ("cell",)
    """Attributes that hold the templates of its cells."""

    def __init__(self, settings: Settings | None = None, name: str | None = None) -> None:
        self.settings = settings
        self.free = False
        """Whether its settings are but defaults, so that a comparison may find better ones."""
        self.resizable = False
        """Whether the sizes of its cells are, too."""
        self.device = torch.device("cpu")
        self.model: Model | None = None
        self._name = name

    @property
    def name(self) -> str:
        """See `Forecaster`."""
        return self._name or self._derived_name()

    @property
    def random(self) -> bool:
        """See `Forecaster`."""
        return True

    @property
    def warmup(self) -> int:
        """See `Forecaster`; 0 where it is not decided before `fit`."""
        return 0 if self.settings is None else self.settings.warmup

    @abstractmethod
    def _derived_name(self) -> str:
        """What it is made of, in a word."""

    @abstractmethod
    def build(self, record: Trajectory, settings: Settings) -> Model:
        """The untrained model for a training record, its weights drawn by torch's generator."""

    def to(self, device: str | torch.device) -> Self:
        """Train and run on this device from now on."""
        self.device = torch.device(device)
        if self.model is not None:
            self.model.to(self.device)
        return self

    def with_defaults(self, settings: Settings, bands: Bands) -> Self:
        """See `Forecaster`."""
        if self.settings is not None:
            return self
        new = self.copy()
        new.settings, new.free = settings, True
        return new

    def trained_as(self, settings: Settings, size: float = 1.0) -> Self:
        """With other settings, and cells `size` times as large."""
        new = self.copy()
        new.settings = settings
        for attribute in self.cells:
            cell = getattr(self, attribute)
            if size != 1 and hasattr(cell, "scaled"):
                setattr(new, attribute, cell.scaled(size))
        return new

    def called(self, name: str) -> Self:
        """Under another name."""
        new = self.copy()
        new._name = name
        return new

    def training_in_words(self) -> str:
        """Sizes, window and steps, for tables."""
        sizes = [getattr(getattr(self, cell), "hidden_size", None) for cell in self.cells]
        said = [f"{' and '.join(map(str, sizes))} hidden units"] if None not in sizes else []
        if self.settings is not None:
            said += [f"windows of {self.settings.window}", self.settings.steps_in_words()]
        return ", ".join(said)

    def weights(self, record: Trajectory) -> int:
        """How many weights are trained, for such a record."""
        model = self._built(record, self._settings_for(record), seed=0)
        return sum(weight.numel() for weight in model.parameters())

    def for_fewer_samples(self, share: float) -> Self:
        """See `Forecaster`: windows shrink with the record, but for the warm-up."""
        if self.settings is None:
            return self
        window, warmup = self.settings.window, self.settings.warmup
        shorter = min(max(round(window * (1 - share)), warmup + 1), window)
        new = self.copy()
        new.settings = replace(self.settings, window=shorter)
        return new

    def check(self, *records: Trajectory) -> None:
        """See `Forecaster`."""
        super().check(*records)
        first, settings = records[0], self._settings_for(records[0])
        complete = first.complete
        if not complete.all() and first_after(complete, settings.warmup) is None:
            raise ValueError(
                f"warmup must fit between the gaps of the {len(first)} training samples, "
                f"got {settings.warmup}"
            )
        if settings.window > len(first):
            raise ValueError(
                f"window must fit into the {len(first)} training samples, got {settings.window}"
            )
        for other in records[1:]:
            check_alike(other, first)
        windows_in(records, settings.window, settings.warmup)
        self._built(first, settings, seed=0)

    def learn(
        self,
        records: Sequence[Trajectory],
        *,
        seed: int,
        horizon: int,
        progress: Callable[[Progress], None] | None,
        checkpoint: Checkpoint | None,
    ) -> None:
        """See `Forecaster`."""
        settings = self.settings = self._settings_for(records[0])
        seen = self._seen(records, seed, horizon)
        self._decide(seen[0], settings)
        self.model = self._built(seen[0], settings, seed).to(self.device)
        history = fit(self.model, seen, settings, seed, progress, checkpoint)
        notes = (*self._remarks(seen[0]), *history.notes)
        report = FitReport(seed, history.seconds, history.losses, notes)
        self.fitted = replace(self.require_fitted(), report=report)

    def extrapolate(self, known: Known) -> dict[str, Array]:
        """See `Forecaster`: a free run from the last `warmup` samples without a gap."""
        parts = self._trained().simulate_components(*self._warm(known))
        since = len(known.y) - self._start(known)
        return {name: part[since:] for name, part in parts.items()}

    def unfiltered(self, steps: int, history: Trajectory) -> dict[str, Array]:
        """What the model's filters are fed with, by name; empty for a model without filters."""
        known, _ = self._known(steps, history, None, None)
        parts = self._trained().simulate_unfiltered(*self._warm(known))
        since = len(known.y) - self._start(known)
        return {name: part[since:] for name, part in parts.items()}

    def describe(self) -> str:
        """See `Forecaster`."""
        training = [self.training_in_words()] if self.free else []
        return "; ".join([*training, *self.require_fitted().report.notes])

    def trajectory(self, known: Known) -> Array:
        """Over the history, too, `(time + steps, ny)`: a free run from its first warm-up on.

        With it a network can hold the slow part of another one. Before the run begins it is what
        was measured.
        """
        complete = np.asarray(~np.isnan(known.y).any(axis=1))
        start = first_after(complete, self.warmup)
        if start is None or not complete[:start].all():
            raise ValueError(
                f"history must begin with {self.warmup} measured samples for {self.name}"
            )
        steps = len(known.y) + known.steps - start
        begun = Known(known.y[:start], steps, known.begin, known.u, known.y_sim)
        return np.concatenate([known.y[:start], total([*self.extrapolate(begun).values()])])

    def _seen(self, records: Sequence[Trajectory], seed: int, horizon: int) -> list[Trajectory]:
        """The records as the model learns from them."""
        return [*records]

    def _decide(self, record: Trajectory, settings: Settings) -> None:
        """Choose what has been left open, by the record as the model sees it."""

    def _remarks(self, record: Trajectory) -> list[str]:
        """What a user should know of a training record as the model sees it."""
        return []

    def _slow(self, known: Known) -> Array | None:
        """What the model is given beside the measured samples, `(time + steps, ny)`."""
        return None

    def _built(self, record: Trajectory, settings: Settings, seed: int) -> Model:
        """The untrained model, its parameters drawn from `seed`."""
        with drawn_from(seed):
            return self.build(record, settings)

    def _settings_for(self, record: Trajectory) -> Settings:
        return self.settings or recipe_settings("default", record)

    def _trained(self) -> Model:
        self.require_fitted()
        assert self.model is not None
        return self.model

    def _start(self, known: Known) -> int:
        """Where the free run starts: after the last warm-up without a gap."""
        complete = np.asarray(~np.isnan(known.y).any(axis=1))
        start = last_before(complete, self.warmup, len(known.y))
        if start is None:
            raise ValueError(
                f"history must have {self.warmup} measured samples in a row to warm up on, got "
                f"{len(known.y)} samples, of which {int(complete.sum())} were measured in whole"
            )
        return start

    def _warm(self, known: Known) -> tuple[Array, int, Array | None, Array | None]:
        """What `Model.simulate` takes: warm-up, steps, inputs and the slow part."""
        start = self._start(known)
        begin = start - self.warmup
        u, slow = (None if s is None else s[begin:] for s in (known.u, self._slow(known)))
        return known.y[begin:start], len(known.y) + known.steps - start, u, slow


@final
class Single(Network):
    """One network on the whole band: the baseline (paper, Sec. 4.1).

    Parameters
    ----------
    cell : Such as `GRU(64)`; of its sizes the hidden ones count, the others are the record's.
    settings : How it is trained; by default the default recipe for the length of the record.
    name : By default what it is made of.

    Examples
    --------
    >>> record = sb.Trajectory(np.sin(0.3 * np.arange(120)), 0.1)
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

    def build(self, record: Trajectory, settings: Settings) -> Model:
        """See `Network`."""
        cell = self.cell.sized(record.ny, 2 * record.nu, settings.warmup)
        return models.Recurrent(cell, record.nu > 0)

    def _derived_name(self) -> str:
        return label_of(self.cell)


class Banded(Network):
    """A network that has but one of two bands, or is told about the other one."""

    def __init__(
        self, bands: Bands | None, conditioned: bool, settings: Settings | None, name: str | None
    ) -> None:
        super().__init__(settings, name)
        self.bands, self.conditioned = bands or Bands(), conditioned

    def with_defaults(self, settings: Settings, bands: Bands) -> Self:
        """See `Forecaster`."""
        new = super().with_defaults(settings, bands)
        if not self.bands.complete:
            new = new.copy()
            given = {k: v for k, v in vars(self.bands).items() if v is not None}
            new.bands = replace(bands, **given)
        return new

    def _decide(self, record: Trajectory, settings: Settings) -> None:
        self.bands = self._bands_for(record, settings)

    def _bands_for(self, record: Trajectory, settings: Settings) -> Bands:
        """The bands; what has been left open of them is chosen by the training record."""
        if self.bands.complete:
            return self.bands
        y_sim = self._low_band(record)
        return self.bands.chosen(record.y, record.sampling_rate, settings.warmup, y_sim)

    def _low_band(self, record: Trajectory) -> Array | None:
        """What is to hold the low band of a record, `(time, ny)`; None where a network is."""
        return None

    def _told(self, record: Trajectory) -> int:
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
    >>> record = sb.Trajectory(np.sin(time) + 0.2 * np.sin(9 * time), 0.1)
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
        bands: Bands | None = None,
        filter_output: bool = False,
        conditioned: bool = False,
        settings: Settings | None = None,
        name: str | None = None,
    ) -> None:
        super().__init__(bands, conditioned, settings, name)
        self.low, self.high = as_template(low), as_template(high)
        self.filter_output = filter_output

    def check(self, *records: Trajectory) -> None:
        """See `Forecaster`."""
        super().check(*records)
        check_warmup(self._settings_for(records[0]), 3 * ((self.bands.order or 1) + 1), self.bands)

    def build(self, record: Trajectory, settings: Settings) -> Model:
        """See `Network`."""
        bands = self._bands_for(record, settings)
        assert bands.downsampling is not None
        # With k = 1 the slow network sees every sample as well, and each input twice.
        nu = record.nu * (2 if bands.downsampling == 1 else 1)
        low = self.low.sized(record.ny, nu, settings.warmup)
        high = self.high.sized(record.ny, self._told(record), settings.warmup)
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


def as_template(cell: Any) -> Template:
    """Check that cells can be made after it; raises TypeError otherwise."""
    if not isinstance(cell, Template):
        raise TypeError(
            f"a cell must have a method sized(ny, nu, warmup) that makes one of these sizes, got "
            f"{type(cell).__name__}"
        )
    return cell


def label_of(template: Template) -> str:
    """What names and tables call a cell: its `label`, or its class."""
    return str(getattr(template, "label", type(template).__name__.lower()))


def check_warmup(settings: Settings, shortest: int, bands: Bands) -> None:
    """Raise ValueError for a warm-up of `shortest` samples or fewer: the filters need more."""
    if settings.warmup <= shortest:
        raise ValueError(
            f"warmup must have more than {shortest} samples for filters of order "
            f"{bands.order or 1}, got {settings.warmup}"
        )


def check_alike(other: Trajectory, record: Trajectory) -> None:
    """Check that another record can be of the same system; raises ValueError otherwise."""
    if (other.ny, other.nu) != (record.ny, record.nu):
        raise ValueError(
            f"{other.name} must have the record's {record.ny} channel(s) and {record.nu} "
            f"input(s), got {other.ny} and {other.nu}"
        )
    if abs(other.sampling_time - record.sampling_time) > 0.01 * record.sampling_time:
        raise ValueError(
            f"{other.name} must be sampled like the record, every {record.sampling_time:g} s, "
            f"got every {other.sampling_time:g} s"
        )

"""What all networks share as forecasters: how they are trained, and run freely.

What is trained is a model of `splitband.models`; a forecaster adds how it is trained and which
bands it has. One network is in `forecasters.single`, one for each band in `forecasters.split`, one
beside a simulator or another forecaster in `forecasters.hybrids`.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Protocol, Self, runtime_checkable

import numpy as np
import numpy.typing as npt
import torch

from splitband.baselines.delays import delayed
from splitband.baselines.linear import input_delays
from splitband.data import Record
from splitband.data.gaps import first_after, last_before
from splitband.forecasters.bands import Bands
from splitband.forecasters.base import Forecaster, total
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.known import Known
from splitband.forecasters.remembering import Remembered
from splitband.forecasters.stepping import NotSteppedError, Part, Recursion, Warmed
from splitband.models import Model
from splitband.networks import Cell
from splitband.runtime.threads import drawn_from
from splitband.training import Checkpoint, Progress, Settings, fit
from splitband.training.recipes import recipe_settings
from splitband.training.settings import SHORTEST_WINDOW, longest_window
from splitband.training.windows import windows_in

Array = npt.NDArray[np.float64]

DELAYS = Remembered(input_delays)
"""Many trainings ask for the delays of the same records."""


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
    model: Model | None = None
    """What has been trained."""
    trained_by: Settings | None = None
    """How: the settings, or what has been chosen where they were left open."""

    def __init__(self, settings: Settings | None = None, name: str | None = None) -> None:
        self.settings = settings
        self.tunable = False
        """Whether its settings are but defaults, so that a comparison may find better ones."""
        self.resizable = False
        """Whether the sizes of its cells are, too."""
        self.device = torch.device("cpu")
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
        settings = self.trained_by or self.settings
        return 0 if settings is None else settings.warmup

    @abstractmethod
    def _derived_name(self) -> str:
        """What it is made of, in a word."""

    @abstractmethod
    def build(self, record: Record, settings: Settings) -> Model:
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
        new = self.clone().set_params(settings=settings)
        new.tunable = True
        return new

    def trained_as(self, settings: Settings, size: float = 1.0) -> Self:
        """With other settings, and cells `size` times as large."""
        changed: dict[str, Any] = {"settings": settings}
        for name in self.cells if size != 1 else ():
            cell = getattr(self, name)
            if hasattr(cell, "scaled"):
                changed[name] = cell.scaled(size)
        return self.clone().set_params(**changed)

    def called(self, name: str) -> Self:
        """Under another name."""
        return self.clone().set_params(name=name)

    def training_in_words(self) -> str:
        """Sizes, window and steps, for tables."""
        sizes = [getattr(getattr(self, cell), "hidden_size", None) for cell in self.cells]
        said = [f"{' and '.join(map(str, sizes))} hidden units"] if None not in sizes else []
        settings = self.trained_by or self.settings
        if settings is not None:
            said += [f"windows of {settings.window}", settings.steps_in_words()]
        return ", ".join(said)

    def weights(self, record: Record) -> int:
        """How many weights are trained, for such a record."""
        model = self._built(record, self._settings_for(record), seed=0)
        return sum(weight.numel() for weight in model.parameters())

    def for_samples(self, samples: int, instead_of: int) -> Self:
        """See `Forecaster`: long windows shrink with the record."""
        if self.settings is None:
            return self
        window = self.settings.window
        least = max(min(SHORTEST_WINDOW, longest_window(samples)), self.settings.warmup + 1)
        shorter = max(round(window * samples / instead_of), least)
        return self.clone().set_params(settings=replace(self.settings, window=min(window, shorter)))

    def check(self, *records: Record) -> None:
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
        windows_in(records, settings.window, settings.warmup)
        self.clone()._built(first, settings, seed=0)

    def learn(
        self,
        records: Sequence[Record],
        *,
        seed: int,
        progress: Callable[[Progress], None] | None,
        checkpoint: Checkpoint | None,
    ) -> None:
        """See `Forecaster`."""
        settings = self.trained_by = self._settings_for(records[0])
        seen = self._inputs_shifted(records, self._seen(records, seed))
        self._decide(seen[0], settings)
        self.model = self._built(seen[0], settings, seed).to(self.device)
        history = fit(self.model, seen, settings, seed, progress, checkpoint)
        notes = (*self._remarks(seen[0]), *history.notes)
        report = FitReport(seed, history.seconds, history.losses, notes, history.cut)
        self.fitted = replace(self.require_fitted(), report=report)

    def extrapolate(self, known: Known) -> dict[str, Array]:
        """See `Forecaster`: a free run from the last `warmup` samples without a gap."""
        parts = self._trained().simulate_components(*self._warm(known))
        since = len(known.y) - self._start(known)
        return {name: part[since:] for name, part in parts.items()}

    def stepped(self) -> Recursion:
        """See `Forecaster`."""
        try:
            model = self._trained().stepped()
        except ValueError as error:
            raise NotSteppedError(f"{self.name} cannot be stepped: {error}") from None
        return Warmed(model, self._slow_part(), self.warmup, self.delays)

    def unfiltered(self, steps: int, history: Record) -> dict[str, Array]:
        """What the model's filters are fed with, by name; empty for a model without filters."""
        known, _ = self._known(steps, history, None, None)
        parts = self._trained().simulate_unfiltered(*self._warm(known))
        since = len(known.y) - self._start(known)
        return {name: part[since:] for name, part in parts.items()}

    def describe(self) -> str:
        """See `Forecaster`."""
        fitted = self.require_fitted()
        said = [self.training_in_words() if self.tunable else "", fitted.late_inputs(self.delays)]
        return "; ".join(filter(None, [*said, *fitted.report.notes]))

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
        begun = replace(known, y=known.y[:start], steps=steps)
        return np.concatenate([known.y[:start], total([*self.extrapolate(begun).values()])])

    def _made(self, params: dict[str, Any]) -> Self:
        """See `Forecaster`; where it runs and what a comparison may change are no options."""
        new = super()._made(params)
        new.device, new.tunable, new.resizable = self.device, self.tunable, self.resizable
        return new

    def _inputs_shifted(self, records: Sequence[Record], seen: Sequence[Record]) -> list[Record]:
        """The records as the model sees them, with inputs that act at once."""
        self.delays = ()
        if records[0].u is not None:
            self.delays = DELAYS(*(x for r in records for x in (r.seen, r.u)))
        return [
            each if each.u is None else replace(each, u=delayed(each.u, self.delays))
            for each in seen
        ]

    def _seen(self, records: Sequence[Record], seed: int) -> list[Record]:
        """The records as the model learns from them."""
        return [*records]

    def _decide(self, record: Record, settings: Settings) -> None:
        """Choose what has been left open, by the record as the model sees it."""

    def _remarks(self, record: Record) -> list[str]:
        """What a user should know of a training record as the model sees it."""
        return []

    def _slow(self, known: Known) -> Array | None:
        """What the model is given beside the measured samples, `(time + steps, ny)`."""
        return None

    def _slow_part(self) -> Part | None:
        """What that is sample by sample; None without any."""
        return None

    def _built(self, record: Record, settings: Settings, seed: int) -> Model:
        """The untrained model, its parameters drawn from `seed`."""
        with drawn_from(seed):
            return self.build(record, settings)

    def _settings_for(self, record: Record) -> Settings:
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
        u = None if known.u is None else delayed(known.u, self.delays)
        slow = self._slow(replace(known, since=begin))
        u, slow = (None if s is None else s[begin:] for s in (u, slow))
        return known.y[begin:start], len(known.y) + known.steps - start, u, slow


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

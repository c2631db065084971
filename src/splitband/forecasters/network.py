"""Train networks as forecasters, and simulate with them.

A forecaster holds a model of `splitband.models`, the settings of its training, its bands, and the
base that it is combined with. Networks alone are in `forecasters.learned`, hybrids with a simulator
or another forecaster in `forecasters.hybrids`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Self, Unpack

import numpy as np

from splitband import models, training
from splitband.baselines.delays import delayed, input_delays
from splitband.data import Record
from splitband.data.gaps import first_after
from splitband.forecasters.bands import OPEN, Bands
from splitband.forecasters.base import Forecaster, Training
from splitband.forecasters.caching import Cached
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.free_run import FreeRun
from splitband.forecasters.initialisation import begin_as_linear
from splitband.forecasters.known import Known
from splitband.forecasters.predicting import known_of
from splitband.forecasters.prehistory import Prehistory
from splitband.forecasters.stepping import Recursion
from splitband.runtime.arrays import Array
from splitband.runtime.threads import seeded
from splitband.simulators.calibration import Calibration
from splitband.training import Settings
from splitband.training.places import checked_starts
from splitband.training.recipes import recipe_settings
from splitband.training.settings import SHORTEST_WINDOW, longest_window

if TYPE_CHECKING:
    import torch
    from torch import nn

    from splitband.models import Model

DELAYS = Cached(input_delays)
"""Cache of input delays: many trainings need those of the same records."""
CONDITIONED = "-conditioned"
"""Suffix of the names of conditioned models."""


class Network(Forecaster):
    """Train a forecaster by gradients.

    A subclass defines its options, its model (`build`) and its name (`_derived_name`). Attributes
    that it does not set keep these defaults: no base, no bands, not conditioned.

    Parameters
    ----------
    settings : Of the training; by default the default recipe for the length of the record.
    name : By default derived from its parts.
    """

    cells: ClassVar[tuple[str, ...]] = ("cell",)
    base: Forecaster | None = None
    """The forecaster of the slow component, in a hybrid."""
    bands: Bands | None = None
    """The frequency bands, where it filters."""
    conditioned: bool = False
    """Whether the slow component is an input of the fast network."""
    model: Model | None = None
    """The trained model."""
    trained_by: Settings | None = None
    """The settings of the training, given or chosen."""
    trained_in: Bands | None = None
    """The bands of the training, given or chosen."""
    fitted_base: Forecaster | None = None
    """The fitted base."""
    prehistory: Prehistory | None = None
    """The distribution of warm-ups, for histories that are shorter than one."""

    def __init__(self, settings: Settings | None = None, name: str | None = None) -> None:
        self.settings = settings
        self.device: str | torch.device = "cpu"
        self._name = name

    @property
    def name(self) -> str:
        """Return the given name, or one derived from its parts."""
        return self._name or self._derived_name()

    random = True

    @property
    def network(self) -> Network:
        """Return itself."""
        return self

    @property
    def warmup(self) -> int:
        """Return the samples of its warm-up; 0 where `fit` has yet to choose the settings."""
        settings = self.trained_by or self.settings
        return 0 if settings is None else settings.warmup

    @property
    def calibration(self) -> Calibration | None:
        """Return the calibration of the base."""
        return None if self.fitted_base is None else self.fitted_base.calibration

    @property
    def parameters(self) -> dict[str, Any]:
        """Return the fitted parameters of the base."""
        return {} if self.fitted_base is None else self.fitted_base.parameters

    @property
    def shares_bands(self) -> bool:
        """Return whether it, or its base, takes the bands that a comparison chooses.

        A comparison chooses bands for networks alone and for the simulator output of the record.
        Another base shows only after its fit up to which frequency it is accurate; the bands are
        chosen then.
        """
        return self._takes_bands or super().shares_bands

    @property
    def _takes_bands(self) -> bool:
        return self.bands == OPEN and (self.base is None or "simulator" in self.base.needs)

    slow_part = "network"

    @property
    def conditioned_in_words(self) -> str:
        """Return the words on conditioning, which end `in_words`."""
        seen = ", with the slower part's output as an input"
        return seen if self.conditioned else ""

    @abstractmethod
    def _derived_name(self) -> str:
        """Return the name that is derived from its parts."""

    @abstractmethod
    def build(self, record: Record, settings: Settings) -> Model:
        """Return the untrained model for a record, with weights drawn from torch's generator."""

    def to(self, device: str | torch.device) -> Self:
        """Train and run on this device from now on."""
        import torch  # noqa: PLC0415  whoever names a device needs it

        self.device = torch.device(device)
        if self.model is not None:
            self.model.to(self.device)
        if self.fitted_base is not None:
            self.fitted_base.to(device)
        return super().to(device)

    def with_defaults(self, settings: Settings, bands: Bands) -> Self:
        """Return it with a comparison's settings and bands, where its own are not set."""
        new = super().with_defaults(settings, bands)
        shared: dict[str, Any] = {} if self.settings is not None else {"settings": settings}
        # Bands that are given in part are completed later, to suit the given cut-off or order.
        if self._takes_bands:
            shared["bands"] = bands
        return new.clone().set_params(**shared) if shared else new

    def trained_as(self, settings: Settings) -> Self:
        """Return a copy with other settings."""
        return self.clone().set_params(settings=settings)

    def untrained(self) -> Forecaster:
        """Return it not trained, with the settings and bands of its training."""
        chosen = {"settings": self.trained_by or self.settings}
        return self.clone().set_params(
            **chosen, **({} if self.trained_in is None else {"bands": self.trained_in})
        )

    def training_in_words(self) -> str:
        """Return sizes, window and steps, for tables."""
        sizes = [describe() for cell in self.cells
                 if (describe := getattr(getattr(self, cell), "size_in_words", None))]  # fmt: skip
        said = [" and ".join(sizes)] if sizes else []
        settings = self.trained_by or self.settings
        if settings is not None:
            said += [f"windows of {settings.window}", settings.steps_in_words()]
        return ", ".join(said)

    def state(self) -> dict[str, torch.Tensor]:
        """Return the state dict of the trained model, on the CPU."""
        return {name: x.detach().cpu().clone() for name, x in self._trained().state_dict().items()}

    def weights(self, record: Record) -> int:
        """Return the number of trained weights, for such a record."""
        model = self._built(record, self._settings_for(record), seed=0)
        return sum(weight.numel() for weight in model.parameters())

    def to_dict(self) -> dict[str, Any]:
        """Return what is saved: the model as its weights; `device` is omitted."""
        said = super().to_dict()
        del said["device"]  # that of the training may not exist where it is loaded
        model = said.pop("model", None)
        return said | {"weights": None if model is None else dict(model.state_dict())}

    @classmethod
    def from_dict(cls, found: dict[str, Any]) -> Self:
        """Return the saved forecaster; raises ValueError for weights that do not fit its model."""
        weights = found.pop("weights")
        found["device"] = "cpu"
        new = super().from_dict(found)
        if new.fitted is not None:
            record, settings = new.fitted.record, new.trained_by
            assert settings is not None
            new.model = models.with_weights(lambda: new._built(record, settings, seed=0), weights)
            if new.prehistory is not None:
                new.prehistory.check(new.model, settings.warmup)
        return new

    def first_needed(self) -> int:
        """Return the first sample of the training record that a forecast from its end needs.

        With a network as base the whole record is needed, since the base's run starts there.
        """
        beside_network = self.fitted_base is not None and self.fitted_base.random
        return 0 if beside_network else super().first_needed()

    def for_samples(self, samples: int, instead_of: int) -> Self:
        """Return it adapted to a part of the training record: long windows shrink with it."""
        new = super().for_samples(samples, instead_of)
        if self.settings is None:
            return new
        window = self.settings.window
        # A shrunken window stays as long as the default recipe's shortest, and beyond the warm-up.
        least = max(min(SHORTEST_WINDOW, longest_window(samples)), self.settings.warmup + 1)
        shorter = max(round(window * samples / instead_of), least)
        settings = replace(self.settings, window=min(window, shorter))
        return new.clone().set_params(settings=settings)

    def check(self, *records: Record) -> None:
        """Raise ValueError for records that do not fit its warm-up, windows, filters or base."""
        super().check(*records)
        if len(records) > 1 and self.base is not None and self.base.anchored:
            raise ValueError(
                f"{self.name} cannot be fitted to several records: its base, {self.base.name}, "
                "depends on the time since the first one began"
            )
        first, settings = records[0], self._settings_for(records[0], records[1:])
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
        checked_starts(records, settings.window, settings.warmup)
        # Cells that are given by name are built when they are trained, as torch loads slowly.
        if not any(hasattr(getattr(self, name), "build") for name in self.cells):
            self.clone()._built(first, settings, seed=0)
        if settings.warmup <= (shortest := self._shortest_warmup()):
            raise ValueError(
                f"warmup must have more than {shortest} samples for filters of order "
                f"{(self.bands and self.bands.order) or 1}, got {settings.warmup}; a record too "
                "short for that is one for methods without filters"
            )

    def learn(self, records: Sequence[Record], **how: Unpack[Training]) -> None:
        """Fit the base, choose settings and bands that are not given, and train the model."""
        seed, start = how["seed"], self._start(how["start"])
        settings = self._settings_for(records[0], records[1:])
        self.trained_by = settings if start is None else settings.after(start.trained_by)
        seen = self._seen(records, seed, start)
        if self.bands is not None:
            self.trained_in = (
                self._bands_for(seen[0], settings) if start is None else start.trained_in
            )
        self.model = self._built(seen[0], settings, seed)
        if start is not None:
            try:
                self.model.load_state_dict(start.state())
            except RuntimeError:
                raise ValueError(
                    f"start must have the sizes and channels of {self.name}: "
                    f"{self.training_in_words()}, got {start.training_in_words()}"
                ) from None
            self.model.units_kept = True
        elif settings.linear_start:
            begin_as_linear(self.model, seen, settings.normalize, seed)
        self.model.to(self.device)
        history = training.fit(self.model, seen, settings, seed, how["progress"], how["checkpoint"])
        notes = (*self._remarks(seen[0]), *history.notes)
        networks: Iterable[Any] = self.model.modules()
        stable = all(each.stable() for each in networks if hasattr(each, "stable"))
        # The error that is assumed of simulations when a short history is completed.
        error = math.hypot(*(losses[-1] for losses in history.losses.values() if losses))
        self.prehistory = Prehistory.of(self.model, seen, settings.warmup, error)
        cut = history.cut or (
            self.fitted_base is not None and self.fitted_base.require_fitted().report.cut
        )
        report = FitReport(seed, history.seconds, history.losses, notes, cut, stable)
        self.fitted = replace(self.require_fitted(), report=report)

    def extrapolate(self, known: Known) -> dict[str, Array]:
        """Return a free run from the last `warmup` samples without a gap, by component."""
        return self._free_run().components(known)

    def trajectory(self, known: Known) -> Array:
        """Return a free run from the first warm-up of the history on, `(time + steps, ny)`."""
        return self._free_run().trajectory(known)

    def unfiltered(self, steps: int, history: Record) -> dict[str, Array]:
        """Return the signals before the model's filters by name; empty for one without filters."""
        return self._free_run().unfiltered(known_of(self, steps, history, None, None)[0])

    def stepped(self, outside: bool = False) -> Recursion:
        """Return the step-by-step form of its model, warmed up."""
        return self._free_run().stepped(outside)

    def differentiable(self, known: Known) -> nn.Module:
        """Return its model, warmed up."""
        return self._free_run().differentiable(known)

    def doubts(self, known: Known) -> list[str]:
        """Return the doubts of the base, and one for a history shorter than the warm-up."""
        return self._free_run().doubts(known)

    def describe(self) -> str:
        """Return the results of the base's fit, the training settings, and remarks."""
        fitted, base = self.require_fitted(), self.fitted_base
        said = []
        if base is not None and base.as_base.described:
            said = [f"{base.as_base.label}: {base.describe()}"]
        said += [self.training_in_words(), fitted.late_inputs(self.delays)]
        return "; ".join(filter(None, [*said, *fitted.report.notes]))

    def _made(self, params: dict[str, Any]) -> Self:
        """Return one with other options, on the same device."""
        new = super()._made(params)
        new.device = self.device
        return new

    def _start(self, start: Forecaster | None) -> Self | None:
        """Return the trained forecaster to go on from; raises ValueError for another kind."""
        if start is None:
            return None
        if not isinstance(start, type(self)) or start.model is None:
            raise ValueError(f"start must be a trained {self.name}, got {start!r}")
        return start

    def _seen(self, records: Sequence[Record], seed: int, start: Self | None) -> list[Record]:
        """Return the records that the model is trained on.

        Their `y_sim` is the output of the base, and their inputs are shifted by the delays.
        """
        seen = [*records]
        if self.base is not None:
            same = start is not None and repr(start.base) == repr(self.base)
            base = start._base_for(records) if start is not None and same else None
            if base is None:
                base = self.base.clone().fit(*records, seed=seed).as_simulator()
            self.fitted_base = base
            seen = [base.on(record, first=i == 0) for i, record in enumerate(records)]
        self.delays = ()
        if records[0].u is not None:
            found = DELAYS([(r.seen, r.u) for r in records]) if start is None else start.delays
            self.delays = found
        return [r if r.u is None else replace(r, u=delayed(r.u, self.delays)) for r in seen]

    def _base_for(self, records: Sequence[Record]) -> Forecaster | None:
        """Return its base where that was fitted to the same samples, which saves another fit."""
        fitted = self.require_fitted()
        before = [fitted.record, *fitted.others]
        same = len(before) == len(records) and all(
            old.grid == new.grid and all(map(_equal, _signals(old), _signals(new)))
            for old, new in zip(before, records, strict=True)
        )
        return self.fitted_base if same else None

    def _remarks(self, record: Record) -> list[str]:
        """Return remarks for the user on a training record with the base's output."""
        return []

    def _shortest_warmup(self) -> int:
        """Return the number of samples that a warm-up must exceed for the filters."""
        return 0

    def _bands_for(self, record: Record, settings: Settings) -> Bands:
        """Return the bands; those that are not given are chosen on the training record."""
        assert self.bands is not None
        if self.trained_in is not None:
            return self.trained_in
        if self.bands.complete:
            return self.bands
        slow = None if self.base is None else record.y_sim
        return self.bands.chosen(record.y, record.sampling_rate, settings.warmup, slow)

    def _fast_network_inputs(self, record: Record) -> int:
        """Return the number of inputs of the network that runs at every sample.

        They are the record's inputs at this sample and the next and, if it is conditioned, value
        and slope of the slow component.
        """
        return 2 * record.nu + (2 * record.ny if self.conditioned else 0)

    def _built(self, record: Record, settings: Settings, seed: int) -> Model:
        """Return the untrained model, its parameters drawn from `seed`."""
        with seeded(seed):
            return self.build(record, settings)

    def _settings_for(self, record: Record, others: Sequence[Record] = ()) -> Settings:
        return self.settings or recipe_settings("default", record, others)

    def _trained(self) -> Model:
        self.require_fitted()
        assert self.model is not None
        return self.model

    def _free_run(self) -> FreeRun:
        """Return the trained model, ready to simulate."""
        return FreeRun(
            self.name,
            self._trained(),
            self.warmup,
            self.delays,
            self.fitted_base,
            self.prehistory,
        )


def _signals(record: Record) -> tuple[Array | None, ...]:
    """Return what a base is fitted to: outputs, inputs and the simulator's output."""
    return record.seen, record.u, record.y_sim


def _equal(one: Array | None, other: Array | None) -> bool:
    if one is None or other is None:
        return one is other
    return np.array_equal(one, other, equal_nan=True)

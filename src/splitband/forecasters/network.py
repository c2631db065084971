"""Train networks as forecasters, and run them freely.

What is trained is a model of `splitband.models`; a forecaster adds how it is trained, which bands
it has and beside what it stands. Networks alone are in `forecasters.learned`, those beside a
simulator or another forecaster in `forecasters.hybrids`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, ClassVar, Self, Unpack

import torch
from torch import nn

from splitband.baselines.delays import delayed
from splitband.baselines.linear import input_delays
from splitband.data import Record
from splitband.data.gaps import first_after
from splitband.forecasters.asking import known_of
from splitband.forecasters.bands import OPEN, Bands
from splitband.forecasters.base import Forecaster, Training
from splitband.forecasters.beginning import Earlier
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.free_run import FreeRun
from splitband.forecasters.known import Known
from splitband.forecasters.prehistory import Prehistory
from splitband.forecasters.remembering import Remembered
from splitband.forecasters.stepping import Recursion
from splitband.models import Model
from splitband.models.base import with_weights
from splitband.runtime.arrays import Array
from splitband.runtime.threads import drawn_from
from splitband.simulators.calibration import Calibration
from splitband.training import Settings, fit
from splitband.training.recipes import recipe_settings
from splitband.training.settings import SHORTEST_WINDOW, longest_window
from splitband.training.windows import windows_in

DELAYS = Remembered(input_delays)
"""Many trainings ask for the delays of the same records."""
CONDITIONED = "-conditioned"
"""What it adds to a name that the fast network is told what is slower."""


class Network(Forecaster):
    """Train a forecaster by gradients.

    A kind of network says which options it has, what its model is (`build`) and what it is called
    (`_derived_name`). Attributes that it does not set keep these defaults: no base, no bands, not
    conditioned.

    Parameters
    ----------
    settings : How; by default the default recipe for the length of the record.
    name : By default what it is made of.
    """

    cells: ClassVar[tuple[str, ...]] = ("cell",)
    base: Forecaster | None = None
    """What holds the slow part, where the network stands beside something."""
    bands: Bands | None = None
    """Which band is whose, where it filters."""
    conditioned: bool = False
    """Whether the fast network is told what the slower part says."""
    earlier: Earlier = Earlier()
    """Trainings that `fit` goes on from; they are not saved."""
    model: Model | None = None
    """What has been trained."""
    trained_by: Settings | None = None
    """How: the settings, or what has been chosen where they were left open."""
    trained_in: Bands | None = None
    """The bands, or what has been chosen where they were left open."""
    fitted_base: Forecaster | None = None
    """What the base has become by `fit`."""
    prehistory: Prehistory | None = None
    """What may come before a history that is shorter than the warm-up."""

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
        """Return the name that it was given, or what it is made of."""
        return self._name or self._derived_name()

    random = True

    @property
    def network(self) -> Network:
        """Return itself."""
        return self

    @property
    def warmup(self) -> int:
        """Return the samples of its warm-up; 0 where that is not decided before `fit`."""
        settings = self.trained_by or self.settings
        return 0 if settings is None else settings.warmup

    @property
    def calibration(self) -> Calibration | None:
        """Return that of the base."""
        return None if self.fitted_base is None else self.fitted_base.calibration

    @property
    def parameters(self) -> dict[str, Any]:
        """Return those of the base."""
        return {} if self.fitted_base is None else self.fitted_base.parameters

    @property
    def shares_bands(self) -> bool:
        """Return whether its bands are open, or those of the base.

        The usual bands are for the simulator whose output the record brings. Up to which frequency
        another base is right is only known once it is fitted; they are chosen then.
        """
        beside_simulator = self.base is None or "simulator" in self.base.needs
        return (self.bands == OPEN and beside_simulator) or super().shares_bands

    slow_part = "network"

    @property
    def conditioned_in_words(self) -> str:
        """Return the end of `in_words`."""
        seen = ", with the slower part's output as an input"
        return seen if self.conditioned else ""

    @abstractmethod
    def _derived_name(self) -> str:
        """Return what it is made of, in a word."""

    @abstractmethod
    def build(self, record: Record, settings: Settings) -> Model:
        """Return the untrained model for a record, its weights drawn by torch's generator."""

    def to(self, device: str | torch.device) -> Self:
        """Train and run on this device from now on."""
        self.device = torch.device(device)
        if self.model is not None:
            self.model.to(self.device)
        if self.fitted_base is not None:
            self.fitted_base.to(device)
        return super().to(device)

    def with_defaults(self, settings: Settings, bands: Bands) -> Self:
        """Return it with the settings and bands of a comparison, where it leaves them open."""
        new = super().with_defaults(settings, bands)
        shared: dict[str, Any] = {} if self.settings is not None else {"settings": settings}
        # What is left open beside a cut-off or an order that is given has to be chosen to suit it.
        if self.bands == OPEN and (self.base is None or "simulator" in self.base.needs):
            shared["bands"] = bands
        if shared:
            new = new.clone().set_params(**shared)
            new.tunable = new.tunable or self.settings is None
        return new

    def trained_as(self, settings: Settings) -> Self:
        """Return it with other settings."""
        return self.clone().set_params(settings=settings)

    def going_on(self, earlier: Earlier) -> Self:
        """Return it with trainings that `fit` goes on from."""
        new = self.clone()
        new.earlier = earlier
        return new

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
        """Return the state of the fitted model."""
        return {name: x.detach().cpu().clone() for name, x in self._trained().state_dict().items()}

    def weights(self, record: Record) -> int:
        """Return how many weights are trained, for such a record."""
        model = self._built(record, self._settings_for(record), seed=0)
        return sum(weight.numel() for weight in model.parameters())

    def to_dict(self) -> dict[str, Any]:
        """Return all that makes the forecaster; of the model its weights, no earlier training."""
        said = super().to_dict()
        model = said.pop("model", None)
        said.pop("earlier", None)
        return said | {"weights": None if model is None else dict(model.state_dict())}

    @classmethod
    def from_dict(cls, found: dict[str, Any]) -> Self:
        """Return the forecaster again; raises ValueError for weights that its model has not."""
        weights = found.pop("weights")
        new = super().from_dict(found)
        if new.fitted is not None:
            record, settings = new.fitted.record, new.trained_by
            assert settings is not None
            new.model = with_weights(lambda: new._built(record, settings, seed=0), weights)
            if new.prehistory is not None:
                new.prehistory.check(new.model, settings.warmup)
        return new

    def first_needed(self) -> int:
        """Return 0 beside a network, which runs freely from the beginning of the record on."""
        beside_network = self.fitted_base is not None and self.fitted_base.random
        return 0 if beside_network else super().first_needed()

    def for_samples(self, samples: int, instead_of: int) -> Self:
        """Return it for a part of the training record: long windows shrink with the record."""
        new = super().for_samples(samples, instead_of)
        if self.settings is None:
            return new
        window = self.settings.window
        least = max(min(SHORTEST_WINDOW, longest_window(samples)), self.settings.warmup + 1)
        shorter = max(round(window * samples / instead_of), least)
        settings = replace(self.settings, window=min(window, shorter))
        return new.clone().set_params(settings=settings)

    def check(self, *records: Record) -> None:
        """Raise ValueError for records that its warm-up, windows, filters or base do not fit."""
        super().check(*records)
        if len(records) > 1 and self.base is not None and self.base.anchored:
            raise ValueError(
                f"{self.name} cannot be fitted to several records: its base, {self.base.name}, "
                "depends on the time since the first one began"
            )
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
        if settings.warmup <= (shortest := self._shortest_warmup()):
            raise ValueError(
                f"warmup must have more than {shortest} samples for filters of order "
                f"{(self.bands and self.bands.order) or 1}, got {settings.warmup}; a record too "
                "short for that is one for methods without filters"
            )

    def learn(self, records: Sequence[Record], **how: Unpack[Training]) -> None:
        """Fit the base, choose what has been left open, and train the model."""
        seed = how["seed"]
        settings = self.trained_by = self._settings_for(records[0])
        seen = self._seen(records, seed)
        if self.bands is not None:
            self.trained_in = self._bands_for(seen[0], settings)
        self.model = self._built(seen[0], settings, seed)
        self.earlier.begin(self.model, seen, settings, seed)
        self.model.to(self.device)
        left = self.earlier.remaining(settings, seed)
        history = fit(self.model, seen, left, seed, how["progress"], how["checkpoint"])
        notes = (*self._remarks(seen[0]), *history.notes)
        networks: Iterable[Any] = self.model.modules()
        stable = all(each.stable() for each in networks if hasattr(each, "stable"))
        error = math.hypot(*(losses[-1] for losses in history.losses.values() if losses))
        self.prehistory = Prehistory.of(self.model, seen, settings.warmup, error)
        report = FitReport(seed, history.seconds, history.losses, notes, history.cut, stable)
        self.fitted = replace(self.require_fitted(), report=report)

    def extrapolate(self, known: Known) -> dict[str, Array]:
        """Return a free run from the last `warmup` samples without a gap, part by part."""
        return self._free_run().components(known)

    def trajectory(self, known: Known) -> Array:
        """Return a free run from the history's first warm-up on, `(time + steps, ny)`."""
        return self._free_run().trajectory(known)

    def unfiltered(self, steps: int, history: Record) -> dict[str, Array]:
        """Return what the model's filters are fed with; empty for a model without filters."""
        return self._free_run().unfiltered(known_of(self, steps, history, None, None)[0])

    def stepped(self, outside: bool = False) -> Recursion:
        """Return the recursion of its model, warmed up."""
        return self._free_run().stepped(outside)

    def differentiable(self, known: Known) -> nn.Module:
        """Return its model, warmed up."""
        return self._free_run().differentiable(known)

    def doubts(self, known: Known) -> list[str]:
        """Return those of the base, and whether the history is short."""
        return self._free_run().doubts(known)

    def describe(self) -> str:
        """Return what the base and the training have settled on."""
        fitted, base = self.require_fitted(), self.fitted_base
        said = []
        if base is not None and base.as_base.described:
            said = [f"{base.as_base.label}: {base.describe()}"]
        said += [self.training_in_words() if self.tunable else "", fitted.late_inputs(self.delays)]
        return "; ".join(filter(None, [*said, *fitted.report.notes]))

    def _made(self, params: dict[str, Any]) -> Self:
        """Return one with other options; where it runs and what may be tuned are none of them."""
        new = super()._made(params)
        kept = ("device", "tunable", "resizable", "earlier")
        vars(new).update({name: vars(self)[name] for name in kept if name in vars(self)})
        return new

    def _seen(self, records: Sequence[Record], seed: int) -> list[Record]:
        """Return the records as the model learns from them.

        The slow part is their `y_sim`, and inputs act at once.
        """
        seen = [*records]
        if self.base is not None:
            base = self.fitted_base = self.base.clone().fit(*records, seed=seed)
            seen = [base.on(record, first=i == 0) for i, record in enumerate(records)]
        self.delays = ()
        if records[0].u is not None:
            self.delays = DELAYS([(r.seen, r.u) for r in records])
        return [r if r.u is None else replace(r, u=delayed(r.u, self.delays)) for r in seen]

    def _remarks(self, record: Record) -> list[str]:
        """Return what a user should know of a training record as the model sees it."""
        return []

    def _shortest_warmup(self) -> int:
        """Return the samples that the filters are longer than."""
        return 0

    def _bands_for(self, record: Record, settings: Settings) -> Bands:
        """Return the bands; what has been left open is chosen by the training record."""
        assert self.bands is not None
        if self.trained_in is not None:
            return self.trained_in
        if self.bands.complete:
            return self.bands
        slow = None if self.base is None else record.y_sim
        return self.bands.chosen(record.y, record.sampling_rate, settings.warmup, slow)

    def _fast_network_inputs(self, record: Record) -> int:
        """Return the inputs of the network that sees every sample.

        They are the record's, of this sample and of the next one, and value and slope of what is
        slower.
        """
        return 2 * record.nu + (2 * record.ny if self.conditioned else 0)

    def _built(self, record: Record, settings: Settings, seed: int) -> Model:
        """Return the untrained model, its parameters drawn from `seed`."""
        with drawn_from(seed):
            return self.build(record, settings)

    def _settings_for(self, record: Record) -> Settings:
        return self.settings or recipe_settings("default", record)

    def _trained(self) -> Model:
        self.require_fitted()
        assert self.model is not None
        return self.model

    def _free_run(self) -> FreeRun:
        """Return what has been trained, ready to be asked."""
        asked = self.name, self._trained(), self.warmup, self.delays
        return FreeRun(*asked, self.fitted_base, self.prehistory)

"""Train networks as forecasters, and simulate with them.

A forecaster holds a model of `splitband.models`, the settings of its training, its bands, and the
base that it is combined with. Networks alone, and hybrids with a simulator or
another forecaster, are in `forecasters.hybrid`.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from copy import copy, deepcopy
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Self, Unpack

import numpy as np

from splitband import models, training
from splitband.filters import Band
from splitband.forecasters.bands import OPEN, Bands
from splitband.forecasters.base import (
    Forecaster,
    Training,
    cells_of,
    fitted_like,
    with_parts_changed,
)
from splitband.forecasters.fitted import FitReport
from splitband.forecasters.held_out import first_held_out
from splitband.forecasters.initialisation import LinearPart, begin_as_linear, reach_of
from splitband.forecasters.network_steps import NetworkSteps
from splitband.forecasters.prediction import ForecastContext, known_of, total
from splitband.forecasters.prehistory import Prehistory
from splitband.forecasters.saving import state_of
from splitband.forecasters.steps import NotSteppedError, Steps
from splitband.linear.delays import delayed, input_delays
from splitband.models.labels import NETWORK, SIMULATOR
from splitband.networks.cell import Cell, Template, WithSize
from splitband.records import Record, check_alike
from splitband.records.signals import covered, first_after, last_before, refilled
from splitband.runtime.arguments import check_device
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.optional import has_torch, require_torch
from splitband.runtime.states import Arrays
from splitband.runtime.threads import one_thread, seeded
from splitband.simulators.calibration import Calibration
from splitband.training import TrainingSettings
from splitband.training.settings import (
    SHORTEST_WINDOW,
    checked_starts,
    longest_window,
    recipe_settings,
    within_reach,
)

if TYPE_CHECKING:
    import torch

    from splitband.models import Model

MOST_FILLED = 1000
"""Most samples of a history that are filled with a network's own predictions. Bounds the time."""
CONDITIONED = "-conditioned"
"""Suffix of the names of conditioned models."""


class Network(Forecaster):
    """A forecaster that is trained by gradients.

    A subclass defines its options, its model (`build`) and its name (`_derived_name`). Attributes
    that it does not set keep these defaults: no base, no bands, not conditioned.

    Parameters
    ----------
    settings : Of the training; by default the default recipe for the length of the record.
    name : By default derived from its parts.
    """

    base: Forecaster | None = None
    """The forecaster of the slow component, in a hybrid."""
    bands: Bands | None = None
    """The frequency bands, where it filters."""
    conditioned: bool = False
    """Whether one component is an input of the network of the other."""
    simulator_band: Band = "low"
    """The band of the base, in a hybrid with filters."""
    model: Model | None = None
    """The trained model."""
    _trained_by: TrainingSettings | None = None
    """The settings of the training, given or chosen."""
    _trained_in: Bands | None = None
    """The bands of the training, given or chosen."""
    _fitted_base: Forecaster | None = None
    """The fitted base."""
    _slow: Array | None = None
    """Its output over a whole record, see `run_over`."""
    _prehistory: Prehistory | None = None
    """The distribution of warm-ups, for histories that are shorter than one."""
    _weights: Arrays
    """The weights of the model, while it is loaded."""
    state_types: ClassVar[Mapping[str, Any]] = {
        "_weights": dict[str, np.ndarray],
        "_trained_by": TrainingSettings,
        "_trained_in": Bands,
        "_prehistory": Prehistory,
        "_fitted_base": "base",
    }

    def __init__(self, settings: TrainingSettings | None = None, name: str | None = None) -> None:
        self.settings = settings
        self._device: str | torch.device = "cpu"
        self._name = name

    @property
    def name(self) -> str:
        return self._name or self._derived_name()

    random = True
    forgets = True

    @property
    def warmup(self) -> int:
        """Return the samples of its warm-up; 0 where `fit` has yet to choose the settings."""
        settings = self._trained_by or self.settings
        return 0 if settings is None else settings.warmup

    @property
    def calibration(self) -> Calibration | None:
        return None if self._fitted_base is None else self._fitted_base.calibration

    @property
    def parameters(self) -> dict[str, Any]:
        return {} if self._fitted_base is None else self._fitted_base.parameters

    @property
    def takes_bands(self) -> bool:
        """Return whether it takes the bands that a comparison chooses.

        A comparison chooses bands for networks alone and for the simulator output of the record.
        Another base shows only after its fit up to which frequency it is accurate; the bands are
        chosen then.
        """
        return self.bands == OPEN and (self.base is None or "simulator" in self.base.needs)

    slow_part = "network"

    def in_bands(self, bands: Bands) -> dict[str, Any]:
        """Return the options that a comparison's bands decide."""
        return {"bands": bands}

    def _of_bands(self, low: str, high: str) -> str:
        """Return which part has which band, with the cut-off where it is known."""
        bands = self._trained_in or self.bands
        if bands is None or bands.cutoff is None:
            return f"{low} in the low band, {high} in the high band"
        return f"{low} below {bands.cutoff:.3g} Hz, {high} above"

    @abstractmethod
    def _derived_name(self) -> str:
        """Return the name that is derived from its parts."""

    @abstractmethod
    def _build(self, record: Record, settings: TrainingSettings) -> Model:
        """Return the untrained model for a record, with weights drawn from torch's generator."""

    def to(self, device: str | torch.device) -> Self:
        check_device(device)
        if not has_torch():
            return super().to(device)
        import torch  # noqa: PLC0415  whoever names a device needs it

        self._device = torch.device(device)
        if self.model is not None:
            self.model.to(self._device)
        if self._fitted_base is not None:
            self._fitted_base.to(device)
        return super().to(device)

    def __getstate__(self) -> dict[str, Any]:
        """Return the state for another process, which cannot pass on tensors of a GPU."""
        state, model = {**vars(self)}, self.model
        if model is not None and str(self._device) != "cpu":
            state["model"] = deepcopy(model).to("cpu")
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        if self.model is not None:
            self.model.to(self._device)

    def trained_as(self, settings: TrainingSettings | None) -> Self:
        """Return a copy with other settings."""
        return self.clone().set_params(settings=settings)

    def for_trial(self, samples: int) -> Self:
        """Return it adapted to `samples` without their held-out part.

        Long windows shrink with the part that is left, but stay as long as the default recipe's
        shortest one, and beyond the warm-up.
        """
        new, settings, fewer = super().for_trial(samples), self.settings, first_held_out(samples)
        if settings is None:
            return new
        least = max(min(SHORTEST_WINDOW, longest_window(fewer)), settings.warmup + 1)
        shorter = max(round(settings.window * fewer / samples), least)
        return new.trained_as(replace(settings, window=min(settings.window, shorter)))

    def untrained(self) -> Forecaster:
        new = self.trained_as(self._trained_by or self.settings)
        return new if self._trained_in is None else new.set_params(bands=self._trained_in)

    def training_in_words(self) -> str:
        cells = cells_of(self).values()
        sizes = [cell.size_in_words() for cell in cells if isinstance(cell, WithSize)]
        said = [" and ".join(sizes)] if sizes else []
        settings = self._trained_by or self.settings
        if settings is not None:
            said += [f"windows of {settings.window}", settings.steps_in_words()]
        return ", ".join(said)

    def state(self) -> Arrays:
        """Return its arrays: the model as its weights; the device is omitted."""
        # That of the training may not exist where it is loaded.
        weights = self._trained().state_dict().items()
        arrays = {f"_weights.{name}": each.detach().cpu().numpy() for name, each in weights}
        return state_of(self, "model", "_device") | arrays

    def complete(self) -> None:
        super().complete()
        record, settings, weights = self.require_fitted().record, self._trained_by, self._weights
        if settings is None or (self.base is None) != (self._fitted_base is None):
            raise InputError(f"{self.name} must have the settings of its training, and its base")
        del self._weights
        self.model = models.with_weights(lambda: self._built(record, settings, seed=0), weights)
        self.model.eval()
        if self._prehistory is not None:
            self._prehistory.check(self.model, settings.warmup)

    def first_needed(self) -> int:
        """Return the first sample of the training record that a forecast from its end needs.

        With a network as base the whole record is needed, since the base's run starts there.
        """
        beside_network = self._fitted_base is not None and self._fitted_base.random
        return 0 if beside_network else super().first_needed()

    def check(self, *records: Record) -> None:
        """Raise ValueError for records that do not fit its warm-up, windows, filters or base.

        Without torch, raise it for any.
        """
        require_torch()
        super().check(*records)
        if len(records) > 1 and self.base is not None and self.base.anchored:
            raise InputError(
                f"{self.name} cannot be fitted to several records: its base, {self.base.name}, "
                "depends on the time since the first one began"
            )
        first, settings = records[0], self._settings_for(records[0], records[1:])
        known = first.y_with_gaps
        if first.measured is not None and first_after(known, settings.warmup) is None:
            raise InputError(
                f"warmup must fit between the gaps of the {len(first)} training samples, "
                f"got {settings.warmup}"
            )
        checked_starts(records, settings.window, settings.warmup)
        # Cells that are given by name are built when they are trained, as torch loads slowly.
        if all(isinstance(cell, Cell) for cell in cells_of(self).values()):
            self.clone()._built(first, settings, seed=0)
        if settings.warmup <= (shortest := self._shortest_warmup()):
            raise InputError(
                f"warmup must have more than {shortest} samples for {self._filters_in_words()}, "
                f"got {settings.warmup}; a record too short for that is one for methods without "
                "filters"
            )

    def learn(self, records: Sequence[Record], **how: Unpack[Training]) -> None:
        seed, start = how["seed"], self._start(how["start"], records[0])
        settings = self._settings_for(records[0], records[1:])
        self._trained_by = settings if start is None else settings.after(start._trained_by)
        seen = self._seen(records, start, how)
        if self.bands is not None:
            self._trained_in = (
                self._bands_for(seen[0], settings) if start is None else start._trained_in
            )
        self.model = self._built(seen[0], settings, seed)
        if start is not None:
            try:
                self.model.load_state_dict(start._trained().state_dict())
            except RuntimeError:
                raise InputError(
                    f"start must have the sizes and channels of {self.name}: "
                    f"{self.training_in_words()}, got {start.training_in_words()}"
                ) from None
            self.model.units_kept = True
        elif settings.linear_start:
            begin_as_linear(self.model, seen, settings.normalize, seed)
        self.model.to(self._device)
        history = training.fit(self.model, seen, settings, seed, how["progress"])
        self.model.eval()
        notes = (*self._remarks(seen[0]), *history.notes)
        linear = (each for each in self.model.modules() if isinstance(each, LinearPart))
        growth = max([1.0, *(each.growth() for each in linear)])
        # The error that is assumed of simulations when a short history is completed.
        error = math.hypot(*(losses[-1] for losses in history.losses.values() if losses))
        self._prehistory = Prehistory.of(self.model, seen, settings.warmup, error)
        cut = history.cut or (
            self._fitted_base is not None and self._fitted_base.require_fitted().report.cut
        )
        report = FitReport(seed, history.seconds, history.losses, notes, cut, growth)
        self.fitted = replace(self.require_fitted(), report=report)

    def extrapolate(self, known: ForecastContext) -> dict[str, Array]:
        """Return the forecast after a history by component, `(steps, ny)` each.

        It warms up on the last `warmup` samples. In a channel that was not measured they are its
        own predictions; where the history is shorter, the samples before it are estimated.
        """
        return self._run(self._trained().simulate_components, known)

    def unfiltered(self, **known: Any) -> dict[str, Array]:
        """Return the signals before the model's filters by name; empty for one without filters."""
        if self.bands is None:
            return {}
        return self._run(self._trained().simulate_unfiltered, known_of(self, **known))

    def trajectory(self, known: ForecastContext) -> Array:
        """Return a free run from the first warm-up of the history on, `(time + steps, ny)`.

        The samples before the run are the measured ones.
        """
        start = len(known.y) if self._short(known) else first_after(known.y, self.warmup)
        if start is None or not covered(known.y)[:start].all():
            raise InputError(
                f"history must begin with {self.warmup} measured samples for {self.name}"
            )
        steps = len(known.y) + known.steps - start
        begun = replace(known, y=known.y[:start], steps=steps)
        return np.concatenate(
            [refilled(begun.y, begun.y), total([*self.extrapolate(begun).values()])]
        )

    def doubts(self, known: ForecastContext) -> list[str]:
        """Return the doubts of the base, and one for a history shorter than the warm-up."""
        base = self._fitted_base
        doubts = [] if self._slow is not None or base is None else base.doubts(known)
        begin = 0 if self._short(known) else self._span(known.y)[0]
        y = known.y[begin:]
        seen = (np.isfinite(y).any(axis=1) | covered(y)).sum()
        if seen < self.warmup:
            short = (
                f"the history has {seen} of the {self.warmup} samples of a warm-up: the missing "
                "history is estimated"
            )
            doubts = [*dict.fromkeys([*doubts, short])]
        return doubts

    def step_form(self) -> Steps:
        try:
            model = self._trained().stepped()
        except ValueError as error:
            raise NotSteppedError(f"{self.name} cannot be stepped: {error}") from None
        base = self._fitted_base
        if base is not None and base.random:
            raise NotSteppedError(f"{self.name} cannot be stepped: its base is a network")
        return NetworkSteps(self, model, None if base is None else base.step_form_as_base())

    def describe(self) -> str:
        fitted, base = self.require_fitted(), self._fitted_base
        said = []
        if base is not None and (base.slow_label != SIMULATOR or base.calibrates):
            said = [f"{base.slow_label}: {base.describe()}"]
        said += [self.training_in_words(), fitted.late_inputs(self.delays)]
        return "; ".join(filter(None, [*said, *fitted.report.notes]))

    def with_options(self, params: dict[str, Any]) -> Self:
        new = super().with_options(params)
        new._device = self._device
        return new

    def _start(self, start: Forecaster | None, record: Record) -> Self | None:
        """Return the trained forecaster to go on from; raises ValueError for another kind."""
        if start is None:
            return None
        if not isinstance(start, type(self)) or start.model is None:
            raise InputError(f"start must be a trained {self.name}, got {start!r}")
        check_alike(start.require_fitted().record, record, "start")
        return start

    def _seen(self, records: Sequence[Record], start: Self | None, how: Training) -> list[Record]:
        """Return the records for the model: with the base's output, and with delayed inputs."""
        seen = [*records]
        if self.base is not None:
            fitted = [*how["bases"], *([] if start is None else start.fitted_bases)]
            base = fitted_like(self.base, records, fitted)
            if base is None:
                base = self.base.clone()._fit(records, how["seed"], bases=fitted)
            self._fitted_base = base = base.as_base()
            seen = [base.on(record, first=i == 0) for i, record in enumerate(records)]
        self.delays = ()
        if records[0].u is not None:
            driven = [(r.y_with_gaps, r.u) for r in records if r.u is not None]
            with one_thread():
                self.delays = input_delays(driven) if start is None else start.delays
        return [r if r.u is None else replace(r, u=delayed(r.u, self.delays)) for r in seen]

    def run_over(self, known: ForecastContext) -> Network:
        """Return it with its base run once, from a state that the history alone tells."""
        new, since = copy(self), 0 if self._short(known) else self._span(known.y)[0]
        new._slow = self._base_output(replace(known, since=since))
        return new

    def _base_output(self, known: ForecastContext) -> Array | None:
        """Return the base's output over history and forecast; None without a base."""
        if self._slow is not None:
            return self._slow[: len(known.y) + known.steps]
        return None if self._fitted_base is None else self._fitted_base.trajectory(known)

    @property
    def fitted_bases(self) -> list[Forecaster]:
        base = self._fitted_base
        return [] if base is None else [base, *base.fitted_bases]

    def _remarks(self, record: Record) -> list[str]:
        """Return remarks for the user on a training record with the base's output."""
        return []

    def _shortest_warmup(self) -> int:
        """Return the number of samples that a warm-up must exceed for the filters."""
        return 0

    def _filters_in_words(self) -> str:
        """Return what needs these samples."""
        return f"filters of order {(self.bands and self.bands.order) or 1}"

    def _bands_for(self, record: Record, settings: TrainingSettings) -> Bands:
        """Return the bands; those that are not given are chosen on the training record."""
        assert self.bands is not None
        if self._trained_in is not None:
            return self._trained_in
        if None not in (self.bands.cutoff, self.bands.order, self.bands.downsampling):
            return self.bands
        slow = None if self.base is None else record.y_sim
        return self.bands.chosen(
            record.y, record.sampling_rate, settings.warmup, slow, self.simulator_band
        )

    def _sized(self, cell: Template, record: Record, settings: TrainingSettings) -> Cell:
        """Return the cell of the network that runs at every sample.

        Its inputs are the record's at this sample and the next and, if it is conditioned, value and
        slope of the slow component.
        """
        nu = 2 * record.nu + (2 * record.ny if self.conditioned else 0)
        return cell.sized(record.ny, nu, settings.warmup)

    def _built(self, record: Record, settings: TrainingSettings, seed: int) -> Model:
        """Return the untrained model, its parameters drawn from `seed`."""
        with seeded(seed):
            return self._build(record, settings)

    def _settings_for(self, record: Record, others: Sequence[Record] = ()) -> TrainingSettings:
        if self.settings is not None:
            return self.settings
        return within_reach(recipe_settings("default", record, others), reach_of(record, others))

    def _trained(self) -> Model:
        self.require_fitted()
        assert self.model is not None
        return self.model

    def _short(self, known: ForecastContext) -> bool:
        """Return whether the history is shorter than the warm-up and can be completed."""
        short = 0 < len(known.y) < self.warmup
        return short and self._prehistory is not None and not np.isnan(known.y).any()

    def _run(
        self, simulate: Callable[..., dict[str, Array]], known: ForecastContext
    ) -> dict[str, Array]:
        """Return what a simulation gives after the history; the base labels its component."""
        y, u, slow, since = self.warmed_up(known)
        found = {}
        for part, values in simulate(y, since + known.steps, u, slow).items():
            label = part
            if self._fitted_base is not None and part.startswith(SIMULATOR):
                # The base may have the label of the fast component; labels must differ.
                slow_label = self._fitted_base.slow_label
                label = "base" if slow_label == NETWORK else slow_label
                label += part.removeprefix(SIMULATOR)
            found[label] = values[since:]
        return found

    def warmed_up(
        self, known: ForecastContext, more: int = 0
    ) -> tuple[Array, Array | None, Array | None, int]:
        """Return the warm-up that ends with the last measured sample, and how many follow it.

        A channel that was not measured has the model's own prediction, from a warm-up on in which
        all were measured; where there is none nearby, that one is interpolated. Inputs and the
        base's output are those from the first sample of the warm-up on, to the last one of the
        forecast and, of a base, `more` where they are known.
        """
        y, u = known.y, None if known.u is None else delayed(known.u, self.delays)
        length, samples = self.warmup, len(known.y)
        if known.y_sim is not None and len(known.y_sim) <= samples:
            more = 0
        whole = replace(known, steps=known.steps + more)
        if self._short(known):
            assert self._prehistory is not None
            slow = self._base_output(whole)
            return *self._prehistory.completed(self._trained(), y, u, slow), 0
        begin, start, last = self._span(y)
        slow = self._base_output(replace(whole, since=begin))
        slow = None if slow is None else slow[begin:]
        u = None if u is None else u[begin : samples + known.steps]
        y = y[begin:last].copy()
        if np.isnan(y[:length]).any():
            mean = np.tile(self._trained().y_mean.cpu().numpy(), (len(y), 1))
            y[:length] = refilled(mean, y)[:length]
        self._fill(y, u, slow)
        moved = last - start
        u, slow = (None if x is None else x[moved:] for x in (u, slow))
        return y[moved:], u, slow, samples - last

    def _span(self, y: Array) -> tuple[int, int, int]:
        """Return where a warm-up begins, and where the filled samples after it begin and end."""
        length, measured = self.warmup, np.asarray(np.isfinite(y))
        seen, complete = (np.asarray(f(measured, axis=1)) for f in (np.any, np.all))
        last = len(y) - int(seen[::-1].argmax()) if seen.any() else 0
        if last < length:
            raise InputError(
                f"history must have {length} samples for {self.name} to warm up on, up to the last "
                f"one that was measured, got {last}"
            )
        start = last_before(y, length, last)
        if start is None or (~complete[start:last]).sum() > MOST_FILLED:
            start = max(length, last - MOST_FILLED)
        return start - length, start, last

    def _fill(self, y: Array, u: Array | None, slow: Array | None) -> None:
        """Fill the gaps after a warm-up with the model's own predictions, in place."""
        n, length = self.warmup, self.warmup
        missing = np.isnan(y)
        while n < len(y):
            stop = n
            while stop < len(y) and missing[stop].all():
                stop += 1
            stop = min(stop + 1, len(y))  # the first measured sample may lack a channel
            if missing[n:stop].any():
                begun = [None if x is None else x[n - length : stop] for x in (u, slow)]
                found = self._trained().simulate_components(y[n - length : n], stop - n, *begun)
                y[n:stop] = np.where(missing[n:stop], total([*found.values()]), y[n:stop])
            n = stop


def with_defaults(
    forecaster: Forecaster,
    settings: TrainingSettings,
    bands: Bands,
    given: Bands = OPEN,
    high: Bands = OPEN,
) -> Forecaster:
    """Return a forecaster with a comparison's settings and bands, where its own are not set.

    `high` are the bands of hybrids with the simulator in the high band. What is `given` of the
    bands also holds for a hybrid whose fit chooses the rest.
    """

    def changed(part: Forecaster) -> Forecaster:
        if not isinstance(part, Network):
            return part
        shared: dict[str, Any] = {} if part.settings is not None else {"settings": settings}
        # Bands that are given in part are completed later, to suit the given cut-off or order.
        if part.bands == OPEN:
            of_band = high if part.simulator_band == "high" else bands
            shared |= part.in_bands(of_band if part.takes_bands else given)
        return part.clone().set_params(**shared) if shared else part

    return with_parts_changed(forecaster, changed)

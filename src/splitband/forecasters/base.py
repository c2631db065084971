"""Define the interface of all forecasters: fitted to a record, they forecast what follows."""

from __future__ import annotations

import contextlib
import time
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypedDict, TypeVar, Unpack, final

import numpy as np
import numpy.typing as npt

from splitband.forecasters.fitted import Fitted
from splitband.forecasters.held_out import held_out_of
from splitband.forecasters.intervals import HeldOut
from splitband.forecasters.prediction import (
    ForecastContext,
    Prediction,
    by_name,
    known_of,
    predicted,
)
from splitband.forecasters.saving import attributes_of, listed, save, state_of
from splitband.forecasters.steps import NotSteppedError, Steps
from splitband.forecasters.stream import Stream, stream_of
from splitband.linear.delays import check_delays
from splitband.metrics import ExtrapolationWarning
from splitband.networks.cell import Template
from splitband.records import Record, check_alike, require_records
from splitband.records.signals import last_before
from splitband.runtime.arguments import check_device, whole
from splitband.runtime.arrays import Array, check_shape
from splitband.runtime.errors import InputError
from splitband.runtime.options import UNKNOWN, WithRepr, options
from splitband.runtime.states import Arrays
from splitband.runtime.threads import one_thread
from splitband.simulators.base import KnownSimulator
from splitband.simulators.calibration import Calibration
from splitband.training import Progress, TrainingSettings

if TYPE_CHECKING:
    import torch


AnyForecaster = TypeVar("AnyForecaster", bound="Forecaster")


class Training(TypedDict):
    """The options that `fit` passes to `learn`.

    `bases`: fitted forecasters, of which a part may be one that need not be fitted again;
    `workers`: number of processes, or an executor, that fit a simulator's parameters.
    """

    seed: int
    start: Forecaster | None
    progress: Callable[[Progress], None] | None
    bases: Sequence[Forecaster]
    workers: int | Executor


def titled(name: str, words: str) -> str:
    """Return a method in words, with the short name by which commands know it."""
    if words in ("", name):
        return name
    return words if words.endswith(f"({name})") else f"{words} ({name})"


class Forecaster(WithRepr, ABC):
    """A model that predicts what follows a record: a network, a simulator, a baseline, a median.

    A forecaster of your own defines its `name`, its training (`learn`) and its forecast
    (`extrapolate`). What `extrapolate` receives (`ForecastContext`: history, inputs, simulator's
    output) is already aligned in time. The constructor keeps each argument under an attribute of
    the same name, which `fit` does not change. All other attributes are set by `fit`, which first
    removes those of an earlier fit.

    Attributes
    ----------
    fitted : The training records and the report of the fit; None before `fit`.
    delays : Delay of each input in samples, as found in training; empty where none are estimated.
    held_out : Errors of held-out forecasts, once an interval has been requested.
    settings : Of its networks' training; None where they are not set or nothing is trained.
    """

    settings: TrainingSettings | None = None
    fits_simulator: ClassVar[bool] = False
    """Whether its fit runs a simulator many times, which may take minutes."""
    state_types: ClassVar[Mapping[str, Any]] = {}
    """The type of each attribute that `learn` sets, for `state`; of one or several fitted
    forecasters, the option that was fitted. Arrays, numbers and texts need not be listed."""
    at_once: ClassVar[bool] = False
    """Whether fit and forecasts together take no time, about a second for a million samples."""
    _words: ClassVar[str] = ""
    """Description that all instances of the class share; see `in_words`."""
    slow_part: ClassVar[str] = ""
    """Description as the slow component of a hybrid, such as "linear model"."""
    forgets: ClassVar[bool] = False
    """Whether a forecast needs no more of a history than its warm-up, as far as inputs are delayed,
    and the last measured sample of each channel. Of a forecaster of your own nothing is known."""
    affine: ClassVar[bool] = False
    """Whether predictions are affine in the inputs, or do not depend on them."""
    fitted: Fitted | None = None
    delays: tuple[int, ...] = ()
    held_out: HeldOut | None = None

    @property
    @abstractmethod
    def name(self) -> str:
        """Return its name in tables and files, unique within a comparison."""

    @property
    def needs(self) -> frozenset[str]:
        """Return what it needs of a record: "inputs", "simulator"."""
        return frozenset().union(*(part.needs for part in parts_of(self)))

    @property
    def random(self) -> bool:
        """Return whether its fit depends on a seed, as the slow training of a network does."""
        return any(part.random for part in parts_of(self))

    @property
    def anchored(self) -> bool:
        """Return whether a forecast depends on the time since the training record began.

        Such a forecaster cannot predict a record whose time is unrelated to that of training.
        """
        return any(part.anchored for part in parts_of(self))

    @property
    def warmup(self) -> int:
        """Return the length of the warm-up: measured samples in a row before a forecast."""
        return 0

    @property
    def calibration(self) -> Calibration | None:
        """Return the fitted calibration of its simulator, or None."""
        return None

    @property
    def parameters(self) -> dict[str, Any]:
        """Return the fitted parameters of its simulator, in a form that JSON can hold."""
        return {}

    def in_words(self) -> str:
        """Return what it is, short enough for a legend; empty where there is no description."""
        return self._words

    def learn(self, records: Sequence[Record], **how: Unpack[Training]) -> None:
        """Fit to the records; by default there is nothing to learn.

        Parameters
        ----------
        records : The training records.
        how : See `Training`; a method that needs none of the options takes `**_`.
        """

    def state(self) -> Arrays:
        """Return what `learn` has found: arrays by name, from which `from_state` restores it.

        By default these are all attributes that are no options: arrays, numbers and texts, what the
        class lists in `state_types`, and None where the class has this default. Raises ValueError
        for any other attribute; a forecaster with such ones defines `state` and `from_state`.
        """
        return state_of(self)

    @classmethod
    def from_state(cls, options: Mapping[str, Any], arrays: Arrays) -> Self:
        """Return the forecaster with these options that has found what `state` returned."""
        new = cls(**options)
        vars(new).update(attributes_of(new, arrays))
        return new

    @abstractmethod
    def extrapolate(self, known: ForecastContext) -> Array | dict[str, Array]:
        """Return the forecast after `known.y`, `(steps, ny)`, or its components by name."""

    def trajectory(self, known: ForecastContext) -> Array:
        """Return its simulation of the history and of the forecast, `(time + steps, ny)`.

        A forecaster with this method can be the slow component of a hybrid.
        """
        raise NotImplementedError(f"{self.name} cannot be the base of a hybrid")

    def describe(self) -> str:
        """Return the result of the fit, in a few words for a table."""
        return ""

    def doubts(self, known: ForecastContext) -> list[str]:
        """Return the method's own reasons to doubt its forecast, in sentences."""
        return []

    @final
    def fit(
        self,
        *records: Record,
        seed: int = 0,
        start: Forecaster | None = None,
        progress: Callable[[Progress], None] | None = None,
    ) -> Self:
        """Fit to one or several records of the same system, and return the forecaster itself.

        A fit that fails or is interrupted leaves the forecaster as it was.

        Parameters
        ----------
        records : The training records, already cut to the training part. Without another history,
            forecasts start at the end of the first one.
        seed : Of all random numbers, initial weights included: the same seed, the same result.
        start : A trained forecaster of the same kind and sizes, from which a network's training
            goes on: it begins with its weights, scaling, delays and bands. The records may be
            others, or longer. Methods without a network fit anew.
        progress : Called after each epoch of a training.

        Raises
        ------
        ValueError
            For records that do not fit together or to the forecaster, see `check`.
        TypeError
            For arguments that are not records.
        FloatingPointError
            When a training diverges.
        """
        return self._fit(records, seed, start, progress)

    @final
    def _fit(
        self,
        records: Sequence[Record],
        seed: int = 0,
        start: Forecaster | None = None,
        progress: Callable[[Progress], None] | None = None,
        bases: Sequence[Forecaster] = (),
        workers: int | Executor = 1,
    ) -> Self:
        """Fit to the records, see `fit` and `Training`."""
        self.check(*records)
        seed = whole("seed", seed, None)
        before = {**vars(self)}
        start = copy(start) if start is self else start
        try:
            self.set_params()  # removes what an earlier fit has found
            self.fitted = Fitted.of(records, seed)
            how = Training(seed=seed, start=start, progress=progress, bases=bases, workers=workers)
            began = time.perf_counter()
            # Closed forms work on small matrices, where the threads of BLAS wait for each other.
            with contextlib.nullcontext() if self.random else one_thread():
                self.learn(records, **how)
            # The training of a network has set its own time.
            seconds = self.fitted.report.seconds or time.perf_counter() - began
            self.fitted = self.fitted.reporting(seconds=seconds, parameters=self.parameters)
        except BaseException:
            vars(self).clear()
            vars(self).update(before)
            raise
        return self

    @final
    def predict(
        self,
        steps: int,
        history: Record | None = None,
        u: npt.ArrayLike | None = None,
        y_sim: npt.ArrayLike | None = None,
        level: float | None = None,
        other_record: bool = False,
    ) -> Prediction:
        """Return the forecast of the samples after a history.

        Parameters
        ----------
        steps : Number of samples.
        history : Measured samples up to the origin; by default the (first) training record. The
            initial state of the forecast is estimated from them. Its time stamps are compared with
            those of the training record; without time stamps both are taken to begin together. It
            must be in the units and at the step of the training record, see `Record.like`; so are
            inputs and prediction.
        u : Known inputs of the forecast samples, `(steps or more, nu)`; required where the record
            has inputs. The columns of a DataFrame are found by their names, here and in `y_sim`.
        y_sim : Simulator output of the forecast samples, `(steps or more, ny)`; by default
            that of the history after its end. A calibrated delay or clock may need more than
            `steps`. Ignored by forecasters that need none or run their own simulator.
        level : Of the interval, 0 to 1: the share of samples that should lie in it. The first call
            with a level refits copies of the forecaster to shorter parts of its training record (a
            network: to three quarters) and forecasts the rest; the errors give all intervals.
        other_record : Whether the history, which must be given then, is of another record: its
            time stamps are not compared with those of the training record. A forecaster that
            depends on the time since the training record began (`anchored`) raises ValueError.

        Raises
        ------
        ValueError
            For a forecaster that has not been fitted, and for a history, inputs or a simulator's
            output that do not fit it or are too short.
        TypeError
            For a history that is not a `Record`.

        Warns
        -----
        ExtrapolationWarning
            For a history whose dates have a time zone where those of the training record have none,
            or the reverse, for inputs, or last outputs of the history, beyond their range in
            training, for a simulator's output that ends too early, for a history shorter than the
            warm-up, for a function of time that disagrees with the history, and for a prediction
            far outside the training range.
        """
        fitted = self.require_fitted()
        if history is not None:
            require_records("history", history)
        steps = whole("steps", steps)
        if level is not None and not 0 < level < 1:
            raise InputError(f"level must be between 0 and 1, got {level}")
        y_sim = y_sim if "simulator" in self.needs else None
        for named in [fitted.record] if history is None else [fitted.record, history]:
            u = by_name("u", u, named.inputs)
            y_sim = by_name("y_sim", y_sim, named.columns)
        known = known_of(self, steps, history, other_record, u, y_sim)
        prediction = predicted(self, known, fitted.record if history is None else history)
        if level is not None:
            prediction = held_out_of(self).interval(level).around(prediction)
        for message in prediction.warnings:
            warnings.warn(message, ExtrapolationWarning, stacklevel=2)
        return prediction

    @final
    def stream(self, history: Record | None = None, other_record: bool = False) -> Stream:
        """Return the forecaster as a stream, which goes on from a history sample by sample.

        Each step takes constant time and memory. The output of a simulator that is no equation
        (`Ode`) is given with each sample.

        Parameters
        ----------
        history, other_record : See `predict`. Samples are in the units and at the step of the
            training record.

        Raises
        ------
        ValueError
            For a forecaster without a step form, such as one of your own that defines none, a
            calibrated delay or clock, or a grey box whose simulator is no equation.
        """
        return stream_of(self, history, other_record)

    @final
    def export(
        self,
        path: str | Path,
        precision: Literal["double", "float"] = "double",
        history: Record | None = None,
        other_record: bool = False,
    ) -> list[Path]:
        """Write the fitted forecaster as a program that needs no Python; return its files.

        The program runs sample by sample as `stream` does, with the same results. The equation of
        an `Ode` is part of it; the output of any other simulator is one of its inputs.

        Parameters
        ----------
        path : Output file, whose ending sets the format: `.c` is C99, with a header file; `.fmu` is
            a functional mock-up unit for co-simulation (FMI 2.0), for Windows, Linux and macOS with
            the extra `everywhere`, else for this platform; `.onnx` is the graph of a step, with a
            second graph for a whole simulation; `.casadi` is the function of `casadi_step`, with a
            second one that returns its state. Of an FMU, set the inputs of a sample, read its
            outputs, and only then make the step to the next sample.
        precision : Of all numbers; an FMU and CasADi compute in double precision.
        history, other_record : The program starts at the end of the history, see `predict`; by
            default of the training record.

        Raises
        ------
        ValueError
            For another ending, and for a part that cannot be exported, which it names, such as a
            cell of your own, or an equation that needs an adaptive solver.
        """
        from splitband.export.writing import export  # noqa: PLC0415  of a higher layer

        return export(self, path, precision, history, other_record)

    def save(self, folder: str | Path) -> None:
        """Write the fitted forecaster to a folder, whole or not at all; `splitband.load` reads it.

        The folder also holds the end of the training record (for the warm-up), the calibration,
        units, input ranges, and the held-out errors, if an interval has been requested.
        """
        save(self, folder)

    def on(self, record: Record, first: bool = True) -> Record:
        """Return a training record, the `first` or another, with the trajectory as `y_sim`."""
        begin = 0.0 if first else None
        known = ForecastContext(record.y_with_gaps, 0, begin, record.u, record.y_sim, record.grid)
        return replace(record, y_sim=self.trajectory(known))

    def to(self, device: str | torch.device) -> Self:
        """Train and run networks on this device from now on, and return the forecaster itself."""
        check_device(device)
        for part in parts_of(self):
            part.to(device)
        return self

    def check(self, *records: Record) -> None:
        """Raise ValueError for unsuitable training records, before anything runs."""
        if not records:
            raise InputError("records must be one or several, got none")
        require_records("records", *records)
        for other in records[1:]:
            check_alike(other, records[0], other.name or "another record")
        measured = [np.isfinite(record.y_with_gaps).any(axis=0) for record in records]
        if not (seen := np.any(measured, axis=0)).all():
            column = records[0].columns[int(seen.argmin())]
            raise InputError(f"records must have a measured sample of {column!r}, got none")
        for record in records:
            name = record.name or "the record"
            if "inputs" in self.needs and record.u is None:
                raise InputError(f"{self.name} needs known inputs, {name} has none")
            if "simulator" in self.needs and record.y_sim is None:
                raise InputError(f"{self.name} needs a simulator, {name} has none")
        for part in parts_of(self):
            part.check(*records)

    def untrained(self) -> Forecaster:
        """Return it not fitted, with the settings and bands that its fit has chosen."""
        return self.clone()

    def get_params(self) -> dict[str, Any]:
        """Return the options by name: the arguments of the constructor.

        Raises TypeError where the constructor does not keep an argument as an attribute.
        """
        return options(self)

    def set_params(self, **params: Any) -> Self:
        """Change some options and return the forecaster itself, which is then not fitted.

        Raises TypeError for an unknown option, and the errors of the constructor.
        """
        new = self.with_options({**self.get_params(), **params})
        vars(self).clear()
        vars(self).update(vars(new))
        return self

    def clone(self) -> Self:
        """Return a new forecaster with the same options, not fitted."""
        return with_parts(self, lambda part: part.clone())

    def require_fitted(self) -> Fitted:
        """Return the training records and the report of the fit; raises ValueError before `fit`."""
        if self.fitted is None:
            raise InputError(f"{self.name} must be fitted first: call fit(record)")
        return self.fitted

    # What follows is for the package alone.

    def training_in_words(self) -> str:
        """Return sizes, window and steps of its networks, for tables; empty without."""
        return ""

    @property
    def title(self) -> str:
        """Return what it is, with its short name."""
        return titled(self.name, self.in_words())

    @property
    def calibrates(self) -> bool:
        """Return whether it calibrates a simulator, which may need output beyond the record."""
        return any(part.calibrates for part in parts_of(self))

    @property
    def refits(self) -> bool:
        """Return whether it is refitted at each origin of a trial, as its fit is quick."""
        return not self.random

    @property
    def filters_history(self) -> bool:
        """Return whether a forecast runs over the whole history, as a Kalman filter does.

        Forecasts from many origins are then made in one run of its step form.
        """
        return any(part.filters_history for part in parts_of(self))

    def run_over(self, known: ForecastContext) -> Forecaster:
        """Return it with its base run over history and forecast, for forecasts from inside them."""
        return self

    @property
    def fitted_bases(self) -> list[Forecaster]:
        """Return the fitted forecasters whose error a network of this one learns."""
        return []

    def as_base(self) -> Forecaster:
        """Return the fitted forecaster as it is the slow component of a hybrid."""
        return self

    def system_matrices(self) -> tuple[Array, Array, Array, Array] | None:
        """Return A, B, C and D of a linear model in state space; None for any other one."""
        return None

    def fitted_copy(
        self, records: Sequence[Record], bases: Sequence[Forecaster] = (), **how: Any
    ) -> Forecaster:
        """Return a copy that is fitted to the records, one of `bases` where that is so already."""
        found = fitted_like(self, records, bases)
        return self.clone()._fit(records, bases=bases, **how) if found is None else found

    def for_trial(self, samples: int) -> Self:
        """Return it adapted to `samples` without their held-out part."""
        if not parts_of(self):
            return self
        return with_parts(self, lambda part: part.for_trial(samples))

    @property
    def slow_label(self) -> str:
        """Return the forecaster's label as the slow component of a prediction."""
        return self.name

    def step_form(self) -> Steps:
        """Return the step form of the fitted forecaster; raises ValueError without one."""
        raise NotSteppedError(
            f"{self.name} has no step form: it predicts, and cannot be streamed or exported"
        )

    def step_form_as_base(self) -> Steps:
        """Return the step form of the slow component of a hybrid, which it is."""
        return self.step_form()

    def first_needed(self) -> int:
        """Return the first sample of the training record that a forecast from its end needs.

        A calibrated delay or clock of a simulator uses all of its earlier output.
        """
        record = self.require_fitted().record
        if "simulator" in self.needs or not all(part.forgets for part in all_parts(self)):
            return 0
        measured = ~np.isnan(record.y_with_gaps)
        first = min(int(np.flatnonzero(channel)[-1]) for channel in measured.T)
        if self.warmup:
            start = last_before(record.y_with_gaps, self.warmup, len(record))
            first = min(first, (self.warmup if start is None else start) - self.warmup)
        first -= max(self.delays, default=0)
        return max(0, min(first, len(record) - 2))

    def with_options(self, params: dict[str, Any]) -> Self:
        """Return a new forecaster of the same class with all of these options."""
        return type(self)(**params)

    def saved_options(self) -> dict[str, Any]:
        """Return the options as they are saved."""
        return self.get_params()

    def complete(self) -> None:
        """Check what was loaded against its training record; raises ValueError."""
        record = self.require_fitted().record
        if self.delays:
            check_delays(self.delays, record.nu)
        check_shape("y_range", self.require_fitted().y_range, 2, record.ny)
        if record.nu:
            check_shape("u_summary", self.require_fitted().u_summary, 3, record.nu)
        if self.held_out is not None:
            self.held_out.check(record.ny)
        for name in (name for name, of in self.state_types.items() if isinstance(of, str)):
            for each in listed(getattr(self, name)):
                check_alike(each.require_fitted().record, record, each.name)


def parts_of(forecaster: Forecaster) -> list[Forecaster]:
    """Return the options of a forecaster, and those in lists, that are forecasters themselves."""
    given = forecaster.get_params().values()
    several = [each if isinstance(each, list | tuple) else [each] for each in given]
    return [each for inner in several for each in inner if isinstance(each, Forecaster)]


def all_parts(forecaster: Forecaster) -> Iterator[Forecaster]:
    """Yield a forecaster, its parts, their parts and so on."""
    yield forecaster
    for part in parts_of(forecaster):
        yield from all_parts(part)


def with_parts(
    forecaster: AnyForecaster, changed: Callable[[Forecaster], Forecaster]
) -> AnyForecaster:
    """Return a new forecaster, not fitted, with each of its parts changed."""
    given = forecaster.get_params().items()
    return forecaster.with_options({name: _changed(option, changed) for name, option in given})


def with_parts_changed(
    forecaster: AnyForecaster, changed: Callable[[Forecaster], Forecaster]
) -> AnyForecaster:
    """Return a forecaster with all of its parts, and itself, changed, the innermost ones first."""
    new: Any = forecaster
    if parts_of(forecaster):
        new = with_parts(forecaster, lambda part: with_parts_changed(part, changed))
    found: Any = changed(new)
    return found


def fitted_like(
    template: Forecaster, records: Sequence[Record], fitted: Sequence[Forecaster]
) -> Forecaster | None:
    """Return a copy of the forecaster with these options that was fitted to the same records."""
    for each in fitted:
        if same(each, template) and each.require_fitted().is_of(records):
            return copy(each)
    return None


def same(one: Any, other: Any) -> bool:
    """Return whether two options are known to be the same; simulators are so as objects alone."""
    if one is other or type(one) is not type(other):
        return one is other
    if isinstance(one, KnownSimulator):
        return bool(one == other)
    if isinstance(one, Forecaster):
        ours, theirs = one.get_params(), other.get_params()
        return all(same(option, theirs[name]) for name, option in ours.items())
    return UNKNOWN not in repr(one) and repr(one) == repr(other)


def cells_of(forecaster: Forecaster) -> dict[str, Template]:
    """Return the options of a forecaster that are templates of its networks' cells, by name."""
    given = forecaster.get_params().items()
    return {name: each for name, each in given if isinstance(each, Template)}


def _changed(option: Any, changed: Callable[[Forecaster], Forecaster]) -> Any:
    """Return an option with the forecasters in it changed; everything else is shared."""
    if isinstance(option, Forecaster):
        return changed(option)
    if type(option) in (list, tuple):
        return type(option)(_changed(part, changed) for part in option)
    return option


def fitted_of(model: Any) -> Fitted:
    """Return what a model was fitted to; raises TypeError for what is no forecaster."""
    if not isinstance(model, Forecaster):
        raise TypeError(
            "forecaster must be a model, such as result.model or what splitband.load(folder) "
            f"returns, got {type(model).__name__}"
        )
    return model.require_fitted()

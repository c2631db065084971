"""Define what predicts: fitted to a record, it forecasts what follows."""

from __future__ import annotations

import contextlib
import time
import warnings
from abc import abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Self, TypedDict, Unpack, final

import numpy.typing as npt
from torch import Tensor, nn

from splitband.baselines.delays import check_delays
from splitband.data import Record, require_records
from splitband.forecasters.asking import (
    first_needed,
    known_at_origin,
    known_of,
    predicted,
    prepared_like,
    seconds_after,
)
from splitband.forecasters.configurable import Configurable
from splitband.forecasters.differentiable import Affine, TorchSimulation
from splitband.forecasters.fitted import Fitted
from splitband.forecasters.intervals import HeldOut
from splitband.forecasters.known import Known
from splitband.forecasters.prediction import Prediction
from splitband.forecasters.stepping import (
    Extrapolated,
    NotSteppedError,
    Part,
    Recursion,
)
from splitband.forecasters.streaming import Stream, stream_of
from splitband.metrics import ExtrapolationWarning
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.options import attributes
from splitband.runtime.provided import provided
from splitband.runtime.threads import one_thread
from splitband.simulators.calibration import Calibration
from splitband.training import Checkpoint, Progress

if TYPE_CHECKING:
    from splitband.forecasters.checking import ModelCheck
    from splitband.forecasters.responses import Responses


class Training(TypedDict):
    """Say how `Forecaster.learn` is to go about it: `seed`, `progress`, `checkpoint` of `fit`."""

    seed: int
    progress: Callable[[Progress], None] | None
    checkpoint: Checkpoint | None


class Forecaster(Configurable):
    """Predict what follows a record: a network, a simulator, a baseline, a mean of several.

    A forecaster of your own says what it is called (`name`), what it learns (`learn`) and what
    comes next (`extrapolate`); `known` is already aligned in time. Its constructor keeps each
    argument under an attribute of the same name, which `fit` leaves as it is. Everything else is
    found by `fit`, and each fit begins without it.

    Attributes
    ----------
    fitted : What is remembered of the training records; None before `fit`.
    delays : By how many samples each input acts late, as found in training; empty where that is
        not asked.
    held_out : How well copies of it forecast known samples, once an interval has been asked for.
    """

    affine: ClassVar[bool] = False
    """Whether predictions are affine in the inputs, or do not depend on them."""
    fitted: Fitted | None = None
    delays: tuple[int, ...] = ()
    held_out: HeldOut | None = None

    @property
    def calibration(self) -> Calibration | None:
        """Return the calibration of the simulator that it runs, where one has been fitted."""
        return None

    @property
    def parameters(self) -> dict[str, Any]:
        """Return what is known of the fitted parameters of its simulator, as JSON can hold it."""
        return {}

    def for_seed(self, seed: int) -> Forecaster:
        """Return the forecaster that is fitted with a seed."""
        return self.by_seed.get(seed, self)

    @property
    def of_one_seed(self) -> Forecaster:
        """Return what is averaged, of a mean over seeds; else itself."""
        return self

    @property
    def warmup(self) -> int:
        """Return how many measured samples in a row a forecast begins with."""
        return 0

    @abstractmethod
    def extrapolate(self, known: Known) -> Array | dict[str, Array]:
        """Return what comes after `known.y`, `(steps, ny)`, or its parts by name."""

    def learn(self, records: Sequence[Record], **how: Unpack[Training]) -> None:
        """Fit to the records; by default there is nothing to learn.

        Parameters
        ----------
        records : The training records.
        how : See `Training`; what needs none of it takes `**_`.
        """

    def trajectory(self, known: Known) -> Array:
        """Return what it says of the history and of what comes after, `(time + steps, ny)`.

        A forecaster that has this method can hold the slow part of a network.
        """
        raise NotImplementedError(f"{self.name} says nothing about a history")

    def on(self, record: Record, first: bool = True) -> Record:
        """Return a training record, the `first` or another, with its trajectory as `y_sim`."""
        begin = 0.0 if first else None
        known = Known(record.seen, 0, begin, record.u, record.y_sim, record.grid)
        return replace(record, y_sim=self.trajectory(known), beyond=None)

    def unfiltered(self, steps: int, history: Record) -> dict[str, Array]:
        """Return what filters are fed with, by name; empty for a forecaster without filters."""
        return {}

    def describe(self) -> str:
        """Return what the fit has settled on, in a few words for a table."""
        return ""

    def doubts(self, known: Known) -> list[str]:
        """Return reasons to doubt what it extrapolates, in sentences, beside those for all."""
        return []

    def given(self, simulator: Any) -> Forecaster:
        """Return it with this simulator where it fits the parameters of one and has none."""
        return self.with_parts(lambda part: part.given(simulator))

    def calibrated(self) -> Forecaster:
        """Return it with its simulator calibrated, if it has one; itself otherwise."""
        return self.with_parts(lambda part: part.calibrated())

    @final
    def fit(
        self,
        *records: Record,
        seed: int = 0,
        progress: Callable[[Progress], None] | None = None,
        checkpoint: Checkpoint | None = None,
    ) -> Self:
        """Fit to one or several records of the same system, and return the forecaster itself.

        Parameters
        ----------
        records : The training records, and nothing else: cut them before. Forecasts go on from
            the end of the first one where no other history is given.
        seed : For all that is random, initial weights included: the same seed, the same result.
        progress : Called after each epoch of a training.
        checkpoint : Where a training that was cut off goes on, with the same numbers to the bit.

        Raises
        ------
        ValueError
            For records that do not fit together or to the forecaster, see `check`.
        TypeError
            For something else than records.
        FloatingPointError
            When a training diverges.
        """
        self.check(*records)
        seed = whole("seed", seed, None)
        kept = {name: vars(self)[name] for name in attributes(self).values()}
        self._become(self.clone(), kept)  # nothing of an earlier fit
        self.fitted = Fitted.of(records, seed)
        began = time.perf_counter()
        # Closed forms work on small matrices, where the threads of BLAS wait for each other.
        with contextlib.nullcontext() if self.random else one_thread():
            self.learn(records, seed=seed, progress=progress, checkpoint=checkpoint)
        report = self.fitted.report
        if not report.seconds:  # the training of a network has set its own time
            report = replace(report, seconds=time.perf_counter() - began)
        self.fitted = replace(self.fitted, report=replace(report, parameters=self.parameters))
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
        """Return the samples that come after a history.

        Parameters
        ----------
        steps : How many.
        history : Measured samples up to the origin; by default the (first) training record. The
            state that a forecast begins with is estimated from them. By its time stamps it is known
            how much later than that record it begins; without any it is taken to begin with it.
            Where the training record was detrended, clipped or resampled and the history was not,
            the same is done to the history and the inputs, and undone on the prediction.
        u : Known inputs of the samples to come, `(steps, nu)`; by default what the history says of
            them (`u_beyond`), as a slice of a longer record does.
        y_sim : A simulator's output of the samples to come, `(steps or more, ny)`, likewise
            (`beyond`); a calibrated delay or clock may need it beyond the last of them. What needs
            none, or has a simulator of its own, does not look at it.
        level : Of the interval, 0 to 1: the share of samples that should lie in it. The first time
            one is asked for, the forecaster is fitted again to three quarters of its training
            record, to see how well it forecasts the rest; the intervals of all levels follow.
        other_record : The history is of another record: its time stamps are not compared with
            those of the training record. What depends on the time since then (`anchored`) has
            nothing to say.

        Raises
        ------
        ValueError
            For a forecaster that has not been fitted, and for a history, inputs or a simulator's
            output that do not fit it or are too short.
        TypeError
            For a history that is no `Record`.

        Warns
        -----
        ExtrapolationWarning
            For a history of another record whose dates have a time zone where those of the training
            record have none, or the reverse, for inputs beyond their range in training, for a
            simulator's output that ends too early, for a function of time that disagrees with the
            history, and for a prediction that leaves the range of the training samples by far.
        """
        fitted = self.require_fitted()
        if history is not None:
            require_records("history", history)
        steps = whole("steps", steps)
        if level is not None and not 0 < level < 1:
            raise ValueError(f"level must be between 0 and 1, got {level}")
        if history is not None and history.prepared != fitted.record.prepared:
            prepared, u, y_sim = prepared_like(fitted.record, history, u, y_sim)
            found = self.predict(steps, prepared, u, y_sim, level, other_record)
            return found.restored(fitted.record.prepared, seconds_after(prepared, steps))
        known, past = known_of(self, steps, history, u, y_sim, other_record)
        prediction = predicted(self, known, past)
        if level is not None:
            prediction = self.tried_out().interval(level).around(prediction)
        for message in prediction.warnings:
            warnings.warn(message, ExtrapolationWarning, stacklevel=2)
        return prediction

    def step_responses(
        self,
        steps: int = 500,
        at: npt.ArrayLike | None = None,
        size: npt.ArrayLike | None = None,
    ) -> Responses:
        """Return the response of each output to a small step of each input.

        Parameters
        ----------
        steps : Samples of the response. As many pass before it, with constant inputs, so that the
            outputs settle.
        at : The operating point, `(nu,)`; by default the means of the training inputs.
        size : Of the steps, `(nu,)`; by default a tenth of each input's range in training. Half of
            it is a step up, half one down; `y` is the difference for a step of 1.

        Raises
        ------
        ValueError
            For a forecaster without inputs, and one whose simulator stays outside of it.
        """
        found: Responses = provided("step responses")(self, steps, at, size)
        return found

    def check_residuals(self, record: Record) -> ModelCheck:
        """Check the fitted forecaster on a record, best one that it was not fitted to.

        Returns the fit of a simulation and of predictions a few samples ahead, the tests of the
        residuals, whether a long free run stays in range, and inputs beyond their range in
        training; see `splitband.forecasters.checking`. What depends on the time since the training
        record began is asked about `record` by its time stamps.

        Raises
        ------
        ValueError
            For a forecaster that has not been fitted, and a record that does not fit it or is too
            short.
        """
        found: ModelCheck = provided("check")(self, record)
        return found

    @final
    def stream(self, history: Record | None = None, other_record: bool = False) -> Stream:
        """Return the forecaster with a state, that goes on sample by sample from a history.

        Each step takes constant time and memory. A forecaster of your own, and a few that look
        ahead or interpolate a simulator's output, are asked anew for each sample, which is slower.

        Parameters
        ----------
        history, other_record : See `predict`. Where the training record was detrended, clipped or
            resampled, samples are in the units of before; they have its step. After a history that
            was prepared in the same way they are in its units.
        """
        return stream_of(self, history, other_record)

    @final
    def as_torch(
        self, history: Record | None = None, other_record: bool = False
    ) -> TorchSimulation:
        """Return a torch module that simulates what follows a history, as `predict` does.

        It takes batches of inputs and is differentiable: for predictive control, inputs that lead
        to a wanted output, or a loss of your own.

        Parameters
        ----------
        history, other_record : See `predict`.

        Raises
        ------
        ValueError
            For a grey box, a network on another network, and what is your own and does not define
            `differentiable`; for a training record that was detrended, clipped or resampled.

        Examples
        --------
        >>> u = np.sin(0.05 * np.arange(200))
        >>> record = sb.Record(np.cumsum(0.1 * u), 0.1, u=u)
        >>> simulate = sb.Linear().fit(record).as_torch()
        >>> futures = torch.zeros(64, 20, 1, requires_grad=True)
        >>> simulate(futures).square().mean().backward()
        >>> futures.grad.shape
        torch.Size([64, 20, 1])
        """
        record = self.require_fitted().record
        if history is not None:
            require_records("history", history)
        if record.prepared:
            raise ValueError(
                f"{self.name} must be fitted to a record as it was measured for as_torch: this one "
                "was detrended, clipped or resampled"
            )
        known = known_at_origin(self, history, other_record)
        return TorchSimulation(self.differentiable(known), record.nu)

    def differentiable(self, known: Known) -> nn.Module:
        """Return what maps inputs after a history `(batch, steps, nu)` to `(batch, steps, ny)`."""
        if not self.affine:
            raise ValueError(f"{self.name} cannot be run by torch: it is not affine in the inputs")
        return Affine(self, known)

    @final
    def export(
        self,
        path: str | Path,
        precision: Literal["double", "float"] = "double",
        history: Record | None = None,
    ) -> list[Path]:
        """Write the fitted forecaster as a program that needs no Python; return its files.

        What is written runs as `stream` does, sample by sample, with the same numbers. A
        simulator's output is one of its inputs.

        Parameters
        ----------
        path : Where to; its ending says as what. `.c` is C99, with a header beside it; `.fmu` is a
            functional mock-up unit for co-simulation (FMI 2.0); `.onnx` is the graph of a step,
            with the one of a whole simulation beside it.
        precision : Of all numbers; an FMU computes in double precision.
        history : After which it begins; by default the training record.

        Raises
        ------
        ValueError
            For another ending, and with the name of what cannot be exported, such as a cell of
            your own.
        """
        files: list[Path] = provided("export")(self, path, precision, history)
        return files

    def stepped(self, outside: bool = False) -> Recursion:
        """Return what the fitted forecaster does with each sample, by default that of its `part`.

        Parameters
        ----------
        outside : Whether the output of a simulator of its own comes with each sample, too, as in a
            program that is exported.

        Raises
        ------
        NotSteppedError
            With the reason where `predict` has to be asked.
        """
        record = self.require_fitted().record
        return Extrapolated(self.part(outside), record.ny, record.nu)

    def part(self, outside: bool = False) -> Part:
        """Return what the fitted forecaster says sample by sample, by itself or in a hybrid.

        Raises NotSteppedError, see `stepped`.
        """
        raise NotSteppedError(f"{self.name} cannot be stepped: {type(self).__name__} has no `part`")

    def save(self, folder: str | Path) -> None:
        """Write the fitted forecaster to a folder, whole or not at all; `splitband.load` reads it.

        With it go the end of the training record, on which a forecast warms up, calibration, units,
        ranges of the inputs, and the intervals, if one has been asked for.
        """
        provided("saving")(self, folder)

    def to_dict(self) -> dict[str, Any]:
        """Return all that makes the forecaster, for `save`: options, and what has been found.

        Of the training record that is the end, on which a forecast warms up.
        """
        end = None if self.fitted is None else self.fitted.end(self.first_needed())
        kept = {name: value for name, value in vars(self).items() if name != "by_seed"}
        return {**kept, "fitted": end}

    @classmethod
    def from_dict(cls, found: dict[str, Any]) -> Self:
        """Return a forecaster made of what `to_dict` said; its constructor is not called."""
        new = object.__new__(cls)
        vars(new).update(found)
        if new.fitted is not None and new.delays:
            check_delays(new.delays, new.fitted.record.nu)
        return new

    def first_needed(self) -> int:
        """Return the first sample of the training record that a forecast from its end needs."""
        return first_needed(self)

    def state(self) -> dict[str, Tensor]:
        """Return the weights that have been trained, with which another training may begin."""
        return {}

    def require_fitted(self) -> Fitted:
        """Return what is remembered of the training records; raises ValueError before `fit`."""
        if self.fitted is None:
            raise ValueError(f"{self.name} must be fitted before it is asked: call fit(record)")
        return self.fitted

    @final
    def tried_out(self) -> HeldOut:
        """Return how well it forecasts known samples, from which intervals of all levels follow.

        The first time it is fitted again, to three quarters of its training record. ValueError is
        raised where that is too short, and for a loaded forecaster that was not tried out before.
        """
        if self.held_out is None:
            self.held_out = provided("held-out forecasts")(self)
        assert self.held_out is not None
        return self.held_out

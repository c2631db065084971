"""Check a fitted forecaster: fits, residual tests, stability, ranges, and step responses."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from splitband.data import Record, require_records
from splitband.data.signals import first_after
from splitband.forecasters.base import Forecaster
from splitband.forecasters.prediction import OVERFLOWED, Prediction
from splitband.forecasters.residuals import (
    CONFIDENCE,
    LAGS,
    Outcome,
    ResidualTests,
    residual_tests,
)
from splitband.metrics import (
    Extrapolation,
    ExtrapolationWarning,
    fit_percent,
    leaves_range,
    tenths,
)
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.threads import without_warnings
from splitband.training.settings import default_warmup

AHEAD = (1, 10)
"""Horizons in samples of the predictions from within the record. Layout."""
ORIGINS = 100
"""Largest number of origins of these predictions, evenly spaced. Bounds the time."""
SETTLED = 0.02
"""A step response has settled where its slope stays within this share of its largest one from what
it ends with, for the last quarter; the 2 % of the settling time, a convention."""
LONGEST = 16
"""Longest simulation of a response for its frequency response, in multiples of the samples asked
for. Bounds the time."""
LONGER = 10
"""Length of the free run that must stay in range, in multiples of the record. By eye."""


@dataclass(frozen=True, eq=False)
class ModelCheck:
    """Hold the results of checking a forecaster on a record.

    Attributes
    ----------
    method : Name of the forecaster.
    record : The record of the check.
    simulation : The free run from a warm-up on the first samples to the end.
    fits : Fit in percent of each output: "simulation", and "1 step ahead" and so on.
    tests : Of the residuals of each output.
    leaves : Samples of a free run of `LONGER` times the record before it leaves the range of the
        training record by far; None where it stays.
    unchecked : Why there is no such run; empty where there is one.
    beyond : Inputs and outputs outside their range in training.
    title : What the forecaster is, in words, with its name.
    """

    method: str
    record: Record
    simulation: Prediction
    fits: Mapping[str, tuple[float, ...]]
    tests: tuple[ResidualTests, ...]
    leaves: int | None = None
    unchecked: str = ""
    beyond: Sequence[Extrapolation] = field(default_factory=tuple)
    title: str = ""

    @property
    def outcome(self) -> Outcome:
        """Return the result of all tests; a long free run that leaves the range rejects, too."""
        found = {test.outcome for test in self.tests}
        if self.leaves is not None or "rejected" in found:
            return "rejected"
        return "not rejected" if "not rejected" in found else "accepted"

    @property
    def accepted(self) -> bool:
        """Return whether nothing rejects the model."""
        return self.outcome != "rejected"

    def in_words(self) -> list[str]:
        """Return the results in sentences, without the fits."""
        said = [test.finding() for test in self.tests]
        if self.unchecked:
            said.append(f"Stability was not checked: {self.unchecked}.")
        elif self.leaves is None:
            said.append(f"The free run over {LONGER} times the record stays in range.")
        else:
            said.append(
                f"The free run over {LONGER} times the record, with its inputs repeated, leaves "
                f"the range of the training record by far after {self.leaves:,} samples."
            )
        said += self.simulation.doubts
        names = {"input": self.record.inputs, "output": self.record.columns}
        return said + [each.describe(names[each.kind][each.channel]) for each in self.beyond]

    def __str__(self) -> str:
        fits = [
            f"{column}: fit {tenths(of[i])} % ({horizon})"
            for i, column in enumerate(self.record.columns)
            for horizon, of in self.fits.items()
        ]
        begin = f"{self.title or self.method} on {self.record.name or 'the record'}: {self.outcome}"
        return "\n".join([begin, *fits, *self.in_words()])

    def as_json(self) -> dict[str, Any]:
        """Return all results, for a JSON file."""
        return {
            "method": self.method,
            "record": self.record.name,
            "samples": len(self.record),
            "outcome": self.outcome,
            "accepted": self.accepted,
            "level": CONFIDENCE,
            "fit": {
                horizon: {
                    column: fit if math.isfinite(fit) else None
                    for column, fit in zip(self.record.columns, fits, strict=True)
                }
                for horizon, fits in self.fits.items()
            },
            "residuals": [test.as_json() for test in self.tests],
            "leaves_range_after": self.leaves,
            "unchecked": self.unchecked,
            "beyond_training": [asdict(each) for each in self.beyond],
            "in_words": self.in_words(),
        }


def check(forecaster: Forecaster, record: Record) -> ModelCheck:
    """Check a fitted forecaster on a record; see `Forecaster.check_residuals`."""
    fitted = forecaster.require_fitted()
    require_records("record", record)
    record = record.prepared_as(fitted.record)
    free = _free_run(forecaster, record)
    if free is None:
        raise InputError(
            f"record must have {2 * LAGS} samples after the warm-up of {forecaster.name}, "
            f"got {len(record)}"
        )
    with without_warnings(ExtrapolationWarning):
        begin = len(record) - len(free)
        fits = {"simulation": tuple(fit_percent(record.truth[begin:], free.y).tolist())}
        fits |= _ahead(forecaster, record, begin)
        unchecked = ""
        if "simulator" in forecaster.needs:
            unchecked = "it needs the simulator's output beyond the record"
        leaves = None if unchecked else _leaves(forecaster, record, begin)
    tests = tests_of(record, free)
    beyond = *fitted.inputs_beyond(record.u), *fitted.outputs_beyond(record.y_with_gaps)
    return ModelCheck(forecaster.name, record, free, fits, tests, leaves, unchecked, beyond,
                      forecaster._title)  # fmt: skip


def tests_of(record: Record, simulated: Prediction) -> tuple[ResidualTests, ...]:
    """Test the residuals of a simulation or forecast to the end of a record.

    Returns nothing where it has fewer than 2 `LAGS` samples.
    """
    if len(simulated) < 2 * LAGS:
        return ()
    left = record.y_with_gaps[len(record) - len(simulated) :] - simulated.y
    return residual_tests(left, record.u, record.columns, record.inputs, simulated.y)


def tests_on(forecaster: Forecaster, record: Record) -> tuple[ResidualTests, ...]:
    """Test the residuals of a fitted forecaster on a record that it was not fitted to, as `check`.

    Returns nothing where `check` would not find enough samples.
    """
    record = record.prepared_as(forecaster.require_fitted().record)
    free = _free_run(forecaster, record)
    return () if free is None else tests_of(record, free)


def _free_run(forecaster: Forecaster, record: Record) -> Prediction | None:
    """Simulate a record to its end, from a warm-up on its first samples; None if it is short."""
    warmup = forecaster.warmup or default_warmup(len(record))  # as a comparison on test records
    begin = first_after(record.complete, max(warmup, 2))
    if begin is None or len(record) - begin < 2 * LAGS:
        return None
    other = not forecaster.anchored
    with without_warnings(ExtrapolationWarning):
        return forecaster.predict(len(record) - begin, record[:begin], other_record=other)


def _ahead(forecaster: Forecaster, record: Record, begin: int) -> dict[str, tuple[float, ...]]:
    """Return the fit of predictions a few samples ahead, from many origins."""
    last = len(record) - max(AHEAD)
    origins = np.unique(np.linspace(begin, last, min(ORIGINS, last - begin + 1)).astype(int))
    other, made = not forecaster.anchored, dict[int, Array]()
    for at in origins:
        try:
            made[at] = forecaster.predict(max(AHEAD), record[:at], other_record=other).y
        except ValueError:
            continue  # a gap in the warm-up
    fits = {}
    for k in AHEAD if made else ():
        truth = np.stack([record.truth[at + k - 1] for at in made])
        fit = fit_percent(truth, np.stack([y[k - 1] for y in made.values()]))
        fits[f"{k} step{'s' if k > 1 else ''} ahead"] = tuple(fit.tolist())
    return fits


def _leaves(forecaster: Forecaster, record: Record, begin: int) -> int | None:
    """Return after how many samples a long free run, with inputs repeated, leaves the range."""
    steps = LONGER * len(record)
    u = None if record.u is None else np.tile(record.u, (LONGER + 1, 1))[begin : begin + steps]
    other = not forecaster.anchored
    long = forecaster.predict(steps, record[:begin], u=u, other_record=other)
    return leaves_range(forecaster.require_fitted().y_range, long.y)


SHARE = 0.1
"""Size of the step, and distance of operating points from the ends, as a share of the input's range
in training. By eye."""


@dataclass(frozen=True, eq=False)
class Responses:
    """Hold the response of each output to a small step of each input around an operating point.

    Attributes
    ----------
    y : Change of the outputs for a unit step at index 0, `(steps, ny, nu)`.
    sampling_time : In seconds.
    columns, inputs : Names of outputs and inputs.
    at : The operating point, `(nu,)`.
    size : Sizes of the simulated steps, `(nu,)`.
    whole : The response until it has settled, or to `LONGEST` times the samples of `y`.
    system : A, B, C and D of a linear model in state space, whose frequency response is exact.
    share : Where all inputs are in their ranges in training; None for their means, or as asked.
    remarks : Sentences on what is missing, see `respond_over_range`.
    """

    y: Array
    sampling_time: float
    columns: tuple[str, ...]
    inputs: tuple[str, ...]
    at: Array
    size: Array
    whole: Array
    system: tuple[Array, Array, Array, Array] | None = None
    share: float | None = None
    remarks: tuple[str, ...] = ()

    @property
    def place(self) -> str:
        """Return where the inputs are in their ranges, in words."""
        return "the mean" if self.share is None else f"{self.share:.0%}".replace("%", " %")

    @property
    def settled(self) -> bool:
        """Return whether the frequency response is that of the model, also at low frequencies."""
        return self.system is not None or _settled(self.whole)

    @property
    def time(self) -> Array:
        """Return the times after the step in seconds, `(steps,)`."""
        return np.asarray(np.arange(len(self.y)) * self.sampling_time, dtype=np.float64)

    @property
    def operating_point(self) -> str:
        """Return the operating point in words."""
        pairs = zip(self.inputs, self.at, strict=True)
        return ", ".join(f"{name} = {value:.4g}" for name, value in pairs)

    def frequency_response(self) -> tuple[Array, npt.NDArray[np.complex128]]:
        """Return frequencies above 0 in Hz, and the small-signal gain there, `(n, ny, nu)`.

        That of `Linear` is exact. For others it is the Fourier transform of the impulse response
        of `whole`, whose last value is taken to stay: it is near 0 where the step response settles,
        and the slope of an integrator. It is wrong where this has not `settled`.
        """
        frequencies = np.fft.rfftfreq(len(self.y), self.sampling_time)[1:]
        z = np.exp(2j * np.pi * frequencies * self.sampling_time)[:, None, None]
        if self.system is not None:
            a, b, c, d = self.system
            gain = c @ np.linalg.solve(z * np.eye(len(a)) - a, b + 0 * z) + d
        else:
            impulse, every = _impulse(self.whole), len(self.whole) // len(self.y)
            gain = np.fft.rfft(impulse, axis=0)[every::every] + impulse[-1] * z / (z - 1)
        return np.asarray(frequencies, np.float64), np.asarray(gain, np.complex128)


def _impulse(y: Array) -> Array:
    """Return the impulse response of a step response, `(steps, ny, nu)`."""
    return np.diff(y, axis=0, prepend=np.zeros_like(y[:1]))


def _settled(y: Array) -> bool:
    """Return whether the slope of all step responses has come to its last value."""
    impulse = _impulse(y)
    left = abs(impulse[-(len(y) // 4 or 1) :] - impulse[-1]).max(axis=0)
    return bool((left <= SETTLED * abs(impulse).max(axis=0)).all())


def respond(
    forecaster: Forecaster,
    steps: int = 500,
    at: npt.ArrayLike | None = None,
    size: npt.ArrayLike | None = None,
    moving: bool = False,
) -> Responses:
    """Return the responses of a fitted forecaster; see `Forecaster.step_responses`.

    With `moving` just those to the inputs that were not constant in training.
    """
    fitted = forecaster.require_fitted()
    record, steps = fitted.record, whole("steps", steps)
    if fitted.u_summary is None:
        raise InputError(f"{forecaster.name} must have inputs to respond to, it has none")
    if "simulator" in forecaster.needs:
        raise InputError(
            f"{forecaster.name} cannot respond by itself: its simulator stays outside of it"
        )
    low, high, mean = fitted.u_summary
    held = mean if at is None else _each("at", at, record.nu)
    sizes = SHARE * (high - low) if size is None else _each("size", size, record.nu)
    of = np.flatnonzero(sizes) if moving else np.arange(record.nu)
    if not (len(of) and sizes[of].all()):
        raise InputError(
            "size must not be 0: give one for an input that was constant in training, "
            f"got {sizes.tolist()}"
        )
    for each in fitted.inputs_beyond(held + 0.5 * np.stack([-abs(sizes), abs(sizes)])):
        warnings.warn(
            f"input {record.inputs[each.channel]} is beyond its range in training ({each.low:g} to "
            f"{each.high:g}) in a step response, at {each.farthest:g}: the response is an "
            "extrapolation",
            ExtrapolationWarning,
            stacklevel=3,
        )

    def simulated(steps: int) -> Array:
        found = np.empty((steps, record.ny, len(of)))
        for k, i in enumerate(of):
            # Up and down: even-order nonlinearities cancel.
            ends = []
            for half in (0.5 * sizes[i], -0.5 * sizes[i]):
                u = np.tile(held, (2 * steps, 1))
                u[steps:, i] += half
                with without_warnings(ExtrapolationWarning):
                    ends.append(forecaster.predict(2 * steps, u=u).y[steps:])
            up, down = (np.where(abs(y) < OVERFLOWED, y, np.nan) for y in ends)
            found[:, :, k] = (up - down) / sizes[i]
        return found

    y = settled = longer = simulated(steps)
    system = forecaster._system()
    while system is None and not _settled(settled) and np.isfinite(longer).all():
        settled = longer
        if len(longer) >= LONGEST * steps:
            break
        longer = simulated(2 * len(longer))
    if system is not None:
        a, b, c, d = system
        system = a, b[:, of], c, d[:, of]
    inputs = tuple(record.inputs[i] for i in of)
    return Responses(y, record.sampling_time, record.columns, inputs, held[of], sizes[of],
                     settled, system)  # fmt: skip


def respond_over_range(forecaster: Forecaster) -> list[Responses]:
    """Return the responses of a fitted forecaster at the means of its training inputs.

    Those of a nonlinear one follow with all inputs at `SHARE` and at 1 - `SHARE` of their ranges in
    training. There are none for one without inputs, or whose simulator stays outside of it. What
    else is left out, `remarks` of the first say.
    """
    try:
        every = [respond(forecaster, moving=True)]
    except InputError:
        return []
    low, high, _ = forecaster.require_fitted().u_summary  # type: ignore[misc]  # it has inputs
    for share in () if forecaster.affine else (SHARE, 1 - SHARE):
        at = low + share * (high - low)
        every.append(replace(respond(forecaster, at=at, moving=True), share=share))
    finite = [each for each in every if np.isfinite(each.y).all()]
    if not finite or not finite[0].y.any():
        return []
    names = forecaster.require_fitted().record.inputs
    still = [name for name in names if name not in every[0].inputs]
    said = [f"In training {', '.join(still)} never moved: the effect is unknown."] if still else []
    said += [f"The response at {each.place} of the training inputs is not finite: left out."
             for each in every if each not in finite]  # fmt: skip
    for each in [each for each in finite if not each.settled][:1]:
        after = len(each.whole) * each.sampling_time
        said.append(
            f"{forecaster.name} has not settled after {after:.4g} s: its gain and phase at low "
            "frequencies are uncertain."
        )
    return [replace(finite[0], remarks=tuple(said)), *finite[1:]]


def _each(what: str, value: npt.ArrayLike, nu: int) -> Array:
    """Return a number for each input."""
    numbers = np.asarray(value, dtype=np.float64)
    if numbers.shape not in ((), (nu,)) or not np.isfinite(numbers).all():
        raise InputError(f"{what} must be a finite number for each of {nu} inputs, got {value!r}")
    return np.broadcast_to(numbers, (nu,))

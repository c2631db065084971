"""Check a fitted forecaster on a record: fits, residual tests, stability, ranges."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from splitband.checks.residuals import (
    CONFIDENCE,
    LAGS,
    Outcome,
    ResidualTests,
    residual_tests,
)
from splitband.forecasters.base import Forecaster, fitted_of
from splitband.forecasters.held_out import (
    Origin,
    after,
    fit_ahead,
    forecasts,
    horizons,
    many_origins,
    so_far_ahead,
)
from splitband.forecasters.prediction import Prediction, known_of
from splitband.forecasters.simulation import simulators_of
from splitband.metrics import (
    Extrapolation,
    ExtrapolationWarning,
    fit_percent,
    leaves_range,
    tenths,
)
from splitband.records import Record, check_alike, require_records
from splitband.records.signals import first_after
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.threads import without_warnings
from splitband.training.settings import default_warmup

AHEAD = 10
"""Usual horizon in samples of the predictions from within the record. Layout."""
MOST_ONE_AHEAD = 2_000
"""Largest number of samples that an unstable model predicts one by one: the last ones. Bounds the
time."""
LONGER = 10
"""Length of the free run in the check of stability, in multiples of the record. Bounds the time."""


@dataclass(frozen=True, eq=False)
class ModelCheck:
    """The results of a check of a forecaster on a record.

    Attributes
    ----------
    method : Name of the forecaster.
    record : The record of the check.
    simulation : The free run from a warm-up on the first samples to the end. Of a model without
        one the last `MOST_ONE_AHEAD` predictions one sample ahead, in its place in `tests`, too.
    fits : Fit in percent by output, of "simulation", "1 sample ahead" and so on.
    tests : Residual tests by output.
    leaves : Samples of a free run of `LONGER` times the record before it leaves the range of the
        training record by far; None for a run in range.
    unchecked : Reason for a missing run; empty otherwise.
    beyond : Inputs and outputs outside their range in training.
    title : Kind and name of the forecaster, in words.
    free : Whether `simulation` is a free run, see `runs_free`.
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
    free: bool = True

    @property
    def outcome(self) -> Outcome:
        """Return the result of all tests; a long free run out of range rejects, too."""
        outcomes = {test.outcome for test in self.tests}
        if self.leaves is not None or "rejected" in outcomes:
            return "rejected"
        return "not rejected" if "not rejected" in outcomes else "accepted"

    @property
    def accepted(self) -> bool:
        """Return whether nothing rejects the model."""
        return self.outcome != "rejected"

    def summary(self) -> str:
        """Return the result of all tests in a phrase."""
        found = ["the residuals still contain an effect of the inputs"]
        if not any(test.dependent for test in self.tests):
            white = all(test.white for test in self.tests)
            found = [] if white else ["the residuals are not white noise"]
        found += [] if self.leaves is None else ["a long free run leaves the range"]
        return " and ".join(found) or "the tests find nothing that the model lacks"

    def in_words(self) -> list[str]:
        """Return the results in sentences, without the fits."""
        sentences = [test.finding() for test in self.tests]
        if self.unchecked:
            sentences.append(f"The free run was not checked: {self.unchecked}.")
        elif self.leaves is None:
            sentences.append(f"The free run over {LONGER} times the record stays in range.")
        else:
            sentences.append(
                f"The free run over {LONGER} times the record, with its inputs repeated, leaves "
                f"the range of the training record by far after {self.leaves:,} samples."
            )
        sentences += self.simulation.doubts
        names = {"input": self.record.inputs, "output": self.record.columns}
        sentences += [signal.describe(names[signal.kind][signal.channel]) for signal in self.beyond]
        return [f"{said[:1].upper()}{said[1:].removesuffix('.')}." for said in sentences]

    def fits_in_words(self) -> list[str]:
        """Return the fits by output and horizon."""
        return [
            f"{column}: fit {tenths(of[i])} % ({horizon})"
            for i, column in enumerate(self.record.columns)
            for horizon, of in self.fits.items()
        ]

    def __str__(self) -> str:
        on = f"{self.title or self.method} on {self.record.name or 'the record'}"
        return "\n".join([f"{on}: {self.summary()}", *self.fits_in_words(), *self.in_words()])

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
            "beyond_training": [asdict(signal) for signal in self.beyond],
            "in_words": self.in_words(),
        }


def check(forecaster: Forecaster, record: Record, ahead: int | None = None) -> ModelCheck:
    """Check a fitted forecaster on a record, preferably not the training record.

    Returns the fit of a simulation and of predictions 1, `ahead` / 10 and `ahead` samples ahead,
    the tests of the residuals, whether a long free run stays in range, and signals beyond their
    range in training. `ahead` is by default that for which the model was chosen, or as far as its
    forecasts reach, or else 10. No free run is demanded of a model of an unstable plant (see
    `runs_free`): its residuals are those of predictions one sample ahead. For an `anchored`
    forecaster, the time stamps of `record` count from the beginning of the training record.

    Raises
    ------
    ValueError
        For an unfitted forecaster, and a record with other columns or too few samples.
    """
    if ahead is not None:
        whole("ahead", ahead)
    fitted = fitted_of(forecaster)
    require_records("record", record)
    check_alike(record, fitted.record, "record")
    found = _simulated(forecaster, record)
    if found is None:
        raise InputError(
            f"record must have {2 * LAGS} samples after the warm-up of {forecaster.name}, which "
            f"takes {_warmup(forecaster, record)} samples in a row without gaps, got {len(record)}"
        )
    said, free = found
    with without_warnings(ExtrapolationWarning):
        begin = len(record) - len(said)
        fits = {"simulation": tuple(fit_percent(record.truth[begin:], said.y).tolist())}
        fits = (fits if free else {}) | _ahead(forecaster, record, begin, ahead)
        unchecked = "" if free else f"the model is {fitted.report.unstable()}"
        exported = any(simulator.own_times for simulator in simulators_of(forecaster))
        if exported or "simulator" in forecaster.needs:
            unchecked = "it needs the simulator's output beyond the record"
        leaves = None if unchecked else _leaves(forecaster, record, begin)
    tests = tests_of(record, said, late=not free)
    beyond = *fitted.inputs_beyond(record.u), *fitted.outputs_beyond(record.y_with_gaps)
    title = forecaster.title
    facts = fits, tests, leaves, unchecked, beyond, title, free
    return ModelCheck(forecaster.name, record, said, *facts)


def usual_ahead(forecaster: Forecaster) -> int:
    """Return the default of `ahead` of `check`."""
    if forecaster.held_out is not None and forecaster.held_out.ahead is not None:
        return forecaster.held_out.ahead
    return forecaster.require_fitted().report.reach or AHEAD


def tests_of(record: Record, simulated: Prediction, late: bool) -> tuple[ResidualTests, ...]:
    """Test the residuals of a simulation or forecast to the end of a record.

    With `late` inputs those of earlier samples alone are tested: behind a controller, inputs depend
    on the output of their own sample.
    """
    left = record.y_with_gaps[len(record) - len(simulated) :] - simulated.y
    u = record.u
    if late and u is not None:
        u = np.concatenate([u[:1], u[:-1]])
    return residual_tests(left, u, record.columns, record.inputs, simulated.y)


def tests_on(forecaster: Forecaster, record: Record) -> tuple[ResidualTests, ...]:
    """Test the residuals of a fitted forecaster on another record, as `check` does.

    Returns nothing for a record with too few samples for `check`.
    """
    found = _simulated(forecaster, record)
    return () if found is None else tests_of(record, found[0], late=not found[1])


def runs_free(forecaster: Forecaster, simulated: Array) -> bool:
    """Return whether a simulation `(time, ny)` of a forecaster is one to judge it by.

    That of an unstable plant is none, as errors grow without bound, nor that of a network with an
    unstable linear part where it leaves the range of training.
    """
    fitted = forecaster.require_fitted()
    if fitted.report.stable or fitted.report.reach is not None:
        return fitted.report.stable
    return leaves_range(fitted.y_range, simulated) is None


def _warmup(forecaster: Forecaster, record: Record) -> int:
    """Return the number of the first samples that set the state, as for test records."""
    return max(forecaster.warmup or default_warmup(len(record)), 2)


def _simulated(forecaster: Forecaster, record: Record) -> tuple[Prediction, bool] | None:
    """Simulate a record from a warm-up on its first samples to its end; None for a short one.

    A model that does not run free (`runs_free`), which is returned as well, predicts each of the
    last `MOST_ONE_AHEAD` samples from those before it instead.
    """
    begin = first_after(record.y_with_gaps, _warmup(forecaster, record))
    if begin is None or len(record) - begin < 2 * LAGS:
        return None
    other = not forecaster.anchored
    if forecaster.require_fitted().report.reach is None:
        with without_warnings(ExtrapolationWarning):
            said = forecaster.predict(**after(record, begin), other_record=other)
        if runs_free(forecaster, said.y):
            return said, True
    begin = max(begin, len(record) - MOST_ONE_AHEAD)
    origins = [Origin(0, at, 1) for at in range(begin, len(record))]
    known = known_of(forecaster, other_record=other, **after(record, begin))
    made = forecasts(forecaster.run_over(known), record, origins, other_record=other)
    y = np.concatenate([said.y for said in made.values()])
    return Prediction(y, record[:begin].grid.after(len(y)), record.columns), False


def _ahead(
    forecaster: Forecaster, record: Record, begin: int, ahead: int | None
) -> dict[str, tuple[float, ...]]:
    """Return the fits of predictions some samples ahead, from many origins."""
    origins = many_origins(0, begin, len(record), ahead or usual_ahead(forecaster))
    if not origins and ahead is not None:
        raise InputError(
            f"ahead must be at most {len(record) - begin}, the samples of the record after a "
            f"warm-up, got {ahead}"
        )
    made = forecasts(forecaster, record, origins, other_record=not forecaster.anchored)
    return {
        so_far_ahead(k): tuple(fit_ahead(record, made, k).tolist())
        for k in (horizons(origins[0].steps) if origins else ())
    }


def _leaves(forecaster: Forecaster, record: Record, begin: int) -> int | None:
    """Return the samples of a long free run, with inputs repeated, before it leaves the range."""
    steps = LONGER * len(record)
    u = None if record.u is None else np.tile(record.u, (LONGER + 1, 1))[begin : begin + steps]
    other = not forecaster.anchored
    long = forecaster.predict(steps, record[:begin], u=u, other_record=other)
    return leaves_range(forecaster.require_fitted().y_range, long.y)

"""Prepare the data for a forecast, and return the forecast with reasons to doubt it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from splitband.data import Record, check_alike
from splitband.data.preparation import seconds
from splitband.data.signals import last_before
from splitband.data.timing import same_sampling, zones_differ
from splitband.forecasters.known import Known, continued
from splitband.forecasters.prediction import Prediction
from splitband.metrics import leaves_range, leaving
from splitband.runtime.arrays import Array

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster


SHORT = 20_000
"""Longest training record with a simulator's output, in samples, that is saved whole. By eye."""
OVERFLOWED = 1e100
"""Replaces predicted values that are not finite, so that their errors are finite, and huge. Its
square is finite, too."""


def first_needed(forecaster: Forecaster) -> int:
    """Return the first sample of the training record that a forecast from its end needs."""
    record = forecaster.require_fitted().record
    if "simulator" in forecaster.needs and len(record) <= SHORT:
        return 0
    measured = ~np.isnan(record.seen)
    first = min(int(np.flatnonzero(channel)[-1]) for channel in measured.T)
    if forecaster.warmup:
        start = last_before(record.complete, forecaster.warmup, len(record))
        first = min(first, (forecaster.warmup if start is None else start) - forecaster.warmup)
    first -= max(forecaster.delays, default=0)
    if "simulator" in forecaster.needs:
        # A calibrated delay or clock uses earlier output, up to a seventh of the record.
        first = min(first, len(record) - len(record) // 5)
    return max(0, min(first, len(record) - 2))


def known_of(
    forecaster: Forecaster,
    steps: int,
    history: Record | None,
    u: npt.ArrayLike | None,
    y_sim: npt.ArrayLike | None,
    other_record: bool = False,
) -> tuple[Known, Record]:
    """Return the data for a forecast of `steps` samples, and the history; see `predict`."""
    fitted = forecaster.require_fitted()
    if other_record and forecaster.anchored:
        raise ValueError(
            f"history must go on from the training record for {forecaster.name}, which depends on "
            "the time since then"
        )
    past, begin = fitted.record, None if other_record else float(fitted.begin)
    if history is not None:
        check_alike(history, fitted.record, "history")
        step, own = fitted.record.sampling_time, history.sampling_time
        if forecaster.anchored and not same_sampling(step, own, len(history)):
            raise ValueError(
                f"history must be sampled like the training record for {forecaster.name}, which "
                f"depends on the time since then: every {step:.7g} s, got every {own:.7g} s"
            )
        past, begin = history, None if other_record else fitted.begins(history)
    inputs = None
    if u is not None and not np.isfinite(np.asarray(u, dtype=np.float64)).all():
        raise ValueError("u must hold finite numbers, got some that are not")
    if past.u is not None:
        inputs = continued("u", past.u, past.u_beyond, u, steps)
    elif u is not None:
        raise ValueError("u must be given exactly for a record with inputs, this has none")
    simulated = None
    if "simulator" in forecaster.needs:
        if past.y_sim is None:
            raise ValueError(
                f"history must bring a simulator's output (y_sim) for {forecaster.name}"
            )
        simulated = continued("y_sim", past.y_sim, past.beyond, y_sim, steps, more=True)
    own = history is None and not other_record
    return Known(past.seen, steps, begin, inputs, simulated, past.grid, own), past


def known_at_origin(
    forecaster: Forecaster, history: Record | None, other_record: bool = False
) -> Known:
    """Return the data at the end of a history, by default of the training record."""
    past = forecaster.require_fitted().record if history is None else history
    u = None if past.u is None else past.u[:0]
    y_sim = None if past.y_sim is None or past.beyond is not None else past.y_sim[:0]
    return known_of(forecaster, 0, history, u, y_sim, other_record)[0]


def predicted(forecaster: Forecaster, known: Known, past: Record) -> Prediction:
    """Return the prediction of a forecaster, with the reasons to doubt it."""
    fitted, steps = forecaster.require_fitted(), known.steps
    extrapolated = forecaster.extrapolate(known)
    parts = extrapolated if isinstance(extrapolated, dict) else {"": extrapolated}
    y = total([*parts.values()])
    if y.shape != (steps, past.ny):
        raise ValueError(
            f"{forecaster.name} must extrapolate {steps} samples of {past.ny} channel(s), "
            f"got the shape {y.shape}"
        )
    beyond = fitted.inputs_beyond(None if known.u is None else known.u[len(known.y) :])
    messages = [each.describe(past.inputs[each.channel]) for each in beyond]
    messages += (doubts := forecaster.doubts(known))
    if zones_differ(past.start, fitted.record.start):
        messages.append(
            "of the dates of the history and of the training record just one has a time zone: "
            f"the two were not compared ({past.grid} and {fitted.record.grid})"
        )
    left = leaves_range(fitted.y_range, y)
    if left is not None:
        messages.append(f"the prediction of {forecaster.name} {leaving(left)}")
    return Prediction(
        y,
        past.grid.after(steps),
        past.columns,
        parts if len(parts) > 1 else {},
        warnings=tuple(messages),
        doubts=tuple(doubts),
    )


def prepared_like(
    record: Record, history: Record, u: npt.ArrayLike | None, y_sim: npt.ArrayLike | None
) -> tuple[Record, npt.ArrayLike | None, npt.ArrayLike | None]:
    """Return a history, future inputs and future simulator output, prepared like a record."""
    prepared = history.prepared_as(record)
    for step in record.prepared:
        if u is not None:
            u = np.asarray(u, np.float64).reshape(-1, history.nu)
            u = step.inputs(u, seconds_after(prepared, len(u)))
        if y_sim is not None:
            y_sim = np.asarray(y_sim, np.float64).reshape(-1, history.ny)
            y_sim = step.outputs(y_sim, seconds_after(prepared, len(y_sim)))
    return prepared, u, y_sim


def seconds_after(record: Record, samples: int) -> Array:
    """Return the times of the `samples` that follow a record, in s."""
    return np.asarray(seconds(record)[-1] + record.sampling_time * np.arange(1.0, samples + 1))


def total(parts: Sequence[Array]) -> Array:
    """Return the sum of the components, with `OVERFLOWED` where it is not finite."""
    most = OVERFLOWED
    return np.nan_to_num(np.sum(parts, axis=0), nan=most, posinf=most, neginf=-most)

"""Predict: what is known at an origin, the forecast from it, and the median of several.

Several trainings are combined by the median of their predictions, sample by sample. One that goes
astray, on inputs that it has not learned from, moves a mean as far as it goes itself, and a median
hardly (docs/developers/rules.md).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt
import pandas as pd

from splitband.metrics import leaves_range, leaving
from splitband.records import Grid, Record, aligned, check_alike
from splitband.records.alignment import log, reach
from splitband.records.preparation import in_turn
from splitband.records.signals import same_names, signal_of
from splitband.records.timing import same_sampling, seconds_between, stamps_at, zones_differ
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.training.settings import default_warmup

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from splitband.forecasters.base import Forecaster


@dataclass(frozen=True, eq=False)
class ForecastContext:
    """The data that a forecaster may use for a forecast.

    Attributes
    ----------
    y : Measured samples up to the origin, `(time, ny)`, NaN in gaps.
    steps : Number of samples to forecast.
    begin : Index of the first sample of `y`, counted from the first one of the training record;
        None for a record with an unrelated time.
    u : The inputs of history and forecast, `(time + steps or more, nu)`, where there are any.
    y_sim : A simulator's output over the same samples, `(time + steps or more, ny)`, if any.
    grid : The times of `y`, by the clock of its record.
    own : Whether `y` is the training record or its end, to which the model is already fitted.
    since : First row of a trajectory that is used; the rows before it are ignored.
    """

    y: Array
    steps: int
    begin: float | None = 0.0
    u: Array | None = None
    y_sim: Array | None = None
    grid: Grid | None = None
    own: bool = False
    since: int = 0


def by_name(name: str, given: npt.ArrayLike | None, names: Sequence[str]) -> npt.ArrayLike | None:
    """Return a signal whose columns, where it is a DataFrame, are in the order of these names."""
    if not isinstance(given, pd.DataFrame) or not names:
        return given
    columns = {str(column): column for column in given.columns}
    if sorted(columns) == sorted(names):
        return given[[columns[each] for each in names]]
    if not same_names([*columns], names):
        raise InputError(
            f"{name} must have the columns {', '.join(names)}, got {', '.join(columns)}"
        )
    return given


def continued(name: str, past: Array, given: npt.ArrayLike | None, steps: int) -> Array:
    """Return a signal up to the origin and, as `given`, after it, `steps` samples or more.

    Raises
    ------
    ValueError
        For too few samples ahead, another number of channels, and given samples that are not
        finite or begin with those of the history.
    """
    n, channels = past.shape
    values = past[:0] if given is None else signal_of(name, given)
    if len(values) < steps or values.shape[1] != channels:
        raise InputError(
            f"{name} must hold the {steps} samples to predict in {channels} channel(s), got "
            f"{'none' if given is None else values.shape}"
        )
    if not np.isfinite(values).all():
        raise InputError(f"{name} must hold finite numbers, got some that are not")
    whole = len(values) >= n + steps and np.array_equal(values[:n], past)
    if whole and n and np.ptp(past):
        raise InputError(
            f"{name} must hold the {steps} samples to predict alone, got the {n} of the history "
            "first"
        )
    return np.concatenate([past, values])


def inputs_after(
    past: Record, coming: Record, steps: int, name: str, stamped: bool = True
) -> Array:
    """Return the inputs after a record, `(steps or more, nu)`: those of the `coming` record.

    The coming record, as it was measured, is prepared like the past one; its outputs are its
    inputs, as a plan has no others. They are aligned by the time stamps of both records. Without
    any, or if they are not to count (`stamped`), the first coming sample follows the last one of
    the past.

    Raises
    ------
    ValueError
        If only one of both has time stamps, and for inputs that do not cover the steps.
    """
    ahead = past.grid.after(steps)
    ahead = ahead if stamped else replace(ahead, start=None)
    if (coming.start is None) != (ahead.start is None):
        lacks = "the planned inputs" if coming.start is None else "these samples"
        raise InputError(
            f"{name} and the samples before it must both have time stamps, or neither: {lacks} "
            "have none, so that the first planned row may belong to the first of these samples or "
            "follow the last; with time_column='' (--time-column '') no stamps count, and it "
            "follows the last"
        )
    if same_names(coming.columns, past.inputs):  # numbered, which match any
        coming = replace(coming, columns=past.inputs, inputs=past.inputs)
    coming = _means_after(past, coming, ahead).like(past)
    assert coming.u is not None
    held = past.reading.holds(past.inputs)
    u = aligned(name, coming.u, coming.grid, ahead, held)
    if u.note:
        log.info("%s: %s", name, u.note)
    if (more := reach(coming.grid, ahead)) > steps:  # for a simulator whose output is late
        ahead = replace(ahead, samples=more)
        u = aligned(name, coming.u, coming.grid, ahead, held)
    assert past.u is not None
    values = np.array(u.values)
    for i, each in enumerate(past.inputs):
        if period := past.reading.periods.get(each):
            values[:, i] = in_turn(values[:, i], past.u[-1, i], period)
    return continued("u", past.u, values, steps)[len(past) :]


def _means_after(past: Record, coming: Record, ahead: Grid) -> Record:
    """Return the rows of a record of shorter step of which `resample` takes the means `ahead`."""
    k = round(past.sampling_time / coming.sampling_time)
    if past.reading.step is None or k < 2:
        return coming
    first = 0
    if ahead.start is not None and coming.start is not None:
        # A mean has the time stamp of its last row.
        last = seconds_between(coming.start, ahead.start) / coming.sampling_time
        first = (round(last) + 1) % k
    return coming[first : len(coming) - (len(coming) - first) % k]


def median_components(
    parts: Sequence[Mapping[str, Array]], totals: Sequence[Array]
) -> dict[str, Array]:
    """Return components, of the members in the middle, that add up to the median."""
    count = len(totals)
    ordered = np.argsort(totals, axis=0, kind="stable")
    middle = ordered[(count - 1) // 2 : count // 2 + 1]
    return {
        name: np.take_along_axis(np.array([each[name] for each in parts]), middle, 0).mean(axis=0)
        for name in parts[0]
    }


def median(values: Sequence[Array]) -> Array:
    """Return the median by comparing pairs (odd-even sort), which an export can write down."""
    ordered, count = [*values], len(values)
    for turn in range(count):
        for i in range(turn % 2, count - 1, 2):
            pair = ordered[i], ordered[i + 1]
            ordered[i], ordered[i + 1] = np.minimum(*pair), np.maximum(*pair)
    return (ordered[(count - 1) // 2] + ordered[count // 2]) / 2


@dataclass(frozen=True, eq=False, repr=False)
class Prediction:
    """A prediction: the samples that follow an origin.

    Attributes
    ----------
    y : `(steps, ny)`, in the record's unit.
    grid : The times of the samples.
    columns : Names of the channels.
    components : The components that add up to `y`, by name; empty where there is only one.
    lower, upper : The interval around `y`, `(steps, ny)`, if requested.
    level : The share of samples that should lie in the interval.
    warnings : Reasons to doubt the prediction, in sentences.
    doubts : Those of them that come from the method itself, see `Forecaster.doubts`.
    """

    y: Array
    grid: Grid
    columns: tuple[str, ...]
    components: Mapping[str, Array] = field(default_factory=dict)
    lower: Array | None = None
    upper: Array | None = None
    level: float | None = None
    warnings: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.y)

    @property
    def time(self) -> Array | pd.DatetimeIndex:
        """Return the time stamps, `(steps,)`: seconds or dates; else seconds after the origin."""
        rows = np.arange(len(self))
        if self.grid.start is None:
            return stamps_at(0.0, self.grid.step, 1 + rows)
        return stamps_at(self.grid.start, self.grid.step, rows)

    def to_frame(self) -> pd.DataFrame:
        """Return a table with a column of time stamps and one for each channel and its interval."""
        table: dict[str, object] = {time_header(self.columns): self.time}
        for i, column in enumerate(self.columns):
            table[column] = self.y[:, i]
            if self.lower is not None and self.upper is not None:
                table[f"{column}, lower"] = self.lower[:, i]
                table[f"{column}, upper"] = self.upper[:, i]
        return pd.DataFrame(table)

    def __repr__(self) -> str:
        level = "" if self.level is None else f", with a {100 * self.level:g} % interval"
        return f"<Prediction of {', '.join(self.columns)}: {self.grid}{level}>"

    def _repr_html_(self) -> str:
        """Return the first and last rows as a table, for notebooks."""
        return f"<p>{escape(repr(self))}</p>{self.to_frame().to_html(max_rows=10, index=False)}"

    def plot(self) -> Figure:
        """Return a plot of the prediction."""
        from splitband.report.pictures import prediction  # noqa: PLC0415  of a higher layer

        return prediction(self)


def median_of(predictions: Sequence[Prediction]) -> Prediction:
    """Return the median of several predictions of the same samples, such as those of several seeds.

    Of components that all of them have, it takes those of the predictions in the middle; the
    warnings of all are kept.
    """
    first = predictions[0]
    totals = [p.y for p in predictions]
    shared = [name for name in first.components if all(name in p.components for p in predictions)]
    parts = [{name: p.components[name] for name in shared} for p in predictions]
    return replace(
        first,
        y=np.median(totals, axis=0),
        components=median_components(parts, totals),
        lower=None,
        upper=None,
        level=None,
        warnings=tuple(dict.fromkeys(said for p in predictions for said in p.warnings)),
        doubts=tuple(dict.fromkeys(said for p in predictions for said in p.doubts)),
    )


def time_header(columns: tuple[str, ...]) -> str:
    """Return a name for the time column that differs from those in `columns`."""
    name = "time"
    while name in columns:
        name += " (s)"
    return name


OVERFLOWED = 1e100
"""Replaces predicted values that are larger or not finite, so that their errors are finite, and
huge. Its square is finite, too."""


def known_of(
    forecaster: Forecaster,
    steps: int,
    history: Record | None,
    other_record: bool = False,
    u: npt.ArrayLike | None = None,
    y_sim: npt.ArrayLike | None = None,
) -> ForecastContext:
    """Return the data for a forecast of `steps` samples after a history; see `predict`."""
    fitted = forecaster.require_fitted()
    if other_record and history is None:
        raise InputError("history must be given where other_record is True, got none")
    if other_record and forecaster.anchored:
        raise InputError(
            f"history must go on from the training record for {forecaster.name}, which depends on "
            "the time since then"
        )
    past, begin = fitted.record, None if other_record else float(fitted.begin)
    if history is not None:
        check_alike(history, fitted.record, "history")
        step, own = fitted.record.sampling_time, history.sampling_time
        if forecaster.anchored and not same_sampling(step, own, len(history)):
            raise InputError(
                f"history must be sampled like the training record for {forecaster.name}, which "
                f"depends on the time since then: every {step:.7g} s, got every {own:.7g} s"
            )
        past, begin = history, None if other_record else fitted.begins(history)
    inputs = None
    if past.u is not None:
        inputs = continued("u", past.u, u, steps)
    elif u is not None:
        raise InputError("u must be left out: the record has no inputs")
    simulated = None
    if "simulator" in forecaster.needs:
        if past.y_sim is None:
            raise InputError(
                f"history must bring a simulator's output (y_sim) for {forecaster.name}"
            )
        simulated = past.y_sim
        if y_sim is not None or len(simulated) < len(past) + steps:
            simulated = continued("y_sim", simulated[: len(past)], y_sim, steps)
    own = history is None
    return ForecastContext(past.y_with_gaps, steps, begin, inputs, simulated, past.grid, own)


def extrapolated(forecaster: Forecaster, known: ForecastContext) -> tuple[Array, dict[str, Array]]:
    """Return a forecast and its components; raises ValueError for one of another shape."""
    found = forecaster.extrapolate(known)
    parts = found if isinstance(found, dict) else {"": found}
    y, ny = total([*parts.values()]), known.y.shape[1]
    if y.shape != (known.steps, ny):
        raise InputError(
            f"{forecaster.name} must extrapolate {known.steps} samples of {ny} channel(s), "
            f"got the shape {y.shape}"
        )
    return y, parts


def predicted(forecaster: Forecaster, known: ForecastContext, past: Record) -> Prediction:
    """Return the prediction of a forecaster, with the reasons to doubt it."""
    fitted, steps = forecaster.require_fitted(), known.steps
    y, parts = extrapolated(forecaster, known)
    beyond = fitted.inputs_beyond(None if known.u is None else known.u[len(known.y) :][:steps])
    messages = [each.describe(past.inputs[each.channel], " of the prediction") for each in beyond]
    used = known.y[-(forecaster.warmup or default_warmup(len(known.y))) :]
    messages += [
        each.describe(past.columns[each.channel], f" of the history's last {len(used)}")
        for each in fitted.outputs_beyond(used)
    ]
    unseen = np.asarray(np.isnan(known.y).all(axis=0))
    messages += [
        f"output {name} was not measured in the history, and is assumed as in training"
        for name, never in zip(past.columns, unseen, strict=True)
        if never
    ]
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


def total(parts: Sequence[Array]) -> Array:
    """Return the sum of the components, with `OVERFLOWED` where it is larger or not finite."""
    y = np.sum(parts, axis=0)
    return np.where(abs(y) < OVERFLOWED, y, OVERFLOWED)

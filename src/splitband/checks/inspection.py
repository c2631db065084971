"""Inspect a record before a model is fitted to it: likely inputs, dead time, spectrum, command.

Which columns are inputs is decided by four kinds of evidence: whether a column moves in steps,
whether its past explains other columns and theirs does not explain it (Granger causality), whether
it is named like an input, and whether it follows others. Constants were chosen on drawn records.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
import pandas as pd

from splitband.checks.simulator import SimulatorCheck, simulator_check
from splitband.filters.cutoff import LEFT_BY_NETWORK, MOST_LOST
from splitband.filters.spectrum import periodogram
from splitband.forecasters.bands import Bands
from splitband.forecasters.held_out import TRAINING_SHARE, beginning
from splitband.forecasters.simulation import Calibrated
from splitband.linear.delays import delays_of
from splitband.records import Record, read, require_records
from splitband.records.reading import Source
from splitband.records.signals import (
    Column,
    bare_name,
    categories_of,
    category_names,
    listed,
    row_ranges,
    unit_of,
)
from splitband.records.timing import UnevenError, as_json
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.system import quoted
from splitband.training.settings import recipe_settings

Role = Literal["input", "output", "constant", "label?"]
INPUT_NAMES = """
u in inp input cmd command sp setpoint ref reference target demand force valve heater pump fan
voltage pwm duty throttle pedal brake steer steering rudder elevator aileron ctrl control controller
actuator actuation mv opening switch stimulus excitation disturbance ambient
"""
OUTPUT_NAMES = "y out output pv response sensor measured measurement"
RUN_NAMES = "run test trial batch experiment label"
LABEL_NAMES = f"{RUN_NAMES} cycle mode phase stage segment"
TEXT_NAMES = f"{RUN_NAMES} operator user comment remark note"
"""Words in the names of inputs, of outputs, of what labels runs or samples, and of text that does
not act on the system. Convention."""
LAGS, SPACINGS = 12, (1, 4, 16, 64)
"""Past samples by column in ARX models, and their spacings in samples: slow effects show in none of
a single sample. No choice on 39 drawn records depends on it."""
MOST_ROWS, DEAD_TIME_ROWS = 8000, 4000
"""Samples in these models, and first ones in the estimate of dead times. Bounds the time."""
NOISE = 1e-3
"""Noise that all columns are taken to have, in standard deviations: what is explained beyond it is
rounding. No choice on 39 drawn records depends on it."""
LEAST = 0.02
"""Least share of the residual that the past of a column explains. As in `linear.delays`."""
PLAIN = 0.25
"""Explained over unexplained variance that is plain. No choice on 39 drawn records depends on
it."""
LEAD = 8.0
"""Ratio of explained to unexplained variance in one direction, over the other, of a column that
leads. No choice on 39 drawn records depends on it."""
HELD, JUMP = 0.6, 0.05
"""Least share of samples that repeat the one before, and least median change in the range, of a
column that moves in steps. By eye."""


@dataclass(frozen=True)
class InspectedColumn:
    """A column of a record, and what it probably is.

    Attributes
    ----------
    name : Its name, with the unit in brackets, if any.
    role : "input", "output", "constant", or "label?" for one that may number runs or samples.
    reasons : Why, in words: "moves in 50 steps", "leads level", "is named so".
    lowest, highest : Its range.
    missing : Number of samples without a value.
    """

    name: str
    role: Role
    reasons: tuple[str, ...]
    lowest: float
    highest: float
    missing: int

    @property
    def clear(self) -> bool:
        """Return whether there are two reasons or more."""
        return len(self.reasons) > 1

    @property
    def range(self) -> str:
        """Return the range with the unit."""
        ends = f"{self.lowest:.5g} to {self.highest:.5g}"
        return (
            f"{ends} {unit_of(self.name)}".rstrip()
            if self.lowest < self.highest
            else (f"{self.lowest:.5g} {unit_of(self.name)}".rstrip())
        )


@dataclass(frozen=True, eq=False)
class Inspection:
    """What a record holds, and how to read it.

    Attributes
    ----------
    record : The record with its columns as they probably are; constant ones are left out.
    columns : All columns.
    dead_times : Dead time in s of each input at each output, by their names.
    doubtful : Those that neither half of the record shows by itself: a slow or nonlinear response
        can look like one.
    peaks : Strongest peaks of the outputs' spectrum: frequency in Hz and share of the power.
    train : First samples, on which the cut-off is chosen.
    bands : Cut-off that `compare` chooses on the same ones for methods of two bands.
    share_above : Share of the power above it.
    simulator : How the record's simulator compares with it, if it has one.
    warnings : What seems wrong, a sentence each; see `Record.warnings`.
    """

    record: Record
    columns: tuple[InspectedColumn, ...]
    dead_times: Mapping[tuple[str, str], float]
    doubtful: Collection[tuple[str, str]]
    peaks: Sequence[tuple[float, float]]
    train: int
    bands: Bands
    share_above: float
    simulator: SimulatorCheck | None = None
    warnings: Sequence[str] = field(default_factory=tuple)

    @property
    def options(self) -> dict[str, Any]:
        """Return the arguments of `read`, and options of commands, that read the record like this.

        `columns` is there only where columns are left out, `gaps` where values are missing, `step`
        where stamps are uneven.
        """
        record, found = self.record, dict[str, Any]()
        if record.nu:
            found["inputs"] = [*dict.fromkeys(map(record.reading.column, record.inputs))]
        if any(column.role in ("constant", "label?") for column in self.columns):
            found["columns"] = [*record.columns]
        found |= {} if record.reading.grid is None else {"step": record.sampling_time}
        return found if record.measured is None else found | {"gaps": "mask"}

    def in_words(self) -> list[str]:
        """Return sampling, dead times and spectrum, a sentence each."""
        return [_sampling(self.record), *self._dead_times(), *self._spectrum()]

    def _dead_times(self) -> list[str]:
        step = self.record.sampling_time
        late = {pair: seconds for pair, seconds in self.dead_times.items() if seconds}
        doubt = "; uncertain, as neither half of the record shows it"
        said = [
            f"{u} to {y} {s:.4g} s ({s / step:.0f} samples{doubt * ((u, y) in self.doubtful)})"
            for (u, y), s in late.items()
        ]
        return [f"dead time: {', '.join(said) or 'none'}"] if self.dead_times else []

    def _spectrum(self) -> list[str]:
        peaks = ", ".join(f"{f:.4g} Hz ({_percent(share)})" for f, share in self.peaks)
        said = [f"strongest frequencies, with their shares of the power: {peaks}"] if peaks else []
        choice, cutoff = self.bands.choice, self.bands.cutoff or 0.0
        if self.simulator is not None:
            return [*said, *([] if choice is None else [choice.reason]), *self.simulator.in_words()]
        if choice is None and not cutoff:
            return said
        above = f"{_percent(self.share_above)} of the power lies above {cutoff:.4g} Hz"
        if self.share_above < LEFT_BY_NETWORK:
            return [*said, f"no high band: nothing to split, {above}"]
        if choice is not None and choice.expected > MOST_LOST:
            return [*said, f"no two bands: nothing to split, {choice.reason}"]
        return [*said, f"two bands: {above}, so methods such as split-gru can split the signal"]

    def as_json(self) -> dict[str, Any]:
        """Return everything for results.json."""
        record = self.record
        return {
            "record": record.name,
            "samples": len(record),
            "sampling_time": record.sampling_time,
            "jitter": record.reading.jitter,
            "start": as_json(record.start),
            "gaps": int((~record.complete).sum()),
            "columns": [asdict(each) | {"unit": unit_of(each.name)} for each in self.columns],
            "inputs": [*record.inputs],
            "outputs": [*record.columns],
            "dead_times": [
                {"input": u, "output": y, "seconds": late, "doubtful": (u, y) in self.doubtful}
                for (u, y), late in self.dead_times.items()
            ],
            "peaks": [{"frequency": f, "share": share} for f, share in self.peaks],
            "train": self.train,
            **asdict(self.bands),
            "share_above": self.share_above,
            **({} if self.simulator is None else {"simulator": asdict(self.simulator)}),
            "options": self.options,
            "in_words": self.in_words(),
            "warnings": [*self.warnings],
        }

    def __repr__(self) -> str:
        rows = [f"{c.name}: {', '.join([c.role, c.range, *c.reasons])}" for c in self.columns]
        options = ", ".join(f"{name}={value!r}" for name, value in self.options.items())
        said = [*rows, *self.in_words(), *(f"warning: {each}" for each in self.warnings)]
        return "\n".join([*said, *([f"read with {options}"] if options else [])])


def inspect(
    record: Record | pd.DataFrame, train: int | None = None, bands: Bands | None = None
) -> Inspection:
    """Return what a record or a table holds: likely inputs with the reasons, dead times, warnings.

    Nothing is fitted but linear regressions: it takes about a second.

    Parameters
    ----------
    record : A record, whose inputs stay inputs, or a table as for `read`. Columns of words in a
        table count as inputs.
    train : Samples on which the cut-off is chosen, by default three quarters.
    bands : Cut-off and order where they are given.

    Raises
    ------
    ValueError
        As `read`, for a table that cannot be read.

    Examples
    --------
    >>> valve = np.repeat([0, 1, 0, 1, 1, 0, 1, 0, 0, 1], 20)
    >>> level = np.convolve(valve, 0.1 * 0.9 ** np.arange(100))[:200]
    >>> record = sb.Record(np.column_stack([valve, level]), 1.0, columns=["valve", "level"])
    >>> found = sb.inspect(record)
    >>> found.record.inputs, found.columns[0].reasons
    (('valve',), ('switches 7 times between 0 and 1', 'is named so'))
    """
    found: Record = as_found(record) if isinstance(record, pd.DataFrame) else record
    require_records("record", found)
    columns = inspected_columns(found)
    record = _arranged(found, columns)
    train = int(TRAINING_SHARE * len(record)) if train is None else train
    training = beginning(record, whole("train", train, 2, len(record)))
    bands = _bands(training, bands or Bands())
    spectrum, rate = periodogram(record.y, record.sampling_rate), record.sampling_rate
    above = 1 - periodogram(training.y, rate).share_below(bands.cutoff or rate)
    (late, doubtful), beside = _dead_times(record), simulator_check(record, train, bands)
    said = [*of_labels(columns), *record.warnings()]
    said += [] if beside is None else beside.warnings()
    peaks = spectrum.peaks()
    return Inspection(record, columns, late, doubtful, peaks, train, bands, above, beside, said)


def as_found(source: Source, columns: Any = None, inputs: Any = None, **how: Any) -> Any:
    """Read a record to inspect it: missing values are masked, uneven stamps put on an even grid.

    Columns of words are inputs where no columns are named.
    """
    if columns is None and inputs is None:
        inputs = holds_words
    how |= {"columns": columns, "inputs": inputs, "gaps": "mask"}
    try:
        return read(source, **how)
    except UnevenError:
        return read(source, **how | {"step": "auto"})


def holds_words(column: Column) -> bool:
    """Return whether a column of a table holds categories, each more than once, that may act."""
    words, called = categories_of(column), _words(str(column.name))
    repeats = 2 * len(words) < int(column.notna().sum())
    return bool(words) and repeats and not called & {*TEXT_NAMES.split()}


def inspected_columns(record: Record) -> tuple[InspectedColumn, ...]:
    """Return the columns of a record, inputs first, each with its likely role and the reasons."""
    signals = {name: record.signals[name] for name in (*record.inputs, *record.columns)}
    held = pd.DataFrame(signals).ffill().bfill()
    (odds, chance), names = _links(held.to_numpy()), [*signals]
    drives, follows = odds.max(axis=1, initial=0.0), odds.max(axis=0, initial=0.0)
    words = {n: of for c, of in record.reading.categories.items() for n in category_names(c, of)}
    roles, reasons = dict[str, Role](), dict[str, tuple[str, ...]]()
    for i, name in enumerate(names):
        doubt = max(follows[i], chance[i, odds[i].argmax()])
        leads = drives[i] > LEAST and drives[i] >= LEAD * doubt
        states = words.get(name, ())
        moves, switch = _moves(held[name].to_numpy(), states)
        led, leader = (names[int(each.argmax())] for each in (odds[i], odds[:, i]))
        called = _words(name)
        for_input = [moves] if moves else []
        for_input += [f"leads {led}"] if leads else []
        for_input += ["is named so"] if called & {*INPUT_NAMES.split()} else []
        followed = follows[i] > LEAST and not leads
        acts = not followed or (
            drives[i] > LEAST and (switch or bool(called & {*INPUT_NAMES.split()}))
        )
        if not np.ptp(signals[name][np.isfinite(signals[name])]):
            roles[name], reasons[name] = "constant", ("has one value",)
        elif name in record.inputs:
            roles[name], reasons[name] = "input", tuple(for_input or ["is given as one"])
        elif label := _as_label(name, signals[name]):
            roles[name], reasons[name] = "label?", (label,)
        elif for_input and acts and not (called & {*OUTPUT_NAMES.split()} and len(for_input) == 1):
            roles[name], reasons[name] = "input", tuple(for_input)
        else:
            roles[name] = "output"
            reasons[name] = (f"follows {leader}",) if followed else ()
    if "output" not in roles.values() and (
        free := [n for n in record.columns if roles[n] == "input"]
    ):
        last = max(free, key=lambda name: follows[names.index(name)])
        roles[last], reasons[last] = "output", ("is left to be one",)
    return tuple(
        InspectedColumn(
            name,
            roles[name],
            reasons[name],
            float(np.nanmin(x)),
            float(np.nanmax(x)),
            int(np.isnan(x).sum()),
        )
        for name, x in signals.items()
    )


def unnamed_inputs(record: Record) -> tuple[InspectedColumn, ...]:
    """Return the outputs of a record that are probably inputs, without inputs, or number runs."""
    labels = map(_as_label, record.columns, record.y_with_gaps.T)
    if record.ny < 2 or (record.nu and not any(labels)):
        return ()
    return tuple(
        c
        for c in inspected_columns(record)
        if c.role == "label?" or (c.role == "input" and not record.nu)
    )


def of_unnamed(columns: Sequence[InspectedColumn]) -> list[str]:
    """Return a sentence on likely inputs that are not named, first on those that are clear."""
    said = of_labels(columns)
    columns = [column for column in columns if column.role == "input"]
    for how, clear in (("probably", True), ("perhaps", False)):
        found = {c.name: c.reasons for c in columns if c.clear is clear}
        why = ", ".join(f"{name!r} ({', '.join(reasons)})" for name, reasons in found.items())
        way = f"inputs={[*found]} (--inputs {quoted(listed([*found]))})"
        said += [f"{how} inputs, not outputs: {why}; {way} takes them as such"] if found else []
    return said


def of_labels(columns: Sequence[InspectedColumn]) -> list[str]:
    """Return a question on each column that may number runs or samples."""
    return [
        f"{c.name!r} {', '.join(c.reasons)}, {c.lowest:g} to {c.highest:g}: does it number runs, "
        f"label samples, or act on the system? runs={c.name!r} (--runs {quoted(c.name)}) reads "
        f"each run as a record of its own, inputs=[{c.name!r}, ...] (--inputs) takes the column as "
        "an input, and columns (--columns) without it leaves it out"
        for c in columns
        if c.role == "label?"
    ]


def _words(name: str) -> set[str]:
    """Return the words of a name in small letters, "u" and "cmd" of "U_cmd [V]"."""
    return {word.lower() for word in re.findall(r"[A-Z]+(?![a-z])|[A-Z]?[a-z]+", bare_name(name))}


def _as_label(name: str, x: Array) -> str:
    """Return why a column of whole numbers may number runs or samples, in words, or ""."""
    x = x[np.isfinite(x)]
    steps, step_test = np.diff(x), x[0] == 0 and np.ptp(x) == 1
    few = 0 < np.count_nonzero(steps) <= (1 - HELD) * len(steps)
    if not few or (x != np.round(x)).any():
        return ""
    if np.isin(steps, (0, 1)).all() and not step_test:
        return "counts up in steps"
    return "is named as a label" if _words(name) & {*LABEL_NAMES.split()} else ""


def _percent(share: float) -> str:
    """Return a share in per cent, with two digits."""
    return f"{100 * share:.0f} %" if share >= 0.095 else f"{100 * share:.2g} %"


def _sampling(record: Record) -> str:
    """Return number, step, jitter and gaps of the samples in words."""
    jitter, missing = record.reading.jitter, ~record.complete
    step = f"{len(record)} samples every {record.sampling_time:.6g} s"
    step += "" if record.start is None else f", {record.grid}"
    uneven = "even" if jitter < 1e-6 * record.sampling_time else f"steps vary by {jitter:.2g} s"
    gaps = f"{missing.sum()} masked ({row_ranges(missing)})" if missing.any() else "no gaps"
    return f"{step}; {uneven}; {gaps}"


def _moves(x: Array, words: Sequence[str] = ()) -> tuple[str, bool]:
    """Return how a column moves in steps, in words, if it does, and whether it has two values."""
    steps, levels = np.abs(np.diff(x)), np.unique(x)
    jumps = steps[steps > 0]
    if len(words) > 2:
        return f"holds one of {', '.join(words)}", True
    if len(levels) == 2:
        states = words or [f"{level:.6g}" for level in levels]
        times = f"{len(jumps)} times " if len(jumps) > 1 else ""
        return f"switches {times}between {' and '.join(states)}", True
    steep = len(jumps) and np.median(jumps) > JUMP * np.ptp(x)
    few = len(jumps) <= (1 - HELD) * len(steps)
    return (f"moves in {len(jumps)} steps" if steep and few else ""), False


def _links(x: Array) -> tuple[Array, Array]:
    """Return how much the past of columns explains others, `(cause, effect)`, and what chance does.

    It is explained variance, beside the past of all others, over what stays unexplained, in ARX
    models with ridge regularisation by `NOISE`, and 0 where it may be chance. Of a pair, the models
    of the first spacing count in which one of both explains `PLAIN` of the other, else those in
    which it explains most: far apart, an output tells what its input did between its samples.
    """
    n, count = x.shape
    scale = x.std(axis=0)
    x = (x - x.mean(axis=0)) / np.where(scale > 0, scale, 1.0)
    found, by_chance = np.zeros((count, count)), np.zeros((count, count))
    settled = np.eye(count, dtype=bool)
    for spacing in SPACINGS:
        free = n // spacing  # samples that are not about the same
        lags = min(LAGS, min(free, MOST_ROWS) // (10 * count))
        if count < 2 or lags < 3 or free < 8 * LAGS:
            break
        first = lags * spacing
        rows = np.unique(np.linspace(first, n - 1, min(n - first, MOST_ROWS)).astype(int))
        past = x[rows[:, None] - spacing * np.arange(1, lags + 1)]  # (rows, lags, columns)
        z = np.column_stack([past.transpose(0, 2, 1).reshape(len(rows), -1), np.ones(len(rows))])
        y = x[rows]
        gram = z.T @ z / len(rows) + NOISE**2 * np.eye(z.shape[1])
        both, inverse = z.T @ y / len(rows), np.linalg.inv(gram)
        weights = inverse @ both
        left = np.maximum((y**2).mean(axis=0) - (both * weights).sum(axis=0), 0.0) + NOISE**2
        chance = (lags + 4 * np.sqrt(2 * lags)) / min(len(rows), free)
        gained = np.zeros((count, count))
        for cause in range(count):
            own = slice(cause * lags, (cause + 1) * lags)
            h = weights[own]
            gained[cause] = (h * np.linalg.solve(inverse[own, own], h)).sum(axis=0) / left
        gained[gained < chance] = 0.0
        either, so_far = np.maximum(gained, gained.T), np.maximum(found, found.T)
        taken = ~settled & (either > so_far)
        found, by_chance = np.where(taken, gained, found), np.where(taken, chance, by_chance)
        settled |= either > PLAIN
    return found, by_chance


def _arranged(record: Record, columns: Sequence[InspectedColumn]) -> Record:
    """Return the record with likely inputs as inputs, without constant outputs."""
    roles = {column.name: column.role for column in columns}
    inputs = [*record.inputs, *(n for n in record.columns if roles[n] == "input")]
    outputs = [name for name in record.columns if roles[name] == "output"]
    if not outputs:
        raise InputError(f"the record must have a column that varies: got {', '.join(roles)}")
    if len(outputs) == record.ny:
        return record
    at, signals = [record.columns.index(name) for name in outputs], pd.DataFrame(record.signals)
    beside = {
        name: None if signal is None else signal[:, at]
        for name, signal in (("y_sim", record.y_sim), ("y_true", record.y_true))
    }
    return Record.with_gaps(
        signals[outputs].to_numpy(),
        record.sampling_time,
        u=signals[inputs].ffill().bfill().to_numpy() if inputs else None,
        columns=tuple(outputs),
        inputs=tuple(inputs),
        name=record.name,
        start=record.start,
        reading=record.reading,
        **beside,
    )


def _dead_times(
    record: Record,
) -> tuple[dict[tuple[str, str], float], frozenset[tuple[str, str]]]:
    """Return the dead times in s by input and output, and which of them neither half shows.

    They are those of the first samples of a long record.
    """
    if record.u is None:
        return {}, frozenset()
    y, u = record.y_with_gaps[:DEAD_TIME_ROWS], record.u[:DEAD_TIME_ROWS]
    delays, middle = delays_of([(y, u)]).taken, len(y) // 2
    shown = np.ones(delays.shape, bool)
    if delays.any():
        halves = (delays_of([(y[half], u[half])]) for half in (slice(middle), slice(middle, None)))
        shown = np.any([abs(h.taken - delays) <= 1 for h in halves], axis=0) | (delays == 0)
    pairs = {
        (name, output): (k, j)
        for j, name in enumerate(record.inputs)
        for k, output in enumerate(record.columns)
    }
    late = {pair: max(int(delays[at]) - 1, 0) * record.sampling_time for pair, at in pairs.items()}
    return late, frozenset(pair for pair, at in pairs.items() if late[pair] and not shown[at])


def _bands(training: Record, given: Bands) -> Bands:
    """Return the bands that `compare` chooses, with a simulator for hybrids of a calibrated one.

    They are as given for outputs that are constant.
    """
    y, rate, y_sim = training.y, training.sampling_rate, None
    if training.y_sim is not None:
        y_sim = Calibrated().fit(training).on(training).y_sim
    if given.cutoff is None and not np.ptp(y, axis=0).any():
        return given
    return given.chosen(y, rate, recipe_settings("default", training).warmup, y_sim)

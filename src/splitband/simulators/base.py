"""Define black-box simulators: functions of a time grid that return a simulated signal.

A simulator needs neither gradients nor an accessible state (Ensinger et al. 2023, Sec. 4.3). `run`
calls a simulator and checks its output; `Recorded` is a simulator's exported output, and `Absent`
the description of a saved model's simulator until the user passes the simulator again.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path, PurePath
from typing import Any, Literal, NoReturn, Protocol, Self

import numpy as np
import numpy.typing as npt

import splitband
from splitband.records import Aligned, Grid, Record, Stamp, aligned
from splitband.records.alignment import reach
from splitband.records.signals import as_float
from splitband.records.timing import in_words, seconds_of
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.files import sha256_of
from splitband.runtime.options import WithRepr
from splitband.simulators.unknown import Trained, Unknown
from splitband.simulators.user_code import check_open, count_arguments

Start = float | Literal["record"]
"""Time of a record's first sample in s, or "record" for its time stamp."""
Hold = Literal["zoh", "linear"]
"""Course of inputs between samples: held (zero-order hold), or along a straight line."""


class SimulatorError(RuntimeError):
    """A simulator has failed; the message gives the reason."""


class SimulatorTimeoutError(TimeoutError):
    """A simulator has not returned within its timeout."""


class Simulator(Protocol):
    """A user's simulator: an object with `simulate(time)` or `simulate(time, u)`.

    Three further attributes are optional: `name`, for messages; `start`, see `simulate`; `driven`,
    whether the simulator takes the record's inputs, if the arguments of `simulate` do not tell. The
    simulators of this package have more, see `KnownSimulator`.
    """

    @property
    def simulate(self) -> Callable[..., npt.ArrayLike]:
        """Return the measured channels at the evenly spaced `time` in s: `(time,)` or `(time, ny)`.

        A method with a second argument also gets the record's inputs `u`, `(time, nu)`. `time` is 0
        at the record's first sample, with the simulator's initial state, or the attribute `start`:
        a number, or "record" for the record's time stamp.
        """


class KnownSimulator:
    """The protocol of simulators inside the package, with its defaults.

    `as_known` converts a user's object.

    Attributes
    ----------
    start : See `Simulator`; None if unspecified.
    hold : Course of inputs between samples, see `Ode`; None if unspecified.
    step : Communication step in s of an FMU, if chosen.
    driven : Whether the simulator takes the record's inputs.
    code : Functions with open arguments, possibly meant for inputs.
    own_times : Whether the output has times of its own, and is interpolated to the record's.
    adjustable : Whether the simulator has parameters or needs inputs, and so a `GreyBox`.
    advances : Whether the simulator can be stepped from any state.
    terms : Unknown terms, see `Ode`.
    """

    simulate: Any
    start: Any = None
    hold: Any = None
    step: float | None = None
    driven = False
    code: Sequence[Any] = ()
    own_times = False
    adjustable = False
    advances = False
    terms: tuple[Unknown, ...] = ()

    @property
    def name(self) -> str:
        """Return the name in messages."""
        return type(self).__name__

    @property
    def needs_inputs(self) -> bool:
        """Return whether a run needs inputs."""
        return self.driven

    def matched(self, columns: Sequence[str], inputs: Sequence[str]) -> Self:
        """Return the simulator for records with these channels and inputs, see `Fmu.matched`."""
        return self

    @property
    def named_terms(self) -> tuple[Unknown, ...]:
        """Return the unknown terms, before training, if their quantities have names."""
        return ()

    def without_terms(self) -> Self:
        """Return a copy with unknown terms that stay as before training."""
        return self

    def taught(self, trained: Sequence[Trained]) -> Self:
        """Return a copy whose unknown terms have these states, in their order; itself for none.

        Raises ValueError for another number of terms.
        """
        if trained:
            raise InputError(
                f"simulator {self.name} must have {len(trained)} unknown term(s), as in training: "
                "sb.Ode(..., unknown=sb.Unknown(...))"
            )
        return self

    def require(self) -> Self:
        """Return the simulator; raises ValueError for a mere description."""
        return self

    def facts(self, fitted: bool) -> tuple[str, str, str | None]:
        """Return kind, file and fingerprint of the description, see `Absent`."""
        return type(self).__name__, "", None

    def description(self, fitted: bool = False) -> Absent:
        """Return the description of the simulator; `fitted`: whether its parameters are fitted."""
        start = None if self.own_times else self.start or 0.0
        return Absent(
            *self.facts(fitted),
            fitted,
            start,
            self.hold if self.driven else None,
            self.step,
            self.named_terms,
        )

    def reach(self, grid: Grid) -> int:
        """Return the number of covered samples of the grid: all, as runs can have any length."""
        return grid.samples

    def at(self, grid: Grid, time: Array, u: Array | None) -> npt.ArrayLike:
        """Return the output at the times of a grid, `time` in s on the simulator's clock."""
        inputs = [] if u is None else [np.resize(u, (len(time), u.shape[1]))]
        output: npt.ArrayLike = self.simulate(time, *inputs)
        return output

    def output(self, grid: Grid, record: Record, u: Array | None) -> Array:
        """Return the output at the times of a grid, `(samples, ny)`, in a record's channels."""
        simulator = matched(self.require(), record.columns, record.inputs)
        return run(simulator, grid.samples, grid.step, record.ny, None, grid.start, u)


class Given(KnownSimulator):
    """A user's own simulator; equal to another `Given` with the same object."""

    def __init__(self, simulator: Simulator) -> None:
        self.simulator = simulator
        if not callable(simulate := getattr(simulator, "simulate", None)):
            raise InputError(
                "simulator must have a method simulate(time) or simulate(time, u), got "
                f"{type(simulator).__name__}; for a function f there is sb.Function(f)"
            )
        self.start = check_start(getattr(simulator, "start", None))
        self._name = getattr(simulator, "name", "") or type(simulator).__name__
        driven = getattr(simulator, "driven", None)
        self.driven = count_arguments(simulate) > 1 if driven is None else bool(driven)
        self.code = (simulate,) if driven is None else ()

    @property
    def name(self) -> str:
        """Return the name of the user's object, or of its class."""
        return self._name

    @property
    def simulate(self) -> Callable[..., npt.ArrayLike]:
        """Return the method of the user's object."""
        return self.simulator.simulate

    def facts(self, fitted: bool) -> tuple[str, str, str | None]:
        """Return the class of the user's object."""
        return type(self.simulator).__name__, "", None

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Given) and self.simulator is other.simulator

    def __hash__(self) -> int:
        return object.__hash__(self.simulator)


def fingerprint(path: str | Path, used: str) -> str | None:
    """Return the SHA-256 of a file and the `used` parts of it; None for a missing file."""
    try:
        return f"{sha256_of(path)} {used}"
    except OSError:
        return None


def as_known(simulator: Any) -> Any:
    """Return a simulator of this package unchanged, and a user's object as a `Given`.

    Raises ValueError for an object without `simulate`.
    """
    return simulator if isinstance(simulator, KnownSimulator) else Given(simulator)


def check_start(start: Any) -> Any:
    """Return a valid `start` of a simulator; raises ValueError for another."""
    if start is None or start == "record":
        return start
    if math.isnan(seconds := as_float(start)):
        raise InputError(f'start must be a number of seconds or "record", got {start!r}')
    return seconds


def check_hold(hold: Any) -> Any:
    """Return a valid `hold` of a simulator, or None; raises ValueError for another."""
    if hold not in (None, "zoh", "linear"):
        raise InputError(f'hold must be "zoh" or "linear", got {str(hold)[:60]!r}')
    return hold


def matched(simulator: Any, columns: Sequence[str], inputs: Sequence[str]) -> Any:
    """Return the simulator for records with these channels and inputs, see `Fmu.matched`.

    Raises ValueError if the simulator needs missing inputs, or may be meant to take the inputs but
    is not driven.
    """
    known = as_known(simulator).matched(columns, inputs)
    if not inputs and known.needs_inputs:
        raise InputError(
            f"simulator {known.name} takes inputs, of which the record has none: name them "
            "(--inputs), or leave the argument out"
        )
    if inputs and not known.driven:
        check_undriven(known, known.name, inputs)
    return known


def check_undriven(simulator: KnownSimulator, name: str, inputs: Sequence[str] = ()) -> None:
    """Raise ValueError for a simulator without inputs that may be meant to take inputs."""
    for function in simulator.code:
        check_open(function, name, inputs)


def origin(simulator: KnownSimulator, stamp: Stamp | None) -> float:
    """Return the simulator's time in s at a record's first sample.

    Raises ValueError for an ambiguous time: a function of time alone, without `start`.
    """
    start, begin = simulator.start, seconds_of(stamp)
    if start == "record":
        if stamp is not None and not isinstance(stamp, float):
            raise InputError(
                'start (--simulator-start) must be a number of seconds, not "record", for a record '
                f"whose clock shows dates: it begins at {in_words(stamp)}"
            )
        return begin
    if start is None and begin and not simulator.driven:
        assert stamp is not None
        raise InputError(
            f'start must be given (--simulator-start) for a function of time: "record" if it means '
            f"the record's clock, which begins at {in_words(stamp)}, 0 if its time begins at the "
            "first sample"
        )
    return float(start or 0.0)


def run(  # noqa: PLR0913
    simulator: Simulator,
    samples: int,
    sampling_time: float,
    ny: int = 1,
    name: str | None = None,
    start: Stamp | None = None,
    u: Array | None = None,
) -> Array:
    """Run a simulator and check its output.

    Parameters
    ----------
    simulator : Any object with a `simulate(time)`, or with a `simulate(time, u)`.
    samples, sampling_time : Number of samples, and the time between two of them in s.
    ny : Number of channels of the record.
    name : Name of the simulator in messages, by default its `name`, or its class.
    start : The record's first time stamp, for the alignment of an exported output. Other simulators
        are called with the times t, t + dt, t + 2 dt, ... for t = 0, or their own `start`, see
        `Simulator`.
    u : The record's inputs at these samples, `(samples, nu)`, for a simulator with inputs.

    Returns
    -------
    Array
        `(samples, ny)`, finite.

    Raises
    ------
    ValueError
        If the simulator raises, exceeds its timeout, or returns a wrong shape or non-finite values.
        The message names the simulator.
    """
    known = as_known(simulator)
    name = name or known.name
    begin = 0.0 if known.own_times else origin(known, start)
    u = _driving(name, known, u, samples)
    # At least two points: a simulator may derive the step.
    time: Array = begin + np.arange(max(samples, 2), dtype=np.float64) * sampling_time
    try:
        returned = np.asarray(known.at(Grid(start, sampling_time, len(time)), time, u))
        if np.iscomplexobj(returned):
            raise TypeError("its values must be real")
        y = np.asarray(returned, float)
    except SimulatorTimeoutError as error:
        raise InputError(f"simulator {name} has not returned {error}") from error
    except (Exception, SystemExit) as error:
        kind = "" if isinstance(error, SimulatorError) else f"{type(error).__name__}: "
        raise InputError(
            f"simulator {name} failed on {samples} samples every {sampling_time:g} s: {kind}{error}"
        ) from error
    y = y[:, None] if y.ndim == 1 else y
    if y.shape != (len(time), ny):
        raise InputError(f"simulator {name} must return {(len(time), ny)} values, got {y.shape}")
    y = y[:samples]
    bad = ~np.isfinite(y).all(axis=1)
    if bad.any():
        raise InputError(
            f"simulator {name} must return finite values: {bad.sum()} samples are not, "
            f"the first at {time[:samples][bad][0]:g} s"
        )
    return y


def _driving(name: str, simulator: KnownSimulator, u: Array | None, samples: int) -> Array | None:
    """Return the inputs of a run, `(samples, nu)`; None for a simulator without inputs."""
    if not simulator.driven:
        if u is not None:
            check_undriven(simulator, name)
        return None
    if u is None:
        return np.empty((samples, 0))
    if len(u) < samples:
        raise InputError(
            f"u must hold the inputs of {samples} samples for simulator {name}, got {len(u)}"
        )
    return u[:samples]


# ---------------------------------------------------------------- simulators that do not run


@dataclass(frozen=True, eq=False, repr=False)
class Recorded(WithRepr, KnownSimulator):
    """The exported output of a simulator, at its own times.

    Attributes
    ----------
    y : `(time,)` or `(time, ny)`.
    sampling_time : In s.
    start : Time stamp of the first sample; None for the record's first sample.
    name : Name in messages.
    columns : Names of the channels, matched with a record's names.
    """

    y: npt.ArrayLike
    sampling_time: float
    start: Stamp | None = None
    name: str = "the exported trajectory"
    columns: tuple[str, ...] = ()
    own_times = True

    @classmethod
    def of(cls, trajectory: Record) -> Recorded:
        """Return the channels of a record as a simulator's output, with its time stamps."""
        step, start = trajectory.sampling_time, trajectory.start
        return cls(trajectory.y, step, start, columns=trajectory.columns)

    def in_columns(self, columns: Sequence[str]) -> Recorded:
        """Return the channels with these names, in this order; all channels if one is missing."""
        if self.columns == tuple(columns) or not {*columns} <= {*self.columns}:
            return self
        places = [self.columns.index(name) for name in columns]
        return replace(self, y=np.asarray(self.y, float)[:, places], columns=tuple(columns))

    def on(self, grid: Grid) -> Aligned:
        """Return the simulation at the times of a grid; raises ValueError for uncovered times."""
        y = np.asarray(self.y, float)
        if not 1 <= y.ndim <= 2 or not y.size:
            raise InputError(f"y must be (time,) or (time, ny) with samples, got {y.shape}")
        if not np.isfinite(y).all():
            raise InputError(f"y must be finite, {self.name} holds NaN or infinity")
        return aligned(self.name, y.reshape(len(y), -1), self._grid, grid)

    def reach(self, grid: Grid) -> int:
        """Return the number of covered times, from the first of the grid on.

        Raises ValueError for incomparable time stamps.
        """
        try:
            return reach(self._grid, grid)
        except ValueError as error:
            raise InputError(f"{self.name}: {error}") from None

    def note(self, grid: Grid) -> str:
        """Return a description of the resampling to a grid; empty without resampling."""
        covered = min(grid.samples, self.reach(grid))
        return self.on(replace(grid, samples=covered)).note if covered > 0 else ""

    def simulate(self, time: Array) -> npt.ArrayLike:
        """Return the simulation at `time` in s, on the clock of its stamps, if in s."""
        step = float(time[1] - time[0]) if len(time) > 1 else self.sampling_time
        return self.on(Grid(float(time[0]), step, len(time))).values

    def at(self, grid: Grid, time: Array, u: Array | None) -> npt.ArrayLike:
        """Return the simulation at the times of a grid, possibly dates."""
        return self.on(grid).values

    def output(self, grid: Grid, record: Record, u: Array | None) -> Array:
        """Return the simulation at the times of a grid, in the channels of a record."""
        return np.asarray(self.in_columns(record.columns).on(grid).values)

    @property
    def _grid(self) -> Grid:
        return Grid(self.start, self.sampling_time, len(np.asarray(self.y)))


@dataclass(frozen=True)
class Absent(KnownSimulator):
    """The description of a simulator, which is neither opened nor run.

    Attributes
    ----------
    kind, file : Names of the class and of the file, without the folder; empty without a file.
    fingerprint : Text for the detection of another simulator: SHA-256 of an FMU, the used
        variables, and the values of parameters unless fitted; None without one.
    fitted : Whether parameters were fitted; other parameter values are then no difference.
    start : Simulator time at a record's first sample, 0 by default; None for recorded output, which
        has time stamps of its own.
    hold : Course of inputs between samples; None if unspecified.
    step : Communication step in s chosen for an FMU; None for the FMU's own.
    unknown : Unknown terms of named quantities, before training.
    """

    kind: str
    file: str = ""
    fingerprint: str | None = None
    fitted: bool = False
    start: Start | None = None
    hold: Hold | None = None
    step: float | None = None
    unknown: tuple[Unknown, ...] = ()

    def __post_init__(self) -> None:
        """Check values, possibly from a file."""
        texts = self.kind, self.file, self.fingerprint or ""
        if not all(isinstance(text, str) for text in texts):
            raise InputError("a simulator must be described by texts")
        if not self.kind.isidentifier() or PurePath(self.file).name != self.file:
            raise InputError(
                f"a simulator must have a class and the name of a file, got "
                f"{self.kind[:60]!r} and {self.file[:60]!r}"
            )
        check_hold(self.hold)
        if not (self.step is None or as_float(self.step) > 0):
            raise InputError(f"step must be a number of seconds, got {str(self.step)[:60]!r}")
        vars(self)["start"] = check_start(self.start)

    def description(self, fitted: bool = False) -> Absent:
        """Return the description itself."""
        return self

    def taught(self, trained: Sequence[Trained]) -> Self:
        """Return the description itself."""
        return self

    def require(self) -> NoReturn:
        """Raise ValueError; the message names the simulator, and how to pass it."""
        ours = "sb." if self.kind in dir(splitband) else ""
        how = f"{ours}{self.kind}({json.dumps(str(self)) if self.file else '...'})"
        raise InputError(
            f"simulator must be given: this model was saved with the simulator {self}; pass it: "
            f"sb.load(folder, simulator={how})"
        )

    def difference(self, simulator: KnownSimulator) -> str:
        """Return a sentence for a simulator other than the described one, else an empty string.

        Simulators without a fingerprint are not compared. Raises ValueError for another `start` or
        `hold`.
        """
        other = simulator.description(self.fitted)
        if self.start is not None and other.start is not None and self.start != other.start:
            raise InputError(
                f"simulator must have start={json.dumps(self.start)} (--simulator-start), with "
                f"which the model was saved, got start={json.dumps(other.start)}; fit the model "
                "again for another start"
            )
        if None not in (self.hold, other.hold) and self.hold != other.hold:
            raise InputError(
                f"simulator must have hold={self.hold!r} (--simulator-hold), with which the model "
                f"was saved, got hold={other.hold!r}; fit the model again for another one"
            )
        saved, current = self.fingerprint, other.fingerprint
        if saved is None or current is None or saved == current:
            return ""
        return (
            f"the simulator is another one than {self}, with which the model was saved: its "
            f"fingerprint is {_shown(current)}, not {_shown(saved)}"
        )

    def __str__(self) -> str:
        """Return the name of the simulator's file, or of its class."""
        return _shown(self.file) if self.file else f"of the kind {self.kind}"


def _shown(text: str) -> str:
    return " ".join(text.split())[:300]  # text of a file, of any length

"""Define black-box simulators, which turn a time grid into a simulated signal.

A simulator needs neither gradients nor an accessible state (paper, Sec. 4.3). `run` calls a
simulator and checks its output; `Recorded` holds the exported output of one, and `Absent` describes
that of a saved model until the user passes it again.
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
from splitband.data import Aligned, Grid, Record, Stamp, aligned
from splitband.data.alignment import reach
from splitband.data.signals import as_float
from splitband.data.timing import in_words, seconds_of
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.files import sha256_of
from splitband.runtime.options import WithRepr
from splitband.simulators.user_code import check_open, count_arguments

Start = float | Literal["record"]
"""Time of a record's first sample in s, or "record" for its time stamp."""
Hold = Literal["zoh", "linear"]
"""How inputs run from one sample to the next: held (zero-order hold), or along a straight line."""


class SimulatorError(RuntimeError):
    """Report that a simulator has failed; the message says why."""


class SimulatorTimeoutError(TimeoutError):
    """Report that a simulator has not returned within its timeout."""


class Simulator(Protocol):
    """Define what a user brings: an object with `simulate(time)` or `simulate(time, u)`.

    Nothing else is needed. Three attributes are read where the object has them: `name`, for
    messages; `start`, see `simulate`; `driven`, whether it takes the record's inputs, where the
    arguments of `simulate` do not say so. Everything else is known of simulators of this package
    alone, see `KnownSimulator`.
    """

    @property
    def simulate(self) -> Callable[..., npt.ArrayLike]:
        """Return the measured channels at the evenly spaced `time` in s: `(time,)` or `(time, ny)`.

        A method with a second argument also gets the record's inputs `u`, `(time, nu)`. `time`
        begins at 0 at the record's first sample, where the initial state is that of the simulator,
        or at its attribute `start`: a number, or "record" for the record's time stamp.
        """


class KnownSimulator:
    """Define the protocol of simulators inside the package, with its defaults.

    An object of a user's becomes one where it comes in, see `as_known`.

    Attributes
    ----------
    start : See `Simulator`; None for a simulator that does not say.
    hold : How inputs run between samples, see `Ode`; None for a simulator that does not say.
    step : Communication step in s that was chosen for an FMU.
    driven : Whether it takes the record's inputs.
    code : Functions of a simulator whose open arguments might be meant for inputs.
    own_times : Whether its output has times of its own, and is interpolated to the record's.
    adjustable : Whether it has parameters or needs inputs, and so a `GreyBox` to run it.
    advances : Whether it can be stepped from any state.
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

    @property
    def name(self) -> str:
        """Return the name in messages."""
        return type(self).__name__

    @property
    def needs_inputs(self) -> bool:
        """Return whether it cannot run without inputs."""
        return self.driven

    def matched(self, columns: Sequence[str], inputs: Sequence[str]) -> Self:
        """Return the simulator for records with these channels and inputs, see `Fmu.matched`."""
        return self

    def require(self) -> Self:
        """Return the simulator; raises ValueError for a description, which cannot run."""
        return self

    def facts(self, fitted: bool) -> tuple[str, str, str | None]:
        """Return the kind, file and fingerprint of its description, see `Absent`."""
        return type(self).__name__, "", None

    def description(self, fitted: bool = False) -> Absent:
        """Return the description of the simulator; `fitted`: whether its parameters were."""
        start = None if self.own_times else self.start or 0.0
        return Absent(
            *self.facts(fitted), fitted, start, self.hold if self.driven else None, self.step
        )

    def reach(self, grid: Grid) -> int:
        """Return how many samples of the grid it covers: all, as it can run for as long."""
        return grid.samples

    def at(self, grid: Grid, time: Array, u: Array | None) -> npt.ArrayLike:
        """Return the output at the times of a grid, which are `time` in s on its own clock."""
        given = [] if u is None else [np.resize(u, (len(time), u.shape[1]))]
        found: npt.ArrayLike = self.simulate(time, *given)
        return found

    def output(self, grid: Grid, record: Record, u: Array | None) -> Array:
        """Return the output at these times, `(samples, ny)`, in the channels of a record."""
        simulator = matched(self.require(), record.columns, record.inputs)
        return run(simulator, grid.samples, grid.step, record.ny, None, grid.start, u)


class Given(KnownSimulator):
    """Hold a simulator of a user's own; it equals another one that holds the same object."""

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
        """Return its own name, or that of its class."""
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
    """Return the SHA-256 of a file and what is used of it; None where the file is gone."""
    try:
        return f"{sha256_of(path)} {used}"
    except OSError:
        return None


def as_known(simulator: Any) -> Any:
    """Return a simulator of this package as it is, and an object of a user's as a `Given`.

    Raises ValueError for an object that has no `simulate`.
    """
    return simulator if isinstance(simulator, KnownSimulator) else Given(simulator)


def check_start(start: Any) -> Any:
    """Return a simulator's `start` if it is one; raises ValueError otherwise."""
    if start is None or start == "record":
        return start
    if math.isnan(seconds := as_float(start)):
        raise InputError(f'start must be a number of seconds or "record", got {start!r}')
    return seconds


def check_hold(hold: Any) -> Any:
    """Return a simulator's `hold` if it is one, or None; raises ValueError otherwise."""
    if hold not in (None, "zoh", "linear"):
        raise InputError(f'hold must be "zoh" or "linear", got {str(hold)[:60]!r}')
    return hold


def matched(simulator: Any, columns: Sequence[str], inputs: Sequence[str]) -> Any:
    """Return the simulator for records with these channels and inputs, see `Fmu.matched`.

    Raises ValueError for one that needs inputs, which the records do not have, and for one that may
    be meant to take those that they have.
    """
    found = as_known(simulator).matched(columns, inputs)
    if not inputs and found.needs_inputs:
        raise InputError(
            f"simulator {found.name} takes inputs, of which the record has none: name them "
            "(--inputs), or leave the argument out"
        )
    if inputs and not found.driven:
        check_undriven(found, found.name, inputs)
    return found


def check_undriven(simulator: KnownSimulator, name: str, inputs: Sequence[str] = ()) -> None:
    """Raise ValueError for a simulator that is not driven, but may be meant to take the inputs."""
    for function in simulator.code:
        check_open(function, name, inputs)


def origin(simulator: KnownSimulator, stamp: Stamp | None) -> float:
    """Return the time in s at which a simulator runs at a record's first sample.

    Raises ValueError where that can be two things: for a function of time alone that does not say
    whether it means the record's clock.
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
    simulator : Anything with a `simulate(time)`, or with a `simulate(time, u)`.
    samples, sampling_time : Number of samples, and the time between two of them in s.
    ny : Number of channels of the record.
    name : Name of the simulator in messages, by default its `name`, or its class.
    start : The record's first time stamp, by which an exported output is aligned. Other simulators
        are called with the times t, t + dt, t + 2 dt, ... for t = 0, or as they say themselves, see
        `Simulator`.
    u : The record's inputs at these samples, `(samples, nu)`, for a simulator that takes them.

    Returns
    -------
    Array
        `(samples, ny)`, finite.

    Raises
    ------
    ValueError
        If the simulator raises, exceeds its timeout, or returns a wrong shape or values that are
        not finite. The message names the simulator.
    """
    known = as_known(simulator)
    name = name or known.name
    begin = 0.0 if known.own_times else origin(known, start)
    u = _driving(name, known, u, samples)
    # A grid has two points at least, from which a simulator can derive the step.
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
    """Return the inputs of a run, `(samples, nu)`; None for a simulator that takes none."""
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
    """Hold the exported output of a simulator, at its own times.

    Attributes
    ----------
    y : `(time,)` or `(time, ny)`.
    sampling_time : In s.
    start : Time stamp of the first sample; None if it begins with the record.
    name : Name in messages.
    columns : Names of the channels, by which those of a record are found.
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
        """Return the channels with these names, in this order; all of them if it has others."""
        if self.columns == tuple(columns) or not {*columns} <= {*self.columns}:
            return self
        places = [self.columns.index(name) for name in columns]
        return replace(self, y=np.asarray(self.y, float)[:, places], columns=tuple(columns))

    def on(self, grid: Grid) -> Aligned:
        """Return the simulation at other times; raises ValueError if it does not cover them."""
        y = np.asarray(self.y, float)
        if not 1 <= y.ndim <= 2 or not y.size:
            raise InputError(f"y must be (time,) or (time, ny) with samples, got {y.shape}")
        if not np.isfinite(y).all():
            raise InputError(f"y must be finite, {self.name} holds NaN or infinity")
        return aligned(self.name, y.reshape(len(y), -1), self._grid, grid)

    def reach(self, grid: Grid) -> int:
        """Return how many times it covers, from the first of the grid on.

        Raises ValueError if their time stamps cannot be compared.
        """
        try:
            return reach(self._grid, grid)
        except ValueError as error:
            raise InputError(f"{self.name}: {error}") from None

    def note(self, grid: Grid) -> str:
        """Return a description of the resampling to these times; empty without any."""
        covered = min(grid.samples, self.reach(grid))
        return self.on(replace(grid, samples=covered)).note if covered > 0 else ""

    def simulate(self, time: Array) -> npt.ArrayLike:
        """Return the simulation at `time` in s, on the same clock if it has stamps in s."""
        step = float(time[1] - time[0]) if len(time) > 1 else self.sampling_time
        return self.on(Grid(float(time[0]), step, len(time))).values

    def at(self, grid: Grid, time: Array, u: Array | None) -> npt.ArrayLike:
        """Return the simulation at the times of a grid, whose stamps may be dates."""
        return self.on(grid).values

    def output(self, grid: Grid, record: Record, u: Array | None) -> Array:
        """Return the simulation at these times, in the channels of a record."""
        return np.asarray(self.in_columns(record.columns).on(grid).values)

    @property
    def _grid(self) -> Grid:
        return Grid(self.start, self.sampling_time, len(np.asarray(self.y)))


@dataclass(frozen=True)
class Absent(KnownSimulator):
    """Describe a simulator in words, without opening or running anything.

    Attributes
    ----------
    kind, file : Names of its class and of its file, without the folder; empty without a file.
    fingerprint : Text by which a different simulator is detected: SHA-256 of an FMU, the variables
        that are used, and the values of its parameters unless they are fitted; None without one.
    fitted : Whether its parameters were fitted; other parameter values are then no difference.
    start : Its time at a record's first sample, 0 if it says none; None for recorded output, which
        has time stamps of its own.
    hold : How its inputs run between samples; None for one that does not say.
    step : Communication step in s that was chosen for an FMU; None for its own.
    """

    kind: str
    file: str = ""
    fingerprint: str | None = None
    fitted: bool = False
    start: Start | None = None
    hold: Hold | None = None
    step: float | None = None

    def __post_init__(self) -> None:
        """Check values that may come from a file."""
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

    def require(self) -> NoReturn:
        """Raise ValueError; the message says which simulator to pass, and how."""
        ours = "sb." if self.kind in dir(splitband) else ""
        how = f"{ours}{self.kind}({json.dumps(str(self)) if self.file else '...'})"
        raise InputError(
            f"simulator must be given: this model was saved with the simulator {self}; pass it: "
            f"sb.load(folder, simulator={how})"
        )

    def difference(self, given: KnownSimulator) -> str:
        """Return a sentence if `given` is not the described simulator, else an empty string.

        Simulators without a fingerprint are not compared. Raises ValueError for one that begins at
        another time, or whose inputs run otherwise between samples.
        """
        other = given.description(self.fitted)
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
        saved, found = self.fingerprint, other.fingerprint
        if saved is None or found is None or saved == found:
            return ""
        return (
            f"the simulator is another one than {self}, with which the model was saved: its "
            f"fingerprint is {_shown(found)}, not {_shown(saved)}"
        )

    def __str__(self) -> str:
        """Return the name of the simulator's file, or of its class."""
        return _shown(self.file) if self.file else f"of the kind {self.kind}"


def _shown(text: str) -> str:
    return " ".join(text.split())[:300]  # it may come from a file

"""Define black-box simulators, which turn a time grid into a simulated signal.

A simulator needs neither gradients nor an accessible state (paper, Sec. 4.3). `run` calls a
simulator and checks its output.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from splitband.data import Grid, Stamp
from splitband.runtime.arrays import Array
from splitband.runtime.files import output_folder, replacing
from splitband.simulators.recorded import Recorded
from splitband.simulators.starting import check_undriven, is_driven, origin


class SimulatorError(RuntimeError):
    """Report that a simulator has failed; the message says why."""


class SimulatorTimeoutError(TimeoutError):
    """Report that a simulator has not returned within its timeout."""


class Simulator(Protocol):
    """Define what `run` calls on a simulator: `simulate(time)` or `simulate(time, u)`."""

    @property
    def simulate(self) -> Callable[..., npt.ArrayLike]:
        """Return the measured channels at the evenly spaced `time` in s: `(time,)` or `(time, ny)`.

        A method with a second argument also gets the record's inputs `u`, `(time, nu)`. `time`
        begins at 0 at the record's first sample, where the initial state is that of the simulator,
        or at its attribute `start`: a number, or "record" for the record's time stamp.
        """


def run(
    simulator: Simulator,
    samples: int,
    sampling_time: float,
    ny: int = 1,
    timeout: float | None = None,
    cache: str | Path | None = None,
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
    timeout : Seconds to wait; after that, the call goes on in a background thread.
    cache : Folder to store outputs in, for a simulator whose `fingerprint()` returns a string that
        changes with everything its output depends on, such as the content of an FMU. By default
        the simulator's own `cache`, if it has one.
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
        If the simulator raises, exceeds the timeout, or returns a wrong shape or values that are
        not finite. The message names the simulator.
    """
    name = name or getattr(simulator, "name", "") or type(simulator).__name__
    cache = cache or getattr(simulator, "cache", None)
    begin = 0.0 if isinstance(simulator, Recorded) else origin(simulator, start)
    u = _driving(name, simulator, u, samples)
    stored = _cache_file(simulator, (samples, sampling_time, ny, begin, _digest(u)), cache)
    if stored is not None and (known := _read_whole(stored, (samples, ny))) is not None:
        return known
    # A grid has two points at least, from which a simulator can derive the step.
    time: Array = begin + np.arange(max(samples, 2), dtype=np.float64) * sampling_time

    def simulate() -> npt.ArrayLike:
        if isinstance(simulator, Recorded):  # `time` holds seconds, and its stamps may be dates
            return simulator.on(Grid(start, sampling_time, len(time))).values
        if u is None:
            return simulator.simulate(time)
        return simulator.simulate(time, np.resize(u, (len(time), u.shape[1])))

    try:
        returned = np.asarray(within(timeout, simulate))
        if np.iscomplexobj(returned):
            raise TypeError("its values must be real")
        y = np.asarray(returned, float)
    except SimulatorTimeoutError as error:
        waited = getattr(simulator, "timeout", None) if timeout is None else timeout
        within_time = "in time" if waited is None else f"within {waited:g} s"
        raise ValueError(f"simulator {name} has not returned {within_time}") from error
    except (Exception, SystemExit) as error:
        kind = "" if isinstance(error, SimulatorError) else f"{type(error).__name__}: "
        raise ValueError(
            f"simulator {name} failed on {samples} samples every {sampling_time:g} s: {kind}{error}"
        ) from error
    y = y[:, None] if y.ndim == 1 else y
    if y.shape != (len(time), ny):
        raise ValueError(f"simulator {name} must return {(len(time), ny)} values, got {y.shape}")
    y = y[:samples]
    bad = ~np.isfinite(y).all(axis=1)
    if bad.any():
        raise ValueError(
            f"simulator {name} must return finite values: {bad.sum()} samples are not, "
            f"the first at {time[:samples][bad][0]:g} s"
        )
    if stored is not None:
        output_folder(stored.parent, "cache")
        with replacing(stored) as temporary:
            np.save(temporary, y)
    return y


def _driving(name: str, simulator: Simulator, u: Array | None, samples: int) -> Array | None:
    """Return the inputs of a run, `(samples, nu)`; None for a simulator that takes none."""
    if not is_driven(simulator):
        if u is not None:
            check_undriven(simulator, name)
        return None
    if u is None:
        return np.empty((samples, 0))
    if len(u) < samples:
        raise ValueError(
            f"u must hold the inputs of {samples} samples for simulator {name}, got {len(u)}"
        )
    return u[:samples]


def _digest(u: Array | None) -> str:
    return "" if u is None else hashlib.sha256(np.ascontiguousarray(u).tobytes()).hexdigest()


def within(timeout: float | None, call: Callable[[], Any]) -> Any:
    """Call a function in a background thread; raises SimulatorTimeoutError after `timeout`."""
    if timeout is None:
        return call()
    outcome: list[Any] = []

    def work() -> None:
        try:
            outcome.extend((True, call()))
        except BaseException as error:  # all are raised again in the caller, Ctrl-C included
            outcome.extend((False, error))

    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    thread.join(min(timeout, threading.TIMEOUT_MAX))
    if not outcome:
        raise SimulatorTimeoutError
    returned, value = outcome
    if not returned:
        raise value
    return value


def _read_whole(stored: Path, shape: tuple[int, int]) -> Array | None:
    """Return the stored output; None if there is none, or the file is damaged."""
    try:
        y = np.load(stored, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    whole = isinstance(y, np.ndarray) and (y.shape, y.dtype) == (shape, np.float64)
    return y if whole and np.isfinite(y).all() else None


def _cache_file(
    simulator: Simulator, grid: tuple[Any, ...], cache: str | Path | None
) -> Path | None:
    fingerprint = getattr(simulator, "fingerprint", lambda: None)()
    if cache is None or fingerprint is None:
        return None
    key = hashlib.sha256(f"{fingerprint} {grid}".encode()).hexdigest()
    return Path(cache) / f"{key[:32]}.npy"

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
from splitband.data.timing import seconds_of
from splitband.runtime.arrays import Array
from splitband.runtime.files import output_folder, replacing
from splitband.simulators.recorded import Recorded


class SimulatorError(RuntimeError):
    """Report that a simulator has failed; the message says why."""


class SimulatorTimeoutError(TimeoutError):
    """Report that a simulator has not returned within its timeout."""


class Simulator(Protocol):
    """Define the method that `run` calls on a simulator."""

    def simulate(self, time: Array) -> npt.ArrayLike:
        """Return the measured channels at the evenly spaced `time` in s: `(time,)` or `(time, ny)`.

        `time` is that of the record, see `run`. An initial state is the state at its first sample.
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
) -> Array:
    """Run a simulator and check its output.

    Parameters
    ----------
    simulator : Anything with a `simulate(time)`.
    samples, sampling_time : Number of samples, and the time between two of them in s.
    ny : Number of channels of the record.
    timeout : Seconds to wait; after that, the call goes on in a background thread.
    cache : Folder to store outputs in, for a simulator whose `fingerprint()` returns a string that
        changes with everything its output depends on, such as the content of an FMU. By default
        the simulator's own `cache`, if it has one.
    name : Name of the simulator in messages, by default its `name`, or its class.
    start : The record's first time stamp. If it is in seconds, the simulator is called with the
        times start, start + dt, start + 2 dt, ...; for a date or None with 0, dt, 2 dt, ... An
        exported output is aligned by its time stamps.

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
    begin = seconds_of(start)
    stored = _cache_file(simulator, (samples, sampling_time, ny, begin), cache)
    if stored is not None and (known := _read_whole(stored, (samples, ny))) is not None:
        return known
    # A grid has two points at least, from which a simulator can derive the step.
    time: Array = begin + np.arange(max(samples, 2), dtype=np.float64) * sampling_time

    def simulate() -> npt.ArrayLike:
        if isinstance(simulator, Recorded):  # `time` holds seconds, and its stamps may be dates
            return simulator.on(Grid(start, sampling_time, len(time))).values
        return simulator.simulate(time)

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

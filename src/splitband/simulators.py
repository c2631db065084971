"""Black-box simulators: whatever turns a time grid into a trajectory.

Nothing about gradients or an inner state is asked of a simulator (paper, Sec. 4.3). `run` calls
one and checks what comes back.
"""

from __future__ import annotations

import hashlib
import shutil
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, Protocol

import numpy as np
import numpy.typing as npt
import scipy

from splitband.data import Aligned, Grid, Stamp, Trajectory, aligned
from splitband.data.alignment import reach
from splitband.data.timing import seconds_of
from splitband.files import replacing

Array = npt.NDArray[np.float64]


class SimulatorError(RuntimeError):
    """What went wrong in a simulator, in words for its user."""


class SimulatorTimeoutError(TimeoutError):
    """A simulator has not returned in time."""


class Simulator(Protocol):
    """What `run` asks of a simulator."""

    def simulate(self, time: Array) -> npt.ArrayLike:
        """The measured channels at the evenly spaced `time` in s: `(time,)` or `(time, ny)`.

        `time` is the record's own, see `run`. An initial state is that of its first sample.
        """


@dataclass(frozen=True, eq=False)
class Recorded:
    """An exported trajectory: a simulation made elsewhere, at times of its own.

    Attributes
    ----------
    y : `(time,)` or `(time, ny)`.
    sampling_time : In s.
    start : Time stamp of the first sample; None for one that begins with the record.
    """

    y: npt.ArrayLike
    sampling_time: float
    start: Stamp | None = None

    @classmethod
    def of(cls, trajectory: Trajectory) -> Recorded:
        """The trajectory of a file that `read` has read, with its time stamps."""
        return cls(trajectory.y, trajectory.sampling_time, trajectory.start)

    def on(self, grid: Grid) -> Aligned:
        """The trajectory at other times; raises ValueError where it does not cover them."""
        y = np.asarray(self.y, float)
        y = y[:, None] if y.ndim == 1 else y
        return aligned("the exported trajectory", y, self._grid, grid)

    def reach(self, grid: Grid) -> int:
        """How many times, counted on from the first of the grid, it covers."""
        return reach(self._grid, grid)

    def simulate(self, time: Array) -> npt.ArrayLike:
        """See `Simulator`; with time stamps in s, `time` is on the same clock."""
        step = float(time[1] - time[0]) if len(time) > 1 else self.sampling_time
        return self.on(Grid(float(time[0]), step, len(time))).values

    @property
    def _grid(self) -> Grid:
        return Grid(self.start, self.sampling_time, len(np.asarray(self.y)))


@dataclass(frozen=True)
class Function:
    """A Python callable, `function(time) -> (time,) or (time, ny)`.

    Attributes
    ----------
    function : What to call.
    key : Identifies it and its parameters in the cache of `run`; without one it is not cached.
    """

    function: Callable[[Array], npt.ArrayLike]
    key: str | None = None

    def simulate(self, time: Array) -> npt.ArrayLike:
        """See `Simulator`."""
        return self.function(time)

    def fingerprint(self) -> str | None:
        """The key."""
        return self.key


@dataclass(frozen=True, eq=False)
class Ode:
    """An ordinary differential equation, solved by `scipy.integrate.solve_ivp`.

    Attributes
    ----------
    derivative : `f(t, x) -> dx/dt`.
    initial_state : x at the record's first sample.
    observe : Maps the states `(time, nx)` to the measured channels; the first state by default.
    rtol, atol : Tolerances of the solver.
    method : Its name for SciPy.
    key : As for `Function`.
    """

    derivative: Callable[[float, Array], Any]
    initial_state: npt.ArrayLike
    observe: Callable[[Array], npt.ArrayLike] = lambda x: x[:, 0]
    rtol: float = 1e-8
    atol: float = 1e-10
    method: Literal["RK23", "RK45", "DOP853", "Radau", "BDF", "LSODA"] = "RK45"
    key: str | None = None

    def simulate(self, time: Array) -> npt.ArrayLike:
        """See `Simulator`; raises RuntimeError where the solver gives up."""
        solution = scipy.integrate.solve_ivp(
            self.derivative,
            (time[0], time[-1]),
            np.asarray(self.initial_state, float),
            method=self.method,
            t_eval=time,
            rtol=self.rtol,
            atol=self.atol,
        )
        if not solution.success:
            raise RuntimeError(f"the solver stopped at t = {solution.t[-1:]} s: {solution.message}")
        return self.observe(solution.y.T)

    def fingerprint(self) -> str | None:
        """The key and the solver's settings."""
        return None if self.key is None else f"{self.key} {self.method} {self.rtol} {self.atol}"


class Fmu:
    """A functional mock-up unit, run by FMPy (the extra `splitband[fmu]`).

    The archive is unpacked once; its instance is reset, not loaded again, between runs. Use it as
    a context manager, or `close` it, to remove the unpacked files.

    Parameters
    ----------
    path : Of the .fmu file.
    outputs : Variables that correspond to the record's channels; by default the FMU's outputs.
    start_values : Parameters and initial values by name.
    """

    def __init__(
        self,
        path: str | Path,
        outputs: Sequence[str] | None = None,
        start_values: Mapping[str, float] | None = None,
    ) -> None:
        try:
            import fmpy  # noqa: PLC0415  the optional extra
            from fmpy.simulation import instantiate_fmu  # noqa: PLC0415
        except ImportError:
            raise ValueError("an FMU needs FMPy: pip install 'splitband[fmu]'") from None
        self.path, self.start_values = Path(path), dict(start_values or {})
        if not self.path.is_file():
            raise FileNotFoundError(f"no such FMU: {self.path}")
        self._simulate_fmu = fmpy.simulate_fmu
        self._folder: str | None = None
        self._instance: Any = None
        try:
            self._folder = tempfile.mkdtemp(prefix="splitband-fmu-")
            fmpy.extract(str(self.path), self._folder)
            self._description = fmpy.read_model_description(self._folder)
            self._instance = instantiate_fmu(self._folder, self._description)
        except Exception as error:
            self.close()
            raise ValueError(f"{self.path} is not an FMU that can be run here: {error}") from error
        variables = {v.name: v for v in self._description.modelVariables}
        given = outputs or [v.name for v in variables.values() if v.causality == "output"]
        for name in (*given, *self.start_values):
            if name not in variables:
                self.close()
                raise ValueError(f"{self.path} has no variable {name}; it has {_some(variables)}")
        self.outputs = list(given)

    def simulate(self, time: Array) -> npt.ArrayLike:
        """See `Simulator`."""
        if self._instance is None:
            raise ValueError(f"the FMU {self.path} has been closed, or an earlier run failed")
        # Given back only after a good end: an instance that failed or still runs cannot be freed.
        instance, self._instance = self._instance, None
        step = float(time[1] - time[0])
        result = self._simulate_fmu(
            self._folder,
            model_description=self._description,
            fmu_instance=instance,
            start_time=float(time[0]),
            stop_time=float(time[-1]),
            output_interval=step,
            start_values=self.start_values,
            output=self.outputs,
        )
        instance.reset()
        self._instance = instance
        if result["time"][-1] < time[-1] - step / 2:
            raise ValueError(f"the FMU {self.path} stopped at {result['time'][-1]:g} s")
        found = np.column_stack([result[name] for name in self.outputs])
        # FMPy stores an event's sample beside that of the grid.
        at = np.searchsorted(result["time"], time - step / 4)
        return found[np.minimum(at, len(found) - 1)]

    def fingerprint(self) -> str:
        """What the trajectory depends on besides the time grid; the key of the cache."""
        content = hashlib.sha256(self.path.read_bytes()).hexdigest()
        return f"{content} {self.outputs} {sorted(self.start_values.items())}"

    def close(self) -> None:
        """Free the instance and remove the unpacked files."""
        if self._instance is not None:
            self._instance.freeInstance()
            self._instance = None
        if self._folder is not None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._folder = None

    def __enter__(self) -> Fmu:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


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
    """Call a simulator and check what it returns.

    Parameters
    ----------
    simulator : Anything with a `simulate(time)`.
    samples, sampling_time : How many samples, and the time between two of them in s.
    ny : Channels of the record.
    timeout : Seconds to wait; what runs on then is left behind in a thread.
    cache : Folder to keep trajectories in, for a simulator whose `fingerprint()` gives a string
        that changes with whatever its trajectory depends on; an FMU's is its content.
    name : What messages call the simulator, by default its class.
    start : The record's first time stamp. In seconds, the simulator is asked for start, start + dt,
        start + 2 dt, ...; where it is a date, or there is none, for 0, dt, 2 dt, ... An exported
        trajectory is aligned by its time stamps.

    Returns
    -------
    Array
        `(samples, ny)`, finite.

    Raises
    ------
    ValueError
        When the simulator raises, takes too long, or returns another shape or NaN. The message
        names the simulator.
    """
    name = name or type(simulator).__name__
    begin = seconds_of(start)
    stored = _cache_file(simulator, (samples, sampling_time, ny, begin), cache)
    if stored is not None and stored.is_file():
        return np.asarray(np.load(stored, allow_pickle=False))
    # A grid has two points at least, from which a simulator can tell its step.
    time: Array = begin + np.arange(max(samples, 2), dtype=np.float64) * sampling_time

    def simulate() -> npt.ArrayLike:
        if isinstance(simulator, Recorded):  # `time` does not say what is a date
            return simulator.on(Grid(start, sampling_time, len(time))).values
        return simulator.simulate(time)

    try:
        found = np.asarray(within(timeout, simulate))
        if np.iscomplexobj(found):
            raise TypeError("its values must be real")
        y = np.asarray(found, float)
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
        stored.parent.mkdir(parents=True, exist_ok=True)
        with replacing(stored) as temporary:
            np.save(temporary, y)
    return y


def within(timeout: float | None, call: Callable[[], Any]) -> Any:
    """Call in a thread of its own that can be given up on; raises SimulatorTimeoutError then."""
    if timeout is None:
        return call()
    outcome: list[Any] = []

    def work() -> None:
        try:
            outcome.extend((True, call()))
        except BaseException as error:  # Ctrl-C too is for the caller
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


def _cache_file(
    simulator: Simulator, grid: tuple[Any, ...], cache: str | Path | None
) -> Path | None:
    fingerprint = getattr(simulator, "fingerprint", lambda: None)()
    if cache is None or fingerprint is None:
        return None
    key = hashlib.sha256(f"{fingerprint} {grid}".encode()).hexdigest()
    return Path(cache) / f"{key[:32]}.npy"


def _some(names: Mapping[str, Any]) -> str:
    shown = list(names)[:10]
    return ", ".join(shown) + (", ..." if len(names) > 10 else "")

"""Forecast with a simulator: unchanged, with gain and offset, or calibrated."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, final

import numpy as np

from splitband.filters import ComplementaryPair
from splitband.forecasters.base import Forecaster, with_parts_changed
from splitband.forecasters.fitted import NEAR_ROW, first_only
from splitband.forecasters.prediction import ForecastContext
from splitband.forecasters.steps import GivenSteps, NotSteppedError, Steps
from splitband.models.labels import SIMULATOR
from splitband.records import Grid, Record, check_alike
from splitband.records.preparation import check_level
from splitband.records.timing import stamp_after
from splitband.runtime.arrays import Array, check_shape
from splitband.runtime.errors import InputError
from splitband.simulators import Simulator
from splitband.simulators.base import Absent, KnownSimulator, as_known
from splitband.simulators.calibration import Calibration, Term, calibrate, samples_needed

MAX_SIMULATED_SAMPLES = 10**8
"""Most samples of a simulator's run, counted from the first training sample: bounds the memory."""
ON_A_SAMPLE = 1e-6
"""Tolerance in samples: the simulator's output this close to a sample is taken at the sample.
Rounding."""
AFFINE: tuple[Term, ...] = ("gain", "offset")


@dataclass(frozen=True, eq=False, repr=False)
class Runs(KnownSimulator):
    """Hold a simulator's runs, computed once for all processes.

    runs : Grid, inputs that drove it, if any, and output `(time, ny)` of each run.
    place : Place of the simulator among those of its method, see `simulators_of`.
    driven : Whether the simulator takes inputs.
    """

    runs: Sequence[tuple[Grid, Array | None, Array]]
    place: int
    driven: bool = False

    def reach(self, grid: Grid) -> int:
        """Return how many samples are available from the start of the grid on, without inputs."""
        return len(self._beginning(grid, None))

    def output(self, grid: Grid, record: Record, u: Array | None) -> Array:
        """Return the output at these times; raises ValueError where it is not available."""
        y = self._beginning(grid, u)
        if len(y) < grid.samples:
            raise InputError(f"the simulator has not been run for {grid}")
        return y[: grid.samples]

    def _beginning(self, grid: Grid, u: Array | None) -> Array:
        """Return the longest output from the start of the grid on, with the same inputs."""
        found = [y for own, by, y in self.runs if _alike(own, grid) and _same_inputs(by, u)]
        return max(found, key=len, default=np.empty((0, 0)))


def _alike(run: Grid, grid: Grid) -> bool:
    """Return whether a run has the start and, but for rounding, the step of a grid."""
    near = NEAR_ROW * run.step / max(run.samples, 1)
    return run.start == grid.start and abs(run.step - grid.step) < near


def _same_inputs(by: Array | None, u: Array | None) -> bool:
    """Return whether the shorter of two inputs is the beginning of the longer one."""
    return by is u if by is None or u is None else np.array_equal(by[: len(u)], u[: len(by)])


def simulators_of(method: Forecaster) -> list[KnownSimulator]:
    """Return the simulators of a method, each once, in the order of its parts."""
    found = (part.simulator for part in simulations(method) if part.simulator is not None)
    return [*dict.fromkeys(found)]


def with_simulators_of(model: Forecaster, method: Forecaster) -> None:
    """Give a trained copy of a method its simulators, for their `Runs` or descriptions."""
    own = simulators_of(method)
    for part in simulations(model):
        if isinstance(part.simulator, Runs):
            part.simulator = own[part.simulator.place]
        elif isinstance(part.simulator, Absent) and own:
            part.simulator = own[0]


def with_simulators_run(method: Forecaster, *records: Record, ran: dict[Any, Runs]) -> Forecaster:
    """Return a method whose simulators have been run; runs in `ran` are not made again."""
    own = simulators_of(method)

    def changed(part: Forecaster) -> Forecaster:
        if not isinstance(part, SimulatorForecaster) or part.simulator is None:
            return part
        if part.simulator.own_times:
            return part
        spans = part.spans(*records)
        key = part.simulator, *((each, grid.samples) for grid, each, _ in spans)
        if key not in ran:
            runs = [(grid, u, part.simulator.output(grid, each, u)) for grid, each, u in spans]
            ran[key] = Runs(runs, 0, part.simulator.driven)
        found = replace(ran[key], place=own.index(part.simulator))
        return part.clone().set_params(simulator=found)

    return with_parts_changed(method, changed)


def simulations(value: Any) -> Iterator[Any]:
    """Yield the parts of a forecaster that have a simulator."""
    if isinstance(value, Forecaster) and "simulator" in vars(value):
        yield value
    elif isinstance(value, Forecaster | list):
        for part in value if isinstance(value, list) else vars(value).values():
            yield from simulations(part)


def description_of(part: Any) -> Absent | None:
    """Return the description of the simulator that a part of a saved forecaster was fitted with."""
    said = part.simulator
    if said is None and part.fitted is not None:
        said = part.fitted.simulator
    return said if isinstance(said, Absent) else None


class SimulatorForecaster(Forecaster):
    """A forecaster that predicts a simulator's output.

    `simulator`: what to run; by default the record contains its output (`y_sim`).
    """

    applied = Calibration()
    """The calibration of the output."""
    u: Array | None = None
    """Inputs of the training record, which drive the simulator before a history."""
    state_types: ClassVar[Mapping[str, Any]] = {"applied": Calibration, "u": Array}
    slow_label = SIMULATOR
    forgets = True

    def __init__(self, simulator: Simulator | None = None, name: str | None = None) -> None:
        self.simulator: Any = None if simulator is None else as_known(simulator)
        self._name = name

    @property
    def affine(self) -> bool:  # type: ignore[override]
        """Return whether predictions do not depend on the inputs."""
        return not self._driven

    @property
    def needs(self) -> frozenset[str]:
        """Return "simulator" where the record must contain its output."""
        return frozenset({"simulator"} if self.simulator is None else ())

    @property
    def name(self) -> str:
        return self._name or f"simulator{self.suffix}"

    @property
    def suffix(self) -> str:
        """Return the end of its name and of that of a hybrid: the terms that it fits."""
        return ""

    def check(self, *records: Record) -> None:
        """Raise ValueError for wrong records; only the first one needs a simulator's output."""
        super().check(*records[:1])
        for other in records[1:]:
            check_alike(other, records[0], other.name or "another record")

    def spans(self, *records: Record) -> list[tuple[Grid, Record, Array | None]]:
        """Return the runs of its simulator that cover records: times, record and inputs of each."""
        longest: dict[Any, tuple[Grid, Record, Array | None]] = {}
        for each in records:
            needed = self._needed(len(each), max(len(records[0]), len(each)))
            u = self._driving(each)
            needed = needed if u is None else min(needed, len(u))
            key = each.start, each.sampling_time, None if u is None else u.tobytes()
            if key not in longest or longest[key][0].samples < needed:
                longest[key] = Grid(each.start, each.sampling_time, needed), each, u
        return [*longest.values()]

    def complete(self) -> None:
        super().complete()
        record = self.require_fitted().record
        self.applied.check(record.ny)
        if self.u is not None:
            check_shape("u", self.u, None, record.nu)

    def learn(self, records: Sequence[Record], **_: Any) -> None:
        """Keep the inputs of the first record, which also drive the simulator later on."""
        if self.simulator is None or self._driven:
            self.u = records[0].u

    def extrapolate(self, known: ForecastContext) -> Array:
        return self.trajectory(replace(known, since=len(known.y)))[len(known.y) :]

    def trajectory(self, known: ForecastContext) -> Array:
        """Return the output over history and forecast, `(time + steps, ny)`.

        Recorded output is only read from the row `known.since` on; the rows before it are NaN.
        """
        samples = len(known.y) + known.steps
        record = self.require_fitted().record
        begin = known.begin or 0.0  # for another record the simulator starts with that record
        if begin < 0 and not self.applied.stays:
            raise InputError(
                f"history must not begin before the training record, for {self.name}, as the time "
                f"of its calibration ({self.applied}) counts from there; it begins "
                f"{-begin * record.sampling_time:.7g} s earlier"
            )
        if self._at_own_times:
            return self._recorded(self.simulator.in_columns(record.columns), known, begin)
        y_sim, begin_sim = known.y_sim, begin
        if self.simulator is not None:
            last = self.applied.positions(samples, record.sampling_time, begin)[-1]
            if not last < MAX_SIMULATED_SAMPLES:
                raise InputError(
                    f"history must lie so that {self.name} is run for at most "
                    f"{MAX_SIMULATED_SAMPLES} samples, got {last:.3g}; without time stamps it "
                    "begins with the training record"
                )
            times, needed = self._times(known), math.ceil(last - ON_A_SAMPLE) + 1
            begin_sim = min(begin, 0.0)  # an earlier history moves the start of the simulation
            if begin_sim and times.start is not None:
                earlier = stamp_after(times.start, begin_sim * record.sampling_time)
                times, needed = replace(times, start=earlier), samples
            u = self._driving_until(known, begin)
            needed = needed if u is None else min(needed, len(u))
            y_sim = self.simulator.output(replace(times, samples=needed), record, u)
        if y_sim is None:
            raise InputError(f"{self.name} needs a simulator's output (y_sim)")
        return self.applied.apply(y_sim, samples, record.sampling_time, begin, begin_sim)

    @property
    def _driven(self) -> bool:
        """Return whether its own simulator takes the inputs of records."""
        return self.simulator is not None and self.simulator.driven

    def _driving(self, record: Record) -> Array | None:
        """Return the known inputs of a record, if they drive it."""
        return record.u if self._driven else None

    def _driving_until(self, known: ForecastContext, begin: float) -> Array | None:
        """Return the inputs from the start of the simulation on, if they drive it."""
        if not self._driven or known.u is None:
            return None
        if begin <= 0:
            return known.u
        fitted = self.require_fitted()
        past = fitted.record.u if self.u is None and not fitted.begin else self.u
        if past is None or begin % 1 or begin > len(past):
            raise InputError(
                f"history must begin in the training record, or right after it, for {self.name}, "
                "whose simulator is driven by all inputs since that began; with other_record=True "
                "(--other-run) the simulator begins with the history"
            )
        return np.concatenate([past[: int(begin)], known.u])

    @property
    def _at_own_times(self) -> bool:
        """Return whether the simulator is recorded output, which is interpolated."""
        return self.simulator is not None and self.simulator.own_times

    def _recorded(self, simulator: Any, known: ForecastContext, begin: float) -> Array:
        """Return the trajectory from recorded output, see `trajectory`; its end is held (`doubts`).

        It is read at whole steps from the history's samples, so that it is interpolated only once.
        """
        times, step = self._times(known), self.require_fitted().record.sampling_time
        count, start = len(known.y) + known.steps - known.since, begin + known.since
        positions, first = self.applied.positions(count, step, start), 0.0
        if times.start is not None and simulator.start is not None:
            first = begin + math.floor(positions[0] - begin + ON_A_SAMPLE)
            times = replace(times, start=stamp_after(times.start, first * step))
        samples = math.ceil(positions[-1] - first - ON_A_SAMPLE) + 1
        least = math.ceil(start + count - first - ON_A_SAMPLE)
        samples = min(samples, max(least, simulator.reach(times)))
        y_sim = simulator.on(replace(times, samples=samples)).values
        y = self.applied.apply(y_sim, count, step, start, first)
        return np.concatenate([np.full((known.since, y.shape[1]), np.nan), y])

    def step_form(self) -> Steps:
        """Return the calibration of its output, which is given with each sample."""
        if not self.applied.stays:
            raise NotSteppedError(
                f"{self.name} cannot be stepped, as its time is calibrated ({self.applied}); "
                "with the terms gain and offset alone it can be"
            )
        ny = self.require_fitted().record.ny
        gain, offset = self.applied.gain or [1.0] * ny, self.applied.offset or [0.0] * ny
        return GivenSteps(np.array(gain), np.array(offset))

    def on(self, record: Record, first: bool = True) -> Record:
        """Return a record with the calibrated output as `y_sim`; both begin together."""
        y_sim = self._output(record)
        y_sim = self.applied.apply(y_sim, len(record), record.sampling_time)
        return replace(record, y_sim=y_sim)

    def doubts(self, known: ForecastContext) -> list[str]:
        """Return a warning where a calibrated clock or delay needs more output than there is."""
        begin, samples = known.begin or 0.0, len(known.y) + known.steps
        if self._at_own_times:
            end = float(self.simulator.reach(self._times(known)))
        elif self._driven and known.u is not None:
            end = begin + len(known.u)
        elif self.simulator is None and known.y_sim is not None:
            end = begin + len(known.y_sim)
        else:
            return []
        step = self.require_fitted().record.sampling_time
        said = self.applied.end_warning(known.steps, step, begin, samples, end)
        return [said] if said else []

    def describe(self) -> str:
        return str(self.applied)

    def _times(self, known: ForecastContext) -> Grid:
        """Return the times of its own simulator: from the first training sample on."""
        fitted = self.require_fitted()
        if known.begin is None and known.grid is not None:  # another record has its own clock
            return known.grid
        start = known.grid.start if fitted.start is None and known.grid else fitted.start
        return replace(fitted.record.grid, start=start)

    def _output(self, record: Record) -> Array:
        """Return the output over a record, and beyond it as far as it is known or needed."""
        if self.simulator is not None:
            samples, u = self._needed(len(record), len(record)), self._driving(record)
            grid = replace(record.grid, samples=samples)
            most = max(len(record), self.simulator.reach(grid)) if u is None else len(u)
            grid = replace(grid, samples=min(samples, most))
            return np.asarray(self.simulator.output(grid, record, u))
        if record.y_sim is None:
            raise InputError(f"{self.name} needs a simulator, the record has none")
        return record.y_sim

    def _needed(self, samples: int, train: int) -> int:
        """Return how many samples its own simulator must run for to cover `samples`."""
        return samples


@final
class Simulation(SimulatorForecaster):
    """A simulator as a forecaster: its output, unchanged.

    Parameters
    ----------
    simulator : What to run; by default the record contains its output (`y_sim`).
    name : By default "simulator".
    """

    at_once = True
    slow_part = "simulator"

    def in_words(self) -> str:
        """Return its name, or "simulator"."""
        return self._name or "simulator"

    def check(self, *records: Record) -> None:
        """Raise ValueError for wrong records, and for detrended ones beside its own simulator."""
        super().check(*records)
        if self.simulator is not None:
            check_level(records[0], self.name)


@final
class Calibrated(SimulatorForecaster):
    """A simulator that is calibrated to the training samples. Not in the paper.

    Gain, offset, delay and clock are fitted to the first training record.

    Parameters
    ----------
    simulator : What to run; by default the record contains its output (`y_sim`).
    terms : Which of "gain", "offset", "delay" and "clock" to fit; by default those that lower the
        error on held-out samples.
    name : By default "simulator-calibrated", or "simulator-affine" for gain and offset.
    below : Frequency in Hz below which simulator and record are compared; by default they are
        compared as they are. A comparison sets it to the cut-off of a hybrid that uses the low band
        alone: noise of the simulator above it would lower the gain.

    Examples
    --------
    >>> time = 0.1 * np.arange(200)
    >>> record = sb.Record(3 * np.sin(time), 0.1)
    >>> model = sb.Calibrated(sb.Function(np.sin), ["gain"]).fit(record[:150])
    >>> model.describe()
    'gain 3'
    >>> hybrid = sb.Residual(sb.Calibrated(sb.Function(np.sin)), sb.GRU(4), conditioned=True)
    """

    def __init__(
        self,
        simulator: Simulator | None = None,
        terms: Sequence[Term] | None = None,
        name: str | None = None,
        below: float | None = None,
    ) -> None:
        super().__init__(simulator, name)
        self.terms = None if terms is None else tuple(terms)
        self.below = below

    @property
    def suffix(self) -> str:
        if self.terms is None:
            return "-calibrated"
        return "-affine" if self.terms == AFFINE else "-" + "-".join(self.terms)

    slow_part = "calibrated simulator"
    calibrates = True
    fits_simulator = True

    @property
    def calibration(self) -> Calibration | None:
        return None if self.fitted is None else self.applied

    def in_words(self) -> str:
        if self.terms == AFFINE:
            return "simulator with fitted gain and offset"
        return "calibrated simulator"

    def learn(self, records: Sequence[Record], **how: Any) -> None:
        super().learn(records, **how)
        first, terms = records[0], () if self.terms is None else (self.terms,)
        y, y_sim = first.y_with_gaps, self._output(first)
        if self.below is not None:
            low = ComplementaryPair.butterworth(self.below, first.sampling_rate).lowpass
            y, y_sim = np.where(np.isnan(y), np.nan, low(first.y)), low(y_sim)
        self.applied = calibrate(y_sim, y, first.sampling_time, *terms)

    def describe(self) -> str:
        return super().describe() + (first_only(self.fitted) if self.fitted is not None else "")

    def _needed(self, samples: int, train: int) -> int:
        return samples_needed(samples, train)

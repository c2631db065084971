"""A simulator as a forecaster: as it comes, with gain and offset, or calibrated."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Self, final

import numpy as np
import numpy.typing as npt

from splitband.data import Grid, Trajectory
from splitband.forecasters.base import Forecaster
from splitband.forecasters.known import Known
from splitband.forecasters.remembering import Remembered
from splitband.simulators import Recorded, Simulator, run
from splitband.simulators.calibration import Calibration, Term, calibrate, samples_needed

Array = npt.NDArray[np.float64]

CALIBRATIONS = Remembered(calibrate)
"""Several forecasters, seeds and trials ask for the same calibration, which takes seconds."""
AFFINE: tuple[Term, ...] = ("gain", "offset")


@final
class Simulation(Forecaster):
    """A simulator's own forecast.

    Parameters
    ----------
    simulator : What to run; by default a record brings its output (`y_sim`, `beyond`).
    calibrated : Fit gain, offset, delay and clock to the training samples, each kept only where it
        pays on held-out ones; or the terms to fit, whether they pay or not.
    name : By default "simulator", "simulator-calibrated" or "simulator-affine".
    """

    def __init__(
        self,
        simulator: Simulator | None = None,
        calibrated: bool | Sequence[Term] = False,
        name: str | None = None,
    ) -> None:
        self.simulator = simulator
        self.calibrated = calibrated if isinstance(calibrated, bool) else tuple(calibrated)
        self.calibration = Calibration()
        self._name = name

    def __deepcopy__(self, memo: dict[int, Any]) -> Simulation:
        # A simulator may hold what cannot be copied, such as an FMU that has been loaded.
        return copy.copy(self)

    @property
    def name(self) -> str:
        """See `Forecaster`."""
        return self._name or "simulator" + self.suffix

    @property
    def suffix(self) -> str:
        """What its calibration adds to a name."""
        if isinstance(self.calibrated, bool):
            return "-calibrated" if self.calibrated else ""
        return "-affine" if self.calibrated == AFFINE else "-" + "-".join(self.calibrated)

    @property
    def needs(self) -> frozenset[str]:
        """A simulator's output on the record, where it brings no simulator of its own."""
        return frozenset({"simulator"} if self.simulator is None else ())

    def learn(self, records: Sequence[Trajectory], *, horizon: int = 0, **_: Any) -> None:
        """See `Forecaster`; the calibration is fitted to the first record."""
        self.calibration = self._calibration(records[0], horizon)

    def prepare(self, record: Trajectory, horizon: int) -> None:
        """See `Forecaster`."""
        if self.calibrated is not False:
            self._calibration(record, horizon)

    def settled(self, record: Trajectory, horizon: int) -> Self:
        """See `Forecaster`: with its output for the record and `horizon` samples more."""
        if self.simulator is None or isinstance(self.simulator, Recorded):
            return self
        y = self._output(record, len(record) + horizon)
        new = self.copy()
        new.simulator = Recorded(y, record.sampling_time, record.start)
        return new

    def extrapolate(self, known: Known) -> Array:
        """See `Forecaster`."""
        return self.trajectory(known)[len(known.y) :]

    def trajectory(self, known: Known) -> Array:
        """Over the history, too, `(time + steps, ny)`."""
        samples = len(known.y) + known.steps
        record = self.require_fitted().record
        begin = known.begin or 0.0  # a simulator of another record begins with it
        y_sim, begin_sim = known.y_sim, begin
        if self.simulator is not None:
            places = self.calibration.places(samples, record.sampling_time, begin)
            start = replace(record, start=self.require_fitted().start)
            y_sim, begin_sim = self._run(start, int(np.ceil(places[-1] - 1e-6)) + 1), 0.0
        if y_sim is None:
            raise ValueError(f"{self.name} needs a simulator's output (y_sim)")
        return self.calibration.apply(y_sim, samples, record.sampling_time, begin, begin_sim)

    def on(self, record: Trajectory) -> Trajectory:
        """A record that begins with the simulator, with its calibrated output as `y_sim`."""
        y_sim = self._output(record, len(record))
        y_sim = self.calibration.apply(y_sim, len(record), record.sampling_time)
        return replace(record, y_sim=y_sim, beyond=None)

    def describe(self) -> str:
        """See `Forecaster`."""
        return "; ".join(filter(None, [str(self.calibration), self.calibration.untried]))

    def _calibration(self, record: Trajectory, horizon: int) -> Calibration:
        """Of the simulator to a training record, to reach `horizon` samples beyond it."""
        if self.calibrated is False:
            return Calibration()
        samples = len(record) + horizon
        y_sim = self._output(record, samples)
        terms = () if self.calibrated is True else (self.calibrated,)
        return CALIBRATIONS(y_sim, record.seen, record.sampling_time, samples, *terms)

    def _output(self, record: Trajectory, samples: int) -> Array:
        """Over a record and what is known beyond, of a simulator of its own what is needed."""
        if self.simulator is not None:
            more = samples_needed(samples, len(record)) if self.calibrated else samples
            if isinstance(self.simulator, Recorded):
                more = min(more, max(samples, self.simulator.reach(record.grid)))
            return self._run(record, more)
        if record.y_sim is None:
            raise ValueError(f"{self.name} needs a simulator, the record has none")
        return (
            record.y_sim if record.beyond is None else np.concatenate([record.y_sim, record.beyond])
        )

    def _run(self, record: Trajectory, samples: int) -> Array:
        """The simulator's own output from the record's first sample on."""
        assert self.simulator is not None
        if isinstance(self.simulator, Recorded):
            return self.simulator.on(Grid(record.start, record.sampling_time, samples)).values
        return run(self.simulator, samples, record.sampling_time, record.ny, start=record.start)

"""Forecast by a simulator with fitted parameters."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Unpack, final

import numpy as np

from splitband.data import Record
from splitband.forecasters.base import Forecaster, Training
from splitband.forecasters.prediction import Known
from splitband.forecasters.stepping import NotSteppedError, Part, Recursion
from splitband.forecasters.stepping_simulators import Clock, FromMemory, Given, Integrated
from splitband.metrics import rmse
from splitband.runtime.arrays import Array
from splitband.runtime.caching import cached
from splitband.simulators.absent import Absent
from splitband.simulators.adjusted import Adjusted
from splitband.simulators.estimate import Estimate
from splitband.simulators.identification import check_runs, identify
from splitband.simulators.shooting import Adjustable, Experiment, fit_key
from splitband.simulators.starting import matched, origin
from splitband.simulators.starts import Effort

STARTS = 0.5, 2 / 3, 5 / 6
"""Origins of the forecasts that choose the `memory`, as shares of the training record. By eye."""
SHORTEST, GROWTH = 20, 4
"""Samples of the shortest `memory` that is tried, and the factor from one to the next. By eye."""
MAX_ERROR_SHARE = 0.9
"""A memory is used if its error is below this share of that of the simulation from the start.
By eye."""


@dataclass(frozen=True, eq=False)
class _Fit:
    """Describe a fit that several forecasters share; its result depends on its `repr` alone."""

    simulator: Any
    records: tuple[Record, ...]
    effort: Effort

    def result(self) -> Estimate:
        """Fit the parameters."""
        return identify(self.simulator, *self.records, effort=self.effort)

    def __repr__(self) -> str:
        experiments = [Experiment.of(record, self.simulator) for record in self.records]
        return f"{fit_key(self.simulator, experiments, self.effort.starts)} {self.effort.seconds}"


estimated = cached(_Fit.result)
"""Fits a simulator once: hybrids, seeds and trials need the same fit, which takes seconds."""


@final
class GreyBox(Forecaster):
    """Fit the parameters of a simulator to the training samples, and run it.

    Parameters
    ----------
    simulator : With ranges for its parameters, such as `Ode` and `Fmu`; None where a comparison
        provides it.
    starts, seconds : Number of starting points and time limit of the fit.
    name : By default "grey-box".

    Attributes
    ----------
    estimate : The values, their uncertainty, and the parameters that the record does not determine.
    adjusted : The simulator with these values.
    memory : Number of samples at the end of a history from which the initial state of a forecast is
        estimated; 0 for all.

    Examples
    --------
    >>> def cooling(t, x, u, p):
    ...     return [-p.rate * (x[0] - 20)]
    >>> tank = sb.Ode(cooling, [60.0], parameters={"rate": (0.01, 1.0)})
    >>> record = sb.Record(20 + 40 * np.exp(-0.1 * 0.5 * np.arange(60)), 0.5)
    >>> sb.GreyBox(tank).fit(record[:40]).predict(20).y[-1].round(2)
    array([22.09])
    """

    def __init__(
        self,
        simulator: Adjustable | None = None,
        starts: int = Effort.starts,
        seconds: float | None = None,
        name: str | None = None,
    ) -> None:
        self.simulator: Any = simulator
        self.starts, self.seconds = starts, seconds
        self._name = name
        self.estimate = Estimate()
        self.adjusted: Adjusted | None = None
        self.memory = 0
        self.u: Array | None = None

    @property
    def name(self) -> str:
        """Return the given name, or "grey-box"."""
        return self._name or "grey-box"

    _slow_part = "a simulator with fitted parameters"

    @property
    def parameters(self) -> dict[str, Any]:
        """Return the estimate, and all values in use, fixed ones included."""
        if self.adjusted is None:
            return {}
        return {**self.estimate.as_json(), "used": dict(self.adjusted.values)}

    def _given(self, simulator: Any) -> Forecaster:
        """Return it with this simulator, if it has none; else itself."""
        if self.simulator is not None:
            return self
        return self.clone().set_params(simulator=simulator)

    def check(self, *records: Record) -> None:
        """Raise ValueError for unsuitable records, and where it has no simulator."""
        super().check(*records)
        if self.simulator is None:
            raise ValueError(
                f"{self.name} needs a simulator with parameters to fit (--simulator and "
                "--parameters)"
            )
        if isinstance(self.simulator, Absent):
            self.simulator.simulate(None)  # raises the error that asks for it
        check_runs(self.simulator, records[0])

    _refits = False
    _fits_simulator = True

    def _to_dict(self) -> dict[str, Any]:
        """Return what is saved, with a description in place of the simulator."""
        described = None if self.simulator is None else Absent.of(self.simulator, fitted=True)
        return {**super()._to_dict(), "simulator": described}

    _words = "the simulator, its parameters fitted to the training samples"

    def learn(self, records: Sequence[Record], **how: Unpack[Training]) -> None:
        """Fit the parameters to all records together."""
        checkpoint = how["checkpoint"]
        folder = None if checkpoint is None else checkpoint.path.parent
        self.estimate = self._estimated(records, Effort(self.starts, self.seconds, folder=folder))
        simulator = self._matched(records[0])
        experiments = [Experiment.of(record, simulator) for record in records]
        adjusted = Adjusted.of(simulator, self.estimate, experiments)
        self.adjusted = replace(adjusted, simulator=None)
        self.u = records[0].u
        self.memory = self._chosen_memory(experiments[0])
        fitted = self.require_fitted()
        self.fitted = replace(fitted, report=replace(fitted.report, cut=self.estimate.cut))

    def _prepare(
        self,
        records: Sequence[Record],
        workers: int | Executor = 1,
        folder: Path | None = None,
    ) -> None:
        """Fit the parameters once for all hybrids, seeds and trials."""
        self._estimated(records, Effort(self.starts, self.seconds, workers, folder))

    def _estimated(self, records: Sequence[Record], effort: Effort) -> Estimate:
        return estimated(_Fit(self._matched(records[0]), tuple(records), effort))

    def _matched(self, record: Record) -> Any:
        """Return the simulator for the channels and inputs of a record."""
        return matched(self.simulator, record.columns, record.inputs)

    def extrapolate(self, known: Known) -> Array:
        """Return the simulation from the state estimated from the last samples of the history."""
        memory = min(self.memory or len(known.y), len(known.y))
        if memory == len(known.y):
            return self.trajectory(known)[len(known.y) :]
        return self._ahead(self._experiment(known), len(known.y), memory)

    def trajectory(self, known: Known) -> Array:
        """Return the simulation over the history and the forecast, `(time + steps, ny)`.

        Where all inputs since the first sample of the training record are known, it starts from the
        state of that sample; else the state at the first sample of the history is estimated.
        """
        adjusted, whole = self._adjusted(), self._experiment(known)
        if self._clock().reaches(known):
            begin, u = int(known.begin or 0), whole.u
            if u is not None and self.u is not None:
                u = np.concatenate([self.u[:begin], u])
            time = self._clock().times(0.0, begin + len(whole.time))
            return adjusted.response(time, u)[0][begin:]
        state = adjusted.beginning(whole.part(0, len(known.y)))
        return adjusted.response(whole.time, whole.u, state)[0]

    def _part(self, outside: bool = False) -> Part:
        """Return the simulator, integrated from the first state of the training record on."""
        if outside:
            ny = self.require_fitted().record.ny
            return Given(np.ones(ny), np.zeros(ny), self.trajectory)
        return self._integrated()

    def _stepped(self, outside: bool = False) -> Recursion:
        """Return the simulator, with its state estimated from `memory` samples."""
        if outside:
            raise NotSteppedError(
                f"{self.name} cannot be exported: its equation is your own code; integrate it "
                "there, with the values that describe() prints, or export a hybrid on it, whose "
                "network takes what the equation says as y_sim"
            )
        record = self.require_fitted().record
        return FromMemory(self._integrated(), self.memory, record.ny, record.nu)

    def describe(self) -> str:
        """Return the values with standard errors, and those that the record does not determine."""
        return str(self.estimate)

    def _integrated(self) -> Integrated:
        if not getattr(self.simulator, "advances", False):
            raise NotSteppedError(f"{self.name} has a simulator that does not go on from its state")
        return Integrated(self.name, self._adjusted(), self._clock())

    def _adjusted(self) -> Adjusted:
        record = self.require_fitted().record
        assert self.adjusted is not None
        return replace(self.adjusted, simulator=self._matched(record))

    def _clock(self) -> Clock:
        fitted = self.require_fitted()
        start = origin(self.simulator, fitted.start)
        return Clock(start, fitted.record.sampling_time, self.u, self.simulator)

    def _experiment(self, known: Known) -> Experiment:
        """Return history and forecast as one experiment, with NaN for the samples to come."""
        fitted = self.require_fitted()
        step = fitted.record.sampling_time
        if known.begin is None:
            start = origin(self.simulator, None if known.grid is None else known.grid.start)
        else:
            start = origin(self.simulator, fitted.start) + known.begin * step
        ahead = np.full((known.steps, known.y.shape[1]), np.nan)
        time = start + step * np.arange(len(known.y) + known.steps, dtype=np.float64)
        return Experiment(time, np.concatenate([known.y, ahead]), known.u)

    def _ahead(self, whole: Experiment, samples: int, memory: int) -> Array:
        """Return the simulation after `samples`, from a state estimated on the last `memory`."""
        adjusted, part = self._adjusted(), whole.part(samples - memory, len(whole.y))
        state = adjusted.beginning(part.part(0, memory))
        return adjusted.response(part.time, part.u, state)[0][memory:]

    def _chosen_memory(self, experiment: Experiment) -> int:
        """Return the memory with the lowest forecast error: for a correct model 0, all samples."""
        samples, window = len(experiment.y), self.estimate.window
        if not self.simulator.states:
            return 0
        origins = [int(share * samples) for share in STARTS]
        ends = [min(origin + samples // 6, samples) for origin in origins]

        def error(forecasts: Sequence[Array]) -> float:
            pairs = zip(origins, forecasts, strict=True)
            parts = [experiment.y[at : at + len(y)] - y for at, y in pairs]
            left = np.concatenate(parts) / self._adjusted().noise
            return rmse(left, np.zeros_like(left))

        best = np.inf
        if not window:
            whole = self._adjusted().response(experiment.time, experiment.u)[0]
            best = MAX_ERROR_SHARE * error([whole[a:b] for a, b in zip(origins, ends, strict=True)])
        chosen, length = window, SHORTEST
        while length <= min(window or samples, origins[0]):
            try:
                found = error([self._ahead(experiment.part(0, b), a, length)
                               for a, b in zip(origins, ends, strict=True)])  # fmt: skip
            except ValueError:
                found = np.inf
            if found < best:
                best, chosen = found, length
            length *= GROWTH
        return chosen

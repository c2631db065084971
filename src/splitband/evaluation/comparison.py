"""Running methods on a record over seeds, under both protocols.

*From the start*: warm up on the first R samples, simulate to the end; the error counts everything
after the warm-up. *Forecast*: warm up on the last R training samples, simulate beyond them.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from splitband.baselines.naive import Naive
from splitband.data import Trajectory
from splitband.data.gaps import first_after, last_before
from splitband.forecasters.methods import (
    CALIBRATIONS,
    FIXED,
    Setup,
    as_seen,
    build,
    calibrations_for,
    check,
    prepared,
)
from splitband.metrics import Extrapolation, extrapolations, input_range, leaves_range, rmse
from splitband.models import Model
from splitband.runtime.processes import over
from splitband.simulators.calibration import Calibration
from splitband.training import Progress, fit
from splitband.training.checkpoints import Checkpoint

Array = npt.NDArray[np.float64]
OVERFLOWED = 1e100
"""Stands for predicted values that are not finite, so that their errors are finite, and huge."""


@dataclass(frozen=True, eq=False)
class Run:
    """One method with one seed.

    Attributes
    ----------
    total_rmse, forecast_rmse : Of the two protocols, in the record's unit.
    seconds : Of the fit.
    from_start, forecast : The predictions `(time, ny)`, to the end of the record.
    leaves : Samples of the forecast before it leaves the range of the training part, see
        `leaves_range`; None where it does not.
    components : What `from_start` is the sum of, for a model of several parts.
    unfiltered : What its filters were fed with, for a model that filters its output.
    later : Forecasts from other samples, by the index of the first one; see `run`.
    description : What a baseline or a calibration settled on, and what went wrong.
    losses : Mean training loss of each epoch, by network.
    """

    method: str
    seed: int
    total_rmse: float
    forecast_rmse: float
    seconds: float
    from_start: Array
    forecast: Array
    leaves: int | None = None
    components: dict[str, Array] = field(default_factory=dict)
    description: str = ""
    losses: dict[str, list[float]] = field(default_factory=dict)
    unfiltered: dict[str, Array] = field(default_factory=dict)
    later: dict[int, Array] = field(default_factory=dict)


@dataclass(frozen=True)
class Failure:
    """One method that could not be fitted with one seed, and why."""

    method: str
    seed: int
    reason: str


class Runs(dict[str, list[Run]]):
    """The runs of each method, in the order of the seeds, without those that failed.

    A method of which every run failed is not among the keys.

    Attributes
    ----------
    failures : The runs that failed.
    """

    def __init__(
        self, runs: Mapping[str, list[Run]] | None = None, failures: Sequence[Failure] = ()
    ) -> None:
        super().__init__(runs or {})
        self.failures = tuple(failures)

    @property
    def failed(self) -> dict[str, str]:
        """Why, of each method that has no run."""
        return {f.method: f.reason for f in self.failures[::-1] if f.method not in self}

    def __missing__(self, method: str) -> list[Run]:
        raise KeyError(f"{method}: {self.failed.get(method, 'not among the methods')}")


@dataclass(frozen=True)
class RunProgress:
    """An epoch of one run is over; `share` of the run's training is done."""

    method: str
    seed: int
    share: float
    loss: float


def run(
    method: str,
    record: Trajectory,
    setup: Setup,
    seed: int,
    progress: Callable[[RunProgress], None] | None = None,
    later: Sequence[int] = (),
    checkpoints: Path | None = None,
    more: Sequence[Trajectory] = (),
    cuts: Sequence[int] = (),
) -> Run:
    """Fit one method on the first `setup.train` samples and predict under both protocols.

    From each of the indices in `later` a network also forecasts the rest of the record, warmed up
    on the samples before, but fitted to the same ones; what needs no training is fitted again, to
    the samples before each of `cuts`, and forecasts from there. A training that was cut off goes on
    from its file in the folder `checkpoints`. Networks train on the records `more`, too.

    Where there is a gap in what a simulation would warm up on, it begins before it, or, from the
    start, after it.
    """
    if method in FIXED:
        return run_baseline(method, FIXED[method], record, setup, seed, cuts)
    record, calibration = prepared(method, record, setup.train)
    more = [as_seen(other, calibration) for other in more]
    model = build(method, record, setup, seed)
    reporter = _reporter(method, seed, progress)
    checkpoint = Checkpoint(checkpoints / f"{method}-{seed}.safetensors") if checkpoints else None
    training = [record[: setup.train], *more]
    history = fit(model, training, setup.settings_of(method), seed, reporter, checkpoint)
    notes = [] if calibration is None else [f"simulator: {calibration}"]
    warmup = setup.settings_of(method).warmup
    first = first_start(record, warmup)
    components = predict(model, record, first - warmup, first)
    from_start, forecast = _total(components), _forecast(model, record, warmup, setup.train)
    return Run(
        method,
        seed,
        *_errors(record, setup, from_start, forecast),
        history.seconds,
        from_start,
        forecast,
        leaves_range(np.concatenate([r.seen for r in training]), forecast),
        components if len(components) > 1 else {},
        "; ".join([*notes, *history.notes]),
        losses=history.losses,
        unfiltered=model.simulate_unfiltered(*_known(record, first - warmup, first)),
        later={start: _forecast(model, record, warmup, start) for start in later},
    )


def _forecast(model: Model, record: Trajectory, warmup: int, at: int) -> Array:
    """From index `at` to the end of the record."""
    start = last_start(record, warmup, at)
    return _total(predict(model, record, start - warmup, start))[at - start :]


def first_start(record: Trajectory, warmup: int) -> int:
    """The first index with `warmup` measured samples right before it."""
    found = first_after(record.complete, warmup)
    if found is None:
        raise ValueError(f"warmup must fit between the gaps of the record, got {warmup} samples")
    return found


def last_start(record: Trajectory, warmup: int, at: int) -> int:
    """The last index up to `at` with `warmup` measured samples right before it."""
    found = last_before(record.complete, warmup, at)
    if found is None:
        raise ValueError(
            f"warmup must fit between the gaps of the first {at} samples, got {warmup} samples"
        )
    return found


def run_baseline(
    method: str,
    baseline: Callable[[Trajectory, int], Naive],
    record: Trajectory,
    setup: Setup,
    seed: int = 0,
    cuts: Sequence[int] = (),
) -> Run:
    """As `run`, for a baseline."""
    began = time.perf_counter()
    naive = baseline(record, setup.train)
    seconds = time.perf_counter() - began
    first = first_start(record, setup.settings.warmup)
    from_start, forecast = (_continued(naive, record, at) for at in (first, setup.train))
    errors = _errors(record, setup, from_start, forecast)
    return Run(
        method,
        seed,
        *errors,
        seconds,
        from_start,
        forecast,
        leaves_range(record.seen[: setup.train], forecast),
        description=str(naive),
        later={
            at: forecast if at == setup.train else _continued(baseline(record, at), record, at)
            for at in cuts
        },
    )


def _continued(naive: Naive, record: Trajectory, at: int) -> Array:
    """From index `at` to the end of the record."""
    last = [channel[~np.isnan(channel)][-1] for channel in record.seen[:at].T]
    return naive.predict(at, len(record) - at, np.array(last))


def _total(parts: Mapping[str, Array]) -> Array:
    """Their sum, with `OVERFLOWED` where it is not finite."""
    most = OVERFLOWED
    return np.nan_to_num(np.sum([*parts.values()], axis=0), nan=most, posinf=most, neginf=-most)


def _errors(
    record: Trajectory, setup: Setup, from_start: Array, forecast: Array
) -> tuple[float, float]:
    """The RMSE of both protocols against the truth where it is known."""
    truth = record.truth
    return rmse(truth[-len(from_start) :], from_start), rmse(truth[setup.train :], forecast)


def compare(
    record: Trajectory,
    methods: Sequence[str],
    setup: Setup,
    seeds: Sequence[int] = (0,),
    jobs: int = 1,
    progress: Callable[[RunProgress], None] | None = None,
    later: Sequence[int] = (),
    checkpoints: Path | None = None,
    more: Sequence[Trajectory] = (),
    cuts: Sequence[int] = (),
) -> Runs:
    """Run every method with every seed; `jobs` changes the numbers by rounding at most.

    What diverges, or cannot be fitted for another reason, is among the result's `failures` and
    does not keep the others from running.

    Parameters
    ----------
    record : Training part and the rest; both protocols end where it ends.
    methods : Names out of `METHODS`.
    setup : Settings for all of them.
    seeds : Each gives one run of each method.
    jobs : Processes at once, each on one thread.
    progress : Called in this process after each epoch of each run.
    later, cuts : See `run`.
    checkpoints : Folder, created if need be, from which trainings that were cut off go on.
    more : Other records of the same system that networks train on too.

    Returns
    -------
    Runs
        The runs of each method, in the order of `seeds`; one of what draws nothing (`FIXED`).

    Raises
    ------
    ValueError
        Before anything is computed, for what `check` finds; and where every method fails.
    """
    check(record, methods, setup, more)
    drawn = {method: seeds[:1] if method in FIXED else seeds for method in methods}
    # The longest first, so that no process is left with one of them at the end.
    todo = sorted(((m, s) for m in methods for s in drawn[m]), key=lambda job: job[0] in FIXED)
    if checkpoints is not None:
        checkpoints.mkdir(parents=True, exist_ok=True)
    calibrations = calibrations_for(record, methods, setup.train, cuts)
    work = partial(
        _work, record, setup, progress is None, later, checkpoints, more, cuts, calibrations
    )
    found = {(r.method, r.seed): r for r in over(work, todo, jobs, progress)}
    done = [found[m, s] for m in methods for s in drawn[m]]
    runs = {m: [r for r in done if isinstance(r, Run) and r.method == m] for m in methods}
    failures = [r for r in done if isinstance(r, Failure)]
    if len(failures) == len(done):
        reasons = dict.fromkeys(f"{f.method}: {f.reason}" for f in failures)
        raise ValueError(f"no method could be fitted; {'; '.join(reasons)}")
    for f in failures:
        if runs[f.method]:
            first, *others = runs[f.method]
            said = "; ".join(filter(None, [first.description, f"seed {f.seed} failed: {f.reason}"]))
            runs[f.method] = [replace(first, description=said), *others]
    return Runs({m: of_method for m, of_method in runs.items() if of_method}, failures)


def ahead_of(record: Trajectory, steps: int, u: Array | None = None) -> Trajectory:
    """The record with `steps` samples to come, to be forecast with all of it as training part.

    The last sample stands in for what will be measured; nothing looks at it there.

    Parameters
    ----------
    record : Whose simulator, if any, reaches `steps` samples beyond it (`beyond`).
    steps : How many.
    u : Known inputs of the samples to come, `(steps, nu)`, where the record has any.
    """
    if (u is None) != (record.u is None):
        raise ValueError(f"u must be given exactly for a record with inputs, nu = {record.nu}")
    y_sim = rest = None
    if record.y_sim is not None:
        beyond = np.empty((0, record.ny)) if record.beyond is None else record.beyond
        if len(beyond) < steps:
            raise ValueError(
                f"the simulator must reach {steps} samples beyond the record, got {len(beyond)}"
            )
        y_sim, rest = np.concatenate([record.y_sim, beyond[:steps]]), beyond[steps:]
    return replace(
        record,
        y=np.concatenate([record.y, np.repeat(record.y[-1:], steps, axis=0)]),
        u=None if record.u is None or u is None else np.concatenate([record.u, u]),
        y_true=None,
        y_sim=y_sim,
        beyond=rest if rest is not None and len(rest) else None,
        measured=None
        if record.measured is None
        else np.concatenate([record.measured, np.ones((steps, record.ny), dtype=np.bool_)]),
    )


def inputs_beyond(training: Sequence[Trajectory], u: Array | None) -> list[Extrapolation]:
    """Which inputs `u` `(time, nu)` ahead go beyond those of the training records."""
    seen = [record.u for record in training if record.u is not None]
    return [] if u is None or not seen else extrapolations(*input_range(seen), u)


def by_channel(record: Trajectory, predicted: Array) -> list[float]:
    """The RMSE of each channel by itself, of a prediction `(time, ny)` that ends with the record.

    NaN for a channel that was not measured there.
    """
    truth = record.truth[len(record) - len(predicted) :]
    return [rmse(y, x) for y, x in zip(truth.T, predicted.T, strict=True)]


def ensemble(runs: Sequence[Run], record: Trajectory, setup: Setup) -> Run:
    """The mean of the predictions of several seeds, with its own errors."""
    from_start, forecast = (
        np.mean([getattr(run, name) for run in runs], axis=0) for name in ("from_start", "forecast")
    )
    errors = _errors(record, setup, from_start, forecast)
    seconds = sum(run.seconds for run in runs)
    return Run(runs[0].method, runs[0].seed, *errors, seconds, from_start, forecast)


def predict(model: Model, record: Trajectory, begin: int, start: int) -> dict[str, Array]:
    """Warm up on `begin`..`start - 1`, simulate to the end of the record; by component."""
    return model.simulate_components(*_known(record, begin, start))


def _known(
    record: Trajectory, begin: int, start: int
) -> tuple[Array, int, Array | None, Array | None]:
    """What a simulation from `start` to the end may know, warmed up from `begin` on."""
    u, y_sim = (None if s is None else s[begin:] for s in (record.u, record.y_sim))
    return record.y[begin:start], len(record) - start, u, y_sim


def _reporter(
    method: str, seed: int, progress: Callable[[RunProgress], None] | None
) -> Callable[[Progress], None] | None:
    if progress is None:
        return None
    return lambda at: progress(RunProgress(method, seed, at.share, at.loss))


def _work(
    record: Trajectory,
    setup: Setup,
    silent: bool,
    later: Sequence[int],
    checkpoints: Path | None,
    more: Sequence[Trajectory],
    cuts: Sequence[int],
    calibrations: Mapping[str, Calibration],
    job: tuple[str, int],
    report: Callable[[RunProgress], None],
) -> Run | Failure:
    method, seed = job
    watch = None if silent else report
    CALIBRATIONS.learn(calibrations)
    try:
        return run(method, record, setup, seed, watch, later, checkpoints, more, cuts)
    except OSError:
        raise  # a full disk, or a process ended from outside, concerns every method
    except Exception as error:
        said = " ".join(str(error).split())
        expected = isinstance(error, FloatingPointError | ValueError)
        return Failure(method, seed, said if expected else f"{type(error).__name__}: {said}")

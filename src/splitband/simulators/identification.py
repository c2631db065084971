"""Fit the parameters of a simulator to records, and assess their identifiability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from splitband.data import Record, require_records
from splitband.metrics import spread
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import NEVER, Deadline, DeadlineError, current, within
from splitband.simulators.estimate import Curvature, Estimate, labelled
from splitband.simulators.shooting import Adjustable, Experiment, Shooting
from splitband.simulators.sources import failure
from splitband.simulators.starting import matched
from splitband.simulators.starts import (
    LAST_ROUNDS,
    SAME_ERROR,
    STARTS,
    Effort,
    StartOutcome,
    descend,
    starting_points,
    tried,
)

_SAME_PLACE = 0.02
"""Distance, as a share of a range, within which values count as the same. By eye."""
WINDOWS_FROM_ERROR = 0.6
"""Error of a simulation of whole records, in deviations, from which on windows are considered.
By eye."""
_WORTH_WINDOWS = 0.3
"""Windows are used if their error is below this share of the error over whole records. By eye."""


_FEW = 3
"""Samples for a test run of a simulator's code. By eye."""
_DEFECTS = (NameError, AttributeError, ImportError)
"""Errors of code that do not depend on parameter values."""


def identify(simulator: Adjustable, *records: Record, effort: Effort | None = None) -> Estimate:
    """Fit the parameters of a simulator to the measured samples of records.

    Parameters
    ----------
    simulator : Simulator with ranges for the fitted parameters, such as an `Ode`.
    records : Records of which all samples are used; each has its own initial values.
    effort : Limits of the search.

    Returns
    -------
    Estimate
        Values with standard errors, and remarks on identifiability.

    Raises
    ------
    ValueError
        If no run of the simulator succeeds; the message gives the reason.
    """
    require_records("records", *records)
    effort = effort or Effort()
    simulator = check_runs(simulator, records[0])
    experiments = [Experiment.of(record, simulator) for record in records]
    scale = spread(np.concatenate([e.y for e in experiments]))
    shooting = Shooting(simulator, experiments, scale)
    if not shooting.names:
        shooting.divide(10**9, np.empty(0))
        return _told(shooting, np.empty(0), 0)
    longest, deadline = shooting.longest, min(current(), Deadline.after(effort.seconds))
    outcomes = tried(shooting, effort, deadline)
    if not any(o.found for o in outcomes):
        over = "the time was over before the first one was done"
        reason = next((o.failure for o in outcomes if o.failure), over)
        raise ValueError(f"simulator must run for some parameters in their ranges: {reason}")
    window = _window(outcomes, longest)
    ranked = sorted((o.found[window][1], o.number) for o in outcomes if window in o.found)
    best = next(o for o in outcomes if o.number == ranked[0][1])
    places = np.array(best.found[window][0])
    shooting = Shooting(simulator.precise(), experiments, scale)
    with within(NEVER):  # the result is evaluated even after the deadline
        shooting.divide(window, places)
        if not (best.cut or deadline.over):
            places, _ = descend(shooting, places, LAST_ROUNDS)
        estimate = _told(shooting, places, window if window < longest else 0)
    agreeing = [error for error, _ in ranked if error <= ranked[0][0] * (1 + SAME_ERROR)]
    remarks = [*estimate.remarks, *_alternatives(shooting, outcomes, window, estimate, places)]
    cut = any(o.cut for o in outcomes) or deadline.over
    if cut:
        remarks.append("the time was over before every starting point was tried")
    if window < longest:
        remarks.append(
            f"simulated in windows of {window} samples, as a simulation of the whole record is lost"
        )
    agreed = len(agreeing), len(ranked)
    return replace(estimate, remarks=tuple(remarks), starts=agreed, cut=cut)


def check_runs(simulator: Any, record: Record) -> Any:
    """Return the simulator for a record's channels and inputs, if it runs at its start values.

    Raises ValueError, with the reason, for one that fails wherever a search begins, as code with a
    wrong type does; where a function of the parameters is not defined, a run is a bad one. Also
    raises it where another number of channels comes than the record has.
    """
    simulator = matched(simulator, record.columns, record.inputs)
    begin, known = Experiment.of(record, simulator).part(0, _FEW), simulator.known
    reason: Exception | None = None
    for places in starting_points(STARTS if known.free else 1, max(len(known.free), 1)):
        at = dict(zip(known.free, places, strict=False))
        values = {name: known.at(name, at.get(name, 0.5)) for name in known.given}
        try:
            with np.errstate(all="ignore"):
                y, _ = simulator.respond(begin.time, begin.u, [(values, None)])[0]
        except DeadlineError:
            raise
        except Exception as error:
            reason = reason or error
            if isinstance(error, _DEFECTS):
                break
            continue
        if y.shape != begin.y.shape:
            raise ValueError(
                f"simulator must return the record's {record.ny} channel(s), "
                f"{', '.join(record.columns)}, as {begin.y.shape}: got {y.shape}"
            )
        return simulator
    assert reason is not None
    where = ", ".join(f"{name} = {value:.4g}" for name, value in known.middle().items())
    raise ValueError(
        f"simulator must run at its start values{where and f' ({where})'}: {failure(reason)}"
    ) from reason


def _window(outcomes: Sequence[StartOutcome], longest: int) -> int:
    """Return the longest window length, unless shorter windows fit far better."""
    best: dict[int, float] = {}
    for outcome in outcomes:
        for length, (_, error) in outcome.found.items():
            best[length] = min(error, best.get(length, np.inf))
    lengths = sorted(best, reverse=True)
    chosen = lengths[0]
    if chosen < longest or best[chosen] < WINDOWS_FROM_ERROR:
        return chosen
    return next((n for n in lengths[1:] if best[n] < _WORTH_WINDOWS * best[chosen]), chosen)


def _told(shooting: Shooting, places: Array, window: int) -> Estimate:
    """Return the estimate at the best places, with standard errors."""
    ny = len(shooting.scale)
    residuals = shooting.residuals(places)
    jacobian = shooting.jacobian(places)
    measured = np.concatenate([w.part.y for w in shooting.windows])
    by_channel = np.where(np.isnan(measured), np.nan, residuals.reshape(-1, ny))
    known = shooting.simulator.known
    curvature = Curvature(shooting.names, known, places, by_channel, jacobian)
    errors, correlations, remarks = curvature.uncertainty()
    names = [labelled(name) for name in shooting.names]
    values = [known.at(n, float(p)) for (n, _), p in zip(shooting.names, places, strict=True)]
    rmse = np.sqrt(np.nanmean(by_channel**2, axis=0)) * shooting.scale
    return Estimate(
        dict(zip(names, values, strict=True)),
        dict(zip(names, map(float, errors), strict=True)),
        correlations,
        tuple(map(float, rmse)),
        tuple(remarks),
        window,
    )


def _alternatives(
    shooting: Shooting,
    outcomes: Sequence[StartOutcome],
    window: int,
    estimate: Estimate,
    places: Array,
) -> list[str]:
    """Return remarks on minima that fit as well, with other values of identifiable parameters."""
    errors = [o.found[window][1] for o in outcomes if window in o.found]
    told = np.array([np.isfinite(e) for e in estimate.errors.values()])
    found: list[Array] = [places]
    remarks = []
    for outcome in outcomes:
        if window not in outcome.found or not told.any():
            continue
        other, error = np.array(outcome.found[window][0]), outcome.found[window][1]
        far = all(np.abs(other - each)[told].max() > _SAME_PLACE for each in found)
        if far and error <= min(errors) * (1 + SAME_ERROR):
            found.append(other)
            known = shooting.simulator.known
            values = ", ".join(
                f"{labelled(name)} = {known.at(name[0], float(place)):.4g}"
                for name, place in zip(shooting.names, other, strict=True)
            )
            remarks.append(f"fits as well with {values}")
    return remarks[:3]

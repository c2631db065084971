"""Identify a linear state-space model: delays, subspace, order, refinement, noise.

1. Delays are estimated by input and output (`linear.delays`); outputs with equal delays are
   modelled together, the others separately.
2. A subspace method gives poles and C of every order, least squares the other parameters. The order
   is chosen by held-out simulation error (`linear.selection`), and candidates are refined to the
   least output error.
3. A Kalman filter is fitted to the errors of the simulation. If these show feedback by a
   controller, output error is biased, and the model is refined once more, by prediction error
   (Ljung, Ch. 13). In an open loop, prediction error held out better for one of 138 drawn records,
   by 0.5 % of fit, for a fifth of the time: it is not tried.

Before all that, a plant that is unstable behind a controller is looked for (`linear.closed_loop`):
its simulation grows, so that nothing of the above applies, and its model is the one of the least
prediction error.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from splitband.linear.closed_loop import Predictor, unstable_predictor, with_outputs
from splitband.linear.delays import Units, delays_of, explains, measured_part
from splitband.linear.kalman import (
    MAX_OBSERVER_POLE,
    covariance,
    fitted_gain,
    root_of,
    states,
    whitening,
)
from splitband.linear.model import LinearModel, assembled
from splitband.linear.refinement import (
    MOST_SAMPLES,
    Signals,
    Solution,
    blocks_of,
    equations,
    evaluated,
    linear_solution,
    refined,
    stepped,
    windows,
)
from splitband.linear.selection import ITERATIONS, OrderSearch, with_constant
from splitband.linear.uncertainty import silent, uncertainty_of
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import DeadlineError, current
from splitband.runtime.errors import InputError

_ALIKE = 2
"""Largest difference in samples of estimated delays of outputs in one model. By eye."""
_EXACT = 1e-7
"""Largest RMS error, in standard deviations, of a simulation without noise. Rounding."""
_MOST_CORRELATED = 0.999
"""Upper limit of the correlation of successive errors. Rounding."""
_GROWTH = 100.0
"""Largest growth of an unstable model's errors over a part of a record: the parts lose two digits
of 16, the whole record all. Rounding."""
_FITS = 0.5
"""Largest RMS error of a simulation that fits, as a share of the standard deviation or of another
simulation's error. Checked by halving and doubling."""
_LAGS = 16
"""Past samples in the prediction of an input. Checked by halving and doubling."""
_ROWS = 20_000
"""Largest number of samples in this prediction, of all records. Bounds the time."""


def identified(
    records: Sequence[tuple[Array, Array]],
    order: int | None = None,
    delay: npt.NDArray[np.int_] | None = None,
    integrators: int | None = None,
    most: int | None = None,
) -> LinearModel:
    """Return the linear model of records.

    records : Pairs of `y` `(time, ny)`, NaN in gaps, and `u` `(time, nu)`, with separate initial
        states.
    order : Number of poles, for every group of outputs with different delays; by default chosen.
    delay : Delays by output and input, `(ny, nu)` in samples; by default estimated.
    integrators : Number of poles at 1; by default chosen.
    most : Largest order of the choice.
    """
    if not integrators and (found := unstable(records, order, delay, most)) is not None:
        return found
    whole, records = records[0][1], [measured_part(y, u) for y, u in records]
    units, ny = Units.of(records), records[0][0].shape[1]
    estimated = delays_of(records) if delay is None else None
    delays = np.asarray(delay, int) if estimated is None else estimated.taken
    parts = []
    for outputs in _groups(delays, _ALIKE if delay is None else 0):
        some = [(y[:, outputs], u) for y, u in records]
        late = delays[outputs].min(axis=0)
        model = _of_outputs(some, units.outputs(outputs), late.tolist(), order, integrators, most)
        parts.append((model, outputs))
    model = _at_the_end(assembled(parts, ny), records[0], whole)
    if estimated is None:
        return model
    errors = model.uncertainty and replace(model.uncertainty, delay_errors=estimated.errors)
    doubted = tuple(estimated.doubted.max(axis=0).tolist())
    return replace(model, doubted=doubted, uncertainty=errors)


def _at_the_end(model: LinearModel, record: tuple[Array, Array], whole: Array) -> LinearModel:
    """Return the model with the states after its first record and before it, at the `whole` u."""
    y, u = record
    begin = max(len(y) - MOST_SAMPLES, 0)  # bounds the time, as gaps take a loop over samples
    before = None if begin else u[:0]
    model = replace(model, last=model.continued(u[begin:], y[begin:], before)[1])
    return model.begun_before(whole, len(whole) - len(u))


def unstable(
    records: Sequence[tuple[Array, Array]],
    order: int | None = None,
    delay: npt.NDArray[np.int_] | None = None,
    most: int | None = None,
) -> LinearModel | None:
    """Return the model of an unstable plant in a closed loop; None for any other record.

    All outputs are modelled together, with the given `delay`; a dead time of a few samples is a
    matter of poles. For other records it takes some milliseconds.
    """
    whole, records = records[0][1], [measured_part(y, u) for y, u in records]
    units = Units.of(records)
    delays = [0] * whole.shape[1] if delay is None else delay.min(axis=0).tolist()
    runs, longest = [units.run(y, u, delays) for y, u in records], max(len(y) for y, _ in records)
    with suppress(DeadlineError):
        predictor = unstable_predictor(runs, [late > 0 for late in delays], order, most)
        if predictor is not None:
            model = _by_prediction(predictor, runs, delays, longest)
            model = _in_units(model, units, records[0][1], runs[0])
            return replace(_at_the_end(model, records[0], whole), doubted=(0,) * model.nu)
    return None


def _groups(delays: npt.NDArray[np.int_], alike: int) -> list[list[int]]:
    """Return groups of outputs for one model, with delays that differ by at most `alike`."""
    left, groups = [*range(len(delays))], []
    while left:
        like = delays[left[0]]
        groups.append([k for k in left if abs(delays[k] - like).max(initial=0) <= alike])
        left = [k for k in left if k not in groups[-1]]
    return groups


def _of_outputs(
    records: Sequence[tuple[Array, Array]],
    units: Units,
    delays: Sequence[int],
    order: int | None,
    integrators: int | None,
    most: int | None,
) -> LinearModel:
    """Return the model of outputs with equal delays."""
    runs, longest = [units.run(y, u, delays) for y, u in records], max(len(y) for y, _ in records)
    moving = [bool(max(np.ptp(run.u[j]) for run in runs) > 0) for j in range(len(delays))]
    cuts = windows(runs, MOST_SAMPLES)
    some = [Signals(*(signal[:, begin:end] for signal in runs[i])) for i, begin, end in cuts]
    search = OrderSearch(some, moving, integrators, most)
    if order is None:
        chosen = search.best()
    else:
        of_order = search.of_order(order)
        if of_order is None:
            raise InputError(
                f"order must suit the record, got {order}: it has too few samples for so many poles"
            )
        chosen = of_order if integrators is not None else search.integrating(of_order, order)
    at = search.on_all(chosen, runs)
    fitted = with_constant(runs) if at.blocks.constant else runs
    model = _model_of(at, runs, delays)
    if not current().over:
        with suppress(DeadlineError):
            model = replace(model, uncertainty=uncertainty_of(at, fitted, at.matrices, longest))
    noisy = at.scale.max() > _EXACT and not current().over
    inputs = [u[-len(e.T) :].T for (_, u), e in zip(records, at.errors, strict=True)]
    if noisy and not integrators and feedback(at.errors, inputs):
        with suppress(DeadlineError):
            predictor = _predictor(model, at, runs)
            by_prediction = _by_prediction(predictor, runs, delays, longest)
            # Inputs that errors predict may be sensors of the outputs: by prediction error a model
            # then takes an output from its own past, and simulates far worse. Of 120 drawn loops
            # with a good fit, none looked so.
            sensors = (model.error < _FITS * np.minimum(by_prediction.error, 1.0)).any()
            if by_prediction.growth <= 1 and not sensors:
                model = by_prediction
            else:
                model = replace(model, by=f"{model.by}, although an input follows the outputs")
    orders, held_out = tuple(search.errors), np.array([*search.errors.values()])
    model = replace(model, orders=orders, held_out=held_out, values=search.values)
    return _in_units(model, units, records[0][1], runs[0])


def _in_units(model: LinearModel, units: Units, u: Array, run: Signals) -> LinearModel:
    """Return a model of normalised records in their units, from the first sample of the first."""
    model = model.in_units(units.y_mean, units.y_scale, units.u_mean, units.u_scale)
    begin = len(u) - run.u.shape[1]
    if not begin:  # fitted from the first sample on
        return replace(model, late=(0,) * model.ny)
    return model.begun(u, begin)


def _model_of(
    at: Solution,
    runs: Sequence[Signals],
    delays: Sequence[int],
    gain: Array | None = None,
    by: str = "output error",
) -> LinearModel:
    """Return the model of blocks in normalised units, its states uncorrelated.

    `runs` have no constant input. The `gain` for the blocks' states is fitted by default.
    """
    blocks, inputs = at.blocks, [run.u.T for run in runs]
    (a, b, c, d), ny = at.matrices(), len(at.scale)
    drift = blocks.matrices()[1][:, -1] if blocks.constant else np.zeros(len(a))
    first = [x.ravel()[blocks.kept.ravel()] for x in at.first]

    def visited() -> Array:
        """Return the states of all records, one record after the other."""
        runs = zip(inputs, first, strict=True)
        return np.concatenate([states(a, u @ b.T + drift, start) for u, start in runs])

    into, out = whitening(visited())
    a, b, c, drift = into @ a @ out, into @ b, c @ out, into @ drift
    first = [into @ start for start in first]
    x = visited()
    np.clip(np.nan_to_num(x, copy=False), -1e150, 1e150, out=x)
    centre, spread = x.mean(axis=0), np.cov(x.T, bias=True).reshape(a.shape)
    cuts = windows(runs, MOST_SAMPLES)
    errors = [at.errors[i][:, begin:end].T for i, begin, end in cuts]
    measured = [runs[i].measured[:, begin:end].T for i, begin, end in cuts]
    gain = fitted_gain(a, c, spread, errors, measured) if gain is None else into @ gain
    pairs = sum((e[1:] * e[:-1]).sum(axis=0) for e in errors)
    both = sum((s[1:] * s[:-1]).sum(axis=0) for s in measured)
    alike = pairs / np.maximum(both, 1) / np.maximum(at.scale**2, 1e-300)
    alike = np.clip(alike, 0, _MOST_CORRELATED)
    system = a, b, c, d, blocks.offset, drift, gain, covariance(a, c, gain, errors, measured)
    of_u = np.zeros(len(delays)), tuple(enumerate(delays)), (max(delays, default=0),) * ny
    begin = first[0], first[0], centre, root_of(spread)
    left = at.scale, np.diag(at.scale**2 * (1 + alike) / (1 - alike)), np.ones(ny)
    integrators = int(2 * blocks.fixed.sum() - (blocks.fixed & blocks.single).sum())
    angles = tuple(silent(np.linalg.eigvals(a).astype(np.complex128), runs))
    return LinearModel(*system, *of_u, *begin, *left, integrators, by, silent=angles)


def _predictor(model: LinearModel, at: Solution, runs: Sequence[Signals]) -> Predictor:
    """Return the predictor with the least error, with a `model` by output error as the start.

    Outputs are simulated in gaps. Immediate feedback and feedthrough cannot be distinguished: with
    a controller, no feedthrough is assumed.
    """
    fitted = with_constant(runs) if at.blocks.constant else runs
    outputs = [at.blocks.simulate(run, x) for run, x in zip(fitted, at.first, strict=True)]
    both = with_outputs(runs, outputs)
    direct = [*(delay > 0 for _, delay in model.taps), *[False] * model.ny]
    begin = linear_solution(blocks_of(model.a - model.gain @ model.c, model.c, direct), both)
    return Predictor(refined(begin, both, ITERATIONS, MAX_OBSERVER_POLE), both)


def _by_prediction(
    predictor: Predictor, runs: Sequence[Signals], delays: Sequence[int], longest: int
) -> LinearModel:
    """Return the model by prediction error, in normalised units."""
    a, b, c, d, gain = predictor.matrices()
    ny, nu = d.shape
    blocks = blocks_of(a, c, [True] * nu, b=b, d=d)
    # The model's simulation, from the best initial states with the best offset.
    runs = _parts(runs, a)
    at = evaluated(blocks, runs, [np.zeros((len(blocks.a), 2)) for _ in runs])
    free = np.zeros(len(blocks.values), bool)
    free[-ny:] = True
    at = stepped(at, runs, free, equations(at, runs, free), 0.0)
    # The gain in the coordinates of the blocks.
    gain = blocks_of(a, c, [False] * ny, b=gain).b.reshape(-1, ny)[blocks.kept.ravel()]
    new = _model_of(at, runs, delays, gain, "prediction error")
    return replace(new, uncertainty=predictor.uncertainty(longest))


def _parts(runs: Sequence[Signals], a: Array) -> Sequence[Signals]:
    """Return the runs; for an unstable model in parts with a growth of at most `_GROWTH`."""
    size = abs(np.linalg.eigvals(a)).max(initial=0.0)
    if size <= 1:
        return runs
    length = max(int(np.log(_GROWTH) / np.log(size)), 4 * len(a))
    parts = []
    for run in runs:
        count = max(run.u.shape[1] // length, 1)
        cut = [np.array_split(signal, count, axis=1) for signal in run]
        parts += [Signals(*part) for part in zip(*cut, strict=True)]
    return parts


def feedback(errors: Sequence[Array], inputs: Sequence[Array]) -> bool:
    """Return whether a controller acts on the inputs: past errors of a simulation predict an input.

    Beside the past of all inputs, after C. W. J. Granger (1969). In an open loop the errors are
    noise, independent of the inputs. Errors explained by squares of the inputs are those of a
    nonlinear system, and may predict a smooth input, too: they do not count. By record, `errors`
    are `(ny, time)` and `inputs` `(nu, time)`.
    """
    rows, nu, ny, most = [], len(inputs[0]), len(errors[0]), _ROWS // len(inputs)
    mean, deviation = np.hstack(inputs).mean(axis=1), np.hstack(inputs).std(axis=1)
    for e, u in zip(errors, inputs, strict=True):
        if u.shape[1] > 2 * _LAGS:
            squares = ((u.T - mean) / np.where(deviation > 0, deviation, 1.0)) ** 2 - 1
            signals = np.vstack([u, e, squares.T])
            views = np.lib.stride_tricks.sliding_window_view(signals, _LAGS + 1, axis=1)
            rows.append(views[:, :most].transpose(1, 0, 2))
    if not rows:
        return False
    data = np.concatenate(rows)
    signals = data[:, : nu + ny, :-1].reshape(len(data), -1)
    of_inputs, past = signals[:, : nu * _LAGS], signals[:, nu * _LAGS :]
    noticed = explains(past, data[:, :nu, -1], of_inputs)
    squares = data[:, nu + ny :].reshape(len(data), -1)
    return noticed and not explains(squares, data[:, nu : nu + ny, -1], signals)

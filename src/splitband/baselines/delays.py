"""Estimate the dead time of inputs in samples.

For an input that acts only after many samples, a linear model needs as many parameters and a
network as long a memory. Shifting the input by its delay avoids both.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy

from splitband.baselines.common import recent
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array

SHORTEST = 4
"""Shortest delay in samples; the model's coefficients account for shorter ones. By eye."""
LONGEST_DELAY = 200
"""Longest delay in samples. By eye."""
_COEFFICIENTS = 400
"""Most coefficients of the ARX model that delays are read from, to limit the time. By eye."""
_SAMPLES_EACH = 5
"""Fewest samples per coefficient. By eye."""
_PAST = 4
"""Past outputs in the ARX model. By eye."""
_CHANCE = 1e-3
"""Probability of a false detection for an input without effect. By eye."""


def check_delays(delays: Sequence[int], inputs: int) -> None:
    """Check the number and range of delays, which may come from a file; raises ValueError."""
    if len(delays) != inputs:
        raise ValueError(f"delays must be those of {inputs} inputs, got {len(delays)}")
    for delay in delays:
        whole("delays", delay, 0, LONGEST_DELAY)


def delayed(u: Array, delays: Sequence[int]) -> Array:
    """Return inputs `(time, nu)`, each delayed in samples; the first value is held before it."""
    if not any(delays):
        return u
    rows = np.arange(len(u))[:, None] - np.asarray(delays)
    return np.asarray(np.take_along_axis(u, np.maximum(rows, 0), axis=0))


def candidates(records: Sequence[tuple[Array, Array]]) -> tuple[int, ...]:
    """Return for each input the first delay at which it has a significant effect.

    This is the lag of the input's first significant coefficient in an ARX model: a regression of
    the output on the lagged inputs and on its own past, which whitens the errors. The delay is 0
    for an input without a significant effect, for one that acts after fewer than `SHORTEST`
    samples, and for records with too few samples.

    Parameters
    ----------
    records : `y` `(time, ny)`, NaN in gaps, and `u` `(time, nu)` of each.
    """
    nu = records[0][1].shape[1]
    ends = [recent(y)[0] for y, _ in records]
    records = [(y[begin:], u[begin:]) for (y, u), begin in zip(records, ends, strict=True)]
    samples = sum(len(y) for y, _ in records)
    shortest = min(len(y) for y, _ in records)
    lags = min(LONGEST_DELAY, _COEFFICIENTS // nu, (samples // _SAMPLES_EACH - _PAST) // nu,
               shortest // 2) - 1  # fmt: skip
    if lags < SHORTEST:
        return (0,) * nu
    found = [
        _significant([(y[:, i], u) for y, u in records], lags)
        for i in range(records[0][0].shape[1])
    ]
    first = [min(of_input) for of_input in zip(*found, strict=True)]
    return tuple(lag if SHORTEST <= lag <= lags else 0 for lag in first)


def _significant(records: Sequence[tuple[Array, Array]], lags: int) -> list[int]:
    """Return the first significant lag of each input; `lags + 1` if there is none."""
    nu = records[0][1].shape[1]
    rows = [_regressors(y, u, lags) for y, u in records]
    x, y = np.concatenate([x for x, _ in rows]), np.concatenate([y for _, y in rows])
    freedom = len(y) - x.shape[1]
    if freedom < x.shape[1]:
        return [lags + 1] * nu
    scale = np.linalg.norm(x, axis=0)
    used = scale > 0
    outer, size, inner = np.linalg.svd(x[:, used] / scale[used], full_matrices=False)
    kept = size > 1e-8 * size[0]
    outer, size, inner = outer[:, kept], size[kept], inner[kept]
    projected = outer.T @ y
    error = float(np.sum((y - outer @ projected) ** 2)) / freedom
    deviation = np.sqrt(error * np.sum((inner / size[:, None]) ** 2, axis=0))
    t = np.zeros(x.shape[1])
    t[used] = (inner.T @ (projected / size)) / np.maximum(deviation, np.finfo(float).tiny)
    limit = scipy.stats.t.isf(_CHANCE / (2 * nu * (lags + 1)), freedom)
    late = (abs(t[: nu * (lags + 1)]) > limit).reshape(nu, lags + 1)
    return [int(of_input.argmax()) if of_input.any() else lags + 1 for of_input in late]


def _regressors(y: Array, u: Array, lags: int) -> tuple[Array, Array]:
    """Return the ARX regressors (lagged inputs, past outputs, 1) and the outputs, without gaps."""
    begin = max(lags, _PAST)
    index = np.arange(begin, len(y))[:, None]
    inputs = [x[index - np.arange(lags + 1)] for x in u.T]
    past = y[index - np.arange(1, _PAST + 1)]
    x = np.hstack([*inputs, past, np.ones((len(index), 1))])
    measured = ~np.isnan(y[begin:]) & ~np.isnan(past).any(axis=1)
    return x[measured], y[begin:][measured]

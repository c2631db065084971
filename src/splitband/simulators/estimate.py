"""Report a parameter fit: values, standard errors, and parameters that are not identifiable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import scipy

from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError
from splitband.runtime.options import saved
from splitband.simulators.parameters import Parameters

Name = tuple[str, int]
"""Name of a parameter, and number of its record; -1 for all records."""

AT_BOUND = 2e-3
"""Distance from a bound, as a share of the range, within which a parameter is at it. By eye."""
MAX_RELATIVE_ERROR = 0.25
"""Standard error, as a share of the range, above which a direction is not identifiable. By eye."""
MIN_NOISE = 1e-3
"""Smallest assumed error of a model, in deviations of the record. By eye."""
MIN_COMPONENT = 0.2
"""Smallest component of a direction for which its parameter is named in a remark. By eye."""
_MOST_LAGS = 0.1
"""Longest lag of the residuals' autocorrelation, as a share of the samples. By eye."""


@saved
@dataclass(frozen=True, eq=False)
class Estimate:
    """Hold the values of fitted parameters, with standard errors.

    Attributes
    ----------
    values : Values by name; initial values of further records as `x0_1, record 2`.
    errors : Standard errors, corrected for the autocorrelation of the residuals; NaN for parameters
        at a bound or not identifiable.
    correlations : Correlations of the estimated values, `(n, n)`, in their order; NaN as above.
    rmse : RMSE of each channel over the training samples.
    remarks : Parameters that are not identifiable or at a bound, and other fits as good.
    window : Samples of the windows in which the record was simulated; 0 for all of it.
    starts : Number of starting points that led to the same fit, and number that were fitted.
    cut : Whether the deadline passed before every starting point was tried.
    """

    values: dict[str, float] = field(default_factory=dict)
    errors: dict[str, float] = field(default_factory=dict)
    correlations: Any = field(default_factory=lambda: np.empty((0, 0)))
    rmse: tuple[float, ...] = ()
    remarks: tuple[str, ...] = ()
    window: int = 0
    starts: tuple[int, int] = (0, 0)
    cut: bool = False

    def __post_init__(self) -> None:
        """Check values that may come from a file."""
        for name, value in self.values.items():
            if not isinstance(value, int | float) or not np.isfinite(value):
                raise InputError(f"an estimate must hold finite numbers, got {name}={value!r}")
        if self.values.keys() != self.errors.keys():
            raise InputError("an estimate must have as many errors as values")

    def __str__(self) -> str:
        """Return each value with its standard error, and the remarks."""
        said = [f"{name} = {_rounded(value, self.errors[name])}"
                for name, value in self.values.items()]  # fmt: skip
        return "; ".join([", ".join(said), *self.remarks] if said else self.remarks)

    def as_json(self) -> dict[str, Any]:
        """Return the content of result files."""
        return {
            "values": self.values,
            "standard_errors": {k: None if np.isnan(e) else e for k, e in self.errors.items()},
            "correlations": [
                [None if np.isnan(c) else round(float(c), 4) for c in row]
                for row in self.correlations
            ],
            "remarks": [*self.remarks],
            "window": self.window or None,
            "starts_that_agree": self.starts[0],
            "starts": self.starts[1],
        }


def _rounded(value: float, error: float) -> str:
    if not np.isfinite(error) or error <= 0:
        return f"{value:.4g}"
    digits = int(np.floor(np.log10(error)))
    decimals = max(1 - digits, 0)
    if abs(value) < 1e5 and decimals < 8:
        return f"{value:.{decimals}f} ± {error:.{decimals}f}"
    return f"{value:.5g} ± {error:.2g}"


def uncertainty(
    names: Sequence[Name], known: Parameters, fractions: Array, residuals: Array, jacobian: Array
) -> tuple[Array, Array, list[str]]:
    """Return the standard errors of fitted values, their correlations, and remarks.

    What is at a bound or not identifiable has NaN.

    Parameters
    ----------
    names, known : Names of the fitted parameters, and all parameters.
    fractions : Positions of the fitted parameters in their ranges, 0 to 1, `(n,)`.
    residuals : `(samples, ny)`, in deviations of the channels; NaN in gaps.
    jacobian : Derivatives of the residuals with respect to `fractions`, `(samples * ny, n)`.
    """
    at_bound, remarks = np.zeros(len(fractions), dtype=bool), []
    for i, (name, fraction) in enumerate(zip(names, fractions, strict=True)):
        if fraction < AT_BOUND or fraction > 1 - AT_BOUND:
            side, end = ("upper", 1) if fraction > 0.5 else ("lower", 0)
            at_bound[i] = True
            remarks.append(
                f"{labelled(name)} is at its {side} bound, {known.range(name[0])[end]:.4g}"
            )
    slopes = np.array([known.slope(n, p) for (n, _), p in zip(names, fractions, strict=True)])
    free = np.flatnonzero(~at_bound)
    noise = _noise(residuals, len(fractions))
    kept, weak = _directions(jacobian[:, free], noise)
    told = (jacobian[:, free] @ kept) * np.tile(noise, len(residuals))[:, None]
    covariance = np.full((len(fractions), len(fractions)), np.nan)
    # (J'J)^-1 J' W J (J'J)^-1, where W holds the error variance of each channel
    inner = kept @ (told.T @ told) @ kept.T * _correlated(residuals)
    covariance[np.ix_(free, free)] = inner
    values = np.array(
        [known.value_at(n, p) or 1.0 for (n, _), p in zip(names, fractions, strict=True)]
    )
    for direction in weak:
        involved = np.flatnonzero(np.abs(direction) > MIN_COMPONENT)
        lost = free[involved]
        covariance[lost] = covariance[:, lost] = np.nan
        remarks.append(
            _remark([names[i] for i in lost], direction[involved] * slopes[lost] / values[lost])
        )
    deviations = np.sqrt(np.diag(covariance))
    with np.errstate(invalid="ignore", divide="ignore"):
        correlations = covariance / np.outer(deviations, deviations)
        pairs = np.argwhere(np.triu(np.abs(correlations) > 0.99, 1))
    remarks += [
        f"{labelled(names[i])} and {labelled(names[j])} are correlated by {correlations[i, j]:.3f}"
        for i, j in pairs
    ]
    return deviations * np.abs(slopes), correlations, remarks


def _directions(jacobian: Array, noise: Array) -> tuple[Array, Array]:
    """Return the factor V / S of the identifiable directions, `(n, k)`, and the other directions."""
    if not jacobian.shape[1]:
        return np.empty((0, 0)), np.empty((0, 0))
    _, s, vt = np.linalg.svd(jacobian, full_matrices=False)
    s = np.concatenate([s, np.zeros(len(vt) - len(s))])
    least = MIN_NOISE * np.sqrt(len(noise))
    level = float(np.sqrt(np.mean(np.maximum(noise, least) ** 2)))
    weak = level / np.maximum(s, 1e-300) > MAX_RELATIVE_ERROR
    return vt[~weak].T / s[~weak], vt[weak]


def _noise(residuals: Array, fitted: int) -> Array:
    """Return the RMS error of each channel, corrected for the number of fitted parameters."""
    measured = np.maximum((~np.isnan(residuals)).sum(axis=0), 1)
    freedom = np.maximum(measured - fitted / residuals.shape[1], 1)
    return np.asarray(np.sqrt(np.nansum(residuals**2, axis=0) / freedom))


def _correlated(residuals: Array) -> float:
    """Return how many residual samples are worth one independent sample, at least 1."""
    most = 1.0
    for channel in residuals.T:
        r = channel[~np.isnan(channel)]
        n = len(r)
        if n < 20 or not np.any(r):
            continue
        lags = max(int(_MOST_LAGS * n), 1)
        products = scipy.signal.correlate(r, r, method="fft")[n - 1 :]
        rho = products[1 : lags + 1] / products[0]
        insignificant = np.flatnonzero(rho < 3 / np.sqrt(n))
        end = int(insignificant[0]) if len(insignificant) else lags
        most = max(most, 1 + 2 * float(rho[:end].sum()))
    return most


def labelled(name: Name) -> str:
    """Return the name of a parameter for messages."""
    return name[0] if name[1] < 1 else f"{name[0]}, record {name[1] + 1}"


def _remark(names: Sequence[Name], changes: Array) -> str:
    """Return a remark about a direction along which the values change by `changes`, relatively."""
    called = [labelled(name) for name in names]
    if len(names) == 1:
        return f"the record does not tell {called[0]}: its value does not matter"
    said = f"the record does not tell {', '.join(called[:-1])} and {called[-1]} apart"
    if len(names) > 2 or abs(abs(changes[0] / changes[1]) - 1) > 0.1:
        return said
    return f"{said}: only their {'product' if changes[0] * changes[1] < 0 else 'ratio'} matters"

"""Report a parameter fit: values, standard errors, and parameters that are not identifiable."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt
import scipy

from splitband.runtime.arrays import Array, Flags
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
                raise ValueError(f"an estimate must hold finite numbers, got {name}={value!r}")
        if self.values.keys() != self.errors.keys():
            raise ValueError("an estimate must have as many errors as values")

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
    places = max(1 - digits, 0)
    if abs(value) < 1e5 and places < 8:
        return f"{value:.{places}f} ± {error:.{places}f}"
    return f"{value:.5g} ± {error:.2g}"


@dataclass(frozen=True, eq=False)
class Curvature:
    """Hold the linearised fit at its minimum.

    Attributes
    ----------
    names, known : Names of the fitted parameters, and all parameters.
    places : Positions of the fitted parameters in their ranges, 0 to 1, `(n,)`.
    residuals : `(samples, ny)`, in deviations of the channels; NaN in gaps.
    jacobian : Derivatives of the residuals with respect to `places`, `(samples * ny, n)`.
    """

    names: Sequence[Name]
    known: Parameters
    places: Array
    residuals: Array
    jacobian: Array

    def uncertainty(self) -> tuple[Array, Array, list[str]]:
        """Return standard errors of the values, their correlations, and remarks."""
        fixed, remarks = self._at_bounds()
        free = np.flatnonzero(~fixed)
        covariance = np.full((len(fixed), len(fixed)), np.nan)
        inner, lost, said = self._covariance(free)
        covariance[np.ix_(free, free)] = inner
        covariance[lost] = covariance[:, lost] = np.nan
        slopes = [self.known.slope(n, p) for (n, _), p in zip(self.names, self.places, strict=True)]
        deviations = np.sqrt(np.diag(covariance))
        with np.errstate(invalid="ignore", divide="ignore"):
            correlations = covariance / np.outer(deviations, deviations)
        remarks += said + self._linked(correlations)
        return deviations * np.abs(slopes), correlations, remarks

    def _covariance(self, free: npt.NDArray[np.int_]) -> tuple[Array, list[int], list[str]]:
        """Return the covariance of the places `free`, those not identifiable, and remarks.

        Directions that are not identifiable are left out of the covariance.
        """
        j = self.jacobian[:, free]
        if not len(free):
            return np.empty((0, 0)), [], []
        _, s, vt = np.linalg.svd(j, full_matrices=False)
        s = np.concatenate([s, np.zeros(len(vt) - len(s))])
        noise, (samples, ny) = self._noise(), self.residuals.shape
        level = float(np.sqrt(np.mean(np.maximum(noise, MIN_NOISE * np.sqrt(ny)) ** 2)))
        weak = level / np.maximum(s, 1e-300) > MAX_RELATIVE_ERROR
        lost: list[int] = []
        said: list[str] = []
        for direction in vt[weak]:
            involved = np.flatnonzero(np.abs(direction) > MIN_COMPONENT)
            lost += [int(free[i]) for i in involved]
            at = [self.names[i] for i in free[involved]]
            pairs = [(name, float(place)) for (name, _), place in
                     zip(at, self.places[free[involved]], strict=True)]  # fmt: skip
            relative = [self.known.slope(*pair) / (self.known.at(*pair) or 1.0) for pair in pairs]
            said.append(_told(at, direction[involved] * np.array(relative)))
        kept = vt[~weak].T / s[~weak]
        told = (j @ kept) * np.tile(noise, samples)[:, None]
        # (J'J)^-1 J' W J (J'J)^-1, where W holds the error variance of each channel
        return kept @ (told.T @ told) @ kept.T * self._correlated(), lost, said

    def _noise(self) -> Array:
        """Return the RMS error of each channel, corrected for the number of parameters."""
        measured = np.maximum((~np.isnan(self.residuals)).sum(axis=0), 1)
        lost = len(self.places) / self.residuals.shape[1]
        power = np.nansum(self.residuals**2, axis=0) / np.maximum(measured - lost, 1)
        return np.asarray(np.sqrt(power))

    def _correlated(self) -> float:
        """Return how many residual samples are worth one independent sample, at least 1."""
        most = 1.0
        for channel in self.residuals.T:
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

    def _at_bounds(self) -> tuple[Flags, list[str]]:
        low, high = self.places < AT_BOUND, self.places > 1 - AT_BOUND
        remarks = []
        for name, at_low, at_high in zip(self.names, low, high, strict=True):
            if at_low or at_high:
                end = self.known.range(name[0])[int(at_high)]
                side = "upper" if at_high else "lower"
                remarks.append(f"{labelled(name)} is at its {side} bound, {end:.4g}")
        return low | high, remarks

    def _linked(self, correlations: Array) -> list[str]:
        """Return a remark for each pair of parameters correlated by more than 0.99."""
        with np.errstate(invalid="ignore"):
            pairs = np.argwhere(np.triu(np.abs(correlations) > 0.99, 1))
        return [
            f"{labelled(self.names[i])} and {labelled(self.names[j])} are correlated by "
            f"{correlations[i, j]:.3f}"
            for i, j in pairs
        ]


def labelled(name: Name) -> str:
    """Return the name of a parameter for messages."""
    return name[0] if name[1] < 1 else f"{name[0]}, record {name[1] + 1}"


def _told(names: Sequence[Name], changes: Array) -> str:
    """Return a remark about a direction that is not identifiable.

    `changes` are the relative changes of the values along it.
    """
    called = [labelled(name) for name in names]
    if len(names) == 1:
        return f"the record does not tell {called[0]}: its value does not matter"
    said = f"the record does not tell {', '.join(called[:-1])} and {called[-1]} apart"
    if len(names) > 2 or abs(abs(changes[0] / changes[1]) - 1) > 0.1:
        return said
    return f"{said}: only their {'product' if changes[0] * changes[1] < 0 else 'ratio'} matters"

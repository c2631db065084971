"""Estimate A and C of a linear system by a subspace method.

Past inputs and outputs are the instruments: P. Van Overschee and B. De Moor, Subspace
Identification for Linear Systems, 1996; M. Verhaegen, Automatica 30, 1994 (PO-MOESP).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
import numpy.typing as npt
import scipy

from splitband.runtime.arrays import Array

_WORK = 3e9
"""Largest number of operations for the triangular factor of the data; further windows are left out
evenly. Bounds the time to about a second."""
_RANK = 1e-9
"""Smallest direction of the data, as a share of the largest. Rounding."""
_WINDOWS = 1.2
"""Fewest windows of the records, in multiples of the values in a window. By eye."""


@dataclass(frozen=True, eq=False)
class Subspace:
    """The range of the observability matrix, for all orders.

    vectors : Directions of the range, `(rows * ny, directions)`, the most important first.
    values : Singular values of the directions.
    ny : Number of outputs.
    stride : Samples from one block row to the next.
    """

    vectors: Array
    values: Array
    ny: int
    stride: int = 1

    @property
    def largest(self) -> int:
        """Return the largest possible order."""
        return min(len(self.vectors) - self.ny, len(self.values))

    def matrices(self, order: int) -> tuple[Array, Array]:
        """Return A and C of this order, at the rate of the record."""
        gamma = self.vectors[:, :order]
        a = np.asarray(
            np.linalg.lstsq(gamma[: -self.ny], gamma[self.ny :], rcond=None)[0], np.float64
        )
        c = gamma[: self.ny]
        return (_root(a, self.stride) if self.stride > 1 else a), c


def _root(a: Array, stride: int) -> Array:
    """Return the root of degree `stride` of `a`, by its poles; negative ones become positive."""
    poles, vectors = np.linalg.eig(a)
    small = np.maximum(abs(poles), 1e-12)
    turned = small ** (1 / stride) * np.exp(1j * np.angle(poles) / stride)
    turned = np.where((poles.imag == 0) & (poles.real < 0), small ** (1 / stride), turned)
    return np.asarray(np.real(vectors @ np.diag(turned) @ np.linalg.pinv(vectors)))


def most_rows(samples: int, records: int, signals: int) -> int:
    """Return the largest number of block rows with enough windows in records without gaps."""
    return int((samples + records) / (2 * records + 2 * _WINDOWS * signals))


def subspace(records: Sequence[tuple[Array, Array]], rows: int, stride: int = 1) -> Subspace | None:
    """Return the subspace of records, weighted as in CVA; None for too few windows without gaps.

    The records are `y`, NaN in gaps, and `u` without an offset, `rows` the block rows of past and
    of future. For slow systems, blocks of `stride` samples are averaged.
    """
    ny, nu = records[0][0].shape[1], records[0][1].shape[1]
    width = 2 * rows * (ny + nu)
    signals = list[Array]()
    for y, u in records:
        both = np.hstack([u, y])
        if stride > 1:
            length = len(both) // stride * stride
            both = both[:length].reshape(-1, stride, ny + nu).mean(axis=1)
        if len(both) >= 2 * rows:
            signals.append(both)
    # Where a window begins that has no gap.
    begins = [_without_gaps(both, 2 * rows) for both in signals]
    count = sum(map(len, begins))
    if count < _WINDOWS * width:
        return None
    thin = int(np.ceil(2 * count * width**2 / _WORK))
    thin = thin if count // thin >= 2 * width else 1
    taken = [at[::thin] for at in begins]
    # Columns [future u, past u and y, future y] by sample and signal, one by one: many windows fill
    # the memory that LAPACK works in, and no other.
    past, future = range(rows), range(rows, 2 * rows)
    columns = [
        *product(future, range(nu)),
        *product(past, range(nu + ny)),
        *product(future, range(nu, nu + ny)),
    ]
    data, size = np.empty((sum(map(len, taken)), width), order="F"), np.empty(width)
    for k, (late, signal) in enumerate(columns):
        x = np.concatenate(
            [both[at + late, signal] for both, at in zip(signals, taken, strict=True)]
        )
        size[k] = np.sqrt(np.cumsum(x**2)[-1])
        data[:, k] = x / (size[k] or 1.0)
    r = scipy.linalg.qr(data, mode="raw", overwrite_a=True, check_finite=False)[1]
    lower = (r * size).T
    i, j = nu * rows, (2 * nu + ny) * rows
    projection, noise = lower[j:, i:j], lower[j:, j:]
    # The square root of the covariance of future outputs, given future inputs.
    spread, axes = np.linalg.eigh(projection @ projection.T + noise @ noise.T)
    spread = np.sqrt(np.maximum(spread, _RANK**2 * max(spread[-1], 1e-300)))
    projection = (axes / spread) @ axes.T @ projection
    root = (axes * spread) @ axes.T
    outer, values, _ = np.linalg.svd(projection, full_matrices=False)
    return Subspace(root @ outer, values, ny, stride)


def filled(y: Array) -> Array:
    """Fill gaps by linear interpolation; a channel without samples becomes 0."""
    rows = np.flatnonzero(~np.isnan(y))
    return np.interp(np.arange(len(y)), rows, y[rows]) if len(rows) else np.zeros_like(y)


def _without_gaps(both: Array, size: int) -> npt.NDArray[np.int_]:
    """Return the first samples of all windows of `size` samples without a gap."""
    before = np.append(0, np.cumsum(np.isnan(both).any(axis=1)))
    return np.flatnonzero(before[size:] == before[:-size])


def stable(a: Array, limit: float = 1 - 1e-6) -> Array:
    """Return A with poles outside of the unit circle reflected, and complex ones below `limit`."""
    poles, vectors = np.linalg.eig(a)
    size = abs(poles)
    most = np.where(poles.imag == 0, 1 - 1e-6, limit * (1 - 1e-6))
    if (size < most).all():
        return a
    inside = np.minimum(np.where(size > 1, 1 / np.maximum(size, 1e-12), size), most)
    moved = poles * inside / np.maximum(size, 1e-300)
    return np.asarray(np.real(vectors @ np.diag(moved) @ np.linalg.pinv(vectors)))

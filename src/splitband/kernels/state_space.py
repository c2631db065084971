"""Roll out a state-space network in innovations form, forward and backward, compiled.

With z_n = [x_n, 1, u_n], s_n = [u_{n-1}, x_n, 1], and u_0 in place of u_{-1},

    x_{n+1} = [A a B] z_n + W_f tanh(F z_n) + K e_n,    y_n = [D C c] s_n + W_g tanh(G s_n),

where e_n is the measured sample minus y_n in the warm-up, and zero afterwards.

These networks have a few states and a few dozen units, often fewer than a vector has lanes. So the
rows of a batch are the lanes (`state_space_lanes`). A few rows would leave most lanes empty: they
are processed one after the other (`state_space_rows`).
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from torch import Tensor

from splitband.kernels import state_space_lanes, state_space_rows
from splitband.kernels.common import Array, Arrays
from splitband.kernels.rollouts import Kernel, Shapes, padded, run, split_rows

_MOST_LANES = 128
"""Rows of a job, with steps that fit into the cache."""
_FEW = 4
"""Fewest rows of `state_space_lanes`; fewer take less time one after the other."""


def state_space_rollout(
    x0: Tensor,
    y_warmup: Tensor,
    steps: int,
    u: Tensor | None,
    *weights: Tensor,
) -> Tensor:
    """Warm up as an observer of the measured samples, then simulate.

    Differentiable once, with respect to every tensor.

    Returns the samples R..R+steps-1, shape `(batch, steps, ny)`.

    Parameters
    ----------
    x0 : The state at the first sample `(batch, S)`, float32 or float64.
    y_warmup : Measured samples `(batch, R, ny)`.
    steps : Number of samples to simulate.
    u : Known inputs `(batch, R + steps - 1, nu)` or longer, or None.
    weights : Weight and bias of the units of f and of g, `(H, S + nu)` and `(H,)`, H >= 0;
        [A, B, W_f] `(S, S + nu + H)` and a `(S,)`; [C, D, W_g] `(ny, S + nu + H)` and c `(ny,)`;
        K `(S, ny)`.
    """
    batch, warmup, ny = y_warmup.shape
    last = max(warmup + steps - 1, 0)
    u = y_warmup.new_empty(batch, last, 0) if u is None else u
    kind, of = (_Rows, state_space_rows) if batch < _FEW else (_Lanes, state_space_lanes)
    kernel = kind(batch, steps, ny, u.shape[-1], last, of.forward, of.backward)
    return run(kernel, (x0, y_warmup, u), weights)


class _StateSpace(Kernel):
    """Pack the weights as [F; A a B], W_f, [G; D C c], W_g, K, with the columns of z and of s."""

    def pack(self, *weights: Array) -> Arrays:
        weight_f, bias_f, weight_g, bias_g, weight_x, bias_x, weight_y, bias_y, gain = weights
        size, columns = gain.shape[0], weight_f.shape[1]
        f = np.concatenate([weight_f, weight_x[:, :columns]])
        g = np.concatenate([weight_g, weight_y[:, :columns]])
        of_f = np.concatenate([bias_f, bias_x])[:, None]
        of_g = np.concatenate([bias_g, bias_y])[:, None]
        z = np.concatenate([f[:, :size], of_f, f[:, size:]], axis=1)
        s = np.concatenate([g[:, size:], g[:, :size], of_g], axis=1)
        packed = z, weight_x[:, columns:], s, weight_y[:, columns:], gain
        return tuple(np.ascontiguousarray(w) for w in packed)

    def sums(self, packed: Arrays) -> Shapes:
        return [w.shape for w in packed]

    def unpack(self, *sums: Array) -> Iterable[Array]:
        dz, dwx, ds, dwy, dgain = sums
        hidden, size, nu = dwx.shape[1], len(dgain), self.nu
        f = np.concatenate([dz[:, :size], dz[:, size + 1 :]], axis=1)
        g = np.concatenate([ds[:, nu:-1], ds[:, :nu]], axis=1)
        of_f, of_g = dz[:, size], ds[:, -1]
        return (
            *(f[:hidden], of_f[:hidden], g[:hidden], of_g[:hidden]),
            *(np.concatenate([f[hidden:], dwx], axis=1), of_f[hidden:]),
            *(np.concatenate([g[hidden:], dwy], axis=1), of_g[hidden:]),
            dgain,
        )


class _Lanes(_StateSpace):
    """Process the rows of a job side by side."""

    def split(self, packed: Arrays) -> list[slice]:
        work = float(self.batch) * self.last * sum(w.size for w in packed)
        return split_rows(self.batch, work, least=-(-self.batch // _MOST_LANES))

    def kept(self, packed: Arrays, rows: int, keep: bool) -> Shapes:
        (_, width), (_, hidden) = packed[0].shape, packed[1].shape
        slots, lanes = (self.last + 1 if keep else 2), padded(rows)
        units = (slots, hidden, lanes)
        errors = ((self.last + 1 - self.steps) * self.ny, lanes)
        return (slots * width, lanes), units, units, errors


class _Rows(_StateSpace):
    """Process the rows one after the other."""

    def split(self, packed: Arrays) -> list[slice]:
        return [slice(row, row + 1) for row in range(self.batch)]

    def kept(self, packed: Arrays, rows: int, keep: bool) -> Shapes:
        (_, width), (_, hidden) = packed[0].shape, packed[1].shape
        slots = self.last + 1 if keep else state_space_rows.CHUNK
        units = (slots, padded(hidden))
        errors = (self.last + 1 - self.steps, padded(self.ny))
        return (slots + 2, padded(width)), units, units, errors

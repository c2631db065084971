"""Simulate a cell freely: warm up on measured samples, then feed predictions back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Literal, cast, get_args

from splitband.networks.cell import Cell
from splitband.networks.layers import Tensor, torch
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

Backend = Literal["auto", "plain", "fused"]


def rollout(
    cell: Cell, y_warmup: Tensor, steps: int, u: Tensor | None = None, backend: Backend = "auto"
) -> Tensor:
    """Warm up on measured samples, then simulate freely (Ensinger et al. 2023, Eq. 8, rollout).

    The warm-up feeds y_0..y_{R-1} and leaves h_R; the first prediction is C h_R, and predictions
    are fed back in place of measurements.

    Parameters
    ----------
    cell : The network.
    y_warmup : Measured samples `(batch, R, ny)`, R >= 1.
    steps : Number of samples to simulate.
    u : Known inputs `(batch, R + steps, nu)` or longer, for a cell with inputs. Row n acts on the
        step from n to n + 1, so the last row is not used.
    backend : `"plain"` is the loop over steps, the definition. `"fused"` is a compiled kernel, for
        cells with a `fused_rollout`, on the CPU. `"auto"` takes the kernel where possible.

    Returns
    -------
    Tensor
        The simulated samples R..R+steps-1, shape `(batch, steps, ny)`.

    Examples
    --------
    >>> import torch
    >>> cell = sb.GRU(8)
    >>> sb.networks.rollout(cell, torch.zeros(2, 5, 1), steps=30).shape
    torch.Size([2, 30, 1])
    """
    _check(cell, y_warmup, steps, u)
    warmup = y_warmup.shape[1]
    if backend not in get_args(Backend):
        raise InputError(f"backend must be one of {get_args(Backend)}, got {backend!r}")
    fused = _kernel(cell, "fused_rollout", y_warmup, steps, u)
    if backend == "fused" and fused is None:
        raise InputError(
            f'backend="fused" needs a cell with a kernel, the CPU, float32 or float64 throughout '
            f"and a step, got {type(cell).__name__} on {y_warmup.device.type} in {y_warmup.dtype} "
            f"for {steps} steps"
        )
    if fused is not None and backend != "plain":
        return fused(y_warmup, steps, u)
    past, future = (None, None) if u is None else (u[:, :warmup], u[:, warmup:])
    return free_run(cell, cell.initial_state(y_warmup, past), steps, future)[0]


def free_run(cell: Cell, h: Any, steps: int, u: Tensor | None = None) -> tuple[Tensor, Any]:
    """Simulate from the state `h`; return the samples `(batch, steps, ny)` and the last state.

    The last state belongs to the last sample: `step(h, observe(h), u)` continues.
    """
    y = cell.observe(h)
    samples = [y]
    for n in range(steps - 1):
        h = cell.step(h, y, None if u is None else u[:, n])
        y = cell.observe(h)
        samples.append(y)
    return torch.stack(samples[:steps], dim=1) if steps else y[:, None][:, :0], h


def jacobians(
    cell: Cell, y_warmup: Tensor, steps: int, u: Tensor | None = None
) -> Iterator[Array] | None:
    """Return the derivatives of the rollout by each of the cell's `parameters()`, row by row.

    Of each row an array `(steps, ny, parameters)`, which a later row overwrites; None where no
    compiled kernel computes them. Arguments as for `rollout`.
    """
    _check(cell, y_warmup, steps, u)
    fused = _kernel(cell, "fused_jacobian", y_warmup, steps, u)
    return None if fused is None else fused(y_warmup, steps, u)


def _kernel(
    cell: Cell, name: str, y_warmup: Tensor, steps: int, u: Tensor | None
) -> Callable[..., Any] | None:
    """Return a cell's method that is compiled if its results are those of the loop, else None.

    A subclass may step differently: it has to declare the method itself.
    """
    if name not in vars(type(cell)) or not cell.fusable():  # type: ignore[attr-defined]
        return None
    given = y_warmup if u is None else u
    dtypes = {x.dtype for x in (y_warmup, given, *cell.parameters())}  # type: ignore[attr-defined]
    served = y_warmup.device.type == "cpu" and steps > 0 and len(dtypes) == 1
    if served and dtypes <= {torch.float32, torch.float64}:
        return cast("Callable[..., Any]", getattr(cell, name))
    return None


def _check(cell: Cell, y_warmup: Tensor, steps: int, u: Tensor | None) -> None:
    if y_warmup.ndim != 3 or y_warmup.shape[-1] != cell.ny or not y_warmup.shape[1]:
        raise InputError(
            f"y_warmup must be (batch, R >= 1, ny = {cell.ny}), got {tuple(y_warmup.shape)}"
        )
    if steps < 0:
        raise InputError(f"steps must not be negative, got {steps}")
    if (u is not None) != bool(cell.nu):
        raise InputError(f"u must be given exactly where the cell takes inputs, nu = {cell.nu}")
    if u is not None:
        batch, warmup, _ = y_warmup.shape
        if u.ndim != 3 or u.shape[0] != batch or u.shape[2] != cell.nu:
            raise InputError(
                f"u must be (batch = {batch}, time, nu = {cell.nu}), got {tuple(u.shape)}"
            )
        if u.shape[1] < warmup + max(steps - 1, 0):
            raise InputError(
                f"u must cover warm-up and simulation, {warmup} + {steps} samples, got {u.shape[1]}"
            )

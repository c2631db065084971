"""Finish a training by L-BFGS on windows laid end to end, all of them in every step.

Not in the paper. Adam takes a few windows at a time and makes fast progress from random weights;
near a minimum its steps are mostly noise. The gradient over the whole record costs no more than a
few dozen steps of Adam for networks of this size, and quasi-Newton iterations (Nocedal and Wright,
Numerical Optimization, 2006, Sec. 7.2) then lower the loss in a fraction of the time. Where
rounding in float32 hides the descent, the iterations go on in float64.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from splitband.runtime.deadlines import Deadline
from splitband.training.optimizers import LBFGS
from splitband.training.settings import ROUND

ROUND_IN_FLOAT64 = 12
"""Iterations of a round in float64, for the time of `ROUND` iterations in float32."""
MEMORY = 30
"""Steps in the estimate of the curvature."""
CONVERGED = 1e-5
"""Least share by which a round with progress lowers the mean square; see `round`."""
MAX_WINDOWS_WITH_OVERLAP = 20_000
"""Up to this many candidates, the predicted parts of successive windows overlap by half."""
UNBOUNDED = 1e10
"""Upper limit of losses, non-finite ones included, in multiples of the first loss."""


def end_to_end(starts: Tensor, window: int, warmup: int, max_samples: int) -> Tensor:
    """Choose the fewest windows, given the first samples of all, that predict every sample.

    The warm-up of a window lies in the predicted part of the window before it. In short records
    (see `MAX_WINDOWS_WITH_OVERLAP`) a further window lies halfway between two of them: most samples
    are then predicted both early and late in a free run, where errors differ.
    """
    overlap = 2 if len(starts) <= MAX_WINDOWS_WITH_OVERLAP else 1
    hop = max(1, (window - warmup) // overlap)
    # Before gaps and at the end of each record.
    last = {*starts[:-1][starts.diff() > 1].tolist(), int(starts[-1])}
    chosen = [int(starts[0])]
    for start in starts[1:].tolist():
        if start >= chosen[-1] + hop or start in last:
            chosen.append(start)
    most = max(1, max_samples // window)
    indices = torch.linspace(0, len(chosen) - 1, min(most, len(chosen))).round().long()
    return torch.tensor(chosen)[indices]


class _OverError(Exception):
    """The deadline has passed in the middle of a round."""


class Lbfgs:
    """L-BFGS with a line search for the strong Wolfe conditions, round by round.

    The objective is `mean_square`, the mean squared error of all windows. At the `deadline` a round
    ends with the best weights so far.
    """

    def __init__(
        self,
        parameters: Sequence[nn.Parameter],
        mean_square: Callable[[], Tensor],
        deadline: Deadline | None = None,
    ) -> None:
        self._deadline = deadline or Deadline()
        self._best: tuple[float, list[Tensor]] | None = None
        self.cut = False
        """Whether the deadline has ended the last round."""
        self.parameters, self._mean_square = [*parameters], mean_square
        self.scale = 0.0
        """Mean square at the beginning, the unit of the loss: torch's tolerances suit a loss of
        about 1."""
        self.settled = self._stuck = False
        double = self.parameters[0].dtype == torch.float64
        iterations = ROUND_IN_FLOAT64 if double else ROUND
        self._optimizer: torch.optim.LBFGS = LBFGS(
            self.parameters,
            max_iter=iterations,
            max_eval=2 * iterations,
            history_size=MEMORY,
            tolerance_grad=0.0,
            tolerance_change=0.0,
            line_search_fn="strong_wolfe",
        )

    def round(self) -> float:
        """Run the iterations of a `ROUND`; return the RMS error after them.

        If the error has grown or is not finite, the weights stay unchanged. The second round in a
        row without progress (see `CONVERGED`) is the last one.
        """
        before = [p.detach().clone() for p in self.parameters]
        began = self._error()
        self.scale = self.scale or began or 1.0
        self._best = None
        try:
            self._optimizer.step(self._closure)
        except _OverError:
            assert self._best is not None
            self.cut = True
            lowest, values = self._best
            self._put(values)
            return float((self.scale * lowest) ** 0.5)
        reached = self._error()
        if not reached <= began:
            self._put(before)
            reached = began
        if reached < (1 - CONVERGED) * began:
            self._stuck = False
            return float(reached**0.5)
        # The estimated curvature may be at fault: one more round without it before the end.
        self.settled = self._stuck
        self._stuck = True
        self._optimizer.state.clear()
        return float(reached**0.5)

    def _put(self, values: Sequence[Tensor]) -> None:
        with torch.no_grad():
            for p, value in zip(self.parameters, values, strict=True):
                p.copy_(value)

    def _error(self) -> float:
        with torch.no_grad():
            return float(self._mean_square())

    def _closure(self) -> float:
        self._optimizer.zero_grad(set_to_none=True)
        loss = self._mean_square() / self.scale
        loss.backward()
        value = loss.item()
        slopes = [p.grad for p in self.parameters if p.grad is not None]
        if not (value < UNBOUNDED and all(bool(slope.isfinite().all()) for slope in slopes)):
            # The step is too long: a state has grown without bound. The line search interpolates
            # values and slopes, and would not return from infinite ones.
            for parameter in self.parameters:
                parameter.grad = torch.zeros_like(parameter)
            value = UNBOUNDED
        if self._best is None or value < self._best[0]:
            self._best = value, [p.detach().clone() for p in self.parameters]
        if self._deadline.over:
            raise _OverError
        return value

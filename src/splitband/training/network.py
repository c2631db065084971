"""Train one network of a model, epoch by epoch."""

from __future__ import annotations

import math
from copy import deepcopy
from functools import partial

import torch
from torch import Tensor, nn

from splitband.models import Task
from splitband.networks.cell import Penalised
from splitband.runtime.deadlines import Deadline
from splitband.runtime.threads import one_torch_thread
from splitband.training import lbfgs, levenberg
from splitband.training.optimizers import Adam
from splitband.training.settings import ROUND, TrainingSettings
from splitband.training.windows import WindowSet, select, targets, windows

DIVERGED = 100.0
"""Diverging loss, in multiples of the target's RMS or of the untrained network's loss, whichever is
larger."""
UNLEARNED = 0.9
"""Loss of a network that has learned nothing, in multiples of the target's RMS; the mean has 1."""
ENOUGH_STEPS = 100
"""Gradient steps before which `UNLEARNED` is not applied."""
_TINY = 1e-6
"""Smallest divisor of the penalty."""
MOST_RESTARTS = 3
"""Largest number of restarts after divergence, with half the learning rate after each."""


class NetworkTraining:
    """The training of one network, epoch by epoch."""

    def __init__(
        self,
        task: Task,
        chosen: WindowSet,
        settings: TrainingSettings,
        seed: int,
        deadline: Deadline,
        driven: bool = False,
    ) -> None:
        self.deadline = deadline
        self.driven = driven
        """Whether the system has known inputs."""
        self.passes = settings.epochs + settings.rounds
        """Epochs, and rounds on all windows after them."""
        self.cut = False
        """Whether the deadline has come before the end of the training."""
        self.task, self.settings, self.starts = task, settings, chosen.starts
        self.known, self.target = windows(task, settings.window, settings.warmup)
        self.measured: Tensor | None = None
        if chosen.measured is not None:
            self.measured = targets(chosen.measured, task, settings.window, settings.warmup)
        self.optimizer = Adam([*task.network.parameters()], lr=settings.learning_rate)
        self.generator = torch.Generator().manual_seed(seed)
        size = float(torch.linalg.vector_norm(task.target)) / task.target.numel() ** 0.5
        self.target_rms = size or 1.0
        self.first_loss = 0.0
        """Loss of the untrained network. The target's RMS alone does not show divergence: the
        residual of a good simulator may be much smaller than an untrained network's output."""
        self.losses: list[float] = []
        self.restarts: list[int] = []
        """Epochs repeated after divergence, with half the learning rate."""
        self.finish: lbfgs.Lbfgs | levenberg.Levenberg | None = None
        self._given_dtype = self._dtype

    @property
    def notes(self) -> list[str]:
        """Return remarks on the training for the user."""
        remarks = [
            f"the loss diverged in epoch {epoch}, repeated with half the learning rate"
            for epoch in self.restarts
        ]
        if self.cut:
            done = f"{len(self.losses)} of {self.passes}"
            remarks.append(f"stopped by the time limit at epoch or round {done}")
        share = self.losses[-1] / self.target_rms if self.losses else 1.0
        if share > UNLEARNED and self.steps() >= ENOUGH_STEPS:
            remarks.append(
                f"nothing was learned: the error in training is {100 * share:.0f} % of the signal"
            )
        return remarks

    @property
    def done(self) -> bool:
        """Return whether all epochs and rounds are done."""
        settled = self.finish is not None and self.finish.settled
        return settled or len(self.losses) >= self.passes

    @property
    def over(self) -> bool:
        """Return whether the training is done, or the deadline has ended it."""
        return self.done or self.cut

    def advance(self) -> None:
        """Train for one epoch or, when all epochs are over, for one round on all windows.

        At least one gradient step is taken, even after the deadline: its loss is needed.
        """
        if self.losses and self.deadline.over:
            self.cut = True
            return
        if len(self.losses) < self.settings.epochs or not self.settings.lbfgs_iterations:
            self.epoch()
            return
        self.finish = self.finish or self._finish()
        self.losses.append(self.finish.round())
        self.cut = self.finish.cut
        if self.finish.settled and self._dtype != torch.float64:
            self._go_on_in_float64()

    def steps(self) -> int:
        """Return the gradient steps so far; an iteration of L-BFGS counts as one."""
        rounds = max(0, len(self.losses) - self.settings.epochs)
        batches = self.settings.batches(len(self.starts))
        return batches * (len(self.losses) - rounds) + ROUND * rounds

    def end(self) -> None:
        """Return the network to its original precision."""
        self.task.network.to(self._given_dtype)

    def epoch(self) -> None:
        """Train an epoch; after divergence, repeat it with half the learning rate."""
        network, optimizer, generator = self.task.network, self.optimizer, self.generator
        good = deepcopy([network.state_dict(), optimizer.state_dict(), generator.get_state()])
        first_loss = self.first_loss
        while True:
            loss = self._pass()
            most = DIVERGED * max(self.target_rms, self.first_loss)
            if loss <= most:
                self.losses.append(loss)
                return
            epoch = len(self.losses) + 1
            if len(self.restarts) >= MOST_RESTARTS:
                raise FloatingPointError(
                    f"training of the {self.task.name} diverged in epoch {epoch}: the loss is "
                    f"{loss:.4g} (at most {most:.4g} is allowed), after halving the learning rate "
                    f"{MOST_RESTARTS} times; lower it ({self.settings.learning_rate:g})"
                )
            weights, moments, drawn = deepcopy(good)  # the optimizer changes the tensors in place
            network.load_state_dict(weights)
            optimizer.load_state_dict(moments)
            generator.set_state(drawn)
            self.first_loss = first_loss
            self.restarts.append(epoch)

    def _pass(self) -> float:
        """Run one pass over all windows and return the mean loss."""
        settings, epoch = self.settings, len(self.losses)
        total, seen_windows, slower = 0.0, 0, 0.5 ** len(self.restarts)
        order = torch.randperm(len(self.starts), generator=self.generator)
        if settings.max_batches is not None:
            order = order[: settings.max_batches * settings.batch_size]
        batches = order.split(settings.batch_size)
        for i, chosen in enumerate(batches):
            batch = self.starts[chosen]
            share = (epoch + i / len(batches)) / settings.epochs
            steps = settings.reach(share, self.target.shape[1])
            for group in self.optimizer.param_groups:
                group["lr"] = settings.rate(epoch, share) * slower
            with one_torch_thread():
                signals, target = select(self.known, batch), self.target[batch, :steps]
                counted = None if self.measured is None else self.measured[batch, :steps]
            self.optimizer.zero_grad(set_to_none=True)
            loss = _rmse(self.task.simulate(signals, steps), target, counted)
            # The square root of a mean square with its penalty, to first order.
            (loss + self._penalty() / (2 * loss.detach().clamp_min(_TINY))).backward()
            with one_torch_thread():
                if settings.clip is not None:
                    nn.utils.clip_grad_norm_(self.task.network.parameters(), settings.clip)
                self.optimizer.step()
            if epoch == 0 and i == 0 and math.isfinite(loss.item()):
                self.first_loss = loss.item()
            total, seen_windows = total + loss.item() * len(batch), seen_windows + len(batch)
            if self.deadline.over and i + 1 < len(batches):
                self.cut = True
                break
        return total / seen_windows

    @property
    def _dtype(self) -> torch.dtype:
        return next(self.task.network.parameters()).dtype

    def _go_on_in_float64(self) -> None:
        settled = self.finish
        self.task.network.to(torch.float64)
        self.finish = self._lbfgs()
        try:
            self._mean_square(self.starts[:1])
        except RuntimeError:  # a user's cell may create float32 tensors
            self.end()
            self.finish = settled

    def _chosen(self) -> Tensor:
        """Return the first samples of the windows of a round."""
        settings = self.settings
        return lbfgs.end_to_end(self.starts, settings.window, settings.warmup, settings.max_samples)

    def _finish(self) -> lbfgs.Lbfgs | levenberg.Levenberg:
        """Return what trains on all windows."""
        if not self.driven:
            return self._lbfgs()
        chosen, measured = self._chosen(), self.measured
        windows = levenberg.Windows(
            select(self.known, chosen),
            self.target[chosen],
            None if measured is None else measured[chosen],
        )
        if not levenberg.suits(self.task, windows):
            return self._lbfgs()
        self.task.network.to(torch.float64)
        return levenberg.Levenberg(self.task, windows.double(), self.settings.l2, self.deadline)

    def _lbfgs(self) -> lbfgs.Lbfgs:
        error = partial(self._mean_square, self._chosen())
        return lbfgs.Lbfgs([*self.task.network.parameters()], error, self.deadline)

    def _mean_square(self, starts: Tensor) -> Tensor:
        """Return the mean squared error of the windows from `starts` on, plus the penalty."""
        dtype = self._dtype
        target = self.target[starts].to(dtype)
        signals = select(self.known, starts).map(lambda signal: signal.to(dtype))
        prediction = self.task.simulate(signals, target.shape[1])
        counted = None if self.measured is None else self.measured[starts]
        return _rmse(prediction, target, counted) ** 2 + self._penalty()

    def _penalty(self) -> Tensor | float:
        """Return the penalty of `TrainingSettings.l2`, in the unit of the mean square."""
        if not self.settings.l2:
            return 0.0
        network = self.task.network
        weights = network.penalised() if isinstance(network, Penalised) else network.parameters()
        return self.settings.l2 * sum(weight.square().sum() for weight in weights)


def _rmse(prediction: Tensor, target: Tensor, counted: Tensor | None = None) -> Tensor:
    # At zero error the gradient of a norm is zero; that of the root of a mean is NaN.
    if counted is None:
        return torch.linalg.vector_norm(prediction - target) / target.numel() ** 0.5
    left = torch.linalg.vector_norm((prediction - target) * counted)
    return left / max(int(counted.sum()), 1) ** 0.5

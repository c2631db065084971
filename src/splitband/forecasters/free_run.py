"""Run a trained model freely from a history, beside what it stands on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from torch import nn

from splitband.baselines.delays import delayed
from splitband.data.gaps import first_after, last_before
from splitband.forecasters.asking import total
from splitband.forecasters.differentiable import ModelSimulation
from splitband.forecasters.known import Known
from splitband.forecasters.prehistory import Prehistory
from splitband.forecasters.stepping import NotSteppedError, Recursion, Warmed
from splitband.models import Model
from splitband.models.hybrid import FAST, SLOW
from splitband.runtime.arrays import Array

if TYPE_CHECKING:
    from splitband.forecasters.base import Forecaster


@dataclass(frozen=True, eq=False)
class FreeRun:
    """Hold a trained model and what is needed to ask it.

    Attributes
    ----------
    name : For errors.
    model : Trained.
    warmup : Measured samples that it begins with.
    delays : By how many samples each input acts late.
    base : What holds the slow part, fitted; None without.
    prehistory : What may come before a history that is shorter than the warm-up.
    """

    name: str
    model: Model
    warmup: int
    delays: tuple[int, ...]
    base: Forecaster | None
    prehistory: Prehistory | None

    def components(self, known: Known) -> dict[str, Array]:
        """Return what comes after a history, `(steps, ny)`, part by part.

        It begins with the last `warmup` samples without a gap. Where the history is shorter, what
        came before is estimated.
        """
        return self._run(self.model.simulate_components, known)

    def unfiltered(self, known: Known) -> dict[str, Array]:
        """Return what the model's filters are fed with meanwhile, likewise."""
        return self._run(self.model.simulate_unfiltered, known)

    def trajectory(self, known: Known) -> Array:
        """Return a run from the history's first warm-up on, `(time + steps, ny)`.

        Before the run begins it is what was measured.
        """
        complete = np.asarray(~np.isnan(known.y).any(axis=1))
        start = len(known.y) if self._short(known) else first_after(complete, self.warmup)
        if start is None or not complete[:start].all():
            raise ValueError(
                f"history must begin with {self.warmup} measured samples for {self.name}"
            )
        steps = len(known.y) + known.steps - start
        begun = replace(known, y=known.y[:start], steps=steps)
        return np.concatenate([known.y[:start], total([*self.components(begun).values()])])

    def doubts(self, known: Known) -> list[str]:
        """Return those of the base, and whether the history is short."""
        doubts = [] if self.base is None else self.base.doubts(known)
        if self._short(known):
            short = (
                f"the history has {len(known.y)} of the {self.warmup} samples of a warm-up: "
                "what came before is estimated"
            )
            doubts = [*dict.fromkeys([*doubts, short])]
        return doubts

    def stepped(self, outside: bool) -> Recursion:
        """Return the same sample by sample, see `Forecaster.stepped`."""
        try:
            model = self.model.stepped()
        except ValueError as error:
            raise NotSteppedError(f"{self.name} cannot be stepped: {error}") from None
        part = None if self.base is None else self.base.part(outside)
        return Warmed(model, part, self.warmup, self.delays)

    def differentiable(self, known: Known) -> nn.Module:
        """Return the same as a torch module, see `Forecaster.differentiable`."""
        base = None
        if self.base is not None:
            if not self.base.affine:
                raise ValueError(
                    f"{self.name} cannot be run by torch: its base, {self.base.name}, is not "
                    "affine in the inputs"
                )
            base = self.base.differentiable(known)
        y, u, slow, since = self._warmed(known)
        longest = max(self.delays, default=0)
        late = np.zeros((0, 0)) if known.u is None else _last(known.u, longest)
        made = ModelSimulation(self.model, (y, u, slow), since, late, self.delays, base)
        return made.to(next(self.model.parameters()).device)

    def _short(self, known: Known) -> bool:
        """Return whether what came before a history has to be estimated, and can be."""
        short = 0 < len(known.y) < self.warmup
        return short and self.prehistory is not None and not np.isnan(known.y).any()

    def _run(self, simulate: Callable[..., dict[str, Array]], known: Known) -> dict[str, Array]:
        y, u, slow, since = self._warmed(known)
        parts = simulate(y, since + known.steps, u, slow)
        return {self._label(part): values[since:] for part, values in parts.items()}

    def _label(self, part: str) -> str:
        """Return what a part of the model is called; the base labels the slow one."""
        if self.base is None or not part.startswith(SLOW):
            return part
        # A base may be named as the fast component is, and two labels must not be the same.
        label = self.base.as_base.label
        return (label if label != FAST else "base") + part.removeprefix(SLOW)

    def _warmed(self, known: Known) -> tuple[Array, Array | None, Array | None, int]:
        """Return the last warm-up without a gap, and how many samples it ends before the origin.

        Beside the measured samples `(warmup, ny)` it has inputs and the base's output, from its
        begin to the last sample that is asked for.
        """
        y, u = known.y, None if known.u is None else delayed(known.u, self.delays)
        slow = None
        if self._short(known):
            assert self.prehistory is not None
            if self.base is not None:
                slow = self.base.trajectory(known)
            y, u, slow = self.prehistory.completed(self.model, y, u, slow)
        complete = np.asarray(~np.isnan(y).any(axis=1))
        start = last_before(complete, self.warmup, len(y))
        if start is None:
            raise ValueError(
                f"history must have {self.warmup} measured samples in a row to warm up on, got "
                f"{len(y)} samples, of which {int(complete.sum())} were measured in whole"
            )
        begin, since = start - self.warmup, len(y) - start
        if self.base is not None and slow is None:
            slow = self.base.trajectory(replace(known, since=begin))[begin:]
        return y[begin:start], None if u is None else u[begin:], slow, since


def _last(u: Array, rows: int) -> Array:
    """Return the last rows; before the first one its value is held, as `delayed` does."""
    return np.concatenate(
        [np.repeat(u[:1], max(rows - len(u), 0), axis=0), u[max(len(u) - rows, 0) :]]
    )

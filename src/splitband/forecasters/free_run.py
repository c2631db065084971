"""Simulate a trained model, with its base, from a history on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from splitband.baselines.delays import delayed
from splitband.data.signals import first_after, last_before
from splitband.forecasters.known import Known
from splitband.forecasters.predicting import total
from splitband.forecasters.prehistory import Prehistory
from splitband.forecasters.stepping import NotSteppedError, Recursion, Warmed
from splitband.models.labels import FAST, SLOW
from splitband.runtime.arrays import Array

if TYPE_CHECKING:
    from torch import nn

    from splitband.forecasters.base import Forecaster
    from splitband.models import Model


@dataclass(frozen=True, eq=False)
class FreeRun:
    """Hold a trained model and what its simulation needs.

    Attributes
    ----------
    name : For errors.
    model : Trained.
    warmup : Samples of the warm-up.
    delays : Delay of each input, in samples.
    base : The fitted forecaster of the slow component, or None.
    prehistory : Distribution of warm-ups, for a history that is shorter than one.
    """

    name: str
    model: Model
    warmup: int
    delays: tuple[int, ...]
    base: Forecaster | None
    prehistory: Prehistory | None

    def components(self, known: Known) -> dict[str, Array]:
        """Return the forecast after a history by component, `(steps, ny)` each.

        It warms up on the last `warmup` samples without a gap. Where the history is shorter, the
        samples before it are estimated.
        """
        return self._run(self.model.simulate_components, known)

    def unfiltered(self, known: Known) -> dict[str, Array]:
        """Return the inputs of the model's filters over the same samples, by name."""
        return self._run(self.model.simulate_unfiltered, known)

    def trajectory(self, known: Known) -> Array:
        """Return a free run from the first warm-up of the history on, `(time + steps, ny)`.

        The samples before the run are the measured ones.
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
        """Return the doubts of the base, and one for a history shorter than the warm-up."""
        doubts = [] if self.base is None else self.base.doubts(known)
        if self._short(known):
            short = (
                f"the history has {len(known.y)} of the {self.warmup} samples of a warm-up: "
                "what came before is estimated"
            )
            doubts = [*dict.fromkeys([*doubts, short])]
        return doubts

    def stepped(self, outside: bool) -> Recursion:
        """Return the recursion of model and base, see `Forecaster.stepped`."""
        try:
            model = self.model.stepped()
        except ValueError as error:
            raise NotSteppedError(f"{self.name} cannot be stepped: {error}") from None
        part = None if self.base is None else self.base.part(outside)
        return Warmed(model, part, self.warmup, self.delays)

    def differentiable(self, known: Known) -> nn.Module:
        """Return model and base as a torch module, see `Forecaster.differentiable`."""
        from splitband.forecasters.differentiable import (  # noqa: PLC0415  needs torch
            ModelSimulation,
        )

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
        """Return whether the history is shorter than the warm-up and can be completed."""
        short = 0 < len(known.y) < self.warmup
        return short and self.prehistory is not None and not np.isnan(known.y).any()

    def _run(self, simulate: Callable[..., dict[str, Array]], known: Known) -> dict[str, Array]:
        y, u, slow, since = self._warmed(known)
        parts = simulate(y, since + known.steps, u, slow)
        return {self._label(part): values[since:] for part, values in parts.items()}

    def _label(self, part: str) -> str:
        """Return the label of a component; the base labels the slow one."""
        if self.base is None or not part.startswith(SLOW):
            return part
        # The base may have the label of the fast component; labels must differ.
        label = self.base.as_base.label
        return (label if label != FAST else "base") + part.removeprefix(SLOW)

    def _warmed(self, known: Known) -> tuple[Array, Array | None, Array | None, int]:
        """Return the last warm-up without a gap, and the samples between its end and the origin.

        The warm-up holds the measured samples `(warmup, ny)`, and the inputs and the base's output
        from its beginning to the last sample of the forecast.
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
    """Return the last rows; the first row is repeated where there are fewer, as in `delayed`."""
    return np.concatenate(
        [np.repeat(u[:1], max(rows - len(u), 0), axis=0), u[max(len(u) - rows, 0) :]]
    )

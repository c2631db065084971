"""Fit a linear output-error model from the known inputs to the measured channels.

A baseline (see `baselines.common`) for records with inputs; for a linear system with white
measurement noise it is the optimal model structure. The initial state of a history is estimated
from that history. See L. Ljung, System Identification, 2nd ed., Sec. 4.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from splitband.baselines.channel import Channel, fit_channels, initial_state
from splitband.baselines.delays import candidates, check_delays, delayed
from splitband.metrics import spread
from splitband.runtime.arrays import Array
from splitband.runtime.deadlines import current
from splitband.runtime.options import saved


@saved
@dataclass(frozen=True, eq=False)
class OutputError:
    """Model each channel by y = (B u + C δ) / A + offset; use `fit`.

    A, B and C are polynomials of the delay operator, δ is the unit impulse at index 0: C δ / A is
    the response to the initial state.

    Attributes
    ----------
    channels : The model of each channel.
    mean, scale : Mean and standard deviation of the inputs, for their normalisation, `(nu,)`.
    delays : Dead time of each input in samples, `nu` of them.
    """

    channels: tuple[Channel, ...]
    mean: Array
    scale: Array
    delays: tuple[int, ...]

    def __post_init__(self) -> None:
        """Check values that may come from a file."""
        check_delays(self.delays, len(self.mean))

    @classmethod
    def fit(
        cls,
        y: Array,
        u: Array,
        others: Sequence[tuple[Array, Array]] = (),
        most: int | None = None,
    ) -> OutputError:
        """Fit to the first samples of a record, by least squares of the simulation error.

        Each channel has its own model with stable poles, whose number is chosen on held-out samples
        (`baselines.origins`). The last samples of a long record are fitted, see `common.recent`. If
        an input acts with a delay, a model with that delay is fitted as well, and the Bayesian
        information criterion chooses between them. After the deadline of `runtime.deadlines` no
        more orders and no delays are tried.

        Parameters
        ----------
        y : `(train, ny)`, NaN in gaps.
        u : Inputs of the same samples, `(train, nu)`.
        others : `y` and `u` of further records of the same system, each with its own initial
            state. The limit `common.LONGEST` on fitted samples is divided between them.
        most : Most poles of each channel; delays are then not tried.
        """
        together = np.concatenate([u, *(inputs for _, inputs in others)])
        mean, scale = together.mean(axis=0), spread(together)
        records = [(seen, (inputs - mean) / scale) for seen, inputs in ((y, u), *others)]
        at_once = cls(fit_channels(records, most), mean, scale, (0,) * len(mean))
        if most is not None or current().over:
            return at_once
        delays = candidates(records)
        begin, shifted = max(delays), [(seen, delayed(x, delays)) for seen, x in records]
        # Fit from the first sample whose delayed inputs are known, with an initial state there.
        acted = [(seen[begin:], x[begin:]) for seen, x in shifted]
        if not begin or np.isnan(acted[0][0]).all(axis=0).any():
            return at_once
        channels = fit_channels(acted)
        first, x = _after(shifted[0][0], begin), shifted[0][1]
        begun = [
            c._replace(c=initial_state(c, part, x))
            for c, part in zip(channels, first.T, strict=True)
        ]
        late = cls(tuple(begun), mean, scale, delays)
        samples = sum(np.count_nonzero(~np.isnan(seen)) for seen, _ in acted) / y.shape[1]
        return min(at_once, late, key=lambda model: model.criterion(samples))

    def simulate(self, u: Array) -> Array:
        """Simulate the training record from its first sample on, `(time, ny)`.

        `u` are its inputs, `(time, nu)`, for as many samples as wanted.
        """
        scaled = self._scaled(u)
        return np.stack([channel.simulate(scaled) for channel in self.channels], axis=1)

    def continued(self, u: Array, y: Array, before: Array | None = None) -> Array:
        """Simulate a record from a state that is estimated from its first samples, `(time, ny)`.

        Parameters
        ----------
        u : Inputs from the first sample on, `(time, nu)`.
        y : The first samples, `(any time, ny)`, NaN in gaps.
        before : If the record continues the training record, the inputs from the first training
            sample to its beginning, `(any time, nu)`; empty if both begin together. The simulated
            state is then corrected as far as `y` contradicts it. None: the prior of the state is
            the distribution of the states in training.
        """
        since = u if before is None else np.concatenate([before, u])
        scaled, late = self._scaled(since), max(self.delays)
        if before is not None:
            y = _after(y, late - len(before))  # before these samples the inputs are not known
        elif len(y) >= 2 * late:
            y = _after(y, late)
        found = []
        for channel, seen in zip(self.channels, y.T, strict=True):
            states, expected = channel.states, before is not None
            begun = channel if expected else channel._replace(c=states.mean)
            y_sim = begun.simulate(scaled)[len(since) - len(u) :]
            left = seen - y_sim[: len(seen)]
            found.append(y_sim + states.correction(left, len(u), channel.a, expected))
        return np.stack(found, axis=1)

    def transfer_function(self, output: int, input_: int) -> tuple[Array, Array]:
        """Return numerator and denominator from an input to an output, in powers of z."""
        channel, late = self.channels[output], self.delays[input_]
        b = channel.b[input_] / self.scale[input_]
        return b, np.append(channel.a, np.zeros(late))

    def state_space(self) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D, including delays, for deviations from `mean` and the offsets.

        The states are those of each channel in observer form, then the delayed inputs.
        """
        own, driven, seen, direct = self.without_delays()
        driven, direct = driven / self.scale, direct / self.scale
        a = scipy.linalg.block_diag(own, *(np.eye(late, k=-1) for late in self.delays))
        b, c, d = np.zeros((len(a), len(self.mean))), np.zeros((len(seen), len(a))), 0 * direct
        c[:, : len(own)] = seen
        first = len(own)
        for j, late in enumerate(self.delays):
            # The channels are driven by the input, or by the last of its delayed values.
            into, out, column = (a, c, first + late - 1) if late else (b, d, j)
            into[: len(own), column], out[:, column] = driven[:, j], direct[:, j]
            if late:
                b[first, j] = 1.0
            first += late
        return a, b, c, d

    def without_delays(self) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D of all channels in observer form, for scaled and delayed inputs."""
        parts = [channel.canonical() for channel in self.channels]
        a, c = (scipy.linalg.block_diag(*(part[i] for part in parts)) for i in (0, 2))
        b, d = (np.concatenate([part[i] for part in parts]) for i in (1, 3))
        return a, b, c, d

    def criterion(self, samples: float) -> float:
        """Return the Bayesian information criterion of a fit to `samples` samples per channel."""
        tiny = np.finfo(np.float64).tiny
        return sum(
            2 * samples * np.log(max(channel.states.error, tiny))
            + (channel.a.size + channel.b.size + channel.c.size) * np.log(samples)
            for channel in self.channels
        )

    def _scaled(self, u: Array) -> Array:
        """Return the delayed and normalised inputs."""
        return (delayed(u, self.delays) - self.mean) / self.scale

    def __str__(self) -> str:
        orders = "+".join(str(len(channel.a) - 1) for channel in self.channels)
        poles = f"{orders} pole{'s' * (orders != '1')}"
        inputs = f"{len(self.mean)} input{'s' * (len(self.mean) != 1)}"
        return f"{poles}, {inputs} and an offset"


def _after(y: Array, begin: int) -> Array:
    """Replace the samples before the index `begin` by NaN."""
    return np.where(np.arange(len(y))[:, None] < begin, np.nan, y)


def input_delays(records: Sequence[tuple[Array, Array]]) -> tuple[int, ...]:
    """Return the dead time of each input in samples, as estimated by the linear model.

    `records` are `y` `(time, ny)`, NaN in gaps, and `u` `(time, nu)` of each.
    """
    first, *others = records
    if not any(candidates(records)):
        return (0,) * first[1].shape[1]
    return OutputError.fit(*first, others).delays

"""Run the linear model sample by sample, as `OutputError.continued` does for a whole history.

The initial state is estimated from the samples so far by least squares, which keep only the
triangular factor: Golub and Van Loan, Matrix Computations, 4th ed., Sec. 6.5.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import scipy

from splitband.baselines.linear import OutputError
from splitband.baselines.states import EXACT, FACTORS, SURPRISING
from splitband.forecasters.known import Known
from splitband.forecasters.stepping import DelayLine, Part, State
from splitband.runtime.arrays import Array
from splitband.runtime.tracing import cond

_SMALLEST = 1e-200
"""Lower limit of a variance in a denominator, far below measured ones."""


class Driven(Part):
    """Simulate a linear output-error model.

    `u`: inputs of the training record from its first sample on, `(time, nu)`.
    """

    def __init__(self, model: OutputError, u: Array) -> None:
        self.model, self.u = model, u
        channels = model.channels
        order = self.order = max(len(channel.a) for channel in channels) - 1

        def padded(x: Array, *shape: int) -> Array:
            new = np.zeros(shape)
            new[tuple(map(slice, x.shape))] = x
            return new

        nu = len(model.mean)
        self.a = np.stack([padded(c.a, order + 1) for c in channels])
        self.b = np.stack([padded(c.b, nu, order + 1) for c in channels])
        self.c = np.stack([padded(c.c, order) for c in channels])
        self.mean = np.stack([padded(c.states.mean, order) for c in channels])
        self.root = np.stack([padded(c.states.root, order, order) for c in channels])
        self.offset = np.array([c.offset for c in channels])
        self.error = np.array([c.states.error for c in channels])
        self.correlation = np.array([c.states.correlation for c in channels])
        self.line = DelayLine(model.delays)

    def initial(self, known: Known | None) -> State:
        """Return the expected state: simulated from the training record, or the training mean."""
        ny, n, late = len(self.a), self.order, max(self.line.delays)
        begin = -1 if known is None or known.begin is None or known.begin % 1 else int(known.begin)
        expected = 0 <= begin <= len(self.u)
        before = self.u[:begin] if expected else self.u[:0]
        line = self.line.initial()
        if len(before):
            rows = np.concatenate([np.repeat(before[:1], late, axis=0), before])
            line = line and {"past": rows[len(rows) - late :], "filled": np.ones(())}
        # The first sample that counts, for two least-squares fits. Where the inputs before the
        # history are unknown, all samples count until `turn`, then those with known late inputs.
        held = [late - len(before)] * 2 if expected else [0, late]
        return {
            "line": line,
            "z": self._after(before) if expected else self.mean,
            "answers": self.root,
            "largest": abs(self.root[:, :, 0]).max(axis=1, initial=0.0),
            "triangle": np.zeros((2, ny, n, n + 1)),
            "previous": np.zeros((2, ny, n + 1)),
            "kept": np.zeros((2, ny)),
            "age": np.zeros(()),
            "held": np.array(held, dtype=np.float64),
            "turn": np.array(0.0 if expected else 2.0 * late),
            "usual": np.array(0.0 if expected else 1.0),
            "own": np.zeros(()),
        }

    def row(self, state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        """Return the simulated sample, and its derivatives by the initial state."""
        line, acting = self.line.tick(state["line"], u)
        x = ((acting - self.model.mean) / self.model.scale)[None, :, None]
        forced = (self.b * x).sum(axis=1)
        y = forced[:, 0] + state["z"][:, 0]
        answer = state["answers"][:, :, 0]
        z = forced[:, 1:] - self.a[:, 1:] * y[:, None] + _shifted(state["z"])
        answers = _shifted(state["answers"]) - self.a[:, None, 1:] * answer[:, :, None]
        row = np.concatenate([(y + self.offset)[:, None], answer], axis=1)
        largest = np.maximum(state["largest"], np.max(abs(answer), axis=1))
        return state | {"line": line, "z": z, "answers": answers, "largest": largest}, row[None]

    def learn(self, state: State, row: Array, y: Array) -> State:
        """Return the state with a further row in the least squares."""
        left = y - row[:, 0]
        seen = np.logical_not(np.isnan(left))
        data = np.concatenate([row[:, 1:], np.where(seen, left, 0.0)[:, None]], axis=1)
        counted = seen[None] & (state["age"] >= state["held"])[:, None]
        kept = state["kept"]

        def updated() -> Any:
            white = (data - kept[..., None] * state["previous"]) / np.sqrt(1 - kept**2)[..., None]
            white = np.where(counted[..., None], white, 0.0)
            rows, _ = triangular(np.concatenate([state["triangle"], white[..., None, :]], axis=2))
            filled = [np.concatenate([np.zeros((*r.shape[:-1], j)), r], axis=-1)
                      for j, r in enumerate(rows)]  # fmt: skip
            return np.stack(filled, axis=2)

        return state | {
            "triangle": cond(counted.any(), updated, lambda: state["triangle"]),
            "previous": np.where(counted[..., None], data, state["previous"]),
            "kept": np.where(counted, self.correlation, kept * self.correlation),
            "age": state["age"] + 1,
            "own": np.where(seen.any(), 0.0, state["own"]),
        }

    def settle(self, state: State) -> Array:
        """Return the most probable correction of the initial state, as in `States.correction`."""
        n = self.order
        known = np.where(state["age"] >= state["turn"], state["triangle"][1], state["triangle"][0])
        noise = np.maximum(self.error, EXACT * state["largest"]) ** 2 + _SMALLEST
        root = np.sqrt(np.concatenate([state["usual"][None], FACTORS]))
        # The prior is appended to the least squares as rows.
        prior = np.concatenate([np.eye(n), np.zeros((n, 1))], axis=1)
        scaled = np.concatenate([np.broadcast_to(root[:, None], (len(root), n)),
                                 np.ones((len(root), 1))], axis=1)  # fmt: skip
        rows, left = triangular(
            np.concatenate(
                [
                    known[None] * scaled[:, None, None, :],
                    np.broadcast_to(
                        (np.sqrt(noise)[:, None, None] * prior)[None],
                        (len(root), len(noise), n, n + 1),
                    ),
                ],
                axis=2,
            )
        )
        unlikely = (left**2).sum(axis=-1) / noise
        solved: list[Any] = []
        for row in reversed(rows):
            unlikely = unlikely + 2 * np.log(abs(row[..., 0]))
            rest = row[..., -1]
            for weight, later in enumerate(solved, start=1):
                rest = rest - row[..., weight] * later
            solved.insert(0, rest / row[..., 0])
        states = np.stack(solved, axis=-1) * root[:, None, None]
        least = np.min(unlikely[1:], axis=0)
        usual = np.arange(len(root))[:, None] == 0
        taken = np.where(
            least + SURPRISING > unlikely[0], usual, (unlikely <= least) & np.logical_not(usual)
        )
        weights = np.where(taken, 1.0, 0.0)
        state_found = (weights[..., None] * states).sum(axis=0) / weights.sum(axis=0)[:, None]
        return np.where(state["own"] > 0, 0.0, state_found)

    def after_training(self, state: State) -> State:
        """Return the state without a correction, as fitted, until the next measured sample."""
        return state | {"own": np.ones(())}

    def _after(self, before: Array) -> Array:
        """Return the filter states after these inputs, from the first training sample on."""
        if not len(before):
            return self.c
        scaled = self.model._scaled(before)
        return np.stack(
            [
                sum(
                    (scipy.signal.lfilter(b, a, x, zi=np.zeros(self.order))[1]
                     for b, x in zip(of_channel, scaled.T, strict=True)),
                    start=scipy.signal.lfilter([0.0], a, np.zeros(len(before)), zi=c)[1],
                )
                for of_channel, a, c in zip(self.b, self.a, self.c, strict=True)
            ]
        )  # fmt: skip


def triangular(a: Array) -> tuple[list[Array], Array]:
    """Return the rows of the triangular factor of `[A, b]`, and the residual of b.

    `a` is `(..., rows, columns + 1)`. The j-th row begins on the diagonal, and is
    `(..., columns + 1 - j)`. The method is Householder reflections.
    """
    rows = []
    for _ in range(a.shape[-1] - 1):
        v = a[..., 0]
        norm = np.sqrt((v**2).sum(axis=-1))
        diagonal = np.where(v[..., 0] > 0, -norm, norm)
        head = v[..., 0] - diagonal
        size = np.where(norm > 0, -diagonal * head, 1.0)
        w = np.concatenate([head[..., None], v[..., 1:]], axis=-1)
        along = (w[..., None] * a).sum(axis=-2) / size[..., None]
        a = a - w[..., None] * along[..., None, :]
        rows.append(a[..., 0, :])
        a = a[..., 1:, 1:]
    return rows, a[..., 0]


def _shifted(z: Array) -> Array:
    """Return the filter states one sample later, without input and feedback."""
    return np.concatenate([z[..., 1:], np.zeros((*z.shape[:-1], 1))], axis=-1)

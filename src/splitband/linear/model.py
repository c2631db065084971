"""Define a linear state-space model in innovations form; `linear.identification` fits it.

A baseline for records with inputs. See L. Ljung, System Identification, 2nd ed., Sec. 4.3.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
import scipy

from splitband.linear.delays import check_delays, delayed
from splitband.linear.kalman import EXACT, most_probable, responses, states, whitening
from splitband.linear.subspace import filled
from splitband.linear.uncertainty import Uncertainty
from splitband.runtime.arrays import Array
from splitband.runtime.errors import InputError

_CHUNK = 2**18
"""Most samples of which all states are computed at once. Bounds the memory."""
_LOST = 100.0
"""Largest growth of an error over a forecast that is worth making. By eye."""
_FASTEST, _SLOWEST = 0.5, 0.95
"""Range of the poles of additional states, without effect on the output. By eye."""


@dataclass(frozen=True, eq=False)
class LinearModel:
    """A model x' = A x + B (u - mean) + drift + K e, y = C x + D (u - mean) + offset + e.

    u are the inputs after their delays, in the columns of `taps`; e is white noise.

    a, b, c, d : A `(n, n)`, B `(n, taps)`, C `(ny, n)` and D `(ny, taps)`, in the record's units.
    offset : `(ny,)`.
    drift : Constant flow into integrators, `(n,)`.
    gain : K, `(n, ny)`.
    noise : Covariance of e, `(ny, ny)`.
    mean : Means of the inputs, `(nu,)`.
    taps : Input and delay in samples by column of B and D.
    late : Longest delays by output, `(ny,)`; 0 for half of the first record or more, as the fit
        then begins with the record.
    first : State at the first sample of the first record, `(n,)`; see `held`.
    last : State after the last sample of the first record, by the Kalman filter, `(n,)`.
    centre, root : Mean of the states in training, and a root R of their covariance R R', `(n, n)`.
    error : RMS error of the simulation of the training records, `(ny,)`.
    spread : Covariance of these errors for an estimate of the state with K = 0, `(ny, ny)`: larger
        with correlation of successive errors.
    scale : Standard deviations of the outputs in training, `(ny,)`.
    integrators : Number of poles fixed at 1.
    by : The criterion, "output error" or "prediction error".
    orders, held_out : Candidate orders and their held-out simulation errors, as shares of the
        outputs' standard deviations.
    values : Singular values of the data. These three are empty for outputs with different delays,
        which have separate models.
    silent : Angles, in radians per sample, of poles without excitation.
    doubted : Longest rejected delays by input in samples, 0 without one: models without them held
        out as well. Empty for given delays.
    uncertainty : Standard errors; None after a deadline.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    offset: Array
    drift: Array
    gain: Array
    noise: Array
    mean: Array
    taps: tuple[tuple[int, int], ...]
    late: tuple[int, ...]
    first: Array
    last: Array
    centre: Array
    root: Array
    error: Array
    spread: Array
    scale: Array
    integrators: int = 0
    by: str = "output error"
    orders: tuple[int, ...] = ()
    held_out: Array = field(default_factory=lambda: np.zeros(0))
    values: Array = field(default_factory=lambda: np.zeros(0))
    silent: tuple[float, ...] = ()
    doubted: tuple[int, ...] = ()
    uncertainty: Uncertainty | None = None

    def __post_init__(self) -> None:
        """Check shapes and delays, possibly from a file."""
        n, ny, taps = len(self.a), len(self.c), len(self.taps)
        shapes: dict[str, tuple[int, ...]]
        shapes = {"a": (n, n), "root": (n, n), "noise": (ny, ny), "spread": (ny, ny)}
        shapes |= {"b": (n, taps), "c": (ny, n), "d": (ny, taps), "gain": (n, ny)}
        shapes |= dict.fromkeys(("drift", "first", "last", "centre"), (n,))
        shapes |= dict.fromkeys(("offset", "error", "scale"), (ny,))
        for name, shape in shapes.items():
            if (actual := np.shape(vars(self)[name])) != shape:
                raise InputError(f"{name} must be {shape}, got {actual}")
        check_delays([delay for _, delay in self.taps], taps)
        check_delays(self.late, ny)
        if any(not 0 <= i < len(self.mean) for i, _ in self.taps):
            raise InputError(f"taps must name one of {len(self.mean)} inputs, got {self.taps}")

    @property
    def ny(self) -> int:
        """Return the number of outputs."""
        return len(self.c)

    @property
    def nu(self) -> int:
        """Return the number of inputs."""
        return len(self.mean)

    @property
    def order(self) -> int:
        """Return the number of states, without delays."""
        return len(self.a)

    @property
    def delays(self) -> tuple[int, ...]:
        """Return the least delays by input over all outputs, `(nu,)`."""
        return tuple(min(d for i, d in self.taps if i == j) for j in range(self.nu))

    @property
    def held(self) -> Array:
        """Return by state the first sample with all delayed inputs in the record, `(n,)`.

        Until then a state keeps its distance from the state of a simulation from `centre`: with
        decay, the distance would become unobservable, or begin far away.
        """
        return np.where(self.c != 0, np.asarray(self.late)[:, None], 0).max(axis=0)

    def begun(self, u: Array, begin: int) -> LinearModel:
        """Return the model for the whole record, given the state at `begin` in `first`."""
        tapped = self.tapped(u)[: max(self.late)]
        if not len(tapped):
            return self
        free = np.zeros(self.order)
        late = self._run(tapped[begin:], self.first, free)[1]
        usual = self._run(tapped, self.centre, free)[1]
        return replace(self, first=self.centre + late - usual)

    def begun_before(self, u: Array, samples: int) -> LinearModel:
        """Return the model for a record `u` with so many samples before its first measured one.

        Its state is traced back as far as the error of the simulation and the spread of the states
        in training allow: what decays is not observable before.
        """
        if not samples:
            return self
        tapped, away = self.tapped(u)[: samples + max(self.late)], self.first - self.centre
        away = self._run(tapped[samples:], self.first, away)[1]
        away = away - self._run(tapped, self.centre, np.zeros(self.order))[1]
        answers = np.linalg.matrix_power(self.a, samples) @ self.root
        doubt = np.sqrt(np.mean((self.error / self.scale) ** 2)) * np.eye(self.order)
        rows, towards = np.vstack([answers, doubt]), np.append(away, np.zeros(self.order))
        back = self.root @ np.linalg.lstsq(rows, towards, rcond=None)[0]
        return replace(self, first=self.centre + back)

    def tapped(self, u: Array) -> Array:
        """Return the delayed inputs minus their means, `(time, taps)`."""
        inputs = [i for i, _ in self.taps]
        return delayed(u[:, inputs], [d for _, d in self.taps]) - self.mean[inputs]

    def simulate(
        self, u: Array, state: Array | None = None, before: Array | None = None, begin: int = 0
    ) -> Array:
        """Simulate from a state at the row `begin` of `u` on, `(time, ny)`.

        The default is the state at the first training sample. `before` are earlier inputs since the
        first training sample, for the delays.
        """
        since = u if before is None else np.concatenate([before, u])
        age = len(since) - len(u) + begin
        tapped = self.tapped(since)[age:]
        away = self.first - self.centre
        return self._run(tapped, self.first if state is None else state, away, age)[0]

    def state_after(self, u: Array) -> Array:
        """Return the state after inputs from the first training sample on, `(n,)`."""
        return self._run(self.tapped(u), self.first, self.first - self.centre)[1]

    @np.errstate(over="ignore", invalid="ignore")  # an unstable model leaves the range of numbers
    def _run(self, tapped: Array, first: Array, away: Array, age: int = 0) -> tuple[Array, Array]:
        """Return the outputs of a simulation, and the state after it.

        `away` is the constant distance of states (`held`) in a record begun `age` samples ago.
        """
        if not len(tapped):
            return np.zeros((0, self.ny)), first
        if len(tapped) > _CHUNK:
            return _in_chunks(
                lambda here, x: self._run(tapped[here], x, away, age + here.start), tapped, first
            )
        forced = tapped @ self.b.T
        forced += self.drift
        ages = age + np.arange(len(tapped))[: max(max(self.late) - age, 0), None]
        forced[: len(ages)] += np.where(ages < self.held, away - self.a @ away, 0.0)
        x = states(self.a, forced, first)
        return x @ self.c.T + tapped @ self.d.T + self.offset, self.a @ x[-1] + forced[-1]

    def in_units(self, y_mean: Array, y_scale: Array, u_mean: Array, u_scale: Array) -> LinearModel:
        """Return the model of signals y_mean + y_scale y and u_mean + u_scale u."""
        both, into = np.outer(y_scale, y_scale), u_scale[[i for i, _ in self.taps]]
        return replace(
            self,
            b=self.b / into,
            c=self.c * y_scale[:, None],
            d=self.d * y_scale[:, None] / into,
            offset=y_mean + y_scale * self.offset,
            gain=self.gain / y_scale,
            noise=self.noise * both,
            mean=u_mean + u_scale * self.mean,
            error=self.error * y_scale,
            spread=self.spread * both,
            scale=self.scale * y_scale,
            uncertainty=self.uncertainty and self.uncertainty.in_units(y_scale, u_scale),
        )

    @property
    def without_filter(self) -> LinearModel:
        """Return the system with K = 0: its states are those of a simulation."""
        return replace(self, gain=np.zeros_like(self.gain), noise=self.spread)

    def whitener(self) -> Array:
        """Return W with W'W the inverse of the covariance of e, with a lower limit, `(ny, ny)`."""
        floor = np.diag((EXACT * np.maximum(self.scale, 1e-150)) ** 2)
        return np.asarray(np.linalg.inv(np.linalg.cholesky(self.noise + floor)))

    def continued(
        self, u: Array, y: Array, before: Array | None = None
    ) -> tuple[Array, Array, Array]:
        """Return predictions `(time, ny)`, the state after `y`, `(n,)`, and its covariance.

        Up to the end of `y`, samples are predicted one step ahead; later ones are simulated. The
        covariance `(n, n)` is due to the unknown initial state.

        u : Inputs from the first sample on, `(time, nu)`.
        y : The first samples, `(any time, ny)`, NaN in gaps.
        before : For a record that continues the training record, the inputs from the first training
            sample to its beginning, `(any time, nu)`; empty if both begin together. The expected
            state is then the state after these inputs. None: the prior of the state is the
            distribution of the states in training.
        """
        since = u if before is None else np.concatenate([before, u])
        expected = before is not None
        tapped = self.tapped(since)
        past = 0 if before is None else len(before)
        x, away = self.centre, np.zeros(self.order)
        if expected:
            away = self.first - self.centre
            x = self._run(tapped[:past], self.first, away)[1]
        tapped = tapped[past:]
        ages = np.arange(len(y))[:, None] + past
        measured = ~np.isnan(y) & (ages >= np.asarray(self.late))
        usual = np.array(0.0 if expected else 1.0)
        left, information = self.root, np.zeros_like(self.root)
        if not measured.any():
            predictions, after = self._run(tapped[: len(y)], x, away, past)
            free = max(len(y) - int(self.held.max(initial=0)), 0)
            left = np.linalg.matrix_power(self.a, free) @ self.root
        elif measured.all():
            errors, _ = self._observed(tapped[: len(y)], y, x)
            observer, white = self.a - self.gain @ self.c, self.whitener()
            answers = responses(observer, self.c, self.root, len(y))
            rows = np.einsum("ij,tjn->tin", white, answers).reshape(-1, self.order)
            towards = rows.T @ (errors[: len(answers)] @ white.T).ravel()
            information = rows.T @ rows
            x = x + self.root @ most_probable(information, towards, usual)
            errors, after = self._observed(tapped[: len(y)], y, x)
            predictions = y - errors
            with np.errstate(all="ignore"):
                left = np.linalg.matrix_power(observer, len(y)) @ self.root
        else:
            *_, information, towards, left = self._with_gaps(tapped, y, measured, x, away, past)
            correction = self.root @ most_probable(information, towards, usual)
            x, away = x + correction, away + correction
            predictions, after, *_ = self._with_gaps(tapped, y, measured, x, away, past)
        covariance = np.zeros_like(self.a)
        if np.isfinite(left).all():
            covariance = left @ np.linalg.solve(np.eye(self.order) + information, left.T)
        ahead, _ = self._run(tapped[len(y) :], after, away, past + len(y))
        return np.concatenate([predictions, ahead]), after, covariance

    def _observed(self, tapped: Array, y: Array, first: Array) -> tuple[Array, Array]:
        """Return prediction errors `(time, ny)` and the state after a history without gaps."""
        if len(tapped) > _CHUNK:
            return _in_chunks(
                lambda here, x: self._observed(tapped[here], y[here], x), tapped, first
            )
        left = y - tapped @ self.d.T - self.offset
        forced = tapped @ self.b.T
        forced += self.drift
        forced += left @ self.gain.T
        a = self.a - self.gain @ self.c
        x = states(a, forced, first)
        return left - x @ self.c.T, a @ x[-1] + forced[-1]

    def _with_gaps(
        self, tapped: Array, y: Array, measured: Any, x: Array, away: Array, age: int
    ) -> tuple[Array, Array, Array, Array, Array]:
        """Return predictions from the state x, the last state, and arguments of `most_probable`.

        The last array is the response of the last state to each column of `root`, `(n, n)`.
        """
        held, constant = self.held, away - self.a @ away
        answers, white, predictions = self.root, self.whitener(), np.empty(y.shape)
        information, towards = np.zeros((self.order, self.order)), np.zeros(self.order)
        for n, (row, value, present) in enumerate(zip(tapped[: len(y)], y, measured, strict=True)):
            predictions[n] = self.c @ x + self.d @ row + self.offset
            response = (self.c @ answers) * present[:, None]
            left = np.where(present, value - predictions[n], 0.0)
            counted = white @ response
            information += counted.T @ counted
            towards += counted.T @ (white @ left)
            free = age + n >= held
            answers = np.where(free[:, None], self.a @ answers, answers) - self.gain @ response
            x = self.a @ x + self.b @ row + self.drift + self.gain @ left
            x = np.where(free, x, x + constant)
        return predictions, x, information, towards, answers

    def state_space(self) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D; states of delayed inputs follow those of the model."""
        longest = [max((d for i, d in self.taps if i == j), default=0) for j in range(self.nu)]
        n, size = self.order, self.order + sum(longest)
        begin = n + np.cumsum([0, *longest])
        whole = np.zeros((size + self.ny, size + self.nu))  # [A B; C D]
        whole[:size, :size] = scipy.linalg.block_diag(
            self.a, *(np.eye(late, k=-1) for late in longest)
        )
        whole[size:, :n] = self.c
        for column, (i, late) in enumerate(self.taps):
            source = begin[i] + late - 1 if late else size + i
            whole[:n, source] += self.b[:, column]
            whole[size:, source] += self.d[:, column]
        for i, late in enumerate(longest):
            if late:
                whole[begin[i], size + i] = 1.0
        return whole[:size, :size], whole[:size, size:], whole[size:, :size], whole[size:, size:]

    def transfer_function(self, output: int, input_: int) -> tuple[Array, Array]:
        """Return numerator and denominator from an input to an output, in powers of z."""
        columns = [t for t, (i, _) in enumerate(self.taps) if i == input_]
        reached = abs(self.c[output]) > 0
        for _ in range(self.order):
            reached = reached | (abs(self.a[reached]) > 0).any(axis=0)
        acts = (abs(self.b[reached]) > 0).any(axis=0) | (abs(self.d[output]) > 0)
        columns = [t for t in columns if acts[t]] or columns[:1]
        longest = max(self.taps[t][1] for t in columns)
        a = np.poly(self.a) if self.order else np.ones(1)
        b = np.zeros(len(a) + longest)
        for t in columns:
            # B(z) = det(zI - A + B C) - det(zI - A) + D det(zI - A). The difference is linear in
            # B C, scaled to 1: with a small gain it would drown in rounding.
            inner = np.outer(self.b[:, t], self.c[output])
            size = abs(inner).max(initial=0.0) or 1.0
            numerator = self.d[output, t] * a
            if self.order:
                numerator = numerator + size * (np.poly(self.a - inner / size) - a)
            late = longest - self.taps[t][1]
            b[longest - late : longest - late + len(numerator)] += numerator
        leading = int(np.argmax(b != 0))  # SciPy warns of leading zeros
        return b[leading:], np.append(a, np.zeros(longest))

    def poles(self) -> npt.NDArray[np.complex128]:
        """Return the poles in the z plane, without delays, `(n,)` complex."""
        return np.asarray(np.linalg.eigvals(self.a), np.complex128)

    @property
    def growth(self) -> float:
        """Return the absolute value of the largest pole outside of the unit circle; else 1."""
        poles = sorted(self.poles(), key=lambda pole: abs(pole - 1))[self.integrators :]
        return max([1.0, *map(abs, poles)])

    @property
    def reach(self) -> int | None:
        """Return how many samples ahead forecasts are worth making; None for a stable model.

        As far as the expected errors of all outputs are below half of their standard deviations,
        and an error grows at most a hundredfold; rounded down to 1, 2 or 5 times a power of ten.
        """
        if self.growth <= 1:
            return None
        longest = max(int(np.log(_LOST) / np.log(self.growth)), 1)
        steps, spread = 1, np.zeros_like(self.a)
        while steps < longest:
            spread = self.a @ spread @ self.a.T + self.gain @ self.noise @ self.gain.T
            power = np.diag(self.c @ spread @ self.c.T + self.noise)
            if (np.sqrt(power) > 0.5 * self.scale).any():
                break
            steps += 1
        power = 10 ** int(np.log10(steps))
        return max(k * power for k in (1, 2, 5) if k * power <= steps)

    def __str__(self) -> str:
        poles = f"{self.order} pole{'s' * (self.order != 1)}"
        held = f", {self.integrators} of them at 1" if self.integrators else ""
        inputs = f"{self.nu} input{'s' * (self.nu != 1)}"
        return f"{poles}{held}, {inputs} and an offset; by {self.by}"


def _in_chunks(
    run: Callable[[slice, Array], tuple[Array, Array]], tapped: Array, first: Array
) -> tuple[Array, Array]:
    """Return the outputs of a long run, and the state after it, by parts of `_CHUNK` samples."""
    outputs, x = [], first
    for begin in range(0, len(tapped), _CHUNK):
        y, x = run(slice(begin, begin + _CHUNK), x)
        outputs.append(y)
    return np.concatenate(outputs), x


def assembled(parts: Sequence[tuple[LinearModel, Sequence[int]]], ny: int) -> LinearModel:
    """Return one model of all outputs from parts with some outputs, driven by equal inputs."""
    if len(parts) == 1:
        return parts[0][0]
    models = [model for model, _ in parts]
    outputs = np.concatenate([[*of_part] for _, of_part in parts]).astype(int)
    back = np.argsort(outputs)

    fields: dict[str, Any] = {
        name: scipy.linalg.block_diag(*(vars(m)[name] for m in models))
        for name in ("a", "b", "c", "d", "gain", "noise", "root", "spread")
    } | {
        name: np.concatenate([vars(m)[name] for m in models])
        for name in ("offset", "drift", "late", "first", "last", "centre", "error", "scale")
    }
    fields |= {
        name: fields[name][back]
        for name in ("c", "d", "noise", "spread", "offset", "late", "error", "scale")
    }
    fields |= {name: fields[name][:, back] for name in ("gain", "noise", "spread")}
    fields["late"] = tuple(fields["late"].tolist())
    uncertainties = [m.uncertainty for m in models if m.uncertainty is not None]
    return LinearModel(
        **fields,
        mean=models[0].mean,
        taps=tuple(tap for m in models for tap in m.taps),
        integrators=sum(m.integrators for m in models),
        by=" and ".join(dict.fromkeys(m.by for m in models)),
        silent=tuple(angle for m in models for angle in m.silent),
        uncertainty=Uncertainty.of_parts(uncertainties, back)
        if len(uncertainties) == len(models)
        else None,
    )


class Realisation(NamedTuple):
    """The system x_{n+1} = A x_n + B u_n + drift, y_n = C x_n + D u_n + offset, and its states.

    The inputs u_n are in the record's units.

    a, b, c, d : `(states, states)`, `(states, nu)`, `(ny, states)` and `(ny, nu)`.
    drift, offset : `(states,)` and `(ny,)`.
    states : State trajectories by record, `(time, states)`.
    gain : K of the innovations form, `(states, ny)`; None for a stable system.
    """

    a: Array
    b: Array
    c: Array
    d: Array
    drift: Array
    offset: Array
    states: tuple[Array, ...]
    gain: Array | None = None


def realised(
    model: LinearModel,
    records: Sequence[tuple[Array, Array]],
    size: int,
    rng: np.random.Generator,
) -> Realisation:
    """Return a state-space model with `size` states, and its states in the records.

    The `model` has no delays. Additional states have no effect on the output; `rng` draws their
    input matrix. `records` are y, NaN in gaps, and u of the training records. The states are those
    of a simulation; of an unstable model those of its Kalman filter.
    """
    inputs = [u for _, u in records]
    additional = size - model.order
    poles = np.linspace(_FASTEST, _SLOWEST, additional)
    a = scipy.linalg.block_diag(model.a, np.diag(poles))
    drawn = rng.standard_normal((additional, model.nu)) * np.sqrt(1 - poles**2)[:, None]
    scale = np.concatenate(inputs).std(axis=0)
    b = np.concatenate([model.b, drawn / np.where(scale > 0, scale, 1.0)])
    c = np.hstack([model.c, np.zeros((model.ny, additional))])
    drift = np.append(model.drift, np.zeros(additional)) - b @ model.mean
    first = np.append(model.first, np.zeros(additional))
    middle = np.append(model.centre, np.zeros(additional))
    starts = [first, *[middle] * (len(inputs) - 1)]
    offset, forces = model.offset - model.d @ model.mean, [u @ b.T + drift for u in inputs]
    moves, gain = a, None
    if model.growth > 1:
        gain = np.concatenate([model.gain, np.zeros((additional, model.ny))])
        moves = a - gain @ c
        left = [np.apply_along_axis(filled, 0, y) - u @ model.d.T - offset for y, u in records]
        forces = [f + e @ gain.T for f, e in zip(forces, left, strict=True)]
    runs = [states(moves, force, x) for x, force in zip(starts, forces, strict=True)]
    into, out = whitening(np.concatenate(runs))
    whole = tuple(run @ into.T for run in runs)
    system = into @ a @ out, into @ b, c @ out, model.d, into @ drift, offset
    return Realisation(*system, whole, None if gain is None else into @ gain)

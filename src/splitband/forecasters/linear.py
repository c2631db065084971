"""Forecast with a linear state-space model of the known inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, ClassVar, Literal, Self, final

import numpy as np
import numpy.typing as npt
import scipy

from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import unmoved
from splitband.forecasters.prediction import ForecastContext
from splitband.forecasters.steps import DelayLine, State, Steps
from splitband.linear.delays import FEWEST_MOVES, LONGEST_DELAY, moves
from splitband.linear.identification import identified
from splitband.linear.model import LinearModel
from splitband.linear.uncertainty import Uncertainty
from splitband.records import Record
from splitband.runtime.arguments import whole
from splitband.runtime.arrays import Array, check_shape
from splitband.runtime.deadlines import current
from splitband.runtime.errors import InputError

MOST_POLES = 200
"""Largest order that may be asked for: bounds the time."""
SMALLEST_COEFFICIENT = 1e-9
"""Coefficients of a numerator below this share of its largest one are 0. Rounding."""


@final
class Linear(Forecaster):
    """A linear state-space model with a Kalman filter (`linear.identification`).

    x' = A x + B u + K e, y = C x + D u + offset + e. Poles and delays come from a subspace method,
    refined to the least simulation error, or to the least prediction error where a controller acts
    on the inputs; a plant that this controller keeps from running away has poles outside of the
    unit circle (`linear.closed_loop`). Several records are fitted together, each with its own
    initial state. Forecasts begin with the state that the Kalman filter finds in the history.

    Parameters
    ----------
    order : Number of poles; by default chosen by held-out simulation error.
    delay : Sample at which an input's impulse response begins: a number for all inputs, one for
        each, or `(ny, nu)` for each input at each output; by default estimated. An input that is
        held between samples and has a dead time of n samples has the delay n + 1 (MATLAB's nk).
    integrators : Number of poles at 1, as of a tank or a position; "auto" chooses.

    Examples
    --------
    >>> u = np.sign(np.sin(0.05 * np.arange(400)))
    >>> y = scipy.signal.lfilter([0, 0.1], [1, -0.9], u)
    >>> sb.Linear().fit(sb.Record(y, 0.1, u=u)).poles().round(6)
    array([0.9+0.j])
    """

    name = "linear"
    affine = forgets = True
    needs = frozenset({"inputs"})

    slow_part = "linear model"
    _words = "linear model"
    state_types: ClassVar[Mapping[str, Any]] = {"model": LinearModel, "u": Array}

    def __init__(
        self,
        order: int | None = None,
        delay: int | Sequence[int] | Sequence[Sequence[int]] | None = None,
        integrators: int | Literal["auto"] = "auto",
    ) -> None:
        self.order = None if order is None else whole("order", order, 1, MOST_POLES)
        self.delay = delay
        self.integrators = integrators
        if integrators != "auto":
            whole("integrators", integrators, 0, self.order or MOST_POLES)

    def check(self, *records: Record) -> None:
        super().check(*records)
        self._delays(records[0])

    def complete(self) -> None:
        super().complete()
        record = self.require_fitted().record
        check_shape("c", self.model.c, record.ny, None)
        check_shape("mean", self.model.mean, record.nu)
        check_shape("u", self.u, None, record.nu)

    filters_history = True
    refits = False
    """Two fits for its held-out forecasts: with one for each of them, the intervals of 40 drawn
    plants held 92 % as well, in 2.4 times the time."""

    def learn(self, records: Sequence[Record], **_: Any) -> None:
        seen = [(r.y_with_gaps, r.u) for r in records if r.u is not None]  # all: see `check`
        self.u = seen[0][1]
        integrators = None if self.integrators == "auto" else self.integrators
        self.model = identified(seen, self.order, self._delays(records[0]), integrators)
        self.delays = self.model.delays
        self.fitted = self.require_fitted().reporting(
            cut=current().over, growth=self.model.growth, reach=self.model.reach
        )
        self.fitted = self.fitted.reporting(notes=tuple(self._notes(records)))

    def extrapolate(self, known: ForecastContext) -> Array:
        assert known.u is not None
        time, before = len(known.y), _inputs_before(self.model, self.u, known)
        u = known.u[: time + known.steps]
        if not known.own or (before is None and self.model.growth <= 1):
            return self.model.continued(u, known.y, before)[0][time:]
        return self.model.simulate(u, self.model.last, before, time)

    def trajectory(self, known: ForecastContext) -> Array:
        """Return its simulation over history and forecast, from a state estimated on the history.

        Where all inputs since the first sample of the training record are known, the prior of this
        state is simulated; else it is the distribution of states in training. Raises ValueError for
        an unstable model, whose simulation leaves every record.
        """
        if said := self.require_fitted().report.unstable():
            raise InputError(
                f"the slow part of a hybrid must be stable; the linear model is {said}"
            )
        assert known.u is not None
        y = np.full_like(known.y, np.nan) if known.own else known.y  # its state is fitted
        u = known.u[: len(y) + known.steps]
        before = _inputs_before(self.model, self.u, known)
        return self.model.without_filter.continued(u, y, before)[0]

    def as_base(self) -> Self:
        """Return it without its Kalman filter, for the slow component of a hybrid."""
        new = copy(self)
        new.model = replace(self.model.without_filter, last=self.model.state_after(self.u))
        return new

    def uncertainty(self) -> Uncertainty:
        """Return poles, static gains, the frequency response and delays with standard errors.

        Raises ValueError for a fit that a deadline ended.
        """
        self.require_fitted()
        if self.model.uncertainty is None:
            raise InputError("uncertainty was not computed: the deadline of the fit came first")
        return self.model.uncertainty

    def step_form(self) -> Steps:
        return LinearSteps(self.model, self.u)

    def state_space(self) -> scipy.signal.StateSpace:
        """Return the fitted model as a discrete-time system, delays included.

        Its inputs and outputs are deviations from `operating_point`.
        """
        self.require_fitted()
        return scipy.signal.StateSpace(
            *self.system_matrices(), dt=self.require_fitted().record.sampling_time
        )

    def system_matrices(self) -> tuple[Array, Array, Array, Array]:
        return self.model.state_space()

    def operating_point(self) -> tuple[Array, Array]:
        """Return the inputs `(nu,)` and outputs `(ny,)` at the operating point."""
        self.require_fitted()
        return self.model.mean, self.model.offset

    def poles(self) -> npt.NDArray[np.complex128]:
        """Return the poles in the z plane, without those at 0 of delayed inputs."""
        self.require_fitted()
        return self.model.poles()

    def transfer_function(self, output: int = 0, input_: int = 0) -> scipy.signal.TransferFunction:
        """Return the fitted transfer function from an input to an output, by index from 0.

        The input's delay is a factor z^-delay, whose poles are at 0.
        """
        fitted = self.require_fitted()
        b, a = self.model.transfer_function(output, input_)
        system = scipy.signal.TransferFunction(np.ones_like(b), a, dt=fitted.record.sampling_time)
        system.num = b  # SciPy's constructor takes leading coefficients below 1e-14 for 0
        return system

    def zeros(self, output: int = 0, input_: int = 0) -> npt.NDArray[np.complex128]:
        """Return the zeros of `transfer_function` in the z plane."""
        self.require_fitted()
        b, _ = self.model.transfer_function(output, input_)
        small = abs(b) < SMALLEST_COEFFICIENT * abs(b).max(initial=0.0)
        return np.asarray(np.roots(np.where(small, 0.0, b)), np.complex128)

    def to_control(self) -> Any:
        """Return `state_space` as a `control.StateSpace` (the extra `control`), with its names."""
        import control  # noqa: PLC0415  an extra

        record = self.require_fitted().record
        names = {"inputs": [*record.inputs], "outputs": [*record.columns]}
        return control.ss(*self.model.state_space(), record.sampling_time, **names)

    def describe(self) -> str:
        fitted = self.require_fitted()
        late = fitted.late_inputs(self.delays)
        return "; ".join(filter(None, [str(self.model), late, *fitted.report.notes]))

    def _delays(self, record: Record) -> npt.NDArray[np.int_] | None:
        """Return the given delays `(ny, nu)`; raises ValueError for what is none."""
        if self.delay is None:
            return None
        limit = min(LONGEST_DELAY, len(record) - 1)
        try:
            found = np.broadcast_to(np.asarray(self.delay, float), (record.ny, record.nu))
            good = bool(((found == np.rint(found)) & (found >= 0) & (found <= limit)).all())
        except (TypeError, ValueError):
            good = False
        if not good:
            raise InputError(
                f"delay must be whole numbers of samples from 0 to {limit}: one for all inputs, "
                f"one for each of {record.nu}, or {record.ny} rows of these, got {self.delay!r}"
            )
        return found.astype(int)

    def _notes(self, records: Sequence[Record]) -> list[str]:
        """Return remarks on poles outside of the unit circle, and on inputs that tell nothing."""
        said = [*filter(None, [self.require_fitted().report.unstable()])]
        said += unmoved(records)
        if self.model.silent:
            step = self.require_fitted().record.sampling_time
            hertz = ", ".join(f"{a / (2 * np.pi * step):.4g}" for a in self.model.silent)
            said.append(f"no input excites the poles at {hertz} Hz: they are uncertain")
        for j, name in enumerate(records[0].inputs if self.delay is None else ()):
            moved = moves([r.u[:, j] for r in records if r.u is not None])
            doubted = self.model.doubted[j]
            if 0 < moved < FEWEST_MOVES:
                said.append(f"{name} moves too rarely to show its delay: Linear(delay=) sets one")
            elif doubted > 1:
                said.append(
                    f"a delay of {doubted} samples of {name} predicts held-out samples no better: "
                    "none is taken; Linear(delay=) sets one"
                )
        return said


@final
class LinearSteps(Steps):
    """Step a linear model, and correct its state by a Kalman filter.

    x, the expected state at the next sample, and its covariance, due to the unknown initial state,
    go on by the filter of the innovations form, whose gain is K once that covariance has vanished.

    model : The fitted model.
    training : Inputs of the training record from its first sample on, `(time, nu)`.
    """

    def __init__(self, model: LinearModel, training: Array) -> None:
        self.model, self.training = model, training
        self.inputs = [i for i, _ in model.taps]
        self.line = DelayLine([delay for _, delay in model.taps])
        self.white, self.late = model.whitener(), np.array(model.late, dtype=np.float64)
        self.held = model.held.astype(np.float64)

    def begin(self, history: ForecastContext | None) -> State:
        """Return the state after a history; without one that of the training records."""
        model, u, age = self.model, None, 0
        x, covariance = model.centre, model.root @ model.root.T
        if history is not None and history.u is not None:
            before, u = _inputs_before(model, self.training, history), history.u
            _, x, covariance = model.continued(u, history.y, before)
            if history.own and (before is not None or model.growth > 1):
                x = model.last
            u = u if before is None else np.concatenate([before, u])
            age = len(u)
        n, ny = model.order, model.ny
        return {
            "line": self.line.begin(None if u is None else u[:, self.inputs]),
            "x": x,
            "y": np.zeros(ny),
            "before": np.zeros((n, n)),
            "covariance": covariance,
            "age": np.array(float(age)),
        }

    def run(self, state: State, u: Array, y_sim: Array) -> tuple[State, Array]:
        model, covariance = self.model, state["covariance"]
        line, acting = self.line.move(state["line"], np.stack([u[i] for i in self.inputs]))
        acting = acting - model.mean[self.inputs]
        y = model.c @ state["x"] + model.d @ acting + model.offset
        moves = self._moves(state["age"])
        following = {
            "line": line,
            "x": model.a @ state["x"] + model.b @ acting + model.drift,
            "y": y,
            "before": covariance,
            "covariance": moves @ covariance @ moves.T,
            "age": state["age"] + 1,
        }
        return following, y

    def correct(self, state: State, y: Array) -> State:
        """Return the state of the filter after a measured sample; a gap has no error."""
        model, age = self.model, state["age"] - 1
        # Before all inputs that act on an output are known, it says nothing.
        counts = np.where(np.isnan(y) | (age < self.late), 0.0, 1.0)
        error = np.where(counts > 0, y - state["y"], 0.0)
        covariance, shift = state["before"], np.zeros(model.order)
        # One white error after the other: no matrix has to be inverted.
        for weights, left in zip(self.white * counts, self.white @ error, strict=True):
            response = weights @ model.c
            spread = covariance @ response
            gain = spread / (1.0 + response @ spread)
            shift = shift + gain * (left - response @ shift)
            covariance = covariance - gain[:, None] * spread
        moves = self._moves(age)
        observer = moves - model.gain @ (counts[:, None] * model.c)
        error = error - counts * (model.c @ shift)
        return state | {
            "x": state["x"] + moves @ shift + model.gain @ error,
            "covariance": observer @ covariance @ observer.T,
        }

    def _moves(self, age: Array) -> Array:
        """Return the matrix by which the deviation of a state goes on, see `LinearModel.held`."""
        kept: Array = np.where((age >= self.held)[:, None], self.model.a, np.eye(self.model.order))
        return kept


def _inputs_before(model: LinearModel, training: Array, known: ForecastContext) -> Array | None:
    """Return the inputs from the first training sample to the history; None if unknown.

    And for an unstable model, whose state they do not tell.
    """
    if model.growth > 1:
        return None
    begin = -1 if known.begin is None or known.begin % 1 else int(known.begin)
    return training[:begin] if 0 <= begin <= len(training) else None

"""Forecast with a linear state-space model of the known inputs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from copy import copy
from dataclasses import replace
from typing import Any, ClassVar, Literal, Self, final

import numpy as np
import numpy.typing as npt
import scipy

from splitband.baselines.delays import FEWEST_MOVES, LONGEST_DELAY, moves
from splitband.baselines.identification import identified
from splitband.baselines.kalman import most_probable
from splitband.baselines.linear import LinearModel
from splitband.baselines.uncertainty import Uncertainty
from splitband.data import Record
from splitband.forecasters.base import Forecaster
from splitband.forecasters.fitted import UNSTABLE, unmoved
from splitband.forecasters.prediction import ForecastContext
from splitband.forecasters.stepping import Part, State, delay_line
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
    """Fit a linear state-space model with a Kalman filter (`baselines.identification`).

    x' = A x + B u + K e, y = C x + D u + offset + e. Poles and delays come from a subspace method,
    refined to the least simulation error, or to the least prediction error where a controller acts
    on the inputs. Several records are fitted together, each with its own initial state. Forecasts
    begin with the state that the Kalman filter finds in the history.

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
        """Raise ValueError for records that do not fit, and for delays that do not fit them."""
        super().check(*records)
        self._delays(records[0])

    def complete(self) -> None:
        """Check the model and the inputs as well; see `Forecaster.complete`."""
        super().complete()
        record = self.require_fitted().record
        check_shape("c", self.model.c, record.ny, None)
        check_shape("mean", self.model.mean, record.nu)
        check_shape("u", self.u, None, record.nu)

    refits = False
    """Two fits for its held-out forecasts: with one for each of them, the intervals of 40 drawn
    plants held 92 % as well, in 2.4 times the time."""

    def learn(self, records: Sequence[Record], **_: Any) -> None:
        """Fit the model to all records."""
        seen = [(r.y_with_gaps, r.u) for r in records if r.u is not None]  # all: see `check`
        self.u = seen[0][1]
        integrators = None if self.integrators == "auto" else self.integrators
        self.model = identified(seen, self.order, self._delays(records[0]), integrators)
        self.delays = self.model.delays
        self.fitted = self.require_fitted().reporting(
            cut=current().over,
            notes=tuple(self._notes(records)),
            stable=self.model.stable,
        )

    def extrapolate(self, known: ForecastContext) -> Array:
        """Return the simulation after the history, from the state at its end."""
        assert known.u is not None
        time, before = len(known.y), _inputs_before(self.u, known)
        u = known.u[: time + known.steps]
        if not known.own or before is None:
            return self.model.continued(u, known.y, before)[0][time:]
        return self.model.simulate(u, self.model.last, before, time)

    def trajectory(self, known: ForecastContext) -> Array:
        """Return its simulation over history and forecast, from a state estimated on the history.

        Where all inputs since the first sample of the training record are known, the prior of this
        state is simulated; else it is the distribution of states in training.
        """
        assert known.u is not None
        y = np.full_like(known.y, np.nan) if known.own else known.y  # its state is fitted
        u = known.u[: len(y) + known.steps]
        return self.model.without_filter.continued(u, y, _inputs_before(self.u, known))[0]

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

    def stepped_part(self, outside: bool = False) -> Part:
        """Return the model's recursion."""
        return _driven(self.model, self.u)

    def state_space(self) -> scipy.signal.StateSpace:
        """Return the fitted model as a discrete-time system, delays included.

        Its inputs and outputs are deviations from `operating_point`.
        """
        self.require_fitted()
        return scipy.signal.StateSpace(
            *self.system_matrices(), dt=self.require_fitted().record.sampling_time
        )

    def system_matrices(self) -> tuple[Array, Array, Array, Array]:
        """Return A, B, C and D, delays included."""
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
        """Return the chosen order, the delays of the inputs, and remarks."""
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
        said = [] if self.model.stable else [UNSTABLE]
        said += unmoved(records)
        if self.model.silent:
            step = self.require_fitted().record.sampling_time
            hertz = ", ".join(f"{a / (2 * np.pi * step):.4g}" for a in self.model.silent)
            said.append(f"no input excites the poles at {hertz} Hz: they are uncertain")
        for j, name in enumerate(records[0].inputs if self.delay is None else ()):
            moved = moves([r.u[:, j] for r in records if r.u is not None])
            doubted = self.model.doubted[j]
            if 0 < moved < FEWEST_MOVES:
                said.append(f"{name} moves too rarely to show its delay: delay= sets one")
            elif doubted > 1:
                said.append(
                    f"a delay of {doubted} samples of {name} predicts held-out samples no better: "
                    "none is taken; delay= sets one"
                )
        return said


def _driven(model: LinearModel, training: Array) -> Part:
    """Return the simulation of a linear model, which observes with its Kalman filter.

    `training`: inputs of the training record from its first sample on, `(time, nu)`.
    """
    inputs = [i for i, _ in model.taps]
    delays = [delay for _, delay in model.taps]
    line, delayed = delay_line(delays)
    white, n = model.whitener(), model.order
    unknown = np.array(model.late, dtype=np.float64)
    held, waits = model.held.astype(np.float64), max(model.late) > 0

    def initial(known: ForecastContext | None) -> State:
        """Return the expected state: simulated from the training record, or the training mean."""
        before = None if known is None else _inputs_before(training, known)
        past = line
        for u in [] if before is None else before[max(len(before) - max(delays, default=0), 0) :]:
            past, _ = delayed(past, u[inputs])
        away = np.zeros(n) if before is None else model.first - model.centre
        return {
            "line": past,
            "x": model.centre if before is None else model.state_after(before),
            "answers": model.root,
            "information": np.zeros((n, n)),
            "towards": np.zeros(n),
            "age": np.array(0.0 if before is None else float(len(before))),
            "usual": np.array(1.0 if before is None else 0.0),
        } | ({"away": away} if waits else {})

    def row(state: State, u: Array, y_sim: Array, ahead: int) -> tuple[State, Array]:
        past, acting = delayed(state["line"], np.stack([u[i] for i in inputs]))
        acting = acting - model.mean[inputs]
        x = state["x"]
        y = model.c @ x + model.d @ acting + model.offset
        x = model.a @ x + model.b @ acting + model.drift
        if waits:
            kept = state["away"] - model.a @ state["away"]
            x = np.where(state["age"] >= held, x, x + kept)
        now = state | {"line": past, "x": x}
        if "age" in state:
            now["age"] = state["age"] + 1
        if "answers" not in state:  # in a free run, see `merged`
            return now, y[None, :, None]
        answers = state["answers"]
        rows = np.concatenate([y[:, None], model.c @ answers], axis=1)
        later = model.a @ answers
        if waits:
            later = np.where((state["age"] >= held)[:, None], later, answers)
        return now | {"answers": later}, rows[None]

    def correct(state: State, rows: Array, y: Array) -> State:
        left = y - rows[:, 0]
        seen = np.logical_not(np.isnan(left)) & (state["age"] > unknown)
        left = np.where(seen, left, 0.0)
        response = np.where(seen[:, None], rows[:, 1:], 0.0)
        counted = white @ response
        return state | {
            "x": state["x"] + model.gain @ left,
            "answers": state["answers"] - model.gain @ response,
            "information": state["information"] + counted.T @ counted,
            "towards": state["towards"] + counted.T @ (white @ left),
        }

    def settle(state: State) -> Array:
        """Return the most probable initial state, as its deviation from the expected one."""
        return most_probable(state["information"], state["towards"], state["usual"])[None]

    def merged(state: State, settled: Array) -> State:
        now = {"line": state["line"], "x": state["x"] + state["answers"] @ settled[0]}
        if waits:
            now |= {"age": state["age"], "away": state["away"] + model.root @ settled[0]}
        return now

    def after_training(state: State) -> State:
        return state | {"x": model.last - state["answers"] @ settle(state)[0]}

    return Part(row, initial, correct, settle, after_training, merged=merged)


def _inputs_before(training: Array, known: ForecastContext) -> Array | None:
    """Return the inputs from the first training sample to the history; None if unknown."""
    begin = -1 if known.begin is None or known.begin % 1 else int(known.begin)
    return training[:begin] if 0 <= begin <= len(training) else None

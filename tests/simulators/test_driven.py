"""Driven simulators against independent answers: SciPy and closed forms, whatever the clock."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy

import splitband as sb
from tests.simulators.fmus import COMPILES, built

pytest.importorskip("fmpy")
if not COMPILES:
    pytest.skip("no gcc to compile an FMU with", allow_module_level=True)

Array = npt.NDArray[np.float64]
DT, SAMPLES = 0.1, 120
TIME: Array = DT * np.arange(float(SAMPLES))
RNG = np.random.default_rng(0)
STEPS = np.repeat(RNG.choice([-1.0, 0.5, 1.0], SAMPLES // 5), 5)
WAVE = np.sin(TIME) + 0.3 * np.cos(2.7 * TIME)
GATE = np.repeat(RNG.integers(0, 2, SAMPLES // 4), 4).astype(float)
LEVEL = np.repeat(RNG.integers(0, 5, SAMPLES // 3), 3).astype(float)
ONE = np.ones(SAMPLES)


def lag(u: Array, held: bool = True) -> Array:
    """SciPy's answer for x' = u - x."""
    system = [[-1.0]], [[1.0]], [[1.0]], [[0.0]]
    y: Array = scipy.signal.lsim(system, u, TIME, interp=not held)[1]
    return y


def jumping(at: float) -> Array:
    """In closed form: x' = 1 - x, and a jump of 1."""
    after = np.where(at - 1e-9 <= TIME, np.exp(-np.maximum(TIME - at, 0.0)), 0.0)
    return np.asarray(1 - np.exp(-TIME) + after)


def switched() -> Array:
    """In closed form: x' = 1 - x, and -x after it has reached 0.5."""
    at = np.log(2.0)
    return np.where(at > TIME, 1 - np.exp(-TIME), 0.5 * np.exp(at - TIME))


def lagging(t: float, x: Any, u: Any, p: Any) -> list[float]:
    return [p.k * (u[0] - x[0])]


def stiff(t: float, x: Any, u: Any) -> list[float]:
    """Robertson's rates, with an inflow: they span eleven decades."""
    slow, fast = 0.04 * x[0], 1e4 * x[1] * x[2]
    return [u[0] - slow + fast, slow - fast - 3e7 * x[1] ** 2, 3e7 * x[1] ** 2]


def robertsons(_: Path) -> sb.Ode:
    return sb.Ode(stiff, [1.0, 0.0, 0.0], method="BDF")


def robertson() -> Array:
    def slope(t: float, x: Array) -> list[float]:
        return stiff(t, x, [np.interp(t, TIME, 0.1 + 0.1 * GATE)])

    how: Any = {"rtol": 1e-9, "atol": 1e-13, "max_step": DT}
    begin, span = [1.0, 0.0, 0.0], (0, TIME[-1])
    return np.asarray(scipy.integrate.solve_ivp(slope, span, begin, "Radau", TIME, **how).y[0])


def fmu(*kinds: str, hold: Any = "linear", **how: Any) -> Callable[[Path], sb.Fmu]:
    """An FMU of these kinds, by default for co-simulation, see `built`."""
    return lambda at: sb.Fmu(built(at, kinds or ("CoSimulation",), **how), hold=hold)


def ode(**how: Any) -> Callable[[Path], sb.Ode]:
    return lambda _: sb.Ode(lagging, [0.0], parameters={"k": 1.0}, **how)


EXCHANGE = "ModelExchange"
SWITCHED = "(r[V] ? 0 : r[U]) - r[X]"
THROUGH = "r[X] + 2 * r[U]"  # an output that depends on the input at once
DISCRETE: dict[str, Any] = {"types": ("Boolean", "Integer"), "inputs": ("gate", "level")}
DISCRETE["slope"] = "r[U] * r[V] - r[X]"
BOTH = {"gate": GATE, "level": LEVEL}


def summed(time: Array, u: Array) -> Array:
    return np.cumsum(u[:, 0]) * (time[1] - time[0]) + time


# What runs, the record's inputs by name, the independent answer, and how near it comes.
Row = tuple[Callable[[Path], Any], dict[str, Array], Array, float]
HELD, SMOOTH, UNIT = {"u": STEPS}, {"u": WAVE}, {"u": ONE}
THROUGH_BOTH = fmu("CoSimulation", EXCHANGE, out=THROUGH, mode=1)
TABLE: dict[str, Row] = {
    "co-simulation": (fmu(), HELD, lag(STEPS), 1e-6),
    "feedthrough read at once": (fmu(out=THROUGH), HELD, lag(STEPS) + 2 * STEPS, 1e-6),
    "a gain in the step": (fmu(out="3 * r[U]", mode=1), HELD, 3 * STEPS, 1e-12),
    "a Boolean and an integer": (fmu(**DISCRETE), BOTH, lag(GATE * LEVEL), 1e-6),
    "exchange": (fmu(EXCHANGE), SMOOTH, lag(WAVE, False), 2e-6),
    "exchange, inputs held": (fmu(EXCHANGE, hold="zoh"), HELD, lag(STEPS), 1e-6),
    "exchange, discrete inputs": (fmu(EXCHANGE, **DISCRETE), BOTH, lag(GATE * LEVEL), 1e-6),
    "both kinds": (THROUGH_BOTH, SMOOTH, lag(WAVE, False) + 2 * WAVE, 2e-6),
    "an event between samples": (fmu(EXCHANGE, next_event=1.03), UNIT, jumping(1.03), 1e-6),
    "an event at a sample": (fmu(EXCHANGE, next_event=2.0), UNIT, jumping(2.0), 1e-6),
    "an event of the state": (fmu(EXCHANGE, slope=SWITCHED, limit=0.5), UNIT, switched(), 1e-6),
    "FMI 3": (fmu(version=3, out=THROUGH), HELD, lag(STEPS) + 2 * STEPS, 1e-6),
    "FMI 3, exchange": (fmu(EXCHANGE, version=3), SMOOTH, lag(WAVE, False), 2e-6),
    "equation": (ode(), SMOOTH, lag(WAVE, False), 1e-6),
    "stiff equation": (robertsons, {"u": 0.1 + 0.1 * GATE}, robertson(), 1e-4),
    "function": (lambda _: sb.Function(summed), HELD, DT * np.cumsum(STEPS) + TIME, 1e-12),
}


@pytest.mark.filterwarnings("ignore::splitband.ExtrapolationWarning")
@pytest.mark.parametrize("start", [0.0, -30.0, 1e7, 1.7e9])
@pytest.mark.parametrize("kind", TABLE)
def test_a_driven_simulator_gives_the_independent_answer(
    kind: str, start: float, tmp_path: Path
) -> None:
    make, inputs, wanted, near = TABLE[kind]
    u = np.column_stack([*inputs.values()])
    record = sb.Record(wanted, DT, u=u, start=start, inputs=tuple(inputs))
    model = sb.Simulation(make(tmp_path / "rig.fmu")).fit(record[:80])
    np.testing.assert_allclose(model.on(record).y_sim[:, 0], wanted, atol=near)
    found = model.predict(SAMPLES - 80, u=record.u[80:])
    np.testing.assert_allclose(found.y[:, 0], wanted[80:], atol=near)


def test_an_output_that_cannot_be_read_at_its_sample_is_refused(tmp_path: Path) -> None:
    """It has feedthrough and a state, and is refused between inputs and step."""
    fmu = sb.Fmu(built(tmp_path / "rig.fmu", out="r[X] + 3 * r[U]", mode=2))
    record = sb.Record(lag(STEPS) + 3 * STEPS, DT, u=STEPS)
    with pytest.raises(ValueError, match=r"depends on the inputs at once.*model exchange"):
        sb.Simulation(fmu).fit(record).on(record)


def test_a_gain_or_a_delay_that_nothing_tells_apart_is_refused(tmp_path: Path) -> None:
    """By one fixed step and no word of its dependencies; with that, the gain is exact."""
    record = sb.Record(3 * STEPS, DT, u=STEPS)
    fmu = sb.Fmu(built(tmp_path / "rig.fmu", out="3 * r[U]", mode=1, fixed=DT))
    with pytest.raises(ValueError, match="computed in the step after it, or one sample late"):
        sb.Simulation(fmu).fit(record).on(record)
    told = sb.Fmu(built(tmp_path / "told.fmu", out="3 * r[U]", mode=1, fixed=DT, dependencies="1"))
    np.testing.assert_allclose(sb.Simulation(told).fit(record).on(record).y_sim, record.y)


def test_what_a_run_cannot_tell_is_said(tmp_path: Path) -> None:
    fmu = sb.Fmu(built(tmp_path / "rig.fmu", mode=1, fixed=DT))
    record = sb.Record(lag(STEPS), DT, u=STEPS)
    with pytest.warns(UserWarning, match="y of .*rig.fmu is taken not to depend on the inputs"):
        found = sb.Simulation(fmu).fit(record).on(record)
    np.testing.assert_allclose(found.y_sim, record.y, atol=1e-6)
    told = sb.Fmu(built(tmp_path / "told.fmu", mode=1, fixed=DT, dependencies=""))
    found = sb.Simulation(told).fit(record).on(record)  # warnings are errors here
    np.testing.assert_allclose(found.y_sim, record.y, atol=1e-6)


def test_values_that_an_input_cannot_take_are_refused(tmp_path: Path) -> None:
    fmu = sb.Fmu(built(tmp_path / "rig.fmu", types=("Boolean", "Real")))
    with pytest.raises(ValueError, match=r"must hold 0 and 1 for u .*Boolean: got 2"):
        fmu.simulate(TIME, 2 * ONE[:, None])


def test_values_that_a_parameter_cannot_take_are_refused(tmp_path: Path) -> None:
    path = built(tmp_path / "rig.fmu", inputs=("u", "n"), types=("Real", "Integer"))
    says: dict[Any, str] = {
        2.7: "hold whole numbers for n .*Integer: got 2.7",
        (0, 5): "be .*not ranges, for n ",
    }
    for value, words in says.items():
        with pytest.raises(ValueError, match=f"parameters must {words}"):
            sb.Fmu(path, parameters={"n": value}, inputs=["u"])


def test_how_an_output_is_read_is_found_out_for_the_inputs_of_each_record(tmp_path: Path) -> None:
    """It depends on the inputs at once above 5 only, in its step: then neither read is right."""
    out = "r[X] + (r[U] > 5 ? r[U] - 5 : 0)"
    fmu = sb.Fmu(built(tmp_path / "rig.fmu", out=out, mode=1))
    small, large = sb.Record(lag(STEPS), DT, u=STEPS), sb.Record(STEPS, DT, u=20 * STEPS)
    found = sb.Simulation(fmu).fit(small).on(small)
    np.testing.assert_allclose(found.y_sim, small.y, atol=1e-6)
    with pytest.raises(ValueError, match="depends on the inputs at once"):
        sb.Simulation(fmu).fit(large).on(large)


def two(folder: Path, **options: Any) -> sb.Fmu:
    return sb.Fmu(built(folder / "two.fmu", inputs=("valve", "heater"), output="level"), **options)


@pytest.mark.parametrize(
    ("columns", "inputs", "message"),
    [
        (("level",), ("a", "b"), r"record's inputs, a, b, .*it has valve, heater"),
        (("level",), ("valve",), r"record's inputs, valve, .*it has valve, heater"),
        (("level",), (), r"of which it has none.*it has valve, heater"),
        (("p", "q"), ("valve", "heater"), r"channels, p, q, .*it has level"),
    ],
)
def test_names_that_do_not_match_are_refused_with_both_lists(
    columns: tuple[str, ...], inputs: tuple[str, ...], message: str, tmp_path: Path
) -> None:
    u = np.zeros((30, len(inputs))) if inputs else None
    record = sb.Record(np.zeros((30, len(columns))), DT, u=u, columns=columns, inputs=inputs)
    for model in (sb.Simulation(two(tmp_path)), sb.GreyBox(two(tmp_path))):
        with pytest.raises(ValueError, match=message):
            model.fit(record).predict(3, record, None if u is None else u[:3])


def test_names_match_without_units_and_local_variables_are_found(tmp_path: Path) -> None:
    u, names = np.column_stack([WAVE, STEPS]), ("heater [W]", "valve (%)")
    record = sb.Record(lag(STEPS), DT, u=u, columns=("x [m]",), inputs=names)
    found = sb.Simulation(two(tmp_path)).fit(record).on(record)
    np.testing.assert_allclose(found.y_sim, record.y, atol=1e-6)


def test_inputs_that_are_not_named_keep_their_start_values(tmp_path: Path) -> None:
    record = sb.Record(lag(STEPS), DT, u=STEPS, inputs=("opening",))
    found = sb.Simulation(two(tmp_path, inputs=["valve"])).fit(record).on(record)
    np.testing.assert_allclose(found.y_sim, record.y, atol=1e-6)
    found = sb.Simulation(two(tmp_path, inputs=[])).fit(record).on(record)
    np.testing.assert_array_equal(found.y_sim, 0 * record.y)
    with pytest.raises(ValueError, match="x is none; it has valve, heater"):
        two(tmp_path, inputs=["x"])


class Own:
    """A simulator of the user's own that takes inputs."""

    def simulate(self, time: Array, u: Array) -> Array:
        return np.cumsum(u[:, 0])


@pytest.mark.filterwarnings("ignore:output y is beyond its range")
def test_every_way_to_run_a_driven_simulator_is_driven() -> None:
    record = sb.Record(np.cumsum(STEPS) + 0.01 * WAVE, DT, u=STEPS, start=0.0)
    train, ahead = record[:80], record.u[80:]
    short = sb.TrainingSettings.paper(window=30, warmup=10, epochs=1)
    # With a network that adds nothing to speak of, a hybrid is its base.
    for model in (
        sb.Simulation(Own()),
        sb.Calibrated(Own(), ["gain", "offset"]),
        sb.Residual(sb.Simulation(Own()), sb.GRU(2), settings=short),
        sb.Filtered(sb.Calibrated(Own(), ["gain"]), sb.GRU(2), sb.Bands(0.5, 1, 1), settings=short),
    ):
        fitted = model.fit(train, seed=0)
        found = fitted.predict(40, u=ahead).y
        other = fitted.predict(40, u=-ahead).y
        stream = fitted.stream()
        output = Own().simulate(np.linspace(0.0, 84 * DT, 85), record.u[:85])[80:]
        stepped = np.stack([stream.step(u, y) for u, y in zip(ahead[:5], output, strict=True)])
        np.testing.assert_allclose(stepped, found[:5], atol=1e-5)
        assert np.abs(found[:, 0] - record.y[80:, 0]).max() < 0.5 * np.ptp(record.y)
        assert np.abs(found - other).max() > 1
        if not model.random:  # what drives it before a history is known
            late = fitted.predict(20, record[60:100], record.u[100:]).y
            np.testing.assert_allclose(late, found[20:], atol=1e-9)
    with pytest.raises(ValueError, match="driven by all inputs"):
        sb.Simulation(Own()).fit(sb.Record(record.y[:50], DT, u=STEPS[:50], start=0.0)).predict(
            5, sb.Record(record.y[60:], DT, u=STEPS[60:], start=6.0), STEPS[:5]
        )


def test_a_comparison_runs_each_record_with_its_own_inputs() -> None:
    """All begin at the same time stamp, and are known by their inputs."""

    def record(u: Array) -> sb.Record:
        return sb.Record(np.cumsum(u) + 1e-3 * WAVE, DT, u=u)

    how: Any = {"methods": [sb.Simulation(Own()), sb.Mean()], "seeds": 1}
    how |= {"others": [record(WAVE)], "tests": [record(GATE), record(-STEPS)]}
    result = sb.compare(record(STEPS), **how)
    errors = result.errors(result.fits["simulator"][0])
    assert max(*errors.tests, errors.total) < 2e-3
    y = result.model.predict(10, u=ONE[:10]).y  # with inputs that it was not run for
    np.testing.assert_allclose(np.diff(y[:, 0]), 1.0)


def test_a_function_of_time_says_which_time_it_means() -> None:
    record = sb.Record(np.sin(TIME + 7), DT, start=7.0)
    with pytest.raises(ValueError, match=r'"record" if it means the record.s clock.*7 s, 0 if'):
        sb.Simulation(sb.Function(np.sin)).fit(record).predict(3)
    for start, shift in (("record", 0.0), (7, 0.0), (0, -7.0)):
        model = sb.Simulation(sb.Function(np.sin, start=start)).fit(record[:80])  # type: ignore[arg-type]
        np.testing.assert_allclose(model.predict(9).y[:, 0], np.sin(TIME[80:89] + 7 + shift))
    with pytest.raises(ValueError, match='start must be a number of seconds or "record", got'):
        sb.Fmu("none.fmu", start="noon")  # type: ignore[arg-type]


def test_an_equation_knows_the_time_that_it_is_given() -> None:
    for method in ("RK45", "BDF"):
        ode = sb.Ode(lambda t, x, u: [t], [0.0], start=5.0, method=method)
        record = sb.Record(5 * TIME + TIME**2 / 2, DT, u=STEPS, start=1.7e9)
        found = sb.GreyBox(ode).fit(record[:80]).predict(40, u=STEPS[80:])
        np.testing.assert_allclose(found.y, record.y[80:], rtol=1e-6)


def test_parameters_that_a_function_does_not_take_are_refused_with_the_signature() -> None:
    """It would be said that the record does not tell them."""

    def level(time: Array, u: Array) -> Array:
        return time

    given = {"c": (0.01, 0.04)}
    says: dict[Any, str] = {
        level: r"level\(time, u\) must be level\(time, u, p\), with p.c in it",
        partial(level): r"\(time, u\) must be .*\(time, u, p\)",
    }
    for function, words in says.items():
        with pytest.raises(ValueError, match=words):
            sb.Function(function, parameters=given)
    with pytest.raises(ValueError, match=r"must be .*\(t, x, u, p\), with p.c"):
        sb.Ode(lambda t, x, u: [u[0]], [0.0], parameters={**given, "x0_1": 1.0})
    sb.Ode(lambda t, x, u: [u[0]], [0.0], parameters={"x0_1": 1.0})
    # As the message says, it is found once it is an argument.
    record = sb.Record(0.02 * np.cumsum(STEPS), DT, u=STEPS)
    told = sb.Function(lambda time, u, p: p.c * np.cumsum(u[:, 0]), parameters=given)
    assert sb.identify(told, record).values == pytest.approx({"c": 0.02})

"""An exported grey box integrates its equation as a stream does."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy

import splitband as sb
from splitband.runtime.arrays import Array
from splitband.simulators.fixed_steps import FixedSteps
from tests.export.test_c import Compiled
from tests.export.test_fmu import Instance
from tests.export.test_onnx import session

EXACT = 1e-11, 1e-13
"""Tolerances of a solver that is as exact as a program."""


def stiffening(t: float, x: Any, u: Any, p: Any) -> list[Any]:
    return [x[1], p.k * (u[0] - x[0] - 0.3 * x[0] ** 3) - p.c * x[1]]


def swinging(t: float, x: Any) -> Any:
    return np.array([x[1], -4.0 * np.sin(x[0]) - 0.1 * x[1] * abs(x[1])])


def timed(t: float, x: Any, u: Any, p: Any) -> Any:
    slope = np.zeros_like(x)
    slope[0] = p.k * (u[0] - x[0]) + 0.1 * np.cos(0.5 * t)
    slope[1] = x[0] - x[1]
    return slope


def sliding(t: float, x: Any, u: Any, p: Any, w: Any) -> list[Any]:
    return [x[1], p.k * (u[0] - x[0]) - p.c * x[1] - w[0] + 0.3 * w[1]]


def term(*names: str, **options: Any) -> sb.Unknown:
    """A term with random weights, held beyond 5."""
    made, z = (
        sb.Unknown(names, hidden=5, **options),
        np.array([[-5.0], [5.0]]).repeat(len(names), 1),
    )
    state = made.begun(z)
    weights = np.random.default_rng(0).normal(size=state.weights.shape)
    return replace(made, trained=replace(state, weights=weights)).holding(z)


def of_inputs(x: Any, u: Any, p: Any) -> Any:
    return np.column_stack([x[:, 0] + 0.1 * u[:, 0], p.c * x[:, 1]])


def inputs(samples: int = 200) -> Array:
    held = np.repeat(np.random.default_rng(0).normal(size=samples // 10), 10)
    return np.asarray(scipy.signal.lfilter([0.5], [1, -0.5], held)[:, None])


RANGES = {"k": (1.0, 9.0), "c": (0.1, 2.0)}
EQUATIONS: dict[str, Callable[[], sb.Ode]] = {
    "inputs on straight lines": lambda: sb.Ode(
        stiffening, [0.1, 0.0], parameters=RANGES, tolerances=EXACT
    ),
    "held inputs": lambda: sb.Ode(
        stiffening, [0.1, 0.0], parameters=RANGES, hold="zoh", tolerances=EXACT
    ),
    "time, and an array that is written to": lambda: sb.Ode(
        timed, [0.0, 0.0], parameters={"k": (0.5, 5.0)}, tolerances=EXACT, start=3.0
    ),
    "unknown terms": lambda: sb.Ode(
        sliding,
        [0.1, 0.0],
        parameters=RANGES,
        tolerances=EXACT,
        unknown=[term("x2", odd=True, bounded=(-1, 1)), term("x1", "u", increasing=True)],
    ),
    "channels of states, inputs and parameters": lambda: sb.Ode(
        stiffening, [0.1, 0.0], of_inputs, RANGES, tolerances=EXACT
    ),
}


def record_of(ode: sb.Ode, columns: int) -> sb.Record:
    """The equation with values within the ranges, and noise."""
    u = inputs()
    matched = ode.matched([f"y{i}" for i in range(columns)], ["u"])
    within = {name: 0.4 * low + 0.6 * high for name, (low, high) in RANGES.items()}
    fixed = matched.fixed({name: within[name] for name in RANGES if name in matched.known.given})
    start = float(ode.start)
    y = np.asarray(fixed.simulate(start + 0.1 * np.arange(200.0), u))
    rng = np.random.default_rng(1)
    return sb.Record(y + rng.normal(0, 0.01, y.shape), 0.1, u=u)


@pytest.mark.parametrize("kind", EQUATIONS)
def test_c_integrates_the_equation(kind: str, tmp_path: Path) -> None:
    ode = EQUATIONS[kind]()
    record: Any = record_of(ode, 2 if "channels" in kind else 1)
    model = sb.GreyBox(ode, starts=1).fit(record[:150])
    model.memory = 0
    compiled, stream = Compiled(model.export(tmp_path / "rig.c")[0]), model.stream()
    worst = 0.0
    for n in range(300):
        u = record.u[n % 200]
        if n % 50 < 5:  # what is measured does not change the state
            compiled.observe(record.y[n % 200], u)
            stream.observe(record.y[n % 200], u)
        else:
            worst = max(worst, np.abs(compiled.step(record.ny, u) - stream.step(u)).max())
    assert worst < 1e-9 * np.ptp(record.y)


def test_without_inputs_and_from_an_estimated_state(tmp_path: Path) -> None:
    time = 0.1 * np.arange(200.0)
    record = sb.Record(np.cos(1.9 * time), 0.1)
    ode = sb.Ode(swinging, [1.0, 0.0], parameters={"x0_1": (0.5, 1.5)}, tolerances=EXACT)
    model = sb.GreyBox(ode, starts=1).fit(record[:150])
    model.memory = 30
    compiled = Compiled(model.export(tmp_path / "rig.c")[0])
    found = np.stack([compiled.step(1) for _ in range(50)])
    np.testing.assert_allclose(found, model.predict(50).y, atol=1e-9)
    later = Compiled(model.export(tmp_path / "later.c", history=record[:170])[0])
    found = np.stack([later.step(1) for _ in range(30)])
    np.testing.assert_allclose(found, model.predict(30, record[:170]).y, atol=1e-9)
    clear = "in the model's initial state, and a step needs no observed sample. */"
    assert f"{clear}\nvoid rig_clear" in (tmp_path / "rig.h").read_text()
    compiled.call("clear")  # begins as the equation does
    begin = model.parameters["used"]["x0_1"]
    free = np.asarray(ode.fixed({"x0_1": begin}).simulate(time[:20]))
    np.testing.assert_allclose([compiled.step(1) for _ in range(20)], free[:, :1], atol=1e-9)


def test_another_run_begins_in_a_state_of_its_own(tmp_path: Path) -> None:
    """Its stamps are those of the training record, as a logger's that begin at 0, its y are not."""
    time = 0.1 * np.arange(200.0)
    ode = sb.Ode(swinging, [1.0, 0.0], parameters={"x0_1": (0.5, 1.5)}, tolerances=EXACT)
    noise = np.random.default_rng(0).normal(0, 0.001, 200)
    both = (replace(ode, parameters={"x0_1": begin}).simulate(time) for begin in (1.2, 0.6))
    one, other = (sb.Record(np.asarray(x)[:, 0] + noise, 0.1, start=0.0) for x in both)
    model = sb.GreyBox(ode, starts=1).fit(one[:150])
    model.memory = 0
    wanted = model.predict(50, other[:150]).y
    np.testing.assert_allclose(wanted, other.y[150:], atol=0.01)
    much_later = model.predict(50, replace(other[:150], start=1e6)).y
    np.testing.assert_allclose(much_later, wanted, atol=1e-6)
    for other_record in (False, True):
        files = model.export(tmp_path / "rig.c", history=other[:150], other_record=other_record)
        assert "end of the history with which" in files[1].read_text()
        compiled = Compiled(files[0])
        found = np.stack([compiled.step(1) for _ in range(50)])
        np.testing.assert_allclose(found, wanted, atol=1e-8)
    step = sb.casadi_step(model, other[:150], other_record=True)
    np.testing.assert_allclose(float(step(step.state())[1]), wanted[0, 0], atol=1e-8)
    np.testing.assert_allclose(
        step.state(one[:150])[:2], sb.casadi_step(model).state()[:2], atol=1e-8
    )


def test_coarse_tolerances_are_said(tmp_path: Path) -> None:
    ode = replace(EQUATIONS["held inputs"](), tolerances=(1e-3, 1e-5))
    model = sb.GreyBox(ode, starts=1).fit(record_of(ode, 1)[:150])
    with pytest.warns(UserWarning, match=r"\(0.001, 1e-05\), are too coarse"):
        model.export(tmp_path / "rig.c")


@pytest.mark.parametrize("count", [1, 4])
@pytest.mark.parametrize("hold", ["linear", "zoh"])
def test_equal_steps_are_those_of_the_solver(count: int, hold: Any) -> None:
    ode = sb.Ode(timed, [0.3, 0.1], parameters={"k": 2.0}, hold=hold).matched(["y"], ["u"])
    time, u = 0.1 * np.arange(20.0), inputs(20)
    y, x = ode.stepped({"k": 2.0}, None, time, u, count)
    steps, now = FixedSteps(ode, {"k": 2.0}, 0.1, count), x[0]
    for n in range(19):
        now = steps.advance(now, time[n], u[n], u[n + 1])
        np.testing.assert_allclose(now, x[n + 1], atol=1e-14)
        np.testing.assert_allclose(steps.observed(now, u[n + 1]), y[n + 1], atol=1e-14)


def everything(x: Any) -> Any:
    a, b = x[:, 0], x[:, 1]
    angles = [np.tan(a), np.arctan(a), np.arcsin(0.5 * a), np.arccos(0.5 * a), np.arctan2(a, b)]
    areas = [np.sinh(a), np.cosh(a), np.arcsinh(a), np.arccosh(2 + a * a), np.arctanh(0.5 * a)]
    powers = [np.expm1(a), np.log1p(a * a), a**3, (1 + a * a) ** 1.7, 2.0**a, np.hypot(a, b)]
    steps = [np.sign(b), abs(a), np.remainder(5 * a, 2.0), np.clip(a, None, 0.2)]
    chosen = [np.where((a > 0) & (b < 0), a, np.ceil(3 * b)), x[:, [1, 0]].sum(1)]
    line = np.interp(a, [-1.0, 0.0, 0.5], [2.0, 0.0, 1.0])
    return np.column_stack([*angles, *areas, *powers, *steps, *chosen, line])


def test_numpys_functions_of_an_equation_are_written_in_c(tmp_path: Path) -> None:
    ode = sb.Ode(swinging, [0.9, 0.0], everything, {"x0_1": (0.8, 1.0)}, tolerances=EXACT)
    time = 0.1 * np.arange(120.0)
    y = np.asarray(ode.fixed({"x0_1": 0.9}).simulate(time))
    model = sb.GreyBox(ode, starts=1).fit(sb.Record(y, 0.1)[:100])
    model.memory = 0
    compiled, stream = Compiled(model.export(tmp_path / "rig.c")[0]), model.stream()
    for _ in range(50):
        np.testing.assert_allclose(compiled.step(y.shape[1]), stream.step(), atol=1e-7)


def lagging(t: float, x: Any, u: Any, p: Any) -> list[Any]:
    return [p.k * (u[0] - x[0])]


def flags(x: Any, u: Any, _: Any) -> Any:
    a, b = x[:, 0], u[:, 0]
    both, joined = (a > 0.2) + (b > 0.5), np.concatenate([x, x > 0.2, u > 0.5], 1)
    sums = [a + 0.3 * both, a + (a > 0.2) * (b > 0.5), a * (1 + 0.5 * (b > 0.5)), joined.sum(1)]
    powers = [(x > 0.2) @ np.ones(1), 2.0 ** (b > 0.5)]
    picked = (b, a, 2 * a), (b > 0.5, a > 0.2, a), (np.logical_and(b, a > 0.2), a, 2 * a)
    return np.column_stack([*sums, *powers, *(np.where(*each) for each in picked)])


def jump(x: Any, u: Any, _: Any) -> Any:
    at, values = [0.0, 0.5, 0.5, 1.0, 1.0], [0.0, 1.0, 2.0, 3.0, 5.0]
    return np.column_stack([np.interp(x[:, 0], at, values), np.interp(u[:, 0] / 2, at, values)])


def multiples(x: Any, u: Any, _: Any) -> Any:
    a, b = x[:, 0], u[:, 0]
    added = [a + np.mod(b, 0.1), a + np.mod(-b, 0.1), a + np.mod(b, -0.1), a + 0.1 * (b // 0.1)]
    return np.column_stack([*added, np.mod(3 * a, 1 + b), (3 * a - 1) // 0.7])


@pytest.mark.parametrize("observe", [flags, jump, multiples])
def test_flags_jumps_and_multiples_are_those_of_numpy(observe: Any, tmp_path: Path) -> None:
    ode = sb.Ode(lagging, [0.1], observe, {"k": (0.5, 5.0)}, tolerances=EXACT, hold="zoh")
    u = np.repeat(np.random.default_rng(0).integers(0, 2, 16), 10).astype(float)[:, None]
    columns = [f"y{i}" for i in range(len(observe(np.zeros((1, 1)), np.zeros((1, 1)), None)[0]))]
    y = np.asarray(
        ode.matched(columns, ["u"]).fixed({"k": 2.0}).simulate(0.1 * np.arange(160.0), u)
    )
    noise = np.random.default_rng(1).normal(0, 0.01, y.shape)
    model = sb.GreyBox(ode, starts=1).fit(sb.Record(y + noise, 0.1, u=u)[:100])
    model.memory = 0
    stream, step = model.stream(), sb.casadi_step(model)
    compiled, state, found = Compiled(model.export(tmp_path / "rig.c")[0]), step.state(), []
    wanted = [stream.step(each) for each in u[100:]]
    for each in u[100:]:
        state, said = step(state, each)
        found.append([compiled.step(len(columns), each), said.full()[:, 0]])
    np.testing.assert_allclose(np.array(found), np.stack(wanted)[:, None].repeat(2, 1), atol=1e-9)
    _, rollout = model.export(tmp_path / "rig.onnx")
    signals = {"y": np.full((60, len(columns)), np.nan), "u": u[100:]}
    np.testing.assert_allclose(session(rollout).run(None, signals)[1], wanted, atol=1e-9)


@pytest.mark.parametrize(
    ("expression", "message"),
    [
        (lambda x: x if x > 0 else 0.0, "write np.where"),
        (lambda x: max(x, 0.0), "np.maximum"),
        (math.sin, "np.sin for math.sin"),
        (lambda x: np.fft.fft(np.stack([x, x]))[0], "cannot be traced"),
        (lambda x: np.stack([x, x]).mean(), r"write np\.mean\(x\)"),
        (lambda x: x.copy(), "write x itself"),
    ],
)
def test_what_cannot_be_written_is_told_with_its_line(
    expression: Any, message: str, tmp_path: Path
) -> None:
    def rhs(t: float, x: Any, u: Any, p: Any) -> list[Any]:
        return [p.k * (u[0] - 0.1 * np.real(expression(x[0])) - x[0])]

    ode = sb.Ode(rhs, [0.5], parameters={"k": (0.5, 2.0)})
    u = inputs(40)
    record = sb.Record(np.cumsum(0.1 * u), 0.1, u=u)
    model = sb.GreyBox(ode, starts=1).fit(record)
    with pytest.raises(ValueError, match=rf"{message}.*test_grey_box.py, line"):
        model.export(tmp_path / "rig.c")
    assert not [*tmp_path.iterdir()]


def test_an_output_that_depends_on_other_samples_is_refused(tmp_path: Path) -> None:
    def from_the_first(x: Any) -> Any:
        return x[:, 0] - x[0, 0]

    ode = sb.Ode(stiffening, [0.1, 0.0], from_the_first, RANGES, tolerances=EXACT)
    model = sb.GreyBox(ode, starts=1).fit(record_of(ode, 1)[:150])
    with pytest.raises(ValueError, match="observe must map each sample by itself"):
        model.export(tmp_path / "rig.c")


def test_an_equation_that_needs_an_adaptive_solver_says_so(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ode = EQUATIONS["held inputs"]()
    model = sb.GreyBox(ode, starts=1).fit(record_of(ode, 1)[:60])
    for name, value in {"MOST_STEPS": 1, "MAX_NOISE_SHARE": 0.0}.items():
        monkeypatch.setattr(f"splitband.simulators.fixed_steps.{name}", value)
    with pytest.raises(ValueError, match=r"needs an adaptive solver.*sb\.load\(folder\) returns"):
        model.export(tmp_path / "rig.c")
    model.simulator = replace(ode, method="Radau")
    with pytest.raises(ValueError, match="with the method Radau cannot"):
        model.export(tmp_path / "rig.c")


def test_unknown_terms_go_wherever_the_equation_goes(tmp_path: Path) -> None:
    """Over a gap, on a second record, saved, below a hybrid, and in every program."""
    ode = EQUATIONS["unknown terms"]()
    record: Any = record_of(ode, 1)
    holed = replace(record, measured=((np.arange(200) < 60) | (np.arange(200) >= 70))[:, None])
    model = sb.GreyBox(ode, starts=1).fit(holed[:150], record[:100])
    wanted, u = model.predict(50, u=record.u[150:]).y, record.u[150:]
    truth = ode.matched(record.columns, record.inputs).fixed({"k": 5.8, "c": 1.24})
    exact = np.asarray(truth.simulate(0.1 * np.arange(200.0), record.u))[150:]
    assert np.abs(wanted - exact).max() < 0.02 * np.ptp(exact)
    stream, step = model.stream(), sb.casadi_step(model)
    np.testing.assert_allclose([stream.step(each) for each in u], wanted, atol=1e-9)
    state, found = step.state(), []
    for each in u:
        state, said = step(state, each)
        found.append(said.full()[:, 0])
    np.testing.assert_allclose(found, wanted, atol=1e-9)
    model.export(tmp_path / "rig.fmu")
    instance = Instance(tmp_path / "rig.fmu", tmp_path / "rig", record)
    np.testing.assert_allclose([instance.step(u=each) for each in u], wanted, atol=1e-9)
    _, rollout = model.export(tmp_path / "rig.onnx")
    signals = {"y": np.full((50, 1), np.nan), "u": u}
    np.testing.assert_allclose(session(rollout).run(None, signals)[1], wanted, atol=1e-9)
    model.save(tmp_path / "model")
    terms = [sb.Unknown(["x2"], hidden=5, odd=True, bounded=(-1, 1))]
    terms.append(sb.Unknown(["x1", "u"], hidden=5, increasing=True))
    again = sb.load(tmp_path / "model", simulator=replace(ode, unknown=terms))
    np.testing.assert_array_equal(again.predict(50, u=u).y, wanted)
    for other, message in (
        (terms[:1], r"must have 2 term\(s\), as in training, got 1"),
        ([terms[0], sb.Unknown(hidden=4)], r"weights must have the shape \(17,\), got \(21,\)"),
    ):
        with pytest.raises(sb.InputError, match=message):
            sb.load(tmp_path / "model", simulator=replace(ode, unknown=other))
    settings = sb.TrainingSettings.paper(window=30, warmup=5, epochs=1)
    hybrid = sb.Residual(ode, sb.GRU(2), settings=settings).fit(record[:150])
    stream = hybrid.stream()
    found = [stream.step(each) for each in u]
    np.testing.assert_allclose(found, hybrid.predict(50, u=u).y, atol=1e-6)
    compiled = Compiled(hybrid.export(tmp_path / "hybrid.c")[0])
    np.testing.assert_allclose([compiled.step(1, each) for each in u], found, atol=1e-6)

"""A CasADi function says what a stream says, and its derivatives are those of differences."""

import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import casadi
import numpy as np
import pytest

import splitband as sb
from tests.export.test_grey_box import EQUATIONS, record_of
from tests.streams import SHORT, driven, fitted, free, in_double, rows

SPLIT = "split", "split, conditioned, +HP", "split at one rate"
DRIVEN = "mean", "persistence", "linear", "simulator", "gru", "rnn", "state-space", *SPLIT
FREE = [f"{name}, no inputs" for name in ("seasonal-naive", "periodic", "gru", "residual")]
KINDS = (*DRIVEN, "filtered", "residual of linear", "ensemble", *FREE)


def flat(y: Any) -> Any:
    return y.full().ravel()


def given(at: dict[str, Any]) -> list[Any]:
    return [np.ravel(at[name]) for name in ("u", "y_sim") if name in at]


@pytest.mark.filterwarnings("ignore:output y0 is beyond its range")
@pytest.mark.parametrize("name", KINDS)
def test_casadi_says_what_a_stream_says(name: str) -> None:
    forecaster, record = fitted(name)
    step, stream = sb.casadi_step(forecaster), forecaster.stream()
    at = rows(record, stream)
    scale, state, worst = float(np.std(record.y)), step.state(), 0.0
    for n in range(300):
        row = at(n % (len(record) - 1))
        state, y = step(state, *given(row))
        worst = max(worst, np.abs(flat(y) - stream.step(**row)).max())
    assert worst < 1e-9 * scale
    stream = forecaster.stream()
    for n in range(150, 190):  # measured again, and a plan from there
        step.stream.observe(record.y[n], **at(n))
        stream.observe(record.y[n], **at(n))
    state, y = step(step.state(), *given(at(190)))
    np.testing.assert_allclose(flat(y), stream.step(**at(190)), atol=1e-9 * scale)
    state, y = step(step.state(record[:190]), *given(at(190)))
    u, y_sim = (None if s is None else s[190:192] for s in (record.u, record.y_sim))
    wanted = forecaster.predict(2, record[:190], u, y_sim).y[0]
    np.testing.assert_allclose(flat(y), wanted, atol=1e-9 * scale)


def derivatives(step: Any, at: Any) -> tuple[Any, Any]:
    """Of all outputs by all arguments: CasADi's, and central differences."""
    sizes = [step.function.numel_in(i) for i in range(step.function.n_in())]
    v, ends = casadi.MX.sym("v", sum(sizes)), np.cumsum([0, *sizes]).tolist()
    out = casadi.vertcat(*step(*(v[a:b] for a, b in pairwise(ends))))
    value = casadi.Function("value", [v], [out])
    slope = casadi.Function("slope", [v], [casadi.jacobian(out, v)])
    found = slope(at).full()
    columns = []
    for i in range(len(at)):
        h = np.zeros(len(at))
        h[i] = 1e-6 * (1 + abs(at[i]))
        columns.append(flat(value(at + h) - value(at - h)) / (2 * h[i]))
    return found, np.stack(columns, axis=1)


@pytest.mark.parametrize("name", ["linear", "gru", "state-space", "split", "filtered", "ensemble"])
def test_derivatives_are_those_of_differences(name: str) -> None:
    forecaster, record = fitted(name)
    step = sb.casadi_step(forecaster)
    at = rows(record, forecaster.stream())(160)
    start = np.concatenate([step.state(), *given(at)])
    found, wanted = derivatives(step, start)
    assert np.isfinite(found).all()
    kept = slice(None)
    if name == "split":  # the phase of its slow network is no continuous state
        kept = slice(len(step.state()), None)
    np.testing.assert_allclose(found[:, kept], wanted[:, kept], rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("name", ["gru", "split, conditioned, +HP", "filtered", "ensemble"])
def test_large_networks_keep_their_matrices(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    forecaster, record = fitted(name)
    small = sb.casadi_step(forecaster)
    monkeypatch.setattr("splitband.export.casadi_graph.MOST_IN_SX", 0)
    large = sb.casadi_step(forecaster)
    assert small.function.is_a("SXFunction")
    assert large.function.is_a("MXFunction")
    at = given(rows(record, small.stream)(150))
    for one, other in zip(small(small.state(), *at), large(large.state(), *at), strict=True):
        np.testing.assert_allclose(flat(one), flat(other), rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("hybrid", [False, True])
def test_the_equation_of_a_grey_box_is_part_of_it(hybrid: bool) -> None:
    ode = EQUATIONS["inputs on straight lines"]()
    record: Any = record_of(ode, 1)
    grey: sb.Forecaster = sb.GreyBox(ode, starts=1)
    model = sb.Residual(grey, sb.GRU(3), conditioned=True, settings=SHORT) if hybrid else grey
    model.fit(record[:150])
    in_double(model)
    step = sb.casadi_step(model)
    state, found = step.state(), []
    for u in record.u[150:]:
        state, y = step(state, u)
        found.append(flat(y))
    np.testing.assert_allclose(found, model.predict(50, u=record.u[150:]).y, atol=1e-9)
    start = np.concatenate([step.state(), record.u[150]])
    found, wanted = derivatives(step, start)
    np.testing.assert_allclose(found, wanted, rtol=1e-5, atol=1e-6)


def test_a_file_is_read_by_casadi(tmp_path: Path) -> None:
    forecaster, record = fitted("filtered")
    path, begin = forecaster.export(tmp_path / "rig.casadi")
    loaded = casadi.Function.load(str(path))
    assert loaded.name_in() == ["state", "u", "y_sim"]
    assert loaded.name_out() == ["state_next", "y"]
    state = casadi.Function.load(str(begin))()["state"]
    step = sb.casadi_step(forecaster)
    u, y_sim = record.u[150], record.y_sim[150]
    for one, other in zip(loaded(state, u, y_sim), step(step.state(), u, y_sim), strict=True):
        np.testing.assert_array_equal(flat(one), flat(other))


def test_the_slope_of_a_simulator_needs_its_next_sample() -> None:
    forecaster, record = fitted("filtered, no inputs")
    with pytest.raises(ValueError, match="the simulator's output of the sample after its end"):
        sb.casadi_step(forecaster)
    history = replace(record[:150], y_sim=record.y_sim[:160])
    step, stream = sb.casadi_step(forecaster, history), forecaster.stream(history)
    state = step.state()
    for n in range(150, 160):
        state, y = step(state, record.y_sim[n : n + 2].ravel())
        np.testing.assert_allclose(flat(y), stream.step(y_sim=record.y_sim[n : n + 2]), atol=1e-12)


def test_a_history_that_does_not_tell_the_state_is_refused() -> None:
    record = driven()
    never = replace(record[:10], measured=np.array([[True, False]] * 10))
    with pytest.raises(ValueError, match="one measured sample"):
        sb.casadi_step(sb.Persistence().fit(record[:150]), never)


def test_casadi_is_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "splitband.export.casadi_graph")
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(ValueError, match=r'pip install "splitband\[casadi\]"'):
        sb.casadi_step(sb.Mean().fit(free()))

"""Simulators as strangers bring them: right by SciPy or in closed form, or refused."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pytest
import scipy

import splitband as sb
from splitband.cli import main
from tests.simulators.fmus import COMPILES, built

Array = npt.NDArray[np.float64]
DT, SAMPLES = 0.1, 100
TIME: Array = DT * np.arange(float(SAMPLES))
RNG = np.random.default_rng(5)
STEPS = np.repeat(RNG.choice([-1.0, 0.5, 1.0], SAMPLES // 5), 5)
WAVE = np.sin(TIME) + 0.3 * np.cos(2.7 * TIME)
LATE = np.where(TIME > 3, 1.0, 0.0)  # inputs are at rest at the beginning
compiled = pytest.mark.skipif(not COMPILES, reason="no gcc to compile an FMU with")


def lag(u: Array) -> Array:
    y: Array = scipy.signal.lsim(([1.0], [1.0, 1.0]), u, TIME, interp=False)[1]
    return y


def record(y: Array, u: Array | None, **how: Any) -> sb.Record:
    return sb.Record(y, DT, u=u, **how)


def simulated(simulator: Any, of: sb.Record) -> Array:
    found: Array = sb.Simulation(simulator).fit(of).on(of).y_sim
    return found


BOTH = np.column_stack([WAVE, STEPS])
# How the FMU is compiled, names and values of the record's inputs, and the answer.
Row = tuple[dict[str, Any], tuple[str, ...], Array, Array]
PLANT: dict[str, Any] = {"inputs": ("b", "a"), "slope": "r[U] - r[X] - 2 * r[V]"}
THREE = np.column_stack([WAVE, TIME, STEPS])
POWER: dict[str, Any] = {"inputs": ("u", "v"), "out": "r[U] * r[V]", "mode": 1}
ZONE: dict[str, Any] = {"out": "r[U] > 5 ? r[U] - 5 : 0", "mode": 1}
PUSHES = 9 * STEPS * LATE
FAST: dict[str, Any] = {"slope": "500 * (r[U] - r[X])", "mode": 1}
RIGHT: dict[str, Row] = {
    "units, order, one too many": (PLANT, ("a [K]", "z", "b [W]"), THREE, lag(STEPS - 2 * WAVE)),
    "a power in the step": (POWER, ("u", "v"), BOTH * LATE[:, None], WAVE * STEPS * LATE),
    "a dead zone in the step": (ZONE, ("u",), PUSHES[:, None], np.maximum(PUSHES - 5, 0)),
    "a fast state": (FAST, ("u",), STEPS[:, None], np.append(0.0, STEPS[:-1])),
}


@compiled
@pytest.mark.parametrize("what", RIGHT)
def test_an_fmu_gives_the_right_answer(what: str, tmp_path: Path) -> None:
    options, inputs, u, wanted = RIGHT[what]
    fmu = sb.Fmu(built(tmp_path / "rig.fmu", **options))
    found = simulated(fmu, record(wanted, u, inputs=inputs, start=1.7e9))
    np.testing.assert_allclose(found[:, 0], wanted, atol=1e-6)


@compiled
@pytest.mark.parametrize(
    ("out", "gain"), [("r[X] + 0.05 * r[U]", 0.05), ("r[X] + r[K] * r[U]", 2.0)]
)
def test_a_feedthrough_that_would_come_late_is_refused(
    out: str, gain: float, tmp_path: Path
) -> None:
    """Though it is small, or 0 where a search begins; read at once, it is right."""
    y = lag(STEPS) + gain * STEPS
    ranges = {"k": (-3.0, 3.0)} if "K" in out else {"k": 1.0}
    fmu = sb.Fmu(built(tmp_path / "rig.fmu", out=out, mode=1), parameters=ranges)
    with pytest.raises(ValueError, match="at once"):
        sb.GreyBox(fmu, starts=1).fit(record(y, STEPS))
    remedy = sb.Fmu(built(tmp_path / "at_once.fmu", out=out), parameters=ranges)
    model = sb.GreyBox(remedy, starts=1).fit(record(y, STEPS)[:80])
    np.testing.assert_allclose(model.predict(20, u=STEPS[80:]).y[:, 0], y[80:], atol=1e-5)


@compiled
def test_a_gain_computed_in_the_step_is_found_from_0_on(tmp_path: Path) -> None:
    path = built(tmp_path / "rig.fmu", out="r[K] * r[U]", mode=1)
    fmu = sb.Fmu(path, parameters={"k": (-3.0, 3.0)})
    model = sb.GreyBox(fmu, starts=1).fit(record(2 * STEPS, STEPS))
    assert model.parameters["used"]["k"] == pytest.approx(2.0)


def optional(time: Array, inputs: Array | None = None) -> Array:
    return 0 * time if inputs is None else lag(inputs[:, 0])


def keyword(time: Array, *, u: Array | None = None) -> Array:
    return optional(time, u)


class Tolerant:
    """Run with or without inputs, by the arguments that there are."""

    def simulate(self, *args: Array) -> Array:
        return optional(*args)


class Told(Tolerant):
    """Say that it takes the inputs."""

    driven = True


def drag(time: Array, u0: float = 1.0) -> Array:
    return u0 * time


def named(time: Array, u: Array | None = None) -> Array:
    return optional(time, u)


DRIVEN = record(lag(STEPS), STEPS)
ALONE = record(lag(STEPS), None)
DATED = record(np.sin(TIME), None, start=pd.Timestamp("2024-01-01 00:00:07"))
NAMED = record(lag(STEPS), STEPS, inputs=("u0",))


def summed(time: Array, u: Array) -> Array:
    return np.asarray(u.sum(axis=1))


def by_parameter() -> sb.Ode:
    return sb.Ode(lambda t, x, p: [-p[0] * x[0]], [1.0], parameters={"k": (0.1, 5)})


def by_clock() -> sb.Function:
    return sb.Function(np.sin, start="record")


REFUSED: dict[str, tuple[Callable[[], Any], sb.Record, str]] = {
    "inputs by another name": (lambda: sb.Function(optional), DRIVEN, "inputs=None.*call it u"),
    "inputs by keyword": (lambda: sb.Function(keyword), DRIVEN, "u=None.*without a [*] before"),
    "any number of arguments": (Tolerant, DRIVEN, r"[*]args is the record's inputs.*call it u"),
    "an input's name for a constant": (lambda: sb.Function(drag), NAMED, "u0=1.0 is the"),
    "no inputs": (lambda: sb.Function(summed), ALONE, "record has none"),
    "parameters for inputs": (by_parameter, DRIVEN, r"\(t, x, u, p\).*got \(t, x, p\)"),
    "a clock of dates": (by_clock, DATED, "shows dates"),
}


@pytest.mark.parametrize("what", REFUSED)
def test_what_may_mean_two_things_is_refused(what: str) -> None:
    make, of, message = REFUSED[what]
    with pytest.raises(ValueError, match=message) as found:
        simulated(make(), of)
    assert "\n" not in str(found.value)


def test_the_remedies_work() -> None:
    np.testing.assert_allclose(simulated(sb.Function(named), DRIVEN), DRIVEN.y)
    np.testing.assert_allclose(simulated(Told(), DRIVEN), DRIVEN.y)
    np.testing.assert_array_equal(simulated(Tolerant(), ALONE), 0 * ALONE.y)
    sine = simulated(sb.Function(np.sin, start=7), DATED)
    np.testing.assert_allclose(sine[:, 0], np.sin(TIME + 7))


class Timed(Tolerant):
    """Say when it begins, and what it is called."""

    start, name = 7, "rig"

    def simulate(self, time: Array) -> Array:  # type: ignore[override]
        return np.sin(time)


def test_an_object_of_ones_own_says_when_it_begins_and_what_it_is_called() -> None:
    np.testing.assert_allclose(simulated(Timed(), DATED), np.sin(TIME + 7)[:, None])
    with pytest.raises(ValueError, match="simulator rig must return"):
        simulated(Timed(), record(np.column_stack([WAVE, STEPS]), None))
    with pytest.raises(ValueError, match=r"must have a method simulate.*got function.*sb.Function"):
        sb.Simulation(named)  # type: ignore[arg-type]


@compiled
def test_the_command_line_skips_an_input_and_says_what_it_cannot_tell(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    built(Path("Plant.fmu").resolve(), inputs=("a",), output="y")
    code = "def f(time, inputs=None): return 0 * time\ndef rhs(t, x, u): return [u[0] - x[0]]"
    Path("sim.py").write_text(code)
    frame = pd.DataFrame({"time": TIME, "w": WAVE, "v": STEPS, "y": lag(STEPS)})
    frame.to_csv("rig.csv", index=False)
    line = shlex.split("inspect rig.csv --inputs w,v --columns y --out out --simulator")
    assert main([*line, "Plant.fmu", "--simulator-inputs", ",a"]) == 0
    says = {"sim.py:f": "call it u", "sim.py:rhs": "(t, x, u, p)", "Plant.fmu": "w, v, in their or"}
    for simulator, message in says.items():
        capsys.readouterr()
        assert main([*line, simulator]) != 0
        assert message in " ".join(capsys.readouterr().err.split())

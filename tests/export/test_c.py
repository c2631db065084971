"""Exported C says what a stream says."""

import ctypes
import subprocess
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import splitband as sb
from tests.streams import BANDS, SHORT, Leaky, driven, fitted, free, in_double, rows

STRICT = ["-std=c99", "-pedantic", "-Wall", "-Wextra", "-Werror"]


class Compiled:
    """An exported program, compiled by gcc, with the methods of a stream."""

    def __init__(self, source: Path, kind: Any = ctypes.c_double) -> None:
        library = source.with_suffix(".so")
        command = ["gcc", *STRICT, "-shared", "-fPIC", str(source), "-o", str(library), "-lm"]
        subprocess.run(command, check=True)
        self.program, self.name = ctypes.CDLL(str(library)), source.stem
        self.type = np.float64 if kind is ctypes.c_double else np.float32
        self.state = ctypes.create_string_buffer(1_000_000)
        self.call("init")

    def call(self, name: str, *arrays: Any) -> int:
        given = [np.ascontiguousarray(a, dtype=self.type) for a in arrays if a is not None]
        pointers = [a.ctypes.data_as(ctypes.c_void_p) for a in given]
        status: int = getattr(self.program, f"{self.name}_{name}")(self.state, *pointers)
        return status

    def observe(self, y: Any, u: Any = None, y_sim: Any = None) -> None:
        self.call("observe", y, u, y_sim)

    def step(self, ny: int, u: Any = None, y_sim: Any = None) -> Any:
        y = np.zeros(ny, dtype=self.type)
        assert self.call("step", u, y_sim, y) == 0
        return y


def test_c_says_what_a_stream_says(
    exported: tuple[sb.Forecaster, sb.Record], tmp_path: Path
) -> None:
    forecaster, record = exported
    forecaster.export(tmp_path / "rig.c")
    compiled, stream = Compiled(tmp_path / "rig.c"), forecaster.stream()
    at = rows(record, stream)
    rng = np.random.default_rng(0)
    observing, worst, scale = False, 0.0, np.std(record.y)
    for n in range(300):
        row = n % (len(record) - 1)
        observing ^= bool(rng.random() < 0.03)
        if observing:
            y = np.where(rng.random(record.ny) < 0.02, np.nan, record.y[row])
            stream.observe(y, **at(row))
            compiled.observe(y, **at(row))
        else:
            said = compiled.step(record.ny, **at(row))
            worst = max(worst, np.abs(said - stream.step(**at(row))).max())
    assert worst < 1e-9 * scale


@pytest.mark.parametrize(
    ("steps", "precision", "kind", "most"),
    [(10_000, "double", ctypes.c_double, 1e-9), (1000, "float", ctypes.c_float, 1e-4)],
)
def test_many_steps_differ_by_rounding(
    steps: int, precision: str, kind: Any, most: float, tmp_path: Path
) -> None:
    forecaster, record = fitted("gru, no inputs")
    if precision == "float":  # of weights in single precision
        forecaster = sb.Single(sb.GRU(6), SHORT).fit(record)
    forecaster.export(tmp_path / "rig.c", precision=precision)  # type: ignore[arg-type]
    compiled, stream = Compiled(tmp_path / "rig.c", kind), forecaster.stream()
    errors = [np.abs(compiled.step(1) - stream.step()).max() for _ in range(steps)]
    assert max(errors) < most * np.std(record.y)


def test_too_few_samples_leave_everything_as_it_is(tmp_path: Path) -> None:
    record = free()
    forecaster = sb.Single(sb.GRU(3), SHORT).fit(record)
    forecaster.export(tmp_path / "rig.c")
    compiled = Compiled(tmp_path / "rig.c")
    compiled.call("clear")
    y = np.full(1, 7.0)
    for n in range(20):
        assert compiled.call("step", y) == 1
        compiled.observe(record.y[n])
    assert y == 7.0
    assert compiled.step(1) == pytest.approx(forecaster.stream(record[:20]).step(), rel=1e-9)


def test_the_simulator_of_a_saved_model_need_not_be_there(tmp_path: Path) -> None:
    record = free()
    model = sb.Residual(sb.Function(np.sin), sb.GRU(3), settings=SHORT).fit(record[:150])
    model.save(tmp_path / "model")
    sb.load(tmp_path / "model").export(tmp_path / "rig.c")
    assert "Begin with nothing measured: the simulator was not" in (tmp_path / "rig.h").read_text()
    compiled, stream = Compiled(tmp_path / "rig.c"), model.stream(record[:20])
    for n in range(20):
        compiled.observe(record.y[n], y_sim=np.sin(0.1 * n))
    assert compiled.step(1, y_sim=np.sin(2.0)) == pytest.approx(
        stream.step(y_sim=np.sin(2.0)), rel=1e-6
    )


def test_a_hybrid_without_its_equation_is_given_what_that_says(tmp_path: Path) -> None:
    record = driven()

    def tank(t: float, x: Any, u: Any, p: Any) -> list[float]:
        return [p.gain * u[0] - p.rate * x[0]]

    ode = sb.Ode(tank, [0.0], parameters={"gain": (0.1, 10.0), "rate": (0.1, 5.0)})
    first = sb.Record(record.y[:, 0], 0.1, u=record.u)
    model = sb.Residual(sb.GreyBox(ode, starts=1), sb.GRU(3), settings=SHORT).fit(first[:150])
    in_double(model)
    model.save(tmp_path / "model")
    files = sb.load(tmp_path / "model").export(tmp_path / "rig.c")
    compiled, stream = Compiled(files[0]), model.stream()
    said = model.predict(60, u=record.u[150:210]).components["grey-box"]
    for n in range(150, 210):
        u = record.u[n]
        if n < 200:
            stream.observe(first.y[n], u)
            compiled.observe(first.y[n], u, said[n - 150])
        else:
            found = compiled.step(1, u, said[n - 150])
            np.testing.assert_allclose(found, stream.step(u), atol=1e-9)
    sb.GreyBox(ode, starts=1).fit(first[:20]).save(tmp_path / "grey")
    with pytest.raises(ValueError, match="simulator must be given"):
        sb.load(tmp_path / "grey").export(tmp_path / "grey.c")


def test_a_header_says_what_is_given_and_may_be_nan(tmp_path: Path) -> None:
    record = driven()
    level = record.resample(2).detrend()
    for each, said in (
        (record, "NaN in y marks a sample that was not measured; u must be finite."),
        (level, f"y[2]: y0 (minus {level.reading.levels['y0']:.6g}), y1 (minus"),
    ):
        model = sb.Linear().fit(each)
        model.export(tmp_path / "rig.c")
        assert said in (tmp_path / "rig.h").read_text()
    compiled, u = Compiled(tmp_path / "rig.c"), np.array([0.5, 0.1])
    np.testing.assert_allclose(compiled.step(2, u), model.predict(1, u=u[None]).y[0], rtol=1e-9)


def test_a_history_that_does_not_tell_the_state_is_said(tmp_path: Path) -> None:
    record = driven()
    never = replace(record[:10], measured=np.array([[True, False]] * 10))
    model = sb.Persistence().fit(record)
    with pytest.warns(UserWarning, match=r"needs 1 measured sample\(s\) before .*the history"):
        model.export(tmp_path / "rig.c", history=never)
    assert Compiled(tmp_path / "rig.c").call("step", np.zeros(2), np.zeros(2)) == 1


def test_what_cannot_be_exported_is_named(tmp_path: Path) -> None:
    record = free()
    own = sb.Single(Leaky(), SHORT).fit(record)
    split = sb.Split(sb.GRU(3), sb.GRU(3), BANDS, True, settings=SHORT).fit(record)
    mean = sb.Mean().fit(record)
    for forecaster, name, message in (
        (own, "rig.c", "the cell Leaky cannot be exported"),
        (split, "rig.c", "filtered forwards and backwards"),
        (mean, "rig.txt", r"path must end with one of \.c, "),
        (mean, "my rig.c", r"such as my_rig\.c, got my rig\.c"),
    ):
        with pytest.raises(ValueError, match=message):
            forecaster.export(tmp_path / name)
    assert not [*tmp_path.iterdir()]


def test_what_single_precision_cannot_hold_saturates(tmp_path: Path) -> None:
    """As a literal, for instance of a threshold; it is finite, and no word that C does not know."""
    sb.Mean().fit(sb.Record(np.full((20, 1), 1e100), 0.1)).export(tmp_path / "rig.c", "float")
    assert "inff" not in (tmp_path / "rig.c").read_text()
    subprocess.run(["gcc", *STRICT, "-fsyntax-only", str(tmp_path / "rig.c")], check=True)

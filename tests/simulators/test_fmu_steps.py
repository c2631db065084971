"""Communication steps of FMUs, and events exactly on a sample: closed forms, and FMPy."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest

import splitband as sb
from splitband.cli import main
from tests.simulators.fmus import COMPILES, built

fmpy = pytest.importorskip("fmpy")
if not COMPILES:
    pytest.skip("no gcc to compile an FMU with", allow_module_level=True)

Array = npt.NDArray[np.float64]
DT = 0.5
U: Array = np.repeat(np.random.default_rng(0).uniform(0, 1, 12), 5)
TIME: Array = DT * np.arange(float(len(U)))


def euler(path: Path, **how: Any) -> Path:
    """x' = u - k x, by one step of Euler in a communication step."""
    return built(path, slope="r[U] - r[K] * r[X]", substeps=0, **how)


def by_euler(count: int, k: float = 1.0, u: Array = U) -> Array:
    """The same with `count` steps from a sample to the next, in closed form."""
    a, y = (1 - k * DT / count) ** count, np.zeros(len(u))
    for n in range(len(u) - 1):
        y[n + 1] = a * y[n] + (1 - a) / k * u[n]
    return y


@pytest.mark.filterwarnings("ignore:.* is taken not to depend on the inputs at once")
@pytest.mark.parametrize("version", [2, 3])
def test_an_fmu_makes_the_steps_that_it_declares_between_samples(
    version: int, tmp_path: Path
) -> None:
    path = euler(tmp_path / "own.fmu", version=version, declared=0.01)
    with sb.Fmu(path) as fmu:
        found = np.asarray(fmu.simulate(TIME, U[:, None]))[:, 0]
    np.testing.assert_allclose(found, by_euler(50), atol=1e-12)
    signals: Any = np.repeat(TIME, 2)[1:], np.repeat(U, 2)[:-1]
    table = np.rec.fromarrays(signals, names="time,u")  # type: ignore[call-overload]
    by_fmpy = fmpy.simulate_fmu(
        str(path), input=table, stop_time=TIME[-1], output_interval=0.01, fmi_type="CoSimulation"
    )
    np.testing.assert_allclose(found, by_fmpy["y"][::50], atol=1e-9)
    record = sb.Record(by_euler(50, 2.0), DT, u=U)
    model = sb.GreyBox(sb.Fmu(path, parameters={"k": (0.2, 5.0)})).fit(record)
    assert model.estimate.values == pytest.approx({"k": 2.0}, rel=1e-6)


def test_a_step_that_does_not_divide_the_sampling_time_is_refused_and_the_nearest_work(
    tmp_path: Path,
) -> None:
    path = euler(tmp_path / "own.fmu")
    with pytest.raises(ValueError, match=r"must divide .* 0.5 s: got 0.2; .* 0.166666667 or 0.25$"):
        sb.Fmu(path, step=0.2).simulate(TIME, U[:, None])
    for step, count in ((0.166666667, 3), (0.25, 2)):
        with pytest.warns(UserWarning, match="depends on the communication step"):
            found = np.ravel(sb.Fmu(path, step=step).simulate(TIME, U[:, None]))
        np.testing.assert_allclose(found, by_euler(count), atol=1e-12)
    with pytest.raises(ValueError, match=r"got 0.7; the nearest are 0.5$"):
        sb.Fmu(path, step=0.7).simulate(TIME, U[:, None])
    with pytest.raises(ValueError, match=r"must be left out for .*model exchange"):
        sb.Fmu(built(tmp_path / "exchange.fmu", ("ModelExchange",)), step=0.1)


def test_a_declared_step_that_does_not_divide_the_sampling_time_is_said(tmp_path: Path) -> None:
    fmu = sb.Fmu(euler(tmp_path / "own.fmu", declared=0.03))
    with pytest.warns(UserWarning, match=r"declares .* 0.03 s, and is run with 0.0294118 s.*0.5 s"):
        found = np.ravel(fmu.simulate(TIME, U[:, None]))
    np.testing.assert_allclose(found, by_euler(17), atol=1e-12)


def test_a_step_that_is_refused_is_named_and_the_one_that_is_taken_can_be_given(
    tmp_path: Path,
) -> None:
    path = euler(tmp_path / "fixed.fmu", fixed=0.1)
    words = r"stopped at 0 s, in a step of 0.5 s: .*declares no step, and step \(--simulator-step\)"
    with pytest.raises(ValueError, match=words):
        sb.Fmu(path).simulate(TIME, U[:, None])
    known = sb.Fmu(path, step=0.1), sb.Fmu(euler(tmp_path / "own.fmu", fixed=0.1, declared=0.1))
    for fmu in known:
        with warnings.catch_warnings():
            warnings.filterwarnings("ignore", ".* is taken not to depend on the inputs at once")
            found = np.ravel(fmu.simulate(TIME, U[:, None]))
        np.testing.assert_allclose(found, by_euler(5), atol=1e-12)
    with (
        pytest.warns(UserWarning, match=r"declares a .* 0.1 s, and is run with 0.05 s"),
        pytest.raises(ValueError, match=r"in a step of 0.05 s.*declares a step of 0.1 s"),
    ):
        known[1].simulate(0.1 * TIME, U[:, None])


def test_it_is_said_where_the_result_depends_on_the_step(tmp_path: Path) -> None:
    path = euler(tmp_path / "coarse.fmu")
    apart = np.abs(by_euler(2) - by_euler(1)).max() / np.ptp(by_euler(2))
    with pytest.warns(UserWarning, match=f"0.25 s in place of 0.5 s .* by up to {apart:.2g} of"):
        sb.Fmu(path).simulate(TIME, U[:, None])
    sb.Fmu(path, step=0.005).simulate(TIME, U[:, None])  # warnings are errors here
    sb.Fmu(built(tmp_path / "fine.fmu")).simulate(TIME, U[:, None])
    # It does not at the middle of the range, but at the value that is found.
    fmu = sb.Fmu(path, parameters={"k": (0.001, 2.0)}, step=0.125)
    found = sb.identify(fmu, sb.Record(by_euler(4, 1.5), DT, u=U))
    assert "0.0625 s in place of 0.125 s it changes by up to" in str(found)


@pytest.mark.parametrize("condition", [">", ">="])
@pytest.mark.parametrize("limit", [0.0, 1.0, 2.5])
def test_an_event_exactly_on_a_sample_gives_the_value_after_it(
    limit: float, condition: str, tmp_path: Path
) -> None:
    """x' = 1 until x = `limit`, where the input is taken away; the indicator is then exactly 0."""
    path = built(
        tmp_path / "event.fmu",
        ("ModelExchange",),
        slope="r[V] ? 0.0 : r[U]",
        limit=limit,
        out="r[X] + 10 * r[V]",
        exceeded=f"r[X] {condition} LIMIT",
    )
    for start in (0.0, 1e9):
        found = np.ravel(sb.Fmu(path).simulate(start + TIME[:20], np.ones((20, 1))))
        after = TIME[:20] >= limit
        np.testing.assert_allclose(found, np.where(after, limit + 10, TIME[:20]), atol=2e-5)


def test_parameters_that_an_fmu_computes_or_keeps_are_refused(tmp_path: Path) -> None:
    path = euler(tmp_path / "own.fmu")
    with pytest.raises(ValueError, match=r"can be set, got y of .*; it has .*x, k"):
        sb.Fmu(path, parameters={"y": (0.0, 1.0)})


@pytest.mark.filterwarnings("default:y of .* depends on the communication step")
def test_the_command_line_takes_a_step_and_a_saved_model_keeps_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    path = euler(tmp_path / "own.fmu")
    rows = np.column_stack([by_euler(100, 2.0), U])
    np.savetxt("rig.csv", rows, delimiter=",", header="y,u", comments="")
    line = "fit rig.csv --method simulator --inputs u --sampling-time 0.5 --out model --simulator "
    line += f"{path} --parameters k=0.2:5 --simulator-step"
    assert main(f"{line} 0.2".split()) == 2
    assert "--simulator-step" in capsys.readouterr().err
    assert main(f"{line} 0.005".split()) == 0
    ahead = "simulate model --steps 3 --future-inputs rig.csv --out a.csv --simulator"
    capsys.readouterr()
    assert main([*ahead.split(), str(path)]) == 0
    assert "another one" not in (out := capsys.readouterr()).out + out.err
    plain = "fit rig.csv --method simulator --inputs u --sampling-time 0.5 --out m --simulator"
    assert main([*plain.split(), str(path)]) == 0
    assert "warning: y of " in capsys.readouterr().out  # from a process of its own
